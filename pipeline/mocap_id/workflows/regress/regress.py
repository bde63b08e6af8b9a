"""Running trials anew, in folders of their own, and comparing what comes out with a baseline."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mocap_id.config import Trial
from mocap_id.errors import ConfigError, Refused
from mocap_id.reporting.contents import SUMMARY_FILE
from mocap_id.workflows.batch import find
from mocap_id.workflows.performing import Engine, Performed, perform_all
from mocap_id.workflows.regress.baseline import Baseline, rounded
from mocap_id.workflows.regress.quantities import Quantity, Value, failure, quantities


@dataclass(frozen=True)
class Moved:
    """A number that is not what it was.

    Parameters
    ----------
    trial, name : str
    before, now : float or str or None
    tolerance : float
        By which it might have moved.
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
    """What became of the baseline's numbers.

    Parameters
    ----------
    moved : tuple of Moved
    compared : int
        How many numbers were.
    unknown : tuple of str
        Trials of which the baseline knows nothing.
    messages : mapping
        Why a trial failed or was refused, files named.
    nearest : Moved or None
        Of those that did not move too far the one that comes nearest to it.
    """

    moved: tuple[Moved, ...]
    compared: int
    unknown: tuple[str, ...]
    messages: Mapping[str, str]
    nearest: Moved | None

    @property
    def passed(self) -> bool:
        """Whether every trial is known and no number has moved."""
        return not self.moved and not self.unknown


Tell = Callable[[Performed], None]


def regress(named: Sequence[str], baseline: Baseline, engine: Engine, tell: Tell = lambda done: None) -> Regression:
    """Run trials anew and compare them with a baseline; their own run folders are not touched.

    Parameters
    ----------
    named : sequence of str
        As for :func:`mocap_id.workflows.batch.find`.
    baseline : Baseline
    engine : Engine
    tell : callable, optional
        Told of each trial once it is done.

    Raises
    ------
    ConfigError
        What is named fits nothing, or a trial's file is wrong.
    """
    found, messages = _run(named, engine, tell)
    known = {trial: now for trial, now in found.items() if trial in baseline.trials}
    compared = [one for trial, now in known.items() for one in _compared(trial, baseline, now)]
    within = [one for one in compared if not too_far(one)]
    return Regression(
        moved=tuple(one for one in compared if too_far(one)),
        compared=len(compared),
        unknown=tuple(trial for trial in found if trial not in baseline.trials),
        messages=messages,
        nearest=max(within, key=used, default=None),
    )


def update(named: Sequence[str], baseline: Baseline, engine: Engine, tell: Tell = lambda done: None) -> Baseline:
    """The baseline with these trials as they are now; other trials of it and the user's tolerances stay."""
    found, _ = _run(named, engine, tell)
    return Baseline({**baseline.trials, **found}, baseline.tolerances)


def too_far(one: Moved) -> bool:
    """Whether a number has moved by more than it may."""
    return used(one) > 1.0


def used(one: Moved) -> float:
    """How much of its tolerance a number has used up; infinite where text changed, or known became unknown."""
    if rounded(one.before) == rounded(one.now):
        return 0.0
    if not isinstance(one.before, float | int) or not isinstance(one.now, float | int):
        return float("inf")
    return abs(one.now - one.before) / one.tolerance if one.tolerance > 0 else float("inf")


def _compared(trial: str, baseline: Baseline, now: Mapping[str, Quantity]) -> Iterator[Moved]:
    before, absent = baseline.trials[trial], Quantity(None)
    for name in {**before, **now}:
        was, is_ = before.get(name, absent), now.get(name, absent)
        tolerance = baseline.tolerance(trial, name, was.tolerance)
        yield Moved(trial, name, was.value, is_.value, tolerance, was.unit or is_.unit)


def _run(
    named: Sequence[str], engine: Engine, tell: Tell
) -> tuple[dict[str, Mapping[str, Quantity]], Mapping[str, str]]:
    """Quantities of every trial, and why some failed or were refused."""
    trials, unreadable = find(named)
    if unreadable:
        raise ConfigError("\n".join(str(one.error) for one in unreadable))
    twice = {trial.name for trial in trials if sum(other.name == trial.name for other in trials) > 1}
    if twice:
        raise ConfigError(f"two trials are called {sorted(twice)[0]}: the baseline tells trials apart by their names")
    with tempfile.TemporaryDirectory(prefix="mocap-id-regress-") as folder:
        anew = [replace(trial, out=Path(folder) / trial.name) for trial in trials]
        done = perform_all(anew, engine, tell)
        found = {trial.name: _quantities(trial, one) for trial, one in zip(anew, done, strict=True)}
    return found, {one.trial: one.message for one in done if one.message is not None}


def _quantities(trial: Trial, done: Performed) -> Mapping[str, Quantity]:
    if done.exit_code not in (0, Refused.exit_code):
        return failure(done.exit_code)
    return quantities(json.loads((trial.out / SUMMARY_FILE).read_text("utf-8")))
