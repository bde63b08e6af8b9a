"""Status of a trial (which stages are done, stale or missing, and why), and deletion of its outputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from filelock import Timeout

from mocap_id.config import Trial
from mocap_id.errors import MocapIdError, StoreError
from mocap_id.runner.dependencies import FileHashes, collect_parameters, compute_cache_key, find_owner
from mocap_id.runner.execution import LOG_FILE, RUN_LOG, forget_refusal, read_last_failure, read_refusal
from mocap_id.stages import STAGES, Stage
from mocap_id.store import Folder, Origin
from mocap_id.store.atomic import LOCK, create_lock
from mocap_id.store.folder import check_owner

State: TypeAlias = Literal["done", "stale", "missing", "damaged", "refused", "waiting"]


@dataclass(frozen=True)
class StageStatus:
    """Status of one stage.

    ``stale``: the outputs were made with other settings or inputs. ``waiting``: the stage depends on an earlier stage
    that is not done, so its own state is unknown.
    """

    stage: str
    state: State
    why: str = ""  # reason for the state; empty for a stage that is done


@dataclass(frozen=True)
class TrialStatus:
    """Status of a trial."""

    stages: tuple[StageStatus, ...]  # status of each stage, in the order of the pipeline
    running: bool  # whether a run has locked the folder
    failure: str | None  # message of the last run if it failed

    @property
    def done(self) -> bool:
        """Whether a run would compute nothing."""
        return all(one.state in ("done", "refused") for one in self.stages) and self.failure is None


def status(trial: Trial, stages: Sequence[Stage] = STAGES) -> TrialStatus:
    """Return the status of a trial without computing or writing anything."""
    folder, files = Folder(trial.out), FileHashes(trial)
    try:
        if folder.is_present():
            check_owner(trial.out, find_owner(trial, files))
    except StoreError as error:
        first, *later = (stage.name for stage in stages)
        waiting = (StageStatus(name, "waiting", f"for {first}") for name in later)
        return TrialStatus((StageStatus(first, "damaged", str(error)), *waiting), False, None)
    return TrialStatus(
        tuple(_find_states(trial, folder, files, stages)), _is_locked(trial.out), read_last_failure(trial.out)
    )


def clean(trial: Trial, first: str | None = None, stages: Sequence[Stage] = STAGES) -> None:
    """Delete the outputs of all stages, or of the stage ``first`` and all later stages.

    Only files that stages or the runner wrote are deleted. The folder is deleted too if it is then empty. Raises
    StoreError if a run has locked the folder, or if it cannot be read or changed, or belongs to another recording.
    """
    folder, names = Folder(trial.out), [stage.name for stage in stages]
    if not folder.is_present():
        return
    with folder.locked():
        check_owner(trial.out, find_owner(trial, FileHashes(trial)))
        for stage in stages[0 if first is None else names.index(first) :]:
            folder.remove_outputs(stage.name, stage.outputs)
        forget_refusal(trial.out)
        if first is None:
            folder.remove([LOG_FILE, RUN_LOG])
            folder.remove_if_empty()


def _find_states(trial: Trial, folder: Folder, files: FileHashes, stages: Sequence[Stage]) -> Iterator[StageStatus]:
    before = None
    for stage in stages:
        if before is not None:
            yield StageStatus(stage.name, "waiting", f"for {before}")
            continue
        found = _find_state(trial, folder, files, stage)
        yield found
        if found.state == "refused":
            later = stages[stages.index(stage) + 1 :]
            yield from (StageStatus(other.name, "refused", f"by {stage.name}") for other in later)
            return
        before = None if found.state == "done" else stage.name


def _find_state(trial: Trial, folder: Folder, files: FileHashes, stage: Stage) -> StageStatus:
    try:
        hashes = files.of(stage) | {file: folder.key(file) for file in stage.inputs}
    except MocapIdError as error:
        return StageStatus(stage.name, "missing", str(error))
    key = compute_cache_key(trial, stage, hashes)
    refused = read_refusal(trial.out, stage.name, key)
    if refused is not None:
        return StageStatus(stage.name, "refused", refused.message)
    missing = [file for file in stage.outputs if not folder.exists(file)]
    if missing:
        return StageStatus(stage.name, "missing", f"{missing[0]} does not exist")
    try:
        origin = folder.origin(stage.name, stage.outputs)
    except StoreError as error:
        return StageStatus(stage.name, "damaged", str(error))
    if origin is None:
        return StageStatus(stage.name, "damaged", "its files were not written together: one was edited or replaced")
    if origin.key == key:
        return StageStatus(stage.name, "done")
    changes = "; ".join(_list_changes(origin, stage, collect_parameters(trial, stage), hashes))
    return StageStatus(stage.name, "stale", changes or "the previous report described a refused trial")


def _list_changes(origin: Origin, stage: Stage, wanted: Mapping[str, Any], hashes: Mapping[str, str]) -> Iterator[str]:
    """Yield the differences between the computation that made the files and a computation with the present inputs."""
    if origin.stage_version != stage.version:
        yield f"made by version {origin.stage_version} of the stage, now version {stage.version}"
    for file in sorted({*hashes, *origin.inputs}):
        if hashes.get(file) != origin.inputs.get(file):
            yield f"{file} has changed"
    before, now = dict(_flatten(origin.parameters)), dict(_flatten(wanted))
    for key in sorted({*before, *now}):
        if before.get(key) != now.get(key):
            yield f"{key} was {before.get(key)}, is now {now.get(key)}"


def _flatten(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _flatten(inner, f"{key}.{name}" if key else str(name))
    else:
        yield key, value


def _is_locked(folder: Path) -> bool:
    own = folder / ".mocap-id"
    if not (own / LOCK).is_file():
        return False
    try:
        with create_lock(own).acquire(timeout=0):
            return False
    except Timeout:
        return True
    except OSError:  # the lock file cannot be opened, and its existence alone does not prove a run
        return False
