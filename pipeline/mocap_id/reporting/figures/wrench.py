"""The ground's wrench and the centre of pressure: measured, modelled, by the reference (figure 6.7)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.decimation import band, envelope, spans
from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import NORMAL_95

_ROWS = (("Fx", "Fx (N)"), ("Fy", "Fy, upwards (N)"), ("tauz", "τz (N·m)"), ("cop_x", "CoP x (m)"))
_COP_TAIL = 0.005  # a centre of pressure under a light foot may shoot off to anywhere


def draw(material: Material) -> Figure | str:
    """Four rows over time; before the identification only what the plates measured."""
    frame = material.frame("dynamics.parquet")
    if frame is None:
        frame = material.frame("wrench.parquet")
    if frame is None or not any(_known(frame, name) for column, _ in _ROWS for name in (column, f"{column}_model")):
        why = material.facts("wrench.parquet").get("why") or material.why_missing("wrench.parquet")
        return f"No contact wrench: {why}."
    figure = style.figure(7.0)
    rows = figure.subplots(4, sharex=True)
    for axes, (name, label) in zip(rows, _ROWS, strict=True):
        style.label_left(axes, label)
        _row(axes, frame, name)
    rows[3].set_xlabel("time (s)")
    style.legend_above(figure, rows)
    return figure


def _known(frame: pd.DataFrame, column: str) -> bool:
    """Whether the column exists and holds a number."""
    return column in frame and bool(np.isfinite(frame[column].to_numpy(dtype=np.float64)).any())


def _row(axes: Axes, frame: pd.DataFrame, name: str) -> None:
    """One component: the fit's samples shaded, the model with its band, the reference, the measurement."""
    time = frame["time"].to_numpy(dtype=np.float64)
    if "in_fit" in frame:
        fit = spans(time, frame["in_fit"].to_numpy(dtype=np.bool_))
        axes.broken_barh(fit, (0, 1), transform=axes.get_xaxis_transform(), color=style.GRID, alpha=0.5, lw=0)
    if _known(frame, name):
        axes.plot(*envelope(time, _column(frame, name)), color=style.MEASURED, lw=0.9, label="measured")
    if _known(frame, f"{name}_reference"):
        reference = envelope(time, _column(frame, f"{name}_reference"))
        axes.plot(*reference, "--", color=style.REFERENCE, label="allometric reference")
    if _known(frame, f"{name}_model"):
        model = _column(frame, f"{name}_model")
        if _known(frame, f"sd_{name}_model"):
            half = NORMAL_95 * _column(frame, f"sd_{name}_model")
            x, low, high = band(time, model - half, model + half)
            axes.fill_between(x, low, high, color=style.MODEL, alpha=0.25, lw=0)
        axes.plot(*envelope(time, model), color=style.MODEL, label="identified model")
    curves = [_column(frame, column) for column in (name, f"{name}_model", f"{name}_reference") if column in frame]
    style.fit_y(axes, curves, _COP_TAIL if name == "cop_x" else 0.0)


def _column(frame: pd.DataFrame, name: str) -> FloatArray:
    return frame[name].to_numpy(dtype=np.float64)
