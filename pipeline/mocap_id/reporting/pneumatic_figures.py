"""Figures of pneumatic devices: torque against angle, and tours through all tasks with changes of the pressures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.pneumatics.chain_tour import ChainTour
from mocap_id.pneumatics.switching import Controller, SwitchedMotion, TransitionMap
from mocap_id.reporting import paper_figures, style

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
