"""Recomputation of trials in temporary folders, and comparison of their results with a baseline."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mocap_id.config import Trial
from mocap_id.errors import ConfigError
from mocap_id.workflows.batch import find_readable_trials
from mocap_id.workflows.parallel import Backend, TrialCallback, TrialRun, run_trials
from mocap_id.workflows.regress.baseline import Baseline, round_value
from mocap_id.workflows.regress.quantities import Quantity, Value, quantities
from mocap_id.workflows.trial_outcome import read_summary


@dataclass(frozen=True)
class Change:
    """A result of a trial: its value in the baseline, and now."""

    trial: str
    name: str
    before: Value  # value in the baseline; None if unknown
    now: Value
    tolerance: float  # allowed change
    unit: str

    @property
    def tolerance_used(self) -> float:
        """The change divided by its tolerance; infinite if a text changed, or if only one value is known."""
        if round_value(self.before) == round_value(self.now):
            return 0.0
        if not isinstance(self.before, float | int) or not isinstance(self.now, float | int):
            return float("inf")
        return abs(self.now - self.before) / self.tolerance if self.tolerance > 0 else float("inf")


@dataclass(frozen=True)
class Regression:
    """Comparison of recomputed trials with a baseline."""

    moved: tuple[Change, ...]  # results that changed by more than their tolerance
    compared: int  # number of compared results
    unknown: tuple[str, ...]  # trials that are not in the baseline
    messages: Mapping[str, str]  # why a trial failed or was refused, by trial; a message may name files
    nearest: Change | None  # the result with the largest tolerated change; None if no change is tolerated

    @property
    def passed(self) -> bool:
        """Whether every trial is in the baseline and no result changed by more than its tolerance."""
        return not self.moved and not self.unknown


def regress(
    named: Sequence[str], baseline: Baseline, backend: Backend, tell: TrialCallback = lambda done: None
) -> Regression:
    """Recompute trials in temporary folders, and return their comparison with a baseline.

    ``named`` is as for :func:`mocap_id.workflows.batch.find_trials`; ``tell`` is called with each finished trial.

    Raises
    ------
    ConfigError
        A name matches no trial, or a trial's file is invalid.
    """
    results, messages = _run(named, backend, tell)
    known = {trial: now for trial, now in results.items() if trial in baseline.trials}
    changes = [one for trial, now in known.items() for one in _compare(trial, baseline, now)]
    small = [one for one in changes if one.tolerance_used <= 1.0]
    return Regression(
        moved=tuple(one for one in changes if one.tolerance_used > 1.0),
        compared=len(changes),
        unknown=tuple(trial for trial in results if trial not in baseline.trials),
        messages=messages,
        nearest=max(small, key=lambda one: one.tolerance_used, default=None),
    )


def update(
    named: Sequence[str], baseline: Baseline, backend: Backend, tell: TrialCallback = lambda done: None
) -> Baseline:
    """Return the baseline with the current results of the named trials; other trials and tolerances are kept."""
    results, _ = _run(named, backend, tell)
    return Baseline({**baseline.trials, **results}, baseline.tolerances)


def _compare(trial: str, baseline: Baseline, now: Mapping[str, Quantity]) -> Iterator[Change]:
    before, missing = baseline.trials[trial], Quantity(None)
    for name in {**before, **now}:
        expected, actual = before.get(name, missing), now.get(name, missing)
        tolerance = baseline.find_tolerance(trial, name, expected.tolerance)
        yield Change(trial, name, expected.value, actual.value, tolerance, expected.unit or actual.unit)


def _run(
    named: Sequence[str], backend: Backend, tell: TrialCallback
) -> tuple[dict[str, Mapping[str, Quantity]], Mapping[str, str]]:
    """Return the results by trial, and the messages of failed or refused trials by trial."""
    trials = find_readable_trials(named)
    twice = {trial.name for trial in trials if sum(other.name == trial.name for other in trials) > 1}
    if twice:
        raise ConfigError(f"two trials are called {sorted(twice)[0]}: the baseline identifies trials by their names")
    with tempfile.TemporaryDirectory(prefix="mocap-id-regress-") as folder:
        copies = [replace(trial, out=Path(folder) / trial.name) for trial in trials]
        runs = run_trials(copies, backend, tell)
        results = {trial.name: _read_results(trial, run) for trial, run in zip(copies, runs, strict=True)}
    return results, {run.trial: run.message for run in runs if run.message is not None}


def _read_results(trial: Trial, run: TrialRun) -> Mapping[str, Quantity]:
    """Return the quantities of a trial; for a trial without a summary, return only the exit code."""
    summary = read_summary(trial.out, run)
    return {"exit_code": Quantity(str(run.exit_code))} if summary is None else quantities(summary)
