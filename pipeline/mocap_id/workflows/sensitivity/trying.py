"""Every perturbation tried on a trial, in processes of their own; the same answers however many there are."""

from __future__ import annotations

import logging
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeAlias

from mocap_id.errors import MocapIdError, NumericalError, Refused
from mocap_id.workflows.processes import end, no_ctrl_c
from mocap_id.workflows.sensitivity.changing import perturbed
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.responses import Moved, Result, moved, result
from mocap_id.workflows.sensitivity.subject import Perturbed, Source, read

_THREADS = ("OPENBLAS", "MKL", "OMP", "NUMBA")
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
    context = multiprocessing.get_context("spawn")  # copies of this process would have its libraries' threads
    with _one_thread():
        pool = ProcessPoolExecutor(min(jobs, len(changes)), context, _begin, (source,))
        try:
            with no_ctrl_c():
                asked = [pool.submit(_try, change) for change in order]
            for future in as_completed(asked):
                done = future.result()
                tell(done)
                found[done.change] = done
        except BrokenProcessPool as error:
            message = "a process was killed, by the system for want of memory perhaps: run again with fewer --jobs"
            raise NumericalError(message) from error
        except BaseException:
            end(pool)
            raise
        pool.shutdown()
    return tuple(found[change] for change in changes)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Have new processes compute on one thread each: they share the machine, and sums keep their order."""
    names = [f"{library}_NUM_THREADS" for library in _THREADS]
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class _Worker:
    """The trial that this process perturbs."""

    trial: Perturbed


def _begin(source: Source) -> None:
    logging.captureWarnings(True)
    logging.basicConfig(format="mocap-id: %(message)s", level=logging.CRITICAL)
    _Worker.trial = read(source)


def _try(change: Perturbation) -> Tried:
    return try_one(_Worker.trial, change)
