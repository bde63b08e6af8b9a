"""Joint states over time, with bands, and shades where nothing was seen (figure 6.2, right)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.reporting import style
from mocap_id.reporting.decimation import band, envelope, spans
from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import NORMAL_95
from mocap_id.reporting.views import Motion

_QUANTITIES = ("angle (deg)", "velocity (deg/s)", "acceleration (deg/s²)")
_STRIP = 0.13  # inches for each joint's strip of gaps


def draw(material: Material) -> Figure | str:
    """Angle, velocity and acceleration of every joint, and below them which joint is bridged when."""
    motion = material.motion
    if motion is None or not motion.mean.size:
        return f"No joint states: {material.why_missing('states.parquet')}."
    joints = motion.mean.shape[1]
    strip = 0.1 + _STRIP * joints
    figure = style.figure(5.4 + strip)
    rows = figure.subplots(4, sharex=True, height_ratios=(1.8, 1.8, 1.8, strip))
    names = material.skeleton.joints if material.skeleton is not None else ()
    for k, (axes, label) in enumerate(zip(rows, _QUANTITIES, strict=False)):
        style.label_left(axes, label)
        _curves(axes, motion, k, names)
        gaps = spans(motion.time, motion.observed.sum(axis=1) < motion.observed.shape[1])
        axes.broken_barh(gaps, (0, 1), transform=axes.get_xaxis_transform(), color=style.GRID, alpha=0.6, lw=0)
    _strips(rows[3], motion)
    style.legend_above(figure, rows[:1])
    rows[3].set_xlabel("time (s)")
    return figure


def _curves(axes: Axes, motion: Motion, order: int, names: tuple[str, ...]) -> None:
    """One derivative of every joint, degrees, with its 95 % band; framed by what was observed, not by the gaps."""
    drawn = []
    for j in range(motion.mean.shape[1]):
        value = np.degrees(motion.mean[:, j, order])
        half = NORMAL_95 * np.degrees(motion.sd[:, j, order])
        colour = style.colour(j + 1)
        x, low, high = band(motion.time, value - half, value + half)
        axes.fill_between(x, low, high, color=colour, alpha=0.25, lw=0)
        label = style.printable(names[j], 20) if j < len(names) else f"joint {j + 1}"
        axes.plot(*envelope(motion.time, value), style.dashes(j + 1), color=colour, label=label)
        seen = motion.observed[:, j]
        drawn += [value, (value - half)[seen], (value + half)[seen]]
    style.fit_y(axes, drawn)


def _strips(axes: Axes, motion: Motion) -> None:
    """A row for each joint, marked where it is bridged."""
    joints = motion.mean.shape[1]
    for j in range(joints):
        axes.broken_barh(spans(motion.time, ~motion.observed[:, j]), (joints - j - 0.8, 0.6), color=style.colour(j + 1))
    if motion.observed.all():
        axes.text(0.5, 0.5, "nowhere", transform=axes.transAxes, ha="center", va="center")
    axes.set(ylim=(0, joints), yticks=[])
    axes.set_ylabel("bridged", rotation=0, ha="right", va="center")
    axes.grid(False, axis="y")
