"""Figures of prescribed springs (thesis 7.6 to 7.9), and of tours with changes of the pressures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.reporting import paper_figures, style
from mocap_id_assist.assisted_body import SpringMap
from mocap_id_assist.controllers import Controlled
from mocap_id_assist.level_set import JointDynamics, ReachableStates
from mocap_id_assist.one_joint import OneJoint, Prescription

_EVERY = 10  # every tenth sample of a tour is drawn


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


def draw_spring_map(springs: SpringMap) -> Figure:
    """Draw the range against stiffness and rest angle of the spring, blank without an equilibrium (figure 7.9)."""
    figure = paper_figures.make_figure(3.6)
    axes = figure.subplots()
    ranges = np.ma.masked_invalid(np.degrees(springs.width))
    cells = axes.pcolormesh(
        np.degrees(springs.rest), springs.stiffness, ranges, cmap=paper_figures.HEAT, shading="nearest", rasterized=True
    )
    figure.colorbar(cells, ax=axes, label="range (°)")
    title = f"range reached within {springs.horizon:g} s and held"
    axes.set(xlabel="rest angle (°)", ylabel="stiffness (N·m/rad)", title=title)
    axes.grid(False)
    return figure


def draw_level_sets(
    reached: ReachableStates, bounds: Sequence[tuple[float, float] | None], dynamics: JointDynamics
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


def draw_switching(controlled: Controlled, limits: tuple[float, float]) -> Figure:
    """Draw the tour of one joint with its nodes, pressures and torque, and the states in which a change is unsafe.

    ``limits`` are those of the person's torque, N·m.
    """
    tour, changes = controlled.tour, controlled.changes
    assert tour.torque is not None and tour.reference is not None
    figure = paper_figures.make_figure(6.4)
    columns = max(len(changes), 1)
    grid = figure.add_gridspec(4, columns, height_ratios=(2, 1, 1, 2))
    shown = slice(None, None, _EVERY)
    time = tour.time[shown]
    top = figure.add_subplot(grid[0, :])
    gas, torque = (figure.add_subplot(grid[k, :], sharex=top) for k in (1, 2))
    for k, node in enumerate(controlled.nodes):
        held = np.where(controlled.held[k], np.degrees(controlled.grid[:, 0]), np.nan)
        low, high = np.nanmin(held), np.nanmax(held)
        active = tour.node[shown] == k
        band: dict[str, Any] = {
            "color": style.pick_colour(k + 1),
            "alpha": 0.2,
            "lw": 0,
            "label": f"held with {node.name}",
        }
        top.fill_between(time, low, high, where=active.tolist(), **band)
    top.plot(time, np.degrees(tour.reference[shown]), "--", color=style.FAINT, lw=0.8, label="reference")
    top.plot(time, np.degrees(tour.q[shown, 0]), color=style.INK, label="angle")
    for k, (side, dash) in enumerate((("flexion", "-"), ("extension", "--"))):
        gas.plot(time, 1e-5 * tour.pressures[shown, 0, k], dash, color=style.BLUE, label=f"{side} side")
    torque.plot(time, tour.torque[shown], color=style.GREEN, lw=0.7, label="person")
    for limit in limits:
        torque.axhline(limit, color=style.INK, ls="--", lw=0.8)
    top.set(ylabel="angle (°)", title="a tour through all tasks")
    gas.set(ylabel="sealed (bar)")
    torque.set(ylabel="torque (N·m)", xlabel="time (s)")
    for column, one in enumerate(changes):
        axes = figure.add_subplot(grid[3, column])
        states = np.degrees(one.states)
        names = [controlled.nodes[k].name for k in (one.before, one.after)]
        for unsafe, colour, label in ((False, style.SKY, "safe change"), (True, style.VERMILLION, "unsafe change")):
            axes.plot(*states[one.unsafe == unsafe].T, ".", ms=2, color=colour, label=label, rasterized=True)
        if one.switched.any():
            ends = states[one.switched, 0][[0, -1]]
            axes.axvspan(*ends, color=style.INK, alpha=0.12, lw=0, label="the controller changes here")
        axes.set(title=f"{names[0]} → {names[1]}", xlabel="angle (°)", ylabel="" if column else "velocity (°/s)")
    paper_figures.add_legend(figure, figure.axes)
    return figure


def draw_chain_tour(controlled: Controlled) -> Figure:
    """Draw the tour of a chain: angles and active node, pressures, and the torque that exceeds the person's limits."""
    tour = controlled.tour
    figure = paper_figures.make_figure(5.2)
    angles, gas, missing = figure.subplots(3, 1, sharex=True, height_ratios=(2, 1.4, 0.8))
    for k, node in enumerate(controlled.nodes):
        active = (tour.node == k).tolist()
        band: dict[str, Any] = {"color": style.pick_colour(k + 1), "alpha": 0.2, "lw": 0}
        band["label"] = f"node {node.name}"
        angles.fill_between(tour.time, 0, 1, where=active, transform=angles.get_xaxis_transform(), **band)
    dashes = ("-", "--", ":")
    for j in range(tour.q.shape[1]):
        angles.plot(tour.time, np.degrees(tour.q[:, j]), dashes[j], color=style.INK, label=f"joint {j + 1}")
    for d in range(tour.pressures.shape[1]):
        for side, colour in enumerate((style.BLUE, style.VERMILLION)):
            label = f"{('flexion', 'extension')[side]} side of device {d + 1}"
            gas.plot(tour.time, 1e-5 * tour.pressures[:, d, side], dashes[d], color=colour, label=label)
    missing.plot(tour.time, tour.excess, color=style.VERMILLION, label="missing torque")
    angles.set(ylabel="angle (°)", title="a tour through all tasks")
    gas.set(ylabel="sealed (bar)")
    missing.set(ylabel="torque (N·m)", xlabel="time (s)")
    paper_figures.add_legend(figure, [angles, gas, missing])
    return figure
