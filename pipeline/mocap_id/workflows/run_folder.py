"""Run folders on disk: complete runs, partial runs and refused trials, opened by YAML file or by folder."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap_id import runner
from mocap_id.config import Trial, load
from mocap_id.errors import ConfigError, StoreError
from mocap_id.store import ArtefactSet, Folder, Provenance
from mocap_id.store.schemas import SCHEMAS

if TYPE_CHECKING:
    from mocap_id.store import Artefact

SUMMARY = "summary.json"


@dataclass(frozen=True)
class RunFolder(ArtefactSet):
    """The artefacts and the summary in a run folder.

    Parameters
    ----------
    source : Path
        The YAML file or folder given on the command line.
    path : Path
        The folder.
    artefacts : mapping of str to Table, LongTable or Tree
        Artefacts by file name; missing ones are absent.
    provenance : mapping of str to Provenance
        Provenance of these artefacts.
    """

    source: Path
    path: Path
    artefacts: Mapping[str, Artefact]
    provenance: Mapping[str, Provenance]

    @cached_property
    def name(self) -> str:
        """The trial's name."""
        names = (each.origin.parameters.get("trial") for each in self.provenance.values())
        return str(next((name for name in names if name), self.summary.get("trial") or self.path.resolve().name))

    @cached_property
    def summary(self) -> Mapping[str, Any]:
        """Content of summary.json; empty if there is no such file.

        Raises
        ------
        StoreError
            The file is not JSON.
        """
        file = self.path / SUMMARY
        try:
            found: Mapping[str, Any] = json.loads(file.read_text("utf-8"))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise StoreError(f"{file} cannot be read ({error}): delete it and run `mocap-id report` again") from error
        return found

    @property
    def in_space(self) -> bool:
        """Whether the trial has `space: 3d`."""
        from mocap_id.store.spatial_views import is_in_space  # noqa: PLC0415  most commands do not ask

        return is_in_space(self.facts("planar.parquet"))

    def why_missing(self, file: str) -> str:
        """Return why an artefact, or the data in it, is missing."""
        if file == "angles.parquet" and file in self.artefacts and not self.in_space:
            return "a trial in the plane has no anatomical angles: see its `states`"
        if file in self.artefacts:
            return str(self.facts(file).get("why") or f"{file} gives no reason")
        refusals = [
            f"the trial was refused ({reason['code']}) before {file} was made"
            for reason in self.summary.get("verdict", {}).get("reasons", ())
            if reason["level"] == "refused"
        ]
        return refusals[0] if refusals else f"{file} is not in {self.path}"


def open_run(path: Path, progress: runner.Progress = lambda step: None) -> RunFolder:
    """Open a run with all artefacts that it has.

    Parameters
    ----------
    path : Path
        A trial's YAML file: missing or outdated results are computed first. Or a run folder, which is read unchanged.
    progress : callable, optional
        Called with each step of a run.

    Raises
    ------
    StoreError
        The folder has no artefacts, a damaged one, or artefacts of different runs.
    ConfigError, RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`. A refused trial raises nothing: the folder describes the refusal.
    """
    if not path.exists():
        raise ConfigError(f"{path}: no such file or folder; expected a trial's YAML file or a run folder, runs/<trial>")
    where = path if path.is_dir() else runner.run(load(path), progress=progress).folder
    folder = Folder(where)
    files = _existing(folder)
    artefacts = {file: folder.read(file) for file in files}
    return RunFolder(path, where, artefacts, check_provenance(folder, files))


def open_lazily(path: Path) -> RunFolder:
    """Open a run folder whose artefacts are read when they are first used.

    An artefact is checked when it is read: StoreError where it is damaged, or was made from another version of its
    inputs than those in the folder. ``provenance`` is empty.

    Raises
    ------
    StoreError
        The folder has neither artefacts nor a summary, which a trial refused at once has.
    """
    folder = Folder(path)
    if not (path / SUMMARY).is_file():
        _existing(folder)
    return RunFolder(path, path, _LazyArtefacts(folder), {})


class _LazyArtefacts(Mapping[str, "Artefact"]):
    """The artefacts in a folder by file name, read when they are used."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder

    def __getitem__(self, file: str) -> Artefact:
        if file not in self:
            raise KeyError(file)
        for needed, key in self._folder.provenance(file).origin.inputs.items():
            if needed in self and self._folder.key(needed) != key:
                raise _made_from_another(self._folder, file, needed)
        return self._folder.read(file)

    def __contains__(self, file: object) -> bool:
        return file in SCHEMAS and self._folder.exists(str(file))

    def __iter__(self) -> Iterator[str]:
        return iter([file for file in SCHEMAS if file in self])

    def __len__(self) -> int:
        return len(list(iter(self)))


def _existing(folder: Folder) -> list[str]:
    """Return the artefacts in a folder; StoreError if there are none."""
    files = [file for file in SCHEMAS if folder.exists(file)]
    if not files:
        raise StoreError(
            f"{folder.path} holds no artefacts of a run: expected a trial's YAML file or a run folder such as "
            "runs/<trial>"
        )
    return files


def _made_from_another(folder: Folder, file: str, needed: str) -> StoreError:
    return StoreError(
        f"{folder.path / file} was made from another {needed} than the one beside it: run the trial again "
        "(`mocap-id run TRIAL.yaml`)"
    )


def open_run_to(path: Path, stage: str, progress: runner.Progress = lambda step: None) -> tuple[Folder, Trial | None]:
    """Open a trial's run folder, computed as far as one stage.

    Parameters
    ----------
    path : Path
        As for :func:`open_run`.
    stage : str
        The last stage that has to run.
    progress : callable, optional
        Called with each step of a run.

    Returns
    -------
    folder : Folder
    trial : Trial or None
        The configuration in a YAML file; None for a run folder.

    Raises
    ------
    Refused
        The trial was refused.
    ConfigError, RecordingError, NumericalError, StoreError
        As for :func:`mocap_id.runner.run`.
    """
    if path.is_dir():
        return Folder(path), None
    trial = load(path)
    outcome = runner.run_to(trial, stage, progress=progress)
    if outcome.refused is not None:
        raise outcome.refused
    return Folder(outcome.folder), trial


def check_provenance(folder: Folder, files: Iterable[str]) -> dict[str, Provenance]:
    """Return the provenance of artefacts after checking that they were made from one another.

    Raises
    ------
    StoreError
        An artefact is missing or damaged, or was made from another version of its input than the one in the folder.
    """
    found = {file: folder.provenance(file) for file in files}
    for file, about in found.items():
        for needed, key in about.origin.inputs.items():
            if needed in found and found[needed].origin.key != key:
                raise _made_from_another(folder, file, needed)
    return found
