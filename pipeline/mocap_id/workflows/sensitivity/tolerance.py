"""How much of each kind of error a trial tolerates, and whether the program notices when it is too much.

A perturbation is tolerated where no base parameter moves by more than a share of its size (5 % by default), or by its
own stated standard deviation where that is more: a smaller change is one that the trial does not claim to know of.
Between the levels tried, the level at which the worst parameter crosses that limit is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mocap_id.workflows.sensitivity.kinds import Kind
from mocap_id.workflows.sensitivity.responses import Result, worst
from mocap_id.workflows.sensitivity.trying import Tried


@dataclass(frozen=True)
class Point:
    """A level of one kind on one target; where it was tried both ways, the worse of the two.

    Parameters
    ----------
    level : float
        Its size, without sign.
    ratio : float
        Largest change of a parameter over what is tolerated; infinite where there are no parameters any more.
    parameter : str
        Whose change that is.
    percent : float
        That change, % of the parameter's size.
    noticed : bool
        The verdict has a caution that the unperturbed one has not, or there is no result.
    torque : float
        Largest change of a joint's torque, rms, % of the unperturbed one's.
    """

    level: float
    ratio: float
    parameter: str
    percent: float
    noticed: bool
    torque: float = math.nan

    @property
    def within(self) -> bool:
        """It is tolerated."""
        return self.ratio <= 1


@dataclass(frozen=True)
class Tolerance:
    """What a trial tolerates of one kind on one target.

    Parameters
    ----------
    kind : Kind
    target : str
    points : tuple of Point
        From the mildest to the worst level; for a kind that is worse on either side, by level.
    low, high : float
        Ends of the tolerated levels, interpolated; NaN where none of those tried is, and no proportion tells.
    """

    kind: Kind
    target: str
    points: tuple[Point, ...]
    low: float
    high: float

    @property
    def broken(self) -> Point | None:
        """The mildest level that is too much; the worst of all where a kind is worse on either side."""
        beyond = [point for point in self.points if not point.within]
        if self.kind.worse == "either":
            return max(beyond, key=lambda point: point.ratio, default=None)
        return next(iter(beyond), None)

    @property
    def silent(self) -> tuple[float, ...]:
        """Levels that are too much without a word of the verdict."""
        return tuple(point.level for point in self.points if not (point.within or point.noticed))


def tolerances(own: Result, tried: Sequence[Tried], names: Sequence[str], share: float) -> tuple[Tolerance, ...]:
    """What a trial tolerates.

    Parameters
    ----------
    own : Result
        Of the unperturbed trial.
    tried : sequence of Tried
    names : sequence of str
        Parameters that count.
    share : float
        Of a parameter's size, that it may move by.
    """
    series: dict[tuple[str, str], dict[float, Point]] = {}
    for one in tried:
        points = series.setdefault((one.change.kind, one.change.target), {})
        point = _point(own, one, names, share)
        if math.isnan(point.ratio):
            continue
        there = points.get(point.level)
        points[point.level] = point if there is None or point.ratio > there.ratio else there
    kinds = {one.change.kind: one.change.of for one in tried}
    return tuple(_tolerance(kinds[kind], target, points.values()) for (kind, target), points in series.items())


def _point(own: Result, one: Tried, names: Sequence[str], share: float) -> Point:
    ratio, name = worst(own, one.result, names, share)
    before = own.parameters.get(name)
    after = one.result.parameters.get(name) if one.result is not None else None
    percent = math.nan
    if before is not None and after is not None and before.size > 0:
        percent = 100 * abs(after.value - before.value) / before.size
    return Point(abs(one.change.level), ratio, name, percent, noticed(own, one.result), 100 * one.moved.torque_share)


def noticed(own: Result, changed: Result | None) -> bool:
    """Whether the program says of a perturbed trial what it did not say of the unperturbed one."""
    return changed is None or bool(changed.codes - own.codes)


def _tolerance(kind: Kind, target: str, points: Iterable[Point]) -> Tolerance:
    ordered = tuple(sorted(points, key=lambda point: -point.level if kind.worse == "less" else point.level))
    low, high = _either(ordered) if kind.worse == "either" else (0.0, _up_to(kind, ordered))
    return Tolerance(kind, target, ordered, low, high)


def _up_to(kind: Kind, points: Sequence[Point]) -> float:
    """The worst level that is tolerated together with all milder ones."""
    mild = None
    for point in points:
        if not point.within:
            return _crossing(kind, mild, point)
        mild = point
    return math.nan if mild is None else mild.level


def _crossing(kind: Kind, mild: Point | None, beyond: Point) -> float:
    """Where the limit lies between a level that is tolerated and the next, which is not."""
    if kind.counted:
        return math.nan if mild is None else mild.level
    if mild is None or mild.level == 0:  # nothing moves without a perturbation
        return beyond.level / beyond.ratio if math.isfinite(beyond.ratio) else math.nan
    return _between(mild, beyond)


def _between(within: Point, beyond: Point) -> float:
    """Level of ratio 1, along a power law; the level within where there is no number beyond, or nothing moved."""
    if not math.isfinite(beyond.ratio) or within.ratio <= 0:
        return within.level
    share = math.log(1 / within.ratio) / math.log(beyond.ratio / within.ratio)
    return float(within.level * (beyond.level / within.level) ** share)


def _either(points: Sequence[Point]) -> tuple[float, float]:
    """Ends of the tolerated stretch that holds the level of least change."""
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
