"""Joint angles of every repetition on one common time (figure 6.5)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figures.phases import averaged
from mocap_id.reporting.material import Material
from mocap_id.reporting.views import Motion

_COLUMNS = 3
_GRID = np.linspace(0.0, 1.0, 101)


def draw(material: Material) -> Figure | str:
    """A panel per joint: each repetition thin, their mean thick, one standard deviation as a band."""
    motion, events = material.motion, material.frame("events.parquet")
    bounds = np.zeros((0, 2)) if events is None else whole_repetitions(events)
    if motion is None or not motion.mean.size or not len(bounds):
        why = "none was found" if events is not None else material.why_missing("events.parquet")
        return f"No repetitions to compare: {why}."
    curves = np.degrees(on_common_time(motion, bounds))  # (R, 101, n)
    joints = curves.shape[2]
    names = material.skeleton.joints if material.skeleton is not None else ()
    lines = -(-joints // _COLUMNS)
    columns = -(-joints // lines)
    figure = style.figure(0.4 + 2.1 * lines)
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for j, axes in enumerate(panels):
        if j >= joints:
            axes.set_axis_off()
            continue
        _panel(axes, curves[..., j], j, style.printable(names[j], 20) if j < len(names) else f"joint {j + 1}")
        _other(axes, material.frame("phases.parquet"), j + 1)
        _seat_off(axes, events)
    figure.supxlabel(f"share of the repetition (%), {len(bounds)} drawn", fontsize=8)
    figure.supylabel("angle (deg)", fontsize=8)
    return figure


def whole_repetitions(events: pd.DataFrame) -> FloatArray:
    """Start and end of the repetitions that have both, (R, 2), s."""
    bounds = events[["start", "end"]].to_numpy(dtype=np.float64)
    whole: FloatArray = bounds[bounds[:, 1] > bounds[:, 0]]  # false where either is unknown
    return whole


def on_common_time(motion: Motion, bounds: FloatArray) -> FloatArray:
    """The angles at 0, 1, … 100 % of each repetition, (R, 101, n), rad; NaN where bridged or outside the states."""
    at = bounds[:, :1] + (bounds[:, 1:] - bounds[:, :1]) * _GRID  # (R, 101)
    nearest = np.searchsorted(motion.time, at).clip(0, len(motion.time) - 1)
    curves = np.stack([np.interp(at, motion.time, angle, np.nan, np.nan) for angle in motion.angles.T], axis=-1)
    return np.where(motion.observed[nearest], curves, np.nan)


def _panel(axes: Axes, curves: FloatArray, joint: int, name: str) -> None:
    colour = style.colour(joint + 1)
    percent = 100 * _GRID
    for curve in curves:
        axes.plot(percent, curve, color=colour, lw=0.6, alpha=0.6)
    count = np.isfinite(curves).sum(axis=0)
    share = np.where(count > 0, count, np.nan)
    mean = np.nansum(curves, axis=0) / share
    spread = np.sqrt(np.nansum((curves - mean) ** 2, axis=0) / np.where(count > 1, count - 1, np.nan))
    axes.fill_between(percent, mean - spread, mean + spread, color=colour, alpha=0.2, lw=0)
    axes.plot(percent, mean, color=colour, lw=1.8)
    axes.set_title(name)
    axes.set_xlim(0, 100)


def _other(axes: Axes, found: pd.DataFrame | None, joint: int) -> None:
    """Another system's angle of the joint, as given, where the trial has one."""
    if found is None:
        return
    mean, sd, percent = averaged(found[found["span"] == "repetition"], f"theta_{joint}_other")
    if not np.isfinite(mean).any():
        return
    mean, sd = np.degrees(mean), np.degrees(sd)
    axes.fill_between(percent, mean - sd, mean + sd, color=style.OTHER, alpha=0.2, lw=0)
    axes.plot(percent, mean, "--", color=style.OTHER, lw=1.4)


def _seat_off(axes: Axes, events: pd.DataFrame | None) -> None:
    """Mean share of the repetition at which the chair is released, dotted."""
    if events is None:
        return
    start, seat_off, end = events[["start", "seat_off", "end"]].to_numpy(dtype=np.float64).T
    share = (seat_off - start) / np.where(end > start, end - start, np.nan)
    share = share[np.isfinite(share)]
    if len(share):
        axes.axvline(100 * float(share.mean()), color=style.INK, lw=0.8, ls=":")
