"""The trials of a study, one after the other or several at a time; one that fails is told and stops no other."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import TypeAlias

from mocap_id import runner
from mocap_id.config import Trial
from mocap_id.errors import MocapIdError, NumericalError
from mocap_id.reporting.contents import FILES
from mocap_id.runner.dependencies import user_files
from mocap_id.stages import STAGES
from mocap_id.store import Folder
from mocap_id.workflows.processes import end, no_ctrl_c


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


_LOGGERS = ("mocap_id", "py.warnings")
Tell: TypeAlias = Callable[[Performed], None]


def perform_all(trials: Sequence[Trial], jobs: int, tell: Tell) -> tuple[Performed, ...]:
    """Run every trial that is not up to date.

    Parameters
    ----------
    trials : sequence of Trial
    jobs : int
        How many at a time, each in a process of its own; 1 for none beside this one.
    tell : callable
        Told of each trial once it is done, in the order in which they end.

    Returns
    -------
    tuple of Performed
        In the order of the trials.
    """
    found = {}
    for done in map(perform, trials) if jobs <= 1 or len(trials) <= 1 else _side_by_side(trials, jobs):
        tell(done)
        found[done.trial] = done
    return tuple(found[trial.name] for trial in trials)


def perform(trial: Trial) -> Performed:
    """Run one trial; its failure is an answer, not an error."""
    start, message, code = time.perf_counter(), None, 0
    steps: tuple[runner.Step, ...] = ()
    try:
        outcome = runner.run(trial)
    except MocapIdError as error:
        message, code = ": ".join([*getattr(error, "__notes__", []), str(error)]), error.exit_code
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


def _side_by_side(trials: Sequence[Trial], jobs: int) -> Iterator[Performed]:
    # New interpreters, not copies of this one, whose libraries have threads by now.
    context, levels = multiprocessing.get_context("spawn"), {name: logging.getLogger(name).level for name in _LOGGERS}
    pool = ProcessPoolExecutor(min(jobs, len(trials)), context, _begin, (levels,))
    try:
        with no_ctrl_c():
            asked = {pool.submit(_perform_until_told, trial): trial for trial in trials}
        for future in as_completed(asked):
            try:
                yield future.result()
            except BrokenProcessPool:
                yield _killed(asked[future])
    except BaseException:
        end(pool)
        raise
    pool.shutdown()


def _killed(trial: Trial) -> Performed:
    message = "a process was killed, by the system for want of memory perhaps: run again with fewer --jobs"
    return Performed(trial.name, NumericalError.exit_code, message, message, None, computed=False, seconds=0.0)


class _Told(BaseException):
    """The process was told to end."""


def _perform_until_told(trial: Trial) -> Performed:
    """:func:`perform` in a process of its own, which takes its half-written files away when it is told to end."""
    signal.signal(signal.SIGTERM, _tell)
    try:
        return perform(trial)
    except _Told:
        os._exit(128 + signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _tell(number: int, frame: object) -> None:
    raise _Told


def _begin(levels: Mapping[str, int]) -> None:
    """Have a new process tell as much as this one."""
    logging.captureWarnings(True)
    logging.basicConfig(format="mocap-id: %(message)s", level=logging.ERROR)
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)


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
