"""The tables of a robot study as text, in the form of the thesis's: mean (standard deviation)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.reporting.numbers import UNKNOWN, known, show, show_fixed
from mocap_id.reporting.robot.material import RobotMaterial, Shown
from mocap_id.reporting.style import unit
from mocap_id.reporting.tables import Grid, grid

_UNITS = {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi), "rad/s": ("deg/s", 180 / np.pi)}
_NAMES = {
    "base": "l₁", "marker": "ε_M", "theta": "ε_θ", "dtheta": "ε_θ̇", "ddtheta": "ε_θ̈", "base_error": "l₁ − reference",
    "condition": "condition", "mass": "m₁+m₂", "mx1": "mx₁+Tₓm₂", "mx2": "mx₂", "my2": "my₂", "Izz2": "Izz₂",
    "torque": "ε_τ", "Fx": "ε_Fx", "Fy": "ε_Fy", "tauz": "ε_τz",
}  # fmt: skip
_DECIMALS = {"mm": 2, "deg": 3, "deg/s": 2, "1": 1, "kg·m²": 4}
_SOURCES = {"this": "this program", "thesis": "thesis"}


def table(shown: Shown) -> Grid:
    """One of the thesis's tables with its rows below ours."""
    columns = [_column(name, unit_) for name, unit_ in shown.quantities]
    oriented = bool(shown.frame["orientation"].notna().any())
    rows = [
        (
            row["joint"] or UNKNOWN,
            *((show_fixed(row["orientation"], 0),) if oriented else ()),
            row["speed"] or UNKNOWN,
            row["obs"],
            _SOURCES[row["source"]],
            str(row["trials"] or UNKNOWN),
            *(_pair(row, name, factor, decimals) for name, _, factor, decimals in columns),
        )
        for row in shown.frame.to_dict("records")
    ]
    labels = ("joint", *(("orientation (deg)",) if oriented else ()), "speed", "obs.", "by", "trials")
    return grid(shown.title, (*labels, *(title for _, title, _, _ in columns)), rows, range(len(labels)))


def _column(name: str, unit_: str) -> tuple[str, str, float, int]:
    """A quantity's name, its title with the unit, factor from SI, and decimals."""
    if name.endswith("_r2"):
        return name, f"{_NAMES[name[:-3]]} r²", 1.0, 5
    shown, factor = _UNITS.get(unit_, (unit(unit_), 1.0))
    title = _NAMES[name] + ("" if unit_ == "1" else f" ({shown})")
    return name, title, factor, _DECIMALS.get(shown, 3)


def _pair(row: Mapping[Any, Any], name: str, factor: float, decimals: int) -> str:
    mean, sd = known(row[f"{name}_mean"]), known(row[f"{name}_sd"])
    if mean is None and sd is None:
        return UNKNOWN
    shown = "?" if mean is None else show_fixed(factor * mean, decimals)
    return shown if sd is None else f"{shown} ({show_fixed(factor * sd, decimals)})"


def overview(material: RobotMaterial) -> Grid:
    """Every trial by its cameras: what came of it, and how far off it is where that is known."""
    frame = material.overview
    rows = [
        (
            row["trial"],
            row["verdict"],
            row["codes"] or UNKNOWN,
            show_fixed(_times(row["base"], 1e3), 2),
            show_fixed(_times(row["base_error"], 1e3), 2),
            show_fixed(row["ddtheta_r2"], 4),
            show(row["condition"]),
            _off(row, "my2"),
            _off(row, "Izz2"),
            row["Izz2_verdict"] or UNKNOWN,
            show_fixed(row["torque_r2"], 4),
            show_fixed(_times(row["encoder_offset"], 1e3), 3),
        )
        for row in frame[frame["method"] == "cameras"].to_dict("records")
    ]
    head = (
        "trial", "verdict", "reasons", "l₁ (mm)", "off (mm)", "acceleration r²", "condition", "my₂ off (%)",
        "Izz₂ off (%)", "Izz₂ is", "torque r²", "encoder's clock (ms)",
    )  # fmt: skip
    caption = "Every trial by its cameras: value less reference ± standard deviation, of the reference"
    return grid(caption, head, rows, (0, 1, 2, 9))


def _off(row: Mapping[Any, Any], name: str) -> str:
    value, reference, sd = (known(row[key]) for key in (name, f"{name}_reference", f"{name}_sd"))
    if value is None or not reference or sd is None:
        return UNKNOWN
    return f"{show_fixed(100 * (value / reference - 1), 2)} ± {show_fixed(100 * sd / reference, 2)}"


def _times(value: object, factor: float) -> float | None:
    number = known(value)
    return None if number is None else factor * number
