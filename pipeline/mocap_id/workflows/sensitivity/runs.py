"""Runs of perturbations in parallel processes; the results do not depend on their number."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from mocap_id.errors import MocapIdError, NumericalError, Refused
from mocap_id.workflows.parallel.backends import LocalBackend
from mocap_id.workflows.sensitivity.perturbed_trial import perturb
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.responses import Estimates, SeriesChanges, compare_series, read_estimates
from mocap_id.workflows.sensitivity.trial_inputs import TrialInputs, TrialSource, read_inputs

_FIRST = ("fit-joints", "ukf-smooth", "identify-dim")


@dataclass(frozen=True)
class PerturbationRun:
    """The result of one perturbation."""

    perturbation: Perturbation
    estimates: Estimates | None  # estimates of the perturbed trial; None if it was refused or failed
    changes: SeriesChanges  # changes from the unperturbed trial; empty if there are no estimates
    why: str  # why there are no estimates; empty if there are
    refused: bool  # the perturbed trial was refused, rather than failed
    seconds: float  # processor time


RunCallback: TypeAlias = Callable[[PerturbationRun], None]


def run_perturbation(trial: TrialInputs, perturbation: Perturbation) -> PerturbationRun:
    """Run a perturbed trial; a failure is a result, not an error."""
    start = time.process_time()
    estimates, changes, why, refused = None, SeriesChanges(), "", False
    try:
        perturbed = perturb(trial, perturbation)
        estimates, changes = read_estimates(perturbed), compare_series(trial, perturbed)
    except MocapIdError as error:
        why, refused = str(error), isinstance(error, Refused)
    except Exception as error:  # noqa: BLE001  a bug in one perturbation must not lose the others
        why = f"an unforeseen failure, {type(error).__name__}: {str(error).partition(chr(10))[0]}"
    return PerturbationRun(perturbation, estimates, changes, why, refused, seconds=time.process_time() - start)


def run_perturbations(
    source: TrialSource, perturbations: Sequence[Perturbation], jobs: int, tell: RunCallback
) -> tuple[PerturbationRun, ...]:
    """Run every perturbation of a trial.

    Parameters
    ----------
    source : TrialSource
    perturbations : sequence of Perturbation
    jobs : int
        Number of parallel processes; the libraries in each use one thread.
    tell : callable
        Called with each run that ends.

    Returns
    -------
    tuple of PerturbationRun
        In the order of the perturbations.

    Raises
    ------
    NumericalError
        A process was killed.
    """
    found = {}
    # The long runs first, so that no process waits for another at the end.
    order = sorted(perturbations, key=lambda one: _FIRST.index(one.definition.entry))
    try:
        with LocalBackend(jobs).workers(len(order)) as workers:
            for future in as_completed([workers.executor.submit(_run, source, one) for one in order]):
                run = future.result()
                tell(run)
                found[run.perturbation] = run
    except BrokenProcessPool as error:
        message = "a process was killed, perhaps because memory ran out: run again with fewer --jobs"
        raise NumericalError(message) from error
    return tuple(found[one] for one in perturbations)


_trials: dict[Path, TrialInputs] = {}
"""In a process of the pool: the trial, read once."""


def _run(source: TrialSource, perturbation: Perturbation) -> PerturbationRun:
    if source.folder not in _trials:
        _trials[source.folder] = read_inputs(source)
    return run_perturbation(_trials[source.folder], perturbation)
