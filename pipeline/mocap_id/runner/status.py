"""What of a trial is done, what would be computed anew and why; and taking away what was made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from filelock import Timeout

from mocap_id.config import Trial
from mocap_id.errors import MocapIdError, StoreError
from mocap_id.runner.dependencies import FileHashes, cache_key, parameters
from mocap_id.runner.execution import LOG_FILE
from mocap_id.runner.log import RUN_LOG, last_failure
from mocap_id.runner.refusals import forget_refusal, remembered
from mocap_id.stages import STAGES, Stage
from mocap_id.store import Folder, Origin
from mocap_id.store.locking import LOCK, lock_in

State: TypeAlias = Literal["done", "stale", "missing", "damaged", "refused", "waiting"]


@dataclass(frozen=True)
class Standing:
    """How a stage stands.

    Parameters
    ----------
    stage : str
    state : {"done", "stale", "missing", "damaged", "refused", "waiting"}
        ``stale`` was made of something else than the trial now says; ``waiting`` stands behind a stage that is not
        done, so that nothing can be said of it.
    why : str
        Empty for what is done.
    """

    stage: str
    state: State
    why: str = ""


@dataclass(frozen=True)
class Status:
    """How a trial stands.

    Parameters
    ----------
    stages : tuple of Standing
        In their order.
    running : bool
        Whether a run holds the folder at the moment.
    failure : str or None
        How the last run ended, if it failed.
    """

    stages: tuple[Standing, ...]
    running: bool
    failure: str | None

    @property
    def done(self) -> bool:
        """Whether a run would compute nothing."""
        return all(one.state in ("done", "refused") for one in self.stages) and self.failure is None


def status(trial: Trial, stages: Sequence[Stage] = STAGES) -> Status:
    """Look at a trial's folder; nothing is written, nothing computed."""
    folder = Folder(trial.out)
    try:
        folder.there()
    except StoreError as error:
        first, *later = (stage.name for stage in stages)
        waiting = (Standing(name, "waiting", f"for {first}") for name in later)
        return Status((Standing(first, "damaged", str(error)), *waiting), False, None)
    return Status(tuple(_standings(trial, folder, stages)), _held(trial.out), last_failure(trial.out))


def clean(trial: Trial, first: str | None = None, stages: Sequence[Stage] = STAGES) -> None:
    """Take away what runs have made: everything, or what the stages from one on made.

    Only files that stages or the runner wrote are touched; what else lies in the folder stays, and so does the folder
    if it is then not empty.

    Parameters
    ----------
    trial : Trial
    first : str, optional
        Name of the first stage whose outputs go.

    Raises
    ------
    StoreError
        A run holds the folder, or it cannot be looked into or changed.
    """
    folder, names = Folder(trial.out), [stage.name for stage in stages]
    if not folder.there():
        return
    with folder.locked():
        for stage in stages[0 if first is None else names.index(first) :]:
            folder.forget(stage.name, stage.outputs)
        forget_refusal(trial.out)
        if first is None:
            folder.remove([LOG_FILE, RUN_LOG])
            folder.dissolve()


def _standings(trial: Trial, folder: Folder, stages: Sequence[Stage]) -> Iterator[Standing]:
    files, before = FileHashes(trial), None
    for stage in stages:
        if before is not None:
            yield Standing(stage.name, "waiting", f"for {before}")
            continue
        standing = _standing(trial, folder, files, stage)
        if standing.state == "refused":
            yield standing
            later = stages[stages.index(stage) + 1 :]
            yield from (Standing(other.name, "refused", f"by {stage.name}") for other in later)
            return
        before = None if standing.state == "done" else stage.name
        yield standing


def _standing(trial: Trial, folder: Folder, files: FileHashes, stage: Stage) -> Standing:
    try:
        hashes = files.of(stage) | {file: folder.key(file) for file in stage.inputs}
    except MocapIdError as error:
        return Standing(stage.name, "missing", str(error))
    wanted = parameters(trial, stage)
    refused = remembered(trial.out, stage.name, cache_key(stage, wanted, hashes))
    if refused is not None:
        return Standing(stage.name, "refused", refused.message)
    missing = [file for file in stage.outputs if not folder.exists(file)]
    if missing:
        return Standing(stage.name, "missing", f"there is no {missing[0]}")
    try:
        origin = folder.origin(stage.name, stage.outputs)
    except StoreError as error:
        return Standing(stage.name, "damaged", str(error))
    if origin is None:
        return Standing(stage.name, "damaged", "its files were not written together: one was changed or exchanged")
    if origin.key == cache_key(stage, wanted, hashes):
        return Standing(stage.name, "done")
    return Standing(stage.name, "stale", "; ".join(_changes(origin, stage, wanted, hashes)) or "it told of a refusal")


def _changes(origin: Origin, stage: Stage, wanted: Mapping[str, Any], hashes: Mapping[str, str]) -> Iterator[str]:
    """In what the computation that made the files differs from the one that would be made now."""
    if origin.stage_version != stage.version:
        yield f"made by version {origin.stage_version} of the stage, which is at {stage.version}"
    for file in sorted({*hashes, *origin.inputs}):
        if hashes.get(file) != origin.inputs.get(file):
            yield f"{file} is another one"
    before, now = dict(_leaves(origin.parameters)), dict(_leaves(wanted))
    for key in sorted({*before, *now}):
        if before.get(key) != now.get(key):
            yield f"{key} was {before.get(key)}, is {now.get(key)}"


def _leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _leaves(inner, f"{key}.{name}" if key else str(name))
    else:
        yield key, value


def _held(folder: Path) -> bool:
    own = folder / ".mocap-id"
    if not (own / LOCK).is_file():
        return False
    try:
        with lock_in(own).acquire(timeout=0):
            return False
    except Timeout:
        return True
    except OSError:  # it may not be opened, so that nobody can tell; a lock by itself is no run
        return False
