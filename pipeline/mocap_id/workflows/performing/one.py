"""Running one trial, whose failure is an answer and not an error."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import dataclass

from mocap_id import runner
from mocap_id.config import Trial
from mocap_id.errors import MocapIdError, NumericalError
from mocap_id.reporting.contents import FILES
from mocap_id.runner.dependencies import user_files
from mocap_id.stages import STAGES
from mocap_id.store import Folder

NOT_RUN = 1
"""Exit code of a trial that was left out since another had failed."""


@dataclass(frozen=True)
class Performed:
    """How a trial went.

    Parameters
    ----------
    trial : str
    exit_code : int
        What `mocap-id run` would have ended with.
    message : str or None
        Why it failed or was refused, for whoever has the recordings: it may name files.
    published : str or None
        The same for everybody: no file is named in it.
    key : str or None
        Of the trial's report: changes with everything that the report tells. None where there is none.
    computed : bool
        Whether any stage had to run.
    seconds : float
        That it took now.
    """

    trial: str
    exit_code: int
    message: str | None
    published: str | None
    key: str | None
    computed: bool
    seconds: float


def perform(trial: Trial) -> Performed:
    """Run one trial; its failure is an answer, not an error."""
    start, message, code = time.perf_counter(), None, 0
    steps: tuple[runner.Step, ...] = ()
    try:
        outcome = runner.run(trial)
    except MocapIdError as error:
        message, code = ": ".join([*getattr(error, "__notes__", []), str(error)]), error.exit_code
    except Exception as error:  # noqa: BLE001  whatever it is, the other trials go on
        message, code = f"unforeseen failure, {type(error).__name__}: {error}", NumericalError.exit_code
    else:
        steps = outcome.steps
        if outcome.refused is not None:
            message, code = outcome.refused.message, outcome.refused.exit_code
    return Performed(
        trial=trial.name,
        exit_code=code,
        message=message,
        published=None if message is None else _published(message, trial),
        key=_key(trial) if code in (0, 4) else None,
        computed=any(step.action == "computed" for step in steps),
        seconds=time.perf_counter() - start,
    )


class _Told(BaseException):
    """The process was told to end."""


def not_run(trial: Trial) -> Performed:
    """What there is to say of a trial that was not begun."""
    message = "not run: another trial failed before"
    return Performed(trial.name, NOT_RUN, message, message, None, computed=False, seconds=0.0)


def killed(trial: Trial) -> Performed:
    """What there is to say of a trial that took its process along."""
    message = "a process was killed, by the system for want of memory perhaps: run again with fewer --jobs"
    return Performed(trial.name, NumericalError.exit_code, message, message, None, computed=False, seconds=0.0)


def perform_until_told(trial: Trial) -> Performed:
    """:func:`perform` in a process of its own, which takes its half-written files away when it is told to end."""
    if threading.current_thread() is not threading.main_thread():  # of a cluster's worker, which sees to itself
        return perform(trial)
    before = signal.signal(signal.SIGTERM, _tell)
    try:
        return perform(trial)
    except _Told:
        os._exit(128 + signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)


def _tell(number: int, frame: object) -> None:
    raise _Told


def _published(message: str, trial: Trial) -> str:
    """A message without the names of the user's files and folders, which may be those of people."""
    files = {path for stage in STAGES for path in user_files(trial, stage).values()}
    for path in sorted(files, key=lambda path: len(str(path)), reverse=True):
        message = message.replace(str(path), f"the {path.suffix.lstrip('.').upper() or 'recording'} file")
        message = message.replace(path.name, f"the {path.suffix.lstrip('.').upper() or 'recording'} file")
    for folder, name in ((trial.out, trial.name), (trial.file, trial.file.name), (trial.file.parent, "")):
        message = message.replace(str(folder), name)
    return message


def _key(trial: Trial) -> str | None:
    origin = Folder(trial.out).origin("report", FILES)
    return None if origin is None else origin.key
