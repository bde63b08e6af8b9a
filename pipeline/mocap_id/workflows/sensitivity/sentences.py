"""The tolerated levels of a trial in sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mocap_id.reporting.numbers import show
from mocap_id.workflows.sensitivity.kinds import ALL, Kind
from mocap_id.workflows.sensitivity.runs import PerturbationRun
from mocap_id.workflows.sensitivity.tolerance import Point, Tolerance

_SHOWN = {"s": ("ms", 1e3), "m": ("mm", 1e3), "of samples": ("% of the samples", 1e2), "rad/s^4": ("rad/s⁴", 1.0)}
_MUCH = 5.0  # %: rms change of a joint torque that is worth mentioning
_COMPONENT_UNITS = {"Fx": "N", "Fy": "N", "tauz": "N·m"}


def amount(kind: Kind, target: str, level: float) -> str:
    """Return a level with a common unit."""
    if kind.name == "marker-count":
        return f"{level:g} markers"
    if kind.counted:
        return f"division by {level:g}"
    unit, factor = _SHOWN.get(kind.unit, (_COMPONENT_UNITS.get(target, kind.unit), 1.0))
    return f"{float(f'{factor * level:.2g}'):g} {unit}"


def title(kind: Kind, target: str) -> str:
    """Return a kind and its target in words."""
    if kind.free:
        return f"{kind.title}, markers to {1e3 * float(target):g} mm: sigma_v"
    return f"{kind.title}, {'all joints' if target == ALL else target}" if target else kind.title


def sentence(one: Tolerance) -> str:
    """Return which levels are tolerated, which parameter changes first, and whether the verdict says so."""
    about = title(one.kind, one.target)
    if not one.points:
        return f"{about}: there is nothing to compare."
    text = f"{about}: {_extent(one)}"
    broken = one.broken
    if broken is None:
        most = max(one.points, key=lambda point: point.ratio)
        return f"{text}, all that was tried ({most.parameter} moves most, by {_percent(most)}){_torques(one)}."
    return f"{text}; {_breaks(one, broken)}, and {_notice(one)}{_torques(one)}."


def failure_note(runs: Sequence[PerturbationRun]) -> str:
    """Return a note on perturbations that failed without being refused; empty if there are none."""
    whys = [run.why for run in runs if run.estimates is None and not run.refused]
    return f"{len(whys)} of {len(runs)} perturbations failed and count as not tolerated ({whys[0]})" if whys else ""


def _torques(one: Tolerance) -> str:
    """Describe how the joint torques change at tolerated levels: noise changes them more than the parameters."""
    known = [point for point in one.points if point.within and point.torque > _MUCH]
    if not known:
        return ""
    most = max(known, key=lambda point: point.torque)
    at = amount(one.kind, one.target, most.level)
    return f"; torques, though, move by {show(most.torque, 2, '%')} (rms) at {at}"


def _extent(one: Tolerance) -> str:
    kind = one.kind
    if kind.worse == "either":
        if math.isnan(one.low):
            return "no level that was tried is tolerated"
        low, high = (amount(kind, one.target, level) for level in (one.low, one.high))
        return f"from {low} to {high}" if low != high else f"at {low} alone"
    if math.isnan(one.high):
        return "no level that was tried is tolerated"
    if kind.name == "marker-count":
        return f"down to {amount(kind, one.target, one.high)}"
    return f"up to {amount(kind, one.target, one.high)}"


def _breaks(one: Tolerance, point: Point) -> str:
    at = amount(one.kind, one.target, point.level)
    if math.isnan(point.percent):
        return f"at {at} nothing is identified any more"
    return f"{at} {'move' if one.kind.name == 'marker-count' else 'moves'} {point.parameter} by {_percent(point)}"


def _percent(point: Point) -> str:
    return "less than 0.001 %" if point.percent < 1e-3 else show(point.percent, 2, "%")


def _notice(one: Tolerance) -> str:
    silent = one.silent
    if not silent:
        return "the verdict says so"
    levels = ", ".join(amount(one.kind, one.target, level) for level in silent)
    beyond = sum(not point.within for point in one.points)
    return "nothing in the verdict says so" if len(silent) == beyond else f"at {levels} nothing in the verdict says so"
