"""Figures of prescribed springs: ranges, postures that can be held, level sets, map of springs (thesis 7.6 to 7.9)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.prescription.level_set import JointDynamics, ReachableSet
from mocap_id.prescription.one_joint import OneJoint
from mocap_id.prescription.one_spring import Prescription
from mocap_id.reporting import paper_figures, style


def draw_ranges(joint: OneJoint, found: Prescription) -> Figure:
    """Draw the range of one joint with and without its spring on a dial, and its holding torque (figures 7.6 to 7.8).

    On the dial, 0 points downwards; the torque of gravity is proportional to the sine of the angle.
    """
    figure = paper_figures.make_figure(3.0)
    grid = figure.add_gridspec(1, 2, width_ratios=(1, 2))
    dial: Any = figure.add_subplot(grid[0, 0], projection="polar")
    dial.set_theta_zero_location("S")
    bands = [
        ("joint limits", (joint.lower, joint.upper), style.BLUE, 1.0),
        ("with spring", found.range, style.GREEN, 0.6),
    ]
    if found.without is not None:
        bands.insert(1, ("without spring", found.without, style.VERMILLION, 0.8))
    for label, (low, high), colour, radius in bands:
        angle = np.linspace(low, high, 181)
        dial.plot(angle, np.full_like(angle, radius), color=colour, lw=5, label=label, solid_capstyle="butt")
    dial.set_rticks([])
    dial.set_ylim(0, 1.1)
    axes = figure.add_subplot(grid[0, 1])
    angle = np.linspace(joint.lower, joint.upper, 361)
    axes.plot(np.degrees(angle), joint.gravity(angle), color=style.VERMILLION, label="without spring")
    if found.helps:
        torque = joint.torque(angle, found.stiffness, found.rest)
        axes.plot(np.degrees(angle), torque, color=style.GREEN, label="with spring")
        axes.axvspan(*np.degrees(found.range), color=style.GREEN, alpha=0.12, lw=0)
    for limit in (joint.torque_low, joint.torque_high):
        axes.axhline(limit, color=style.INK, ls="--", lw=0.8)
    spring = f"{found.stiffness:.3g} N·m/rad, rest {np.degrees(found.rest):.1f}°" if found.helps else "no spring helps"
    axes.set(title=spring, xlabel="angle (°)", ylabel="holding torque (N·m)")
    paper_figures.add_legend(figure, [dial])
    return figure


def draw_holdable_postures(tips: FloatArray, without: BoolArray, held: BoolArray, joint: FloatArray) -> Figure:
    """Draw the tip positions that can be held without and with springs.

    Parameters
    ----------
    tips : (N, 2) array
        Tip position of each sampled posture, m.
    without, held : (N,) bool arrays
        Whether each posture can be held without springs, and with springs.
    joint : (2,) array
        Position of the first joint, m.
    """
    figure = paper_figures.make_figure(3.4)
    panels = figure.subplots(1, 2, sharey=True)  # both axes shared would not allow `datalim`
    kinds = (("without springs", without, style.VERMILLION), ("with springs", held, style.GREEN))
    for axes, (title, which, colour) in zip(panels, kinds, strict=True):
        axes.plot(*tips[~which].T, ".", ms=1.2, color=style.FAINT, rasterized=True)
        axes.plot(*tips[which].T, ".", ms=2.2, color=colour, rasterized=True)
        axes.plot(*joint, "o", ms=5, mfc="none", mec=style.INK)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(title=title, xlabel="x (m)")
    panels[0].set_ylabel("y, up (m)")
    return figure


def draw_spring_map(stiffness: FloatArray, rest: FloatArray, width: FloatArray, horizon: float) -> Figure:
    """Draw the range against stiffness and rest angle of the spring (figure 7.9, left).

    Parameters
    ----------
    stiffness, rest : (K,), (R,) arrays
        Stiffness, N·m/rad, and rest angle, rad, of the springs.
    width : (K, R) array
        Range of the joint with each spring, rad; NaN (blank) without an equilibrium within the limits.
    horizon : float
        Time in which the range is reached, s.
    """
    figure = paper_figures.make_figure(3.6)
    axes = figure.subplots()
    ranges = np.ma.masked_invalid(np.degrees(width))
    cells = axes.pcolormesh(
        np.degrees(rest), stiffness, ranges, cmap=paper_figures.HEAT, shading="nearest", rasterized=True
    )
    figure.colorbar(cells, ax=axes, label="range (°)")
    title = f"range reached within {horizon:g} s and held"
    axes.set(xlabel="rest angle (°)", ylabel="stiffness (N·m/rad)", title=title)
    axes.grid(False)
    return figure


def draw_level_sets(
    reached: ReachableSet, bounds: Sequence[tuple[float, float] | None], dynamics: JointDynamics
) -> Figure:
    """Draw the arrival time against angle and velocity, reachable sets, and the range that can be held (7.9, right).

    ``bounds`` are the ends of this range, rad, at each time of ``reached``; None without one. Only the last is drawn.
    """
    figure = paper_figures.make_figure(3.6)
    axes = figure.subplots()
    grid = reached.grid
    angle = np.degrees(grid.angle)
    arrival = np.where(np.isfinite(reached.arrival), reached.arrival, np.nan)
    levels = np.linspace(0.0, reached.times[-1], paper_figures.SHADES + 1)
    shades = axes.contourf(angle, grid.velocity, arrival.T, levels=levels, cmap=paper_figures.HEAT)
    figure.colorbar(shades, ax=axes, label="arrival time (s)")
    for values in reached.values:
        axes.contour(angle, grid.velocity, values.T, levels=[0.0], colors=style.INK, linewidths=0.7)
    if bounds[-1] is not None:
        for end in bounds[-1]:
            axes.axvline(np.degrees(end), color=style.INK, lw=1.2)
    start = dynamics.equilibrium()
    if start is not None:
        axes.plot(np.degrees(start), 0.0, "x", color=style.VERMILLION)
    axes.set(xlabel="angle (°)", ylabel="velocity (rad/s)", title="states reached from rest at the cross")
    return figure
