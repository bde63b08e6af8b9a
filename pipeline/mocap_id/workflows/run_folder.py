"""Run folders on disk: complete runs, partial runs and refused trials, opened from a YAML file or a folder."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap_id import plain_files, runner
from mocap_id.config import Trial, load
from mocap_id.errors import ConfigError, StoreError
from mocap_id.store import ArtefactSet, Folder, Provenance, hash_file
from mocap_id.store.atomic import write_files
from mocap_id.store.folder import Owner, check_owner, hash_path, hash_texts, read_owner, store_owner
from mocap_id.store.provenance import SCHEMAS

if TYPE_CHECKING:
    from mocap_id.reporting.results import CommandResult
    from mocap_id.store import Artefact

SUMMARY = "summary.json"


@dataclass(frozen=True)
class RunFolder(ArtefactSet):
    """The artefacts and the summary in a run folder."""

    source: Path  # the YAML file or folder that the user gave
    path: Path  # the run folder
    artefacts: Mapping[str, Artefact]  # existing artefacts by file name
    provenance: Mapping[str, Provenance]  # provenance of these artefacts by file name

    @cached_property
    def name(self) -> str:
        names = (each.origin.parameters.get("trial") for each in self.provenance.values())
        return str(next((name for name in names if name), self.summary.get("trial") or self.path.resolve().name))

    @cached_property
    def summary(self) -> Mapping[str, Any]:
        """Content of summary.json, empty if there is no such file; StoreError is raised if it cannot be read."""
        file = self.path / SUMMARY
        try:
            summary = json.loads(file.read_text("utf-8"))
            if not isinstance(summary, dict) or summary.get("schema") != "mocap-id/summary":
                raise ValueError("it is not the summary of a trial")
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, RecursionError) as error:
            raise StoreError(f"{file} cannot be read ({error}): delete it and run `mocap-id report` again") from error
        return summary

    def why_missing(self, file: str) -> str:
        """Return the reason why an artefact, or its data, is missing."""
        if file == "angles.parquet" and file in self.artefacts and not self.in_space:
            return "a trial in the plane has no anatomical angles: use its `states`"
        if file in self.artefacts:
            return str(self.facts(file).get("why") or f"{file} does not contain the reason")
        refusals = [
            f"the trial was refused ({reason['code']}) before {file} was made"
            for reason in self.summary.get("verdict", {}).get("reasons", ())
            if reason["level"] == "refused"
        ]
        return refusals[0] if refusals else f"{file} is not in {self.path}"


def open_run(path: Path, progress: runner.Progress = lambda step: None) -> RunFolder:
    """Open a run, read all its artefacts, and return them.

    If ``path`` is a trial's YAML file, missing or outdated results are computed first. If it is a run folder, it is
    read and not changed. ``progress`` is called with each step of a run. StoreError is raised if the folder has no
    artefacts, a damaged artefact, or artefacts of different runs, and the errors of :func:`mocap_id.runner.run`. A
    refused trial raises nothing; its run folder describes the refusal.
    """
    if not path.exists():
        raise ConfigError(
            f"{path}: no such file or folder; expected a trial's YAML file or a run folder, runs/<trial>"
            f"{plain_files.suggest(path)}"
        )
    run_folder = path if path.is_dir() else runner.run(load(path), progress=progress).folder
    folder = Folder(run_folder)
    files = _list_artefacts(folder)
    artefacts = {file: folder.read(file) for file in files}
    return RunFolder(path, run_folder, artefacts, check_provenance(folder, files))


def open_lazily(path: Path) -> RunFolder:
    """Open a run folder; each artefact is read when it is used, and ``provenance`` is empty.

    Reading an artefact raises StoreError if it is damaged, or if it was made from inputs that differ from those in the
    folder. StoreError is also raised if the folder has neither artefacts nor a summary. A trial that the first stage
    refused has only a summary.
    """
    folder = Folder(path)
    if not (path / SUMMARY).is_file():
        _list_artefacts(folder)
    return RunFolder(path, path, _LazyArtefacts(folder), {})


class _LazyArtefacts(Mapping[str, "Artefact"]):
    """The artefacts in a folder by file name; each artefact is read when it is used."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder

    def __getitem__(self, file: str) -> Artefact:
        if file not in self:
            raise KeyError(file)
        for needed, key in self._folder.provenance(file).origin.inputs.items():
            if needed in self and self._folder.key(needed) != key:
                raise _report_mismatch(self._folder, file, needed)
        return self._folder.read(file)

    def __contains__(self, file: object) -> bool:
        return file in SCHEMAS and self._folder.exists(str(file))

    def __iter__(self) -> Iterator[str]:
        return (file for file in SCHEMAS if file in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _list_artefacts(folder: Folder) -> list[str]:
    """Return the file names of the artefacts in a folder; raise StoreError if the folder contains no artefacts."""
    files = [file for file in SCHEMAS if folder.exists(file)]
    if not files:
        raise StoreError(
            f"{folder.path} contains no artefacts of a run: expected a trial's YAML file or a run folder such as "
            "runs/<trial>"
        )
    return files


def _report_mismatch(folder: Folder, file: str, needed: str) -> StoreError:
    return StoreError(
        f"{folder.path / file} was not made from the {needed} in this folder: run the trial again "
        "(`mocap-id run TRIAL.yaml`)"
    )


def open_run_to(path: Path, stage: str, progress: runner.Progress = lambda step: None) -> tuple[Folder, Trial | None]:
    """Return the run folder of a trial with its results up to one stage, and the trial.

    ``path`` and ``progress`` are as for :func:`open_run`; ``stage`` is the last stage that must have run. The trial is
    None if ``path`` is a folder, whose results are not checked. Refused is raised if the trial was refused, and the
    errors of :func:`mocap_id.runner.run`.
    """
    if path.is_dir():
        return Folder(path), None
    trial = load(path)
    outcome = runner.run_to(trial, stage, progress=progress)
    if outcome.refused is not None:
        raise outcome.refused
    return Folder(outcome.folder), trial


def check_provenance(folder: Folder, files: Iterable[str]) -> dict[str, Provenance]:
    """Return the provenance of artefacts by file name.

    StoreError is raised if one is missing or damaged, or was made from an input that differs from that in the folder.
    """
    provenance = {file: folder.provenance(file) for file in files}
    for file, own in provenance.items():
        for needed, key in own.origin.inputs.items():
            if needed in provenance and provenance[needed].origin.key != key:
                raise _report_mismatch(folder, file, needed)
    return provenance


def find_owner_of_files(*sources: Path) -> Owner:
    """Return the owner of results that are made from run folders, folders of studies, trials' files, or other files."""
    names: list[str] = []
    contents: list[str] = []
    folders: list[Path] = []
    for source in sources:
        folder = source
        if not source.is_dir():  # a trial's file, or another file
            with contextlib.suppress(ConfigError):
                folder = load(source).out
        folders.append(folder)
    for folder in folders:
        stored = read_owner(folder) or read_owner(folder, "study.json")
        names.append(folder.stem if stored is None else stored.name)
        contents += [hash_file(folder)] if folder.is_file() else [] if stored is None else stored.contents
    return Owner(", ".join(names), folders[0], (hash_texts([*names, *contents]),) if contents else ())


def check_ending(file: Path, *endings: str) -> None:
    """Raise ConfigError if a file name that the user gave with ``--out`` has none of these endings."""
    if file.suffix.lower() not in endings:
        raise ConfigError(f"--out {file}: expected a file name that ends in {' or '.join(endings)}")


def write_owned(folder: Path, files: Mapping[str, bytes], output: str, *sources: Path) -> None:
    """Write files that are made from ``sources``, with their owner; StoreError is raised if they belong to another.

    ``output`` identifies the files among the outputs in the folder.
    """
    owner = find_owner_of_files(*sources)
    check_owner(folder, owner, output)
    write_files(folder, files)
    store_owner(folder, owner, output)


def describe_sources(out: Path, *sources: Path) -> dict[str, list[str]]:
    """Return names and hashes of what the outputs in a folder are made from, for a document in the folder.

    Results of the same sources have a hash in common: of their content, or of the path of the first.
    """
    owner = find_owner_of_files(*sources)
    return {"names": owner.name.split(", "), "hashes": [*owner.contents, hash_path(owner.file, out)]}


def write_result(result: CommandResult, out: Path | None, *sources: Path) -> tuple[CommandResult, list[str]]:
    """Write a result into a folder, if there is one; return it with its sources, and a line about the files."""
    if out is None:
        return result, []
    result = replace(result, made_from=describe_sources(out, *sources))
    return result, [f"written to {out}: {', '.join(result.write(out))}"]
