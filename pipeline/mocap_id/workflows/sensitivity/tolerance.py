"""The tolerated levels of each kind of error, and whether the verdict warns of larger errors, also as text.

A perturbation is tolerated if no base parameter changes by more than a fraction of its size (5 % by default), or by its
stated standard deviation if that is larger, because a smaller change is within the uncertainty of the trial. Between
the tested levels, the level at which the first parameter exceeds this limit is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mocap_id.reporting.numbers import show
from mocap_id.workflows.sensitivity.kinds import ALL, Kind
from mocap_id.workflows.sensitivity.responses import Estimates, largest_ratio
from mocap_id.workflows.sensitivity.runs import PerturbationRun

_UNITS = {"s": ("ms", 1e3), "m": ("mm", 1e3), "of samples": ("% of the samples", 1e2), "rad/s^4": ("rad/s⁴", 1.0)}
_COMPONENT_UNITS = {"Fx": "N", "Fy": "N", "tauz": "N·m"}
_MUCH = 5.0  # %: rms change of a joint torque above which it is mentioned


@dataclass(frozen=True)
class Point:
    """The response to one level of a kind on a target; of two levels with opposite signs, only the worse response."""

    level: float  # absolute value of the level
    ratio: float  # largest change of a parameter, divided by the tolerated change; infinite if parameters are missing
    parameter: str  # the parameter with this change
    percent: float  # the change, % of the parameter's size
    noticed: bool  # whether the verdict has a new caution, or there is no result
    torque: float = math.nan  # largest rms change of a joint torque, % of the rms of the unperturbed torque

    @property
    def is_tolerated(self) -> bool:
        """Whether the level is tolerated."""
        return self.ratio <= 1


@dataclass(frozen=True)
class Tolerance:
    """The tolerated levels of one kind on one target."""

    kind: Kind
    target: str
    # from the mildest to the worst level; ascending levels for a kind that gets worse in both directions
    points: tuple[Point, ...]
    # ends of the tolerated levels, interpolated; NaN if no tested level is tolerated and no end can be estimated
    low: float
    high: float

    @property
    def broken(self) -> Point | None:
        """The mildest level that is not tolerated; for ``kind.worse == "either"``, the level with the largest change.

        None if all levels are tolerated.
        """
        beyond = [point for point in self.points if not point.is_tolerated]
        if self.kind.worse == "either":
            return max(beyond, key=lambda point: point.ratio, default=None)
        return next(iter(beyond), None)

    @property
    def silent(self) -> tuple[float, ...]:
        """Levels that are not tolerated although the verdict has no new caution."""
        return tuple(point.level for point in self.points if not (point.is_tolerated or point.noticed))


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
        Parameters whose changes are compared with the tolerance.
    share : float
        Tolerated change of a parameter, as a fraction of its size.
    """
    series: dict[tuple[str, str], dict[float, Point]] = {}
    for run in runs:
        points = series.setdefault((run.perturbation.kind, run.perturbation.target), {})
        point = _make_point(own, run, names, share)
        if math.isnan(point.ratio):
            continue
        other = points.get(point.level)
        points[point.level] = point if other is None or point.ratio > other.ratio else other
    kinds = {run.perturbation.kind: run.perturbation.definition for run in runs}
    return tuple(_find_tolerance(kinds[kind], target, points.values()) for (kind, target), points in series.items())


def _make_point(own: Estimates, run: PerturbationRun, names: Sequence[str], share: float) -> Point:
    ratio, name = largest_ratio(own, run.estimates, names, share)
    before = own.parameters.get(name)
    after = run.estimates.parameters.get(name) if run.estimates is not None else None
    percent = math.nan
    if before is not None and after is not None and before.size > 0:
        percent = 100 * abs(after.value - before.value) / before.size
    noticed = run.estimates is None or bool(run.estimates.codes - own.codes)
    return Point(abs(run.perturbation.level), ratio, name, percent, noticed, 100 * run.changes.torque_share)


def _find_tolerance(kind: Kind, target: str, points: Iterable[Point]) -> Tolerance:
    ordered = tuple(sorted(points, key=lambda point: -point.level if kind.worse == "less" else point.level))
    low, high = _find_range(ordered) if kind.worse == "either" else (0.0, _find_limit(kind, ordered))
    return Tolerance(kind, target, ordered, low, high)


def _find_limit(kind: Kind, points: Sequence[Point]) -> float:
    """Return the worst level that is tolerated together with all milder levels; NaN if there is no such level."""
    mild = None
    for point in points:
        if not point.is_tolerated:
            return _find_crossing(kind, mild, point)
        mild = point
    return math.nan if mild is None else mild.level


