"""Run of one trial among many; a failure is returned as a result, not raised as an exception."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from mocap_id import runner
from mocap_id.config import Trial
from mocap_id.errors import MocapIdError, NumericalError
from mocap_id.reporting.contents import FILES
from mocap_id.runner.dependencies import find_user_files
from mocap_id.stages import STAGES
from mocap_id.store import Folder

NOT_RUN = 1
"""Exit code of a trial that was skipped because another trial failed."""


@dataclass(frozen=True)
class TrialRun:
    """The result of the run of a trial."""

    trial: str  # name of the trial
    exit_code: int  # exit code of `mocap-id run` for this trial
    message: str | None  # why the trial failed or was refused; only for the user's terminal, because it may name files
    published: str | None  # the same without names of files, for reports that are passed on
    key: str | None  # cache key of the trial's report, which changes with its content; None if there is no report
    computed: bool  # whether any stage ran
    seconds: float  # duration of the run, s


RunTrial: TypeAlias = Callable[[Trial], TrialRun]
"""A function that runs one trial; it must be importable by other processes."""


def run_trial(trial: Trial) -> TrialRun:
    """Run one trial and return its result; a failure is part of the result."""
    start, message, code = time.perf_counter(), None, 0
    steps: tuple[runner.Step, ...] = ()
    try:
        outcome = runner.run(trial)
    except MocapIdError as error:
        message, code = ": ".join([*getattr(error, "__notes__", []), str(error)]), error.exit_code
    except Exception as error:  # noqa: BLE001  after any failure, the other trials still run
        message, code = f"unforeseen failure, {type(error).__name__}: {error}", NumericalError.exit_code
    else:
        steps = outcome.steps
        if outcome.refused is not None:
            message, code = outcome.refused.message, outcome.refused.exit_code
    return TrialRun(
        trial=trial.name,
        exit_code=code,
        message=message,
        published=None if message is None else _hide_names(message, trial),
        key=_read_key(trial) if code in (0, 4) else None,
        computed=any(step.action == "computed" for step in steps),
        seconds=time.perf_counter() - start,
    )


class _Terminated(BaseException):
    """The process received SIGTERM."""


def make_not_run(trial: Trial) -> TrialRun:
    """Return the result of a trial that was not started, because another trial failed."""
    message = "not run, because another trial failed before"
    return TrialRun(trial.name, NOT_RUN, message, message, None, computed=False, seconds=0.0)


def make_killed(trial: Trial) -> TrialRun:
    """Return the result of a trial whose process was killed."""
    message = "a process was killed, perhaps by the system because memory ran out: run again with fewer --jobs"
    return TrialRun(trial.name, NumericalError.exit_code, message, message, None, computed=False, seconds=0.0)


def run_until_terminated(run: RunTrial, trial: Trial) -> TrialRun:
    """Run a trial in a worker process; after SIGTERM, remove incomplete files before the process ends."""
    if threading.current_thread() is not threading.main_thread():  # a cluster's worker handles signals itself
        return run(trial)
    before = signal.signal(signal.SIGTERM, _raise_terminated)
    try:
        return run(trial)
    except _Terminated:
        os._exit(128 + signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)


def _raise_terminated(number: int, frame: object) -> None:
    signal.signal(number, signal.SIG_IGN)  # the pool sends it again, which must not interrupt the removal of files
    raise _Terminated


def _hide_names(message: str, trial: Trial) -> str:
    """Return a message without names of files and folders, because these may contain names of people."""
    files = {path for stage in STAGES for path in find_user_files(trial, stage).values()}
    for path in sorted(files, key=lambda path: len(str(path)), reverse=True):
        neutral = f"the {path.suffix.lstrip('.').upper() or 'recording'} file"
        message = message.replace(str(path), neutral).replace(path.name, neutral)
    for folder, name in ((trial.out, trial.name), (trial.file, trial.file.name), (trial.file.parent, "")):
        message = message.replace(str(folder), name)
    return message


def _read_key(trial: Trial) -> str | None:
    origin = Folder(trial.out).origin("report", FILES)
    return None if origin is None else origin.key
