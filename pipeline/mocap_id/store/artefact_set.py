"""Sets of artefacts in which some may be absent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from mocap_id import store

if TYPE_CHECKING:
    from mocap_id.store.artefacts import Artefact, Facts, LongTable, Table, Tree


class ArtefactSet:
    """Base of classes with an attribute ``artefacts``: artefacts by file name, of which some may be absent."""

    artefacts: Mapping[str, Artefact]

    def table(self, file: str) -> Table | None:
        """Return the Parquet artefact ``file``; None if it is absent or has a row for every frame and marker."""
        artefact = self.artefacts.get(file)
        return artefact if isinstance(artefact, store.Table) else None

    def long(self, file: str) -> LongTable | None:
        """Return the Parquet artefact ``file``, which has a row for every frame and marker; None if it is absent."""
        artefact = self.artefacts.get(file)
        return artefact if isinstance(artefact, store.LongTable) else None

    def tree(self, file: str) -> Tree | None:
        """Return the HDF5 artefact ``file``; None if it is absent."""
        artefact = self.artefacts.get(file)
        return artefact if isinstance(artefact, store.Tree) else None

    def facts(self, file: str) -> Facts:
        """Return the facts of an artefact; empty if it is absent."""
        artefact = self.artefacts.get(file)
        return artefact.facts if artefact is not None else {}
