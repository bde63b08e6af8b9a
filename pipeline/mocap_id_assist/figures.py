"""Figures of workspaces, prescribed springs and pneumatic devices (thesis figures 7.1 to 7.9, 8.1)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray
from mocap_id.reporting import paper_figures, style
from mocap_id_assist.controllers import ChainTour, Controller, SwitchedMotion, TransitionMap
from mocap_id_assist.level_set import JointDynamics, ReachableSet
from mocap_id_assist.one_joint import OneJoint, Prescription
from mocap_id_assist.workspace import Overlay, Workspace

_TIPS, _CHANGES = 1500, 6000  # maximum number of points that are drawn


_VIEWS = (("front", 2, 1), ("side", 0, 1), ("top", 2, 0))


def draw_area(workspace: Workspace, recorded: FloatArray, joint: FloatArray) -> Figure:
    """Return the figure of a planar workspace: recorded tips, sampled postures, area, and convergence (figure 7.1).

    Parameters
    ----------
    workspace : Workspace
        Set of tip positions that can be reached.
    recorded : (T, 2) array
        Tip positions in the recording, m; empty if the chain is not from a recording but defined in YAML.
    joint : (2,) array
        Position of the first joint, m.
    """
    figure = paper_figures.make_figure(2.6)
    track, cloud, area, converged = figure.subplots(1, 4)
    every = max(1, len(recorded) // _TIPS)
    track.plot(*recorded[::every].T, ".", ms=1.5, color=style.VERMILLION)
    cloud.plot(*workspace.shape.points[:_TIPS].T, ".", ms=1.2, color=style.VERMILLION)
    for axes in (cloud, area):
        _draw_edge(axes, workspace)
    simplices = workspace.shape.triangulation.simplices[workspace.shape.kept]
    filled = PolyCollection(list(workspace.shape.points[simplices]), facecolors=style.SKY, rasterized=True)
    area.add_collection(filled)
    half = 0.5 * (workspace.interval[1] - workspace.interval[0])
    titles = ("recorded tip", "sampled postures", f"{workspace.measure:.4f} ± {half:.4f} m²")
    for axes, title in zip((track, cloud, area), titles, strict=True):
        _draw_joint(axes, joint)
        axes.set(title=title, xlabel="x (m)")
    track.set_ylabel("y, up (m)")
    _draw_convergence(converged, workspace, "m²")
    return figure


def draw_volume(workspace: Workspace, joint: FloatArray) -> Figure:
    """Return the figure of a spatial workspace: surface, convergence, and three projections (figures 7.3 and 7.4).

    Parameters
    ----------
    workspace : Workspace
        Set of tip positions that can be reached.
    joint : (3,) array
        Position of the first joint, m.
    """
    figure = paper_figures.make_figure(5.0)
    grid = figure.add_gridspec(2, 3)
    points, facets = workspace.shape.points, workspace.shape.boundary()
    solid: Any = figure.add_subplot(grid[0, :2], projection="3d")
    solid.plot_trisurf(points[:, 2], points[:, 0], points[:, 1], triangles=facets, color=style.SKY, rasterized=True)
    solid.scatter(joint[2], joint[0], joint[1], color=style.INK)
    solid.set(xlabel="z (m)", ylabel="x (m)", zlabel="y (m)", title=f"{workspace.measure:.4f} m³")
    _draw_convergence(figure.add_subplot(grid[0, 2]), workspace, "m³")
    for k, (name, across, up) in enumerate(_VIEWS):
        axes = figure.add_subplot(grid[1, k])
        shadow = list(points[facets][:, :, [across, up]])
        axes.add_collection(PolyCollection(shadow, facecolors=style.SKY, edgecolors=style.SKY, rasterized=True))
        axes.autoscale_view()
        _draw_joint(axes, joint[[across, up]])
        axes.set(title=name, xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    return figure


def draw_change(change: Overlay, names: tuple[str, str]) -> Figure:
    """Return the figure of two sessions' workspaces: parts in both, gained and lost; three views in space.

    Parameters
    ----------
    change : Overlay
        The two workspaces on a common set of points.
    names : tuple of str
        Names of the earlier and the later session.
    """
    views = (("in the plane", 0, 1),) if change.points.shape[1] == 2 else _VIEWS
    figure = paper_figures.make_figure(3.4)
    kinds = (
        (change.before & change.after, style.FAINT, f"both, {change.kept:.4f}"),
        (change.after & ~change.before, style.GREEN, f"gained: {style.clean(names[1], 24)}, {change.gained:.4f}"),
        (change.before & ~change.after, style.VERMILLION, f"lost: {style.clean(names[0], 24)}, {change.lost:.4f}"),
    )
    panels = figure.subplots(1, len(views), squeeze=False)[0]
    every = max(1, len(change.points) // _CHANGES)
    for axes, (name, across, up) in zip(panels, views, strict=True):
        for which, colour, label in kinds:
            points = change.points[which][::every]
            axes.plot(points[:, across], points[:, up], ".", ms=1.4, color=colour, label=label)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(title=name, xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    paper_figures.add_legend(figure, panels)
    return figure


def _draw_joint(axes: Axes, joint: FloatArray) -> None:
    axes.plot(*joint, "o", ms=5, mfc="none", mec=style.INK)
    axes.set_aspect("equal", adjustable="datalim")


def _draw_edge(axes: Axes, workspace: Workspace) -> None:
    segments = workspace.shape.points[workspace.shape.boundary()]
    axes.add_collection(LineCollection(list(segments), colors=style.BLUE, linewidths=0.9, rasterized=True))
    axes.autoscale_view()


def _draw_convergence(axes: Axes, workspace: Workspace, unit: str) -> None:
    """Draw area or volume against the number of samples, with the interval of the last value."""
    counts, _, values = zip(*workspace.convergence, strict=True)
    axes.axhspan(*workspace.interval, color=style.BLUE, alpha=0.15, lw=0)
    axes.plot(counts, values, "o-", ms=3, color=style.BLUE)
    axes.set_xscale("log")
    axes.set_xticks(counts, [f"{count:d}" for count in counts], rotation=45)
    axes.minorticks_off()
    axes.set(title=f"convergence ({unit})", xlabel="samples")


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


_EVERY = 10  # every tenth sample of a tour is drawn


def draw_curve(
    angle: FloatArray,
    torque: FloatArray,
    deviation: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    friction: float,
) -> Figure:
    """Draw the torque of a device against the angle: 95 % band, friction, isothermal and adiabatic limits.

    Parameters
    ----------
    angle : (N,) array
        Joint angle, rad.
    torque, deviation : (N,) arrays
        Torque of the device and its standard deviation, N·m.
    limits : pair of (N,) arrays
        Isothermal and adiabatic torque, N·m.
    friction : float
        Coulomb friction, N·m.
    """
    figure = paper_figures.make_figure(3.2)
    axes, degrees = figure.subplots(), np.degrees(angle)
    band: dict[str, Any] = {"color": style.BLUE, "alpha": 0.15, "lw": 0, "label": "95 % interval"}
    axes.fill_between(degrees, torque - NORMAL_95 * deviation, torque + NORMAL_95 * deviation, **band)
    axes.plot(degrees, torque, color=style.BLUE, label="torque")
    for sign, label in ((-1, "flexing"), (1, "extending")):
        axes.plot(degrees, torque + sign * friction, ":", color=style.INK, lw=0.8, label=label)
    for values, dash, label in zip(limits, ("--", "-."), ("isothermal", "adiabatic"), strict=True):
        axes.plot(degrees, values, dash, color=style.VERMILLION, lw=0.8, label=label)
    axes.axhline(0, color=style.INK, lw=0.6)
    axes.set(xlabel="angle, positive in flexion (°)", ylabel="torque on the joint (N·m)")
    paper_figures.add_legend(figure, [axes])
    return figure


def draw_switching(
    controller: Controller, motion: SwitchedMotion, limits: tuple[float, float], maps: Sequence[TransitionMap]
) -> Figure:
    """Draw a tour with its nodes, pressures and torque, and the states in which a change of node is unsafe.

    Parameters
    ----------
    controller : Controller
        Controller with its nodes, the pressure settings between which it changes.
    motion : SwitchedMotion
        Simulated motion during the tour.
    limits : (low, high)
        Limits of the person's torque, N·m.
    maps : sequence of TransitionMap
        Unsafe states of each change between two nodes.
    """
    figure = paper_figures.make_figure(6.4)
    columns = max(len(maps), 1)
    grid = figure.add_gridspec(4, columns, height_ratios=(2, 1, 1, 2))
    shown = slice(None, None, _EVERY)
    time = motion.tour.time[shown]
    top = figure.add_subplot(grid[0, :])
    gas, torque = (figure.add_subplot(grid[k, :], sharex=top) for k in (1, 2))
    for k, node in enumerate(controller.nodes):
        held = np.where(node.depth > 0, np.degrees(controller.angle), np.nan)
        low, high = np.nanmin(held), np.nanmax(held)
        active = motion.node[shown] == k
        band: dict[str, Any] = {
            "color": style.pick_colour(k + 1),
            "alpha": 0.2,
            "lw": 0,
            "label": f"held with {node.name}",
        }
        top.fill_between(time, low, high, where=active.tolist(), **band)
    top.plot(time, np.degrees(motion.tour.angle[shown]), "--", color=style.FAINT, lw=0.8, label="reference")
    top.plot(time, np.degrees(motion.angle[shown]), color=style.INK, label="angle")
    for k, (side, dash) in enumerate((("flexion", "-"), ("extension", "--"))):
        gas.plot(time, 1e-5 * motion.pressures[shown, k], dash, color=style.BLUE, label=f"{side} side")
    torque.plot(time, motion.torque[shown], color=style.GREEN, lw=0.7, label="person")
    for limit in limits:
        torque.axhline(limit, color=style.INK, ls="--", lw=0.8)
    top.set(ylabel="angle (°)", title="a tour through all tasks")
    gas.set(ylabel="sealed (bar)")
    torque.set(ylabel="torque (N·m)", xlabel="time (s)")
    for column, one in enumerate(maps):
        axes = figure.add_subplot(grid[3, column])
        angle = np.degrees(one.angle)
        names = [controller.nodes[k].name for k in (one.before, one.after)]
        for unsafe, colour, label in ((False, style.SKY, "safe change"), (True, style.VERMILLION, "unsafe change")):
            a, v = np.nonzero(one.unsafe == unsafe)
            axes.plot(angle[a], np.degrees(one.velocity[v]), ".", ms=2, color=colour, label=label, rasterized=True)
        if one.switched.any():
            ends = angle[one.switched][[0, -1]]
            axes.axvspan(*ends, color=style.INK, alpha=0.12, lw=0, label="the controller changes here")
        axes.set(title=f"{names[0]} → {names[1]}", xlabel="angle (°)", ylabel="" if column else "velocity (°/s)")
    paper_figures.add_legend(figure, figure.axes)
    return figure


def draw_chain_tour(tour: ChainTour, names: Sequence[str]) -> Figure:
    """Draw the tour of a chain: angles and active node, pressures, and the torque that exceeds the person's limits.

    Parameters
    ----------
    tour : ChainTour
    names : sequence of str
        Names of the nodes.
    """
    figure = paper_figures.make_figure(5.2)
    angles, gas, missing = figure.subplots(3, 1, sharex=True, height_ratios=(2, 1.4, 0.8))
    for k, name in enumerate(names):
        active = (tour.node == k).tolist()
        band: dict[str, Any] = {"color": style.pick_colour(k + 1), "alpha": 0.2, "lw": 0, "label": f"node {name}"}
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
