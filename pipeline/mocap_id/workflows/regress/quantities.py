"""The headline numbers of a trial, each with how far it may move before somebody ought to know.

Where a number has a stated standard deviation, the tolerance is its 95 % interval: what has moved farther is another
answer. Where it has none, a share of the number stands in, or what a lab would call the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

INTERVAL = 1.96
"""Standard deviations to either side of a value: 95 %."""

Value: TypeAlias = float | str | None


@dataclass(frozen=True)
class Quantity:
    """A value and by how much it may move.

    Parameters
    ----------
    value : float or str or None
        Text may not change at all; None is unknown.
    tolerance : float
        In the value's unit.
    unit : str
    """

    value: Value
    tolerance: float = 0.0
    unit: str = ""


def quantities(summary: Mapping[str, Any]) -> dict[str, Quantity]:
    """Name → quantity of a trial's summary.json; a name is the way to it in the file."""
    return {
        **dict(_verdict(summary)),
        **dict(_skeleton(summary)),
        **dict(_dynamics(summary.get("dynamics") or {})),
        **dict(_repetitions(summary.get("repetitions") or [])),
    }


def failure(exit_code: int) -> dict[str, Quantity]:
    """Of a trial that went wrong: that it did, and how."""
    return {"exit_code": Quantity(str(exit_code))}


def _verdict(summary: Mapping[str, Any]) -> Iterator[tuple[str, Quantity]]:
    verdict = summary["verdict"]
    yield "verdict.level", Quantity(verdict["level"])
    yield "verdict.codes", Quantity(" ".join(sorted({reason["code"] for reason in verdict["reasons"]})))


def _skeleton(summary: Mapping[str, Any]) -> Iterator[tuple[str, Quantity]]:
    plane, segments = summary.get("plane") or {}, summary.get("segments") or {}
    markers, noise = summary.get("markers") or {}, summary.get("noise") or {}
    yield "plane.yaw_deg", _absolute(plane.get("yaw_deg"), 0.5, "deg")
    yield "segments.names", Quantity(" ".join(segments.get("names") or []))
    for marker, segment in sorted((segments.get("assignment") or {}).items()):
        yield f"segments.assignment.{marker}", Quantity(str(segment))
    for joint in summary.get("joints") or []:
        for axis, value, sd in zip("xy", joint["centre_m"], joint["sd_m"], strict=True):
            yield f"joints.{joint['name']}.{axis}", _stated(value, sd, "m")
    for name, length in (summary.get("lengths_m") or {}).items():
        yield f"lengths_m.{name}", _stated(length["value"], length["sd"], "m")
    yield "markers.reprojection_rms_mm", _share(markers.get("reprojection_rms_mm"), 0.05, "mm")
    yield "markers.missing_fraction", _absolute(markers.get("missing_fraction"), 0.001, "")
    yield "noise.marker_sd_m", _share(noise.get("marker_sd_m"), 0.05, "m")


def _dynamics(dynamics: Mapping[str, Any]) -> Iterator[tuple[str, Quantity]]:
    for base in dynamics.get("base") or []:
        yield f"dynamics.base.{base['name']}", _stated(base["value"], base["sd"], base["unit"])
        yield f"dynamics.base.{base['name']}.verdict", Quantity(base.get("verdict") or "")
    yield "dynamics.condition_number", _share(dynamics.get("condition_number"), 0.05, "")
    offset, sd = dynamics.get("clock_offset_s"), dynamics.get("clock_offset_sd_s")
    yield "dynamics.clock_offset_s", _stated(offset, sd, "s")
    for name, residual in (dynamics.get("wrench") or {}).items():
        yield f"dynamics.wrench.{name}.r2", _absolute(residual["r2"], 0.005, "")
        yield f"dynamics.wrench.{name}.sd", _share(residual["sd"], 0.05, "N*m" if name == "tauz" else "N")
    yield "dynamics.cop_rms_m", _share(dynamics.get("cop_rms_m"), 0.05, "m")
    yield "dynamics.samples", _share(dynamics.get("samples"), 0.02, "")


def _repetitions(repetitions: list[Mapping[str, Any]]) -> Iterator[tuple[str, Quantity]]:
    yield "repetitions.count", Quantity(str(len(repetitions)))
    for number, one in enumerate(repetitions, start=1):
        for event in ("start_s", "seat_off_s", "stand_s", "seat_on_s", "end_s"):
            yield f"repetitions.{number}.{event}", _absolute(one.get(event), 0.02, "s")


def _stated(value: float | None, sd: float | None, unit: str) -> Quantity:
    """By the 95 % interval; by a share where none is stated."""
    if sd is None or not math.isfinite(sd):
        return _share(value, 0.05, unit)
    return Quantity(value, INTERVAL * sd, unit)


def _share(value: float | None, share: float, unit: str) -> Quantity:
    return Quantity(value, 0.0 if value is None else share * abs(value), unit)


def _absolute(value: float | None, tolerance: float, unit: str) -> Quantity:
    return Quantity(value, tolerance, unit)
