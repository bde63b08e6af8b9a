"""The main results of a trial, each with its tolerated change.

The tolerance of a number with a standard deviation is half of its 95 % interval. Other numbers have a relative
tolerance, or an absolute one that is negligible in practice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from mocap_id.arrays import NORMAL_95

Value: TypeAlias = float | str | None


@dataclass(frozen=True)
class Quantity:
    """A value with its tolerance."""

    value: Value  # a number, or a text that must not change; None if unknown
    tolerance: float = 0.0  # in the unit of the value
    unit: str = ""


def quantities(summary: Mapping[str, Any]) -> dict[str, Quantity]:
    """Return the quantities in a trial's summary.json by name; a name is the path of keys in the file."""
    return {
        **dict(_list_verdict(summary)),
        **dict(_list_skeleton(summary)),
        **dict(_list_dynamics(summary.get("dynamics") or {})),
        **dict(_list_repetitions(summary.get("repetitions") or [])),
    }


def _list_verdict(summary: Mapping[str, Any]) -> Iterator[tuple[str, Quantity]]:
    verdict = summary["verdict"]
    yield "verdict.level", Quantity(verdict["level"])
    yield "verdict.codes", Quantity(" ".join(sorted({reason["code"] for reason in verdict["reasons"]})))


def _list_skeleton(summary: Mapping[str, Any]) -> Iterator[tuple[str, Quantity]]:
    plane, segments = summary.get("plane") or {}, summary.get("segments") or {}
    markers, noise = summary.get("markers") or {}, summary.get("noise") or {}
    yield "plane.yaw_deg", Quantity(plane.get("yaw_deg"), 0.5, "deg")
    yield "segments.names", Quantity(" ".join(segments.get("names") or []))
    for marker, segment in sorted((segments.get("assignment") or {}).items()):
        yield f"segments.assignment.{marker}", Quantity(str(segment))
    for joint in summary.get("joints") or []:
        centre = joint["centre_m"] or []
        for axis, value, sd in zip("xyz", centre, joint["sd_m"] or [None] * len(centre), strict=False):
            yield f"joints.{joint['name']}.{axis}", _make_with_interval(value, sd, "m")
        if summary.get("space") == "3d":
            yield f"joints.{joint['name']}.kind", Quantity(joint["kind"])
            yield f"joints.{joint['name']}.known", Quantity(str(joint["known"]))
    for name, angle in (summary.get("angles") or {}).items():
        low, high = angle["interval_deg"] or (None, None)
        sd = None if low is None or high is None else (high - low) / (2 * NORMAL_95)
        yield f"angles.{name}.range_deg", _make_with_interval(angle["range_deg"], sd, "deg")
    for name, length in (summary.get("lengths_m") or {}).items():
        yield f"lengths_m.{name}", _make_with_interval(length["value"], length["sd"], "m")
    yield "markers.reprojection_rms_mm", _make_relative(markers.get("reprojection_rms_mm"), 0.05, "mm")
    yield "markers.missing_fraction", Quantity(markers.get("missing_fraction"), 0.001, "")
    yield "noise.marker_sd_m", _make_relative(noise.get("marker_sd_m"), 0.05, "m")


def _list_dynamics(dynamics: Mapping[str, Any]) -> Iterator[tuple[str, Quantity]]:
    for base in dynamics.get("base") or []:
        yield f"dynamics.base.{base['name']}", _make_with_interval(base["value"], base["sd"], base["unit"])
        yield f"dynamics.base.{base['name']}.verdict", Quantity(base.get("verdict") or "")
    yield "dynamics.condition_number", _make_relative(dynamics.get("condition_number"), 0.05, "")
    offset, sd = dynamics.get("clock_offset_s"), dynamics.get("clock_offset_sd_s")
    yield "dynamics.clock_offset_s", _make_with_interval(offset, sd, "s")
    for name, residual in (dynamics.get("wrench") or {}).items():
        yield f"dynamics.wrench.{name}.r2", Quantity(residual["r2"], 0.005, "")
        yield (
            f"dynamics.wrench.{name}.sd",
            _make_relative(residual["sd"], 0.05, "N*m" if name.startswith("tau") else "N"),
        )
    yield "dynamics.cop_rms_m", _make_relative(dynamics.get("cop_rms_m"), 0.05, "m")
    yield "dynamics.samples", _make_relative(dynamics.get("samples"), 0.02, "")


def _list_repetitions(repetitions: list[Mapping[str, Any]]) -> Iterator[tuple[str, Quantity]]:
    yield "repetitions.count", Quantity(str(len(repetitions)))
    for number, one in enumerate(repetitions, start=1):
        for event in ("start_s", "seat_off_s", "stand_s", "seat_on_s", "end_s"):
            yield f"repetitions.{number}.{event}", Quantity(one.get(event), 0.02, "s")


def _make_with_interval(value: float | None, sd: float | None, unit: str) -> Quantity:
    """Return a quantity whose tolerance is half of its 95 % interval, or 5 % if the standard deviation is unknown."""
    if sd is None or not math.isfinite(sd):
        return _make_relative(value, 0.05, unit)
    return Quantity(value, NORMAL_95 * sd, unit)


def _make_relative(value: float | None, share: float, unit: str) -> Quantity:
    return Quantity(value, 0.0 if value is None else share * abs(value), unit)
