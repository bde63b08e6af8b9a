"""Wrench, centre of pressure and joint torques, averaged over the repetitions on their own time."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.material import Material

_WRENCH = (("Fx", "Fx (N)"), ("Fy", "Fy (N)"), ("tauz", "τz (N·m)"), ("cop_x", "CoP x (m)"))
_SOURCES = (
    ("", style.MEASURED, "-", "measured"),
    ("_model", style.MODEL, "-", "identified model"),
    ("_reference", style.REFERENCE, "--", "allometric reference"),
)


def draw(material: Material) -> Figure | str:
    """Four panels of the wrench, one of the torques; mean and one standard deviation over whole repetitions."""
    frame = material.frame("phases.parquet")
    if frame is None:
        return f"No averages over repetitions: {material.why_missing('phases.parquet')}."
    frame = frame[(frame["span"] == "repetition") & ~frame["quantity"].astype(str).str.startswith("theta_")]
    if not frame["mean"].notna().any():
        why = material.facts("phases.parquet").get("why") or "neither forces nor torques are known"
        return f"No averages over repetitions: {why}."
    figure = style.figure(4.2)
    *panels, torques, spare = figure.subplots(2, 3).ravel()
    spare.set_axis_off()
    for axes, (name, label) in zip(panels, _WRENCH, strict=True):
        axes.set_title(label)
        for suffix, colour, dash, what in _SOURCES:
            _curve(axes, frame, f"{name}{suffix}", (colour, dash, what))
        curves = [averaged(frame, f"{name}{suffix}")[0] for suffix, *_ in _SOURCES]
        style.fit_y(axes, [values for values in curves if values.size], 0.02 if name == "cop_x" else 0.0)
    names = material.skeleton.joints if material.skeleton is not None else ()
    torques.set_title("joint torques (N·m)")
    for k, name in enumerate(names, start=1):
        _curve(torques, frame, f"tau_{k}", (style.colour(k), "-", style.printable(name, 14)))
    if torques.lines:
        spare.legend(*torques.get_legend_handles_labels(), title="torques", loc="center left", fontsize=7)
    figure.supxlabel("share of the repetition (%)", fontsize=8)
    style.legend_above(figure, np.array(panels))
    return figure


def averaged(frame: pd.DataFrame, quantity: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean, standard deviation and percent of a quantity; empty where it is not there."""
    own = frame[frame["quantity"] == quantity]
    mean, sd, percent = (own[name].to_numpy(dtype=np.float64) for name in ("mean", "sd", "percent"))
    return mean, sd, percent


def _curve(axes: Axes, frame: pd.DataFrame, quantity: str, look: tuple[str, str, str | None]) -> None:
    mean, sd, percent = averaged(frame, quantity)
    if not np.isfinite(mean).any():
        return
    colour, dash, label = look
    axes.fill_between(percent, mean - sd, mean + sd, color=colour, alpha=0.15, lw=0)
    axes.plot(percent, mean, dash, color=colour, lw=1.2, label=label)
    axes.set_xlim(0, 100)