def _find_crossing(kind: Kind, mild: Point | None, beyond: Point) -> float:
    """Return the limit between ``mild`` (tolerated; None: no perturbation) and ``beyond`` (not); NaN if unknown."""
    if kind.is_count:
        return math.nan if mild is None else mild.level
    if mild is None or mild.level == 0:  # without a perturbation nothing changes
        return beyond.level / beyond.ratio if math.isfinite(beyond.ratio) else math.nan
    return _interpolate(mild, beyond)


def _interpolate(mild: Point, beyond: Point) -> float:
    """Return the level with ratio 1, interpolated by a power law; ``mild.level`` if a ratio is zero or infinite."""
    if not math.isfinite(beyond.ratio) or mild.ratio <= 0:
        return mild.level
    share = math.log(1 / mild.ratio) / math.log(beyond.ratio / mild.ratio)
    return float(mild.level * (beyond.level / mild.level) ** share)


def _find_range(points: Sequence[Point]) -> tuple[float, float]:
    """Return both ends of the tolerated range around the level of least change; NaN if no level is tolerated."""
    if not any(point.is_tolerated for point in points):
        return math.nan, math.nan
    first = last = min(range(len(points)), key=lambda k: points[k].ratio)
    while first > 0 and points[first - 1].is_tolerated:
        first -= 1
    while last < len(points) - 1 and points[last + 1].is_tolerated:
        last += 1
    low = points[first].level if first == 0 else _interpolate(points[first], points[first - 1])
    high = points[last].level if last == len(points) - 1 else _interpolate(points[last], points[last + 1])
    return low, high


def describe_tolerance(one: Tolerance) -> str:
    """Return a sentence: the tolerated levels, the parameter that changes first, and whether the verdict warns."""
    kind, target = one.kind, one.target
    if kind.free:
        about = f"{kind.title}, markers to {1e3 * float(target):g} mm: sigma_v"
    else:
        about = f"{kind.title}, {'all joints' if target == ALL else target}" if target else kind.title
    if not one.points:
        return f"{about}: there is nothing to compare."
    text = f"{about}: {_describe_range(one)}"
    broken = one.broken
    if broken is None:
        most = max(one.points, key=lambda point: point.ratio)
        change = f"{most.parameter} changes most, by {_format_percent(most)}"
        return f"{text}, all levels that were tried ({change}){_describe_torques(one)}."
    return f"{text}; {_describe_break(one, broken)}, and {_describe_warning(one)}{_describe_torques(one)}."


def describe_failures(runs: Sequence[PerturbationRun]) -> str:
    """Return a note about perturbations that failed without a refusal; empty if no perturbation failed."""
    whys = [run.why for run in runs if run.estimates is None and not run.refused]
    return f"{len(whys)} of {len(runs)} perturbations failed and count as not tolerated ({whys[0]})" if whys else ""


def _format_level(one: Tolerance, level: float) -> str:
    """Return a level as text, in a usual unit."""
    if one.kind.name == "marker-count":
        return f"{level:g} markers"
    if one.kind.is_count:
        return f"division by {level:g}"
    unit, factor = _UNITS.get(one.kind.unit, (_COMPONENT_UNITS.get(one.target, one.kind.unit), 1.0))
    return f"{float(f'{factor * level:.2g}'):g} {unit}"


def _format_percent(point: Point) -> str:
    return "less than 0.001 %" if point.percent < 1e-3 else show(point.percent, 2, "%")


def _describe_range(one: Tolerance) -> str:
    if math.isnan(one.low) or math.isnan(one.high):
        return "no level that was tried is tolerated"
    low, high = (_format_level(one, level) for level in (one.low, one.high))
    if one.kind.worse == "either":
        return f"from {low} to {high}" if low != high else f"at {low} alone"
    return f"down to {high}" if one.kind.name == "marker-count" else f"up to {high}"


def _describe_break(one: Tolerance, point: Point) -> str:
    at = _format_level(one, point.level)
    if math.isnan(point.percent):
        return f"at {at} nothing is identified any more"
    verb = "change" if one.kind.name == "marker-count" else "changes"
    return f"{at} {verb} {point.parameter} by {_format_percent(point)}"


def _describe_warning(one: Tolerance) -> str:
    silent = one.silent
    if not silent:
        return "the verdict warns of it"
    levels = ", ".join(_format_level(one, level) for level in silent)
    beyond = sum(not point.is_tolerated for point in one.points)
    return (
        "the verdict does not warn of it" if len(silent) == beyond else f"at {levels} the verdict does not warn of it"
    )


def _describe_torques(one: Tolerance) -> str:
    """Return text about the largest change of a torque at a tolerated level; empty if it is small.

    Noise changes torques more than parameters.
    """
    points = [point for point in one.points if point.is_tolerated and point.torque > _MUCH]
    if not points:
        return ""
    most = max(points, key=lambda point: point.torque)
    return f"; torques, however, change by {show(most.torque, 2, '%')} (rms) at {_format_level(one, most.level)}"
