"""Every perturbation tried on a trial, in processes of their own; the same answers however many there are."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from mocap_id.errors import MocapIdError, NumericalError, Refused
from mocap_id.workflows.performing.engine import Here
from mocap_id.workflows.sensitivity.changing import perturbed
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.responses import Moved, Result, moved, result
from mocap_id.workflows.sensitivity.subject import Perturbed, Source, read

_FIRST = ("fit-joints", "ukf-smooth", "identify-dim")


@dataclass(frozen=True)
class Tried:
    """What came of one perturbation.

    Parameters
    ----------
    change : Perturbation
    result : Result or None
        None where the perturbed trial was refused or failed.
    moved : Moved
        Against the unperturbed trial; empty where there is no result.
    why : str
        Why there is no result; empty where there is one.
    refused : bool
        The perturbed trial was refused, rather than failed.
    seconds : float
        Processor time.
    """

    change: Perturbation
    result: Result | None
    moved: Moved
    why: str
    refused: bool
    seconds: float


Tell: TypeAlias = Callable[[Tried], None]


def try_one(trial: Perturbed, change: Perturbation) -> Tried:
    """Perturb a trial and see what becomes of it; a failure is an answer, not an error."""
    start = time.process_time()
    found, off, why, refused = None, Moved(), "", False
    try:
        changed = perturbed(trial, change)
        found, off = result(changed), moved(trial, changed)
    except MocapIdError as error:
        why, refused = str(error), isinstance(error, Refused)
    except Exception as error:  # noqa: BLE001  one perturbation that nobody foresaw must not cost the others
        why = f"an unforeseen failure, {type(error).__name__}: {str(error).partition(chr(10))[0]}"
    return Tried(change, found, off, why, refused, seconds=time.process_time() - start)


def try_all(source: Source, changes: Sequence[Perturbation], jobs: int, tell: Tell) -> tuple[Tried, ...]:
    """Try every perturbation of a trial.

    Parameters
    ----------
    source : Source
    changes : sequence of Perturbation
    jobs : int
        How many at a time, each in a process of its own whose libraries have one thread.
    tell : callable
        Told of each once it is done, in the order in which they end.

    Returns
    -------
    tuple of Tried
        In the order of the perturbations.

    Raises
    ------
    NumericalError
        A process was killed.
    """
    found = {}
    # The long ones first, so that no process waits for another's at the end.
    order = sorted(changes, key=lambda change: _FIRST.index(change.of.entry))
    try:
        with Here(jobs).workers(len(changes)) as workers:
            for future in as_completed([workers.executor.submit(_try, source, change) for change in order]):
                done = future.result()
                tell(done)
                found[done.change] = done
    except BrokenProcessPool as error:
        message = "a process was killed, by the system for want of memory perhaps: run again with fewer --jobs"
        raise NumericalError(message) from error
    return tuple(found[change] for change in changes)


_trials: dict[Path, Perturbed] = {}
"""In a process of the pool: the trial that it perturbs, read once."""


def _try(source: Source, change: Perturbation) -> Tried:
    if source.folder not in _trials:
        _trials[source.folder] = read(source)
    return try_one(_trials[source.folder], change)
