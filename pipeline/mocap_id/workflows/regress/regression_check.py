"""Recomputation of trials in temporary folders, and comparison of their results with a baseline."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mocap_id.config import Trial
from mocap_id.errors import ConfigError, Refused
from mocap_id.reporting.contents import SUMMARY_FILE
from mocap_id.workflows.batch import find_trials
from mocap_id.workflows.parallel import Backend, TrialCallback, TrialRun, run_trials
from mocap_id.workflows.regress.baseline import Baseline, rounded
from mocap_id.workflows.regress.quantities import Quantity, Value, failure, quantities


@dataclass(frozen=True)
class Change:
    """A result before and after.

    Parameters
    ----------
    trial, name : str
    before, now : float or str or None
    tolerance : float
        Allowed change.
    unit : str
    """

    trial: str
    name: str
    before: Value
    now: Value
    tolerance: float
    unit: str


@dataclass(frozen=True)
class Regression:
    """Comparison of recomputed trials with a baseline.

    Parameters
    ----------
    moved : tuple of Change
        Results that changed by more than their tolerance.
    compared : int
        Number of compared results.
    unknown : tuple of str
        Trials that are not in the baseline.
    messages : mapping
        Why a trial failed or was refused; messages may name files.
    nearest : Change or None
        The result within its tolerance that used most of it.
    """

    moved: tuple[Change, ...]
    compared: int
    unknown: tuple[str, ...]
    messages: Mapping[str, str]
    nearest: Change | None

    @property
    def passed(self) -> bool:
        """Whether every trial is in the baseline and no result changed by more than its tolerance."""
        return not self.moved and not self.unknown


def regress(
    named: Sequence[str], baseline: Baseline, backend: Backend, tell: TrialCallback = lambda done: None
) -> Regression:
    """Recompute trials and compare them with a baseline; their own run folders are not touched.

    Parameters
    ----------
    named : sequence of str
        As for :func:`mocap_id.workflows.batch.find_trials`.
    baseline : Baseline
    backend : Backend
    tell : callable, optional
        Called with each finished trial.

    Raises
    ------
    ConfigError
        A name matches no trial, or a trial's file is invalid.
    """
    found, messages = _run(named, backend, tell)
    known = {trial: now for trial, now in found.items() if trial in baseline.trials}
    compared = [one for trial, now in known.items() for one in _compared(trial, baseline, now)]
    within = [one for one in compared if not exceeds_tolerance(one)]
    return Regression(
        moved=tuple(one for one in compared if exceeds_tolerance(one)),
        compared=len(compared),
        unknown=tuple(trial for trial in found if trial not in baseline.trials),
        messages=messages,
        nearest=max(within, key=tolerance_used, default=None),
    )


def update(
    named: Sequence[str], baseline: Baseline, backend: Backend, tell: TrialCallback = lambda done: None
) -> Baseline:
    """Return the baseline with current results of these trials; other trials and the user's tolerances are kept."""
    found, _ = _run(named, backend, tell)
    return Baseline({**baseline.trials, **found}, baseline.tolerances)


def exceeds_tolerance(one: Change) -> bool:
    """Return whether a result changed by more than its tolerance."""
    return tolerance_used(one) > 1.0


def tolerance_used(one: Change) -> float:
    """Return the change divided by its tolerance; infinite where text changed, or a known value became unknown."""
    if rounded(one.before) == rounded(one.now):
        return 0.0
    if not isinstance(one.before, float | int) or not isinstance(one.now, float | int):
        return float("inf")
    return abs(one.now - one.before) / one.tolerance if one.tolerance > 0 else float("inf")


def _compared(trial: str, baseline: Baseline, now: Mapping[str, Quantity]) -> Iterator[Change]:
    before, absent = baseline.trials[trial], Quantity(None)
    for name in {**before, **now}:
        was, is_ = before.get(name, absent), now.get(name, absent)
        tolerance = baseline.tolerance(trial, name, was.tolerance)
        yield Change(trial, name, was.value, is_.value, tolerance, was.unit or is_.unit)


def _run(
    named: Sequence[str], backend: Backend, tell: TrialCallback
) -> tuple[dict[str, Mapping[str, Quantity]], Mapping[str, str]]:
    """Return the results of every trial, and the messages of failed or refused ones."""
    trials, unreadable = find_trials(named)
    if unreadable:
        raise ConfigError("\n".join(str(one.error) for one in unreadable))
    twice = {trial.name for trial in trials if sum(other.name == trial.name for other in trials) > 1}
    if twice:
        raise ConfigError(f"two trials are called {sorted(twice)[0]}: the baseline identifies trials by their names")
    with tempfile.TemporaryDirectory(prefix="mocap-id-regress-") as folder:
        anew = [replace(trial, out=Path(folder) / trial.name) for trial in trials]
        done = run_trials(anew, backend, tell)
        found = {trial.name: _quantities(trial, one) for trial, one in zip(anew, done, strict=True)}
    return found, {one.trial: one.message for one in done if one.message is not None}


def _quantities(trial: Trial, done: TrialRun) -> Mapping[str, Quantity]:
    if done.exit_code not in (0, Refused.exit_code):
        return failure(done.exit_code)
    return quantities(json.loads((trial.out / SUMMARY_FILE).read_text("utf-8")))
