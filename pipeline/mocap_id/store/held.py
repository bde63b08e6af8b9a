"""Looking into a run's artefacts, of which some may not have been made."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.store.artefacts import Artefact, Facts, LongTable, Table, Tree


class Held:
    """What holds ``artefacts`` by their file names; those that were not made are absent."""

    artefacts: Mapping[str, Artefact]

    def table(self, file: str) -> Table | None:
        """A Parquet artefact, None where it is absent."""
        artefact = self.artefacts.get(file)
        return artefact if isinstance(artefact, Table) else None

    def long(self, file: str) -> LongTable | None:
        """A Parquet artefact with a row for every frame and marker, None where it is absent."""
        artefact = self.artefacts.get(file)
        return artefact if isinstance(artefact, LongTable) else None

    def tree(self, file: str) -> Tree | None:
        """An HDF5 artefact, None where it is absent."""
        artefact = self.artefacts.get(file)
        return artefact if isinstance(artefact, Tree) else None

    def facts(self, file: str) -> Facts:
        """The facts beside an artefact, empty where it is absent."""
        artefact = self.artefacts.get(file)
        return artefact.facts if artefact is not None else {}
