"""How much of each kind of error a trial tolerates, and whether the verdict shows larger errors.

A perturbation is tolerated if no base parameter changes by more than a share of its size (5 % by default), or by its
own stated standard deviation if that is larger: a smaller change is within the uncertainty of the trial. Between the
tried levels, the level at which the first parameter exceeds this limit is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mocap_id.workflows.sensitivity.kinds import Kind
from mocap_id.workflows.sensitivity.responses import Estimates, largest_ratio
from mocap_id.workflows.sensitivity.runs import PerturbationRun


@dataclass(frozen=True)
class Point:
    """A level of one kind on one target; of a level that was tried with both signs, the worse one."""

    level: float  # absolute level
    ratio: float  # largest change of a parameter / tolerated change; infinite if the parameters are lost
    parameter: str  # the parameter with this change
    percent: float  # the change, % of the parameter's size
    noticed: bool  # the verdict has a new caution, or there is no result
    torque: float = math.nan  # largest rms change of a joint torque, % of the rms of the unperturbed torque

    @property
    def within(self) -> bool:
        """Whether the level is tolerated."""
        return self.ratio <= 1


@dataclass(frozen=True)
class Tolerance:
    """The tolerated levels of one kind on one target."""

    kind: Kind
    target: str
    # from the mildest to the worst level; by level for a kind that gets worse in both directions
    points: tuple[Point, ...]
    # ends of the tolerated levels, interpolated; NaN if no tried level is tolerated and none can be estimated
    low: float
    high: float

    @property
    def broken(self) -> Point | None:
        """The mildest level that is not tolerated; the level of most change if both directions make it worse."""
        beyond = [point for point in self.points if not point.within]
        if self.kind.worse == "either":
            return max(beyond, key=lambda point: point.ratio, default=None)
        return next(iter(beyond), None)

    @property
    def silent(self) -> tuple[float, ...]:
        """Levels that are not tolerated although the verdict has no new caution."""
        return tuple(point.level for point in self.points if not (point.within or point.noticed))


def find_tolerances(
    own: Estimates, runs: Sequence[PerturbationRun], names: Sequence[str], share: float
) -> tuple[Tolerance, ...]:
    """Return the tolerated levels of each kind on each target.

    Parameters
    ----------
    own : Estimates
        Estimates of the unperturbed trial.
    runs : sequence of PerturbationRun
    names : sequence of str
        Parameters that are judged.
    share : float
        Tolerated change of a parameter, as a share of its size.
    """
    series: dict[tuple[str, str], dict[float, Point]] = {}
    for run in runs:
        points = series.setdefault((run.perturbation.kind, run.perturbation.target), {})
        point = _point(own, run, names, share)
        if math.isnan(point.ratio):
            continue
        other = points.get(point.level)
        points[point.level] = point if other is None or point.ratio > other.ratio else other
    kinds = {run.perturbation.kind: run.perturbation.definition for run in runs}
    return tuple(_tolerance(kinds[kind], target, points.values()) for (kind, target), points in series.items())


def _point(own: Estimates, run: PerturbationRun, names: Sequence[str], share: float) -> Point:
    ratio, name = largest_ratio(own, run.estimates, names, share)
    before = own.parameters.get(name)
    after = run.estimates.parameters.get(name) if run.estimates is not None else None
    percent = math.nan
    if before is not None and after is not None and before.size > 0:
        percent = 100 * abs(after.value - before.value) / before.size
    torque = 100 * run.changes.torque_share
    return Point(abs(run.perturbation.level), ratio, name, percent, noticed(own, run.estimates), torque)


def noticed(own: Estimates, changed: Estimates | None) -> bool:
    """Return whether the perturbed trial has no result, or a caution that the unperturbed one does not have."""
    return changed is None or bool(changed.codes - own.codes)


def _tolerance(kind: Kind, target: str, points: Iterable[Point]) -> Tolerance:
    ordered = tuple(sorted(points, key=lambda point: -point.level if kind.worse == "less" else point.level))
    low, high = _either(ordered) if kind.worse == "either" else (0.0, _up_to(kind, ordered))
    return Tolerance(kind, target, ordered, low, high)


def _up_to(kind: Kind, points: Sequence[Point]) -> float:
    """Return the worst level that is tolerated together with all milder levels; NaN if there is none."""
    mild = None
    for point in points:
        if not point.within:
            return _crossing(kind, mild, point)
        mild = point
    return math.nan if mild is None else mild.level


def _crossing(kind: Kind, mild: Point | None, beyond: Point) -> float:
    """Return the limit between a tolerated level and the next, which is not tolerated."""
    if kind.counted:
        return math.nan if mild is None else mild.level
    if mild is None or mild.level == 0:  # without a perturbation nothing changes
        return beyond.level / beyond.ratio if math.isfinite(beyond.ratio) else math.nan
    return _between(mild, beyond)


def _between(within: Point, beyond: Point) -> float:
    """Return the level of ratio 1 by a power law; the tolerated level if a ratio is zero or infinite."""
    if not math.isfinite(beyond.ratio) or within.ratio <= 0:
        return within.level
    share = math.log(1 / within.ratio) / math.log(beyond.ratio / within.ratio)
    return float(within.level * (beyond.level / within.level) ** share)


def _either(points: Sequence[Point]) -> tuple[float, float]:
    """Return both ends of the tolerated range around the level of least change."""
    if not any(point.within for point in points):
        return math.nan, math.nan
    best = min(range(len(points)), key=lambda k: points[k].ratio)
    first = last = best
    while first > 0 and points[first - 1].within:
        first -= 1
    while last < len(points) - 1 and points[last + 1].within:
        last += 1
    low = points[first].level if first == 0 else _between(points[first], points[first - 1])
    high = points[last].level if last == len(points) - 1 else _between(points[last], points[last + 1])
    return low, high
