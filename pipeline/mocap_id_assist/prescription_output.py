"""The files of a prescription (JSON document, tables, figures), and the sentences about it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mocap_id import __version__
from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.reporting import paper_figures, style
from mocap_id.reporting.paper_figures import render
from mocap_id.reporting.results import CommandResult, make_text_file, to_finite
from mocap_id_assist.assisted_body import PrescriptionResult, SpringMap
from mocap_id_assist.controllers import Controlled
from mocap_id_assist.level_set import JointDynamics, ReachableStates
from mocap_id_assist.pneumatic import spring_document
from mocap_id_assist.springs import OneJoint, Prescription, find_held_postures
from mocap_id_assist.workspaces import workspace_result

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

    ``tips`` (N, 2) are those of sampled postures, m. ``without`` and ``held`` (N,) say which of these can be held
    without and with springs. ``joint`` (2,) is the position of the first joint, m.
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


def prescription_output(found: PrescriptionResult) -> CommandResult:
    """Return ``prescription.json``, and the tables and figures of all computed parts.

    In the document, `springs` is null if no springs could be prescribed; `why` is then the reason.
    """
    body, one, several, devices = found.body, found.one, found.several, found.devices
    content: dict[str, Any] = {
        "product": __version__,
        "prescription": found.config.wishes.prescription,
        "joints": [
            {
                "name": name,
                "limits_deg": _degrees((body.limits.lower[j], body.limits.upper[j])),
                "strength_Nm": [to_finite(value) for value in body.strength[j]],
            }
            for j, name in enumerate(body.joints)
        ],
        "why": found.refused,
        "springs": None,
    }
    if found.workspace is not None and body.subject is not None:
        content["workspace"] = workspace_result(body.subject, found.workspace).document
    if one is not None and found.joint is not None:
        spring = {"joints": [1], "stiffness_Nm_per_rad": one.stiffness, "rest_deg": to_finite(np.degrees(one.rest))}
        content |= {
            "helps": one.helps,
            "springs": [spring] if one.helps else [],
            "moment_of_gravity_Nm": found.joint.weight,
            "range_deg": _degrees(one.range),
            "range_without_deg": None if one.without is None else _degrees(one.without),
            "gap_deg": float(np.degrees(one.gap)),
        }
    if several is not None:
        content |= {
            "helps": several.helps,
            "springs": [
                {
                    "joints": [joint + 1 for joint in place.joints],
                    "stiffness_Nm_per_rad": float(several.stiffness[s]),
                    "rest_deg": to_finite(np.degrees(several.rest[s])),
                }
                for s, place in enumerate(found.places)
                if several.stiffness[s] > 0
            ],
            "functional_workspace_m2": several.area,
            "functional_workspace_without_m2": several.without,
            "reachable_m2": several.reachable,
            "gap_m2": several.gap,
            "boxes": several.boxes,
        }
    if (timed := found.timed) is not None:
        start = timed.dynamics.equilibrium()
        content["level_set"] = {
            "stiffness_Nm_per_rad": timed.dynamics.stiffness,
            "rest_deg": to_finite(np.degrees(timed.dynamics.rest)),
            "inertia_kgm2": timed.dynamics.inertia,
            "equilibrium_deg": None if start is None else float(np.degrees(start)),
            "static_deg": None if timed.static is None else _degrees(timed.static),
            "unheld_deg": [_degrees(each) for each in timed.unheld],
            "horizons": [
                {
                    "time_s": time,
                    "reached_and_held_deg": None if bound is None else _degrees(bound),
                    "grid_error_deg": None if error is None else to_finite(np.degrees(error)),
                }
                for time, bound, error in zip(timed.reached.times, timed.bounds, timed.grid_errors, strict=True)
            ],
        }
    if (springs := found.map) is not None:
        best = None
        if springs.best is not None:
            k, r = springs.best
            best = {
                "stiffness_Nm_per_rad": float(springs.stiffness[k]),
                "rest_deg": float(np.degrees(springs.rest[r])),
                "reached_and_held_deg": float(np.degrees(springs.width[k, r])),
            }
        content["search"] = {"horizon_s": springs.horizon, "springs": int(springs.width.size), "best": best}
    if (graph := found.graph) is not None:
        names = [node.name for node in graph.nodes]
        ways = {(a, b): graph.find_path(a, b) for a, b in combinations(range(len(names)), 2)}
        content["sub_workspaces"] = {
            "nodes": [
                {
                    "name": node.name,
                    "tasks": list(node.tasks),
                    "springs": None
                    if node.stiffness is None or node.rest is None
                    else [
                        {"stiffness_Nm_per_rad": float(k), "rest_deg": to_finite(np.degrees(rest))}
                        for k, rest in zip(node.stiffness, node.rest, strict=True)
                    ],
                    "held_share": float(node.held.mean()),
                }
                for node in graph.nodes
            ],
            "switches": [
                {
                    "between": [names[k] for k in between],
                    "overlap_share": share,
                    "at_deg": np.degrees(graph.postures[posture]).tolist(),
                }
                for between, share, posture in graph.switches
            ],
            "ways": [
                {"from": names[a], "to": names[b], "by": None if way is None else [names[k] for k in way]}
                for (a, b), way in ways.items()
            ],
        }
    if devices is not None:
        replaced: dict[str, Any] = {
            "springs": [
                {
                    "joints": [joint + 1 for joint in found.places[each.place].joints],
                    "device": each.device.keys.device,
                    "flexion_Pa": each.setting.flexion,
                    "extension_Pa": each.setting.extension,
                    "nearest_spring": spring_document(each.nearest),
                }
                for each in devices
            ],
            "why": "" if devices else "no spring was prescribed for the joints of a device",
        }
        if one is not None:
            lost = _find_lost_range(found)
            replaced["range_deg"] = None if found.device_range is None else np.degrees(found.device_range).tolist()
            replaced["range_lost_deg"] = None if lost is None else float(np.degrees(lost))
        elif several is not None:
            replaced["functional_workspace_m2"] = found.device_area
            replaced["functional_workspace_lost_m2"] = several.area - found.device_area
        content["devices"] = replaced
    if found.controlled is not None:
        content["controller"] = _describe_controller(found.controlled)
    return CommandResult("prescription", "prescription.json", content, other_files=lambda: _make_files(found), end="")


def _find_lost_range(found: PrescriptionResult) -> float | None:
    """Return how much smaller the held range is with the device than with the linear spring, rad; None if unknown."""
    assert found.one is not None
    if not found.devices:
        return None
    held = found.device_range
    return float(np.ptp(found.one.range)) - (0.0 if held is None else held[1] - held[0])


def _describe_controller(controlled: Controlled) -> dict[str, Any]:
    """Return nodes, changes, tour and problems; one joint has angles where a chain has devices and postures."""
    names, tour, is_joint = [node.name for node in controlled.nodes], controlled.tour, bool(controlled.made_for)
    nodes = []
    for k, node in enumerate(controlled.nodes):
        gas = node.pressures.tolist()
        entry: dict[str, Any] = {"name": node.name}
        if is_joint:
            entry |= {"made_for_deg": np.degrees(controlled.made_for[k]).tolist()}
            entry |= {"flexion_Pa": gas[0][0], "extension_Pa": gas[0][1], "reserve_Nm": controlled.reserve[k]}
            entry["held_deg"] = _list_intervals(controlled.grid[:, 0], controlled.held[k])
        else:
            entry["devices"] = [
                {"joints": [joint + 1 for joint in joints], "flexion_Pa": pair[0], "extension_Pa": pair[1]}
                for joints, pair in zip(controlled.joints, gas, strict=True)
            ]
            entry |= {"reserve_share": controlled.reserve[k], "held_share": float(controlled.held[k].mean())}
        nodes.append(entry)
    changes = []
    for one in controlled.changes:
        entry = {"from": names[one.before], "to": names[one.after]}
        shares = {
            "unsafe_share": float(one.unsafe[one.switched].mean()) if one.switched.any() else None,
            "unsafe_share_of_overlap": float(one.unsafe.mean()),
        }
        if is_joint:
            speed = np.abs(one.states[:, 1])
            still = speed == speed.min()
            angle = one.states[still, 0]
            entry["overlap_deg"] = np.degrees(angle[[0, -1]]).tolist()
            entry["changes_deg"] = _list_intervals(angle, one.switched[still])
            entry |= {**shares, "unsafe_at_rest_deg": _list_intervals(angle, one.unsafe[still])}
        else:
            entry |= {"postures": len(one.states), **shares}
        changes.append(entry)
    visits = [
        {
            "task": visit.task,
            "start_s": visit.start,
            **({} if visit.posture is None else {"at_deg": np.degrees(visit.posture).tolist()}),
            "held": visit.held,
            "missing_Nm": visit.missing,
        }
        for visit in controlled.visits
    ]
    steps = []
    for (k, before, after), gas in zip(tour.switches, controlled.gas, strict=True):
        at = np.degrees(tour.q[k]).tolist()
        place = {"angle_deg": at[0]} if is_joint else {"at_deg": at}
        steps.append(
            {"time_s": float(tour.time[k]), "from": names[before], "to": names[after], **place, "gas_g": 1e3 * gas}
        )
    return {
        "nodes": nodes,
        "changes": changes,
        "tour": {
            "duration_s": float(tour.time[-1]),
            "tasks": visits,
            "changes": steps,
            **({} if is_joint else {"missing_Nm": float(tour.excess.max())}),
            "gas_g": 1e3 * sum(controlled.gas),
            "shortest_dwell_s": to_finite(controlled.shortest_dwell),
            "settling_s": controlled.settling,
        },
        "problems": list(controlled.problems),
    }


def _list_intervals(angle: FloatArray, which: BoolArray) -> list[list[float]]:
    """Return the intervals of ``angle``, rad, in which ``which`` is true, in degrees."""
    return [np.degrees([angle[run.start], angle[run.stop - 1]]).tolist() for run in find_runs(which)]


def _degrees(pair: tuple[float, float]) -> list[float]:
    return [float(np.degrees(pair[0])), float(np.degrees(pair[1]))]


def _make_files(found: PrescriptionResult) -> dict[str, bytes]:
    """Return the tables and figures, by name."""
    files: dict[str, bytes] = {}
    name = found.config.wishes.prescription
    one, joint, timed, springs, controlled = found.one, found.joint, found.timed, found.map, found.controlled
    sampled, several, strength = found.postures, found.several, found.body.strength
    if one is not None and joint is not None:
        files |= render("range", f"range with and without a spring: {name}", lambda: draw_ranges(joint, one))
    if sampled is not None and several is not None:
        without = find_held_postures(sampled, (), strength, several)
        held = find_held_postures(sampled, found.places, strength, several)
        first = found.body.arm.centres[0]
        title = f"holdable postures: {name}"
        files |= render("functional", title, lambda: draw_holdable_postures(sampled.tips, without, held, first))
    if timed is not None:
        title = f"reachable set over time: {name}"
        files |= render("level_set", title, lambda: draw_level_sets(timed.reached, timed.bounds, timed.dynamics))
        lines = ["time_s,lower_deg,upper_deg"]
        for time, bound in zip(timed.reached.times, timed.bounds, strict=True):
            ends = ("" if bound is None else f"{np.degrees(end):.3f}" for end in bound or (0, 0))
            lines.append(",".join([f"{time:g}", *ends]))
        files["horizons.csv"] = make_text_file(lines)
    if springs is not None:
        title = f"springs by their reachable sets: {name}"
        files |= render("search", title, lambda: draw_spring_map(springs))
        lines = ["stiffness_Nm_per_rad,rest_deg,reached_and_held_deg,held_deg"]
        for k, stiffness in enumerate(springs.stiffness):
            for r, rest in enumerate(np.degrees(springs.rest)):
                width, static = np.degrees([springs.width[k, r], springs.static[k, r]])
                reached = "" if np.isnan(width) else f"{width:.3f}"
                lines.append(f"{stiffness:.6g},{rest:.6g},{reached},{static:.3f}")
        files["search.csv"] = make_text_file(lines)
    if controlled is not None:
        limits = None if joint is None else (joint.torque_low, joint.torque_high)
        files |= render(
            "controller",
            f"controller over sub-workspaces: {name}",
            lambda: draw_chain_tour(controlled) if limits is None else draw_switching(controlled, limits),
        )
        # the states in which a change is unsafe: angle and velocity of one joint, or postures of a chain
        names, joints = [node.name for node in controlled.nodes], controlled.grid.shape[1]
        axes = ["angle_deg", "velocity_deg_s"] if controlled.made_for else [f"angle_{j + 1}_deg" for j in range(joints)]
        lines = [",".join(["from", "to", *axes, "missing_Nm", "controller_changes_here"])]
        for change in controlled.changes:
            for at in np.flatnonzero(change.unsafe):
                state = ",".join(f"{value:.2f}" for value in np.degrees(change.states[at]))
                between = f"{names[change.before]},{names[change.after]}"
                lines.append(f"{between},{state},{change.missing[at]:.4f},{str(bool(change.switched[at])).lower()}")
        files["unsafe_postures.csv" if limits is None else "unsafe_states.csv"] = make_text_file(lines)
    return files


def prescription_lines(found: PrescriptionResult) -> Iterator[str]:
    """Yield sentences about all computed parts."""
    name, one, joint, several = found.config.wishes.prescription, found.one, found.joint, found.several
    if found.workspace is not None:
        low, high = found.workspace.interval
        area = found.workspace.measure
        yield f"{name}: joint limits alone allow {area:.5f} m² (95 % interval {low:.5f} to {high:.5f})"
    if found.refused is not None:
        yield f"{name}: nothing can be prescribed: {found.refused}. Only the kinematic workspace is known"
        return
    if one is not None and joint is not None:
        without = "nothing" if one.without is None else _range(one.without)
        yield f"{name}: without a spring {without} can be held; gravity needs up to {joint.weight:.3f} N·m"
        if one.helps:
            share = one.stiffness / joint.weight
            yield (
                f"spring: {one.stiffness:.4g} N·m/rad ({share:.4f} of the moment of gravity per radian), rest angle "
                f"{math.degrees(one.rest):.1f}°: {_range(one.range)} can be held"
            )
            yield f"no other spring widens the range by more than another {math.degrees(one.gap):.2f}°"
        else:
            yield f"no spring helps: no spring widens the range by {math.degrees(one.gap):.1f}° or more"
    if several is not None:
        yield (
            f"{name}: without springs {several.without:.4f} m² of {several.reachable:.4f} m² within reach can be held, "
            f"with them {several.area:.4f} m²"
        )
        if not several.helps:
            yield "no springs help"
        for s, place in enumerate(found.places):
            if several.stiffness[s] > 0:
                across = " and ".join(found.body.joints[joint] for joint in place.joints)
                rest = f"{math.degrees(several.rest[s]):.1f}°"
                yield f"spring on {across}: {several.stiffness[s]:.4g} N·m/rad, rest {rest}"
        yield (
            f"no other springs hold over {several.gap:.4f} m² more of these samples ({several.boxes} boxes searched)"
        )
    if (timed := found.timed) is not None:
        for time, bound, error in zip(timed.reached.times, timed.bounds, timed.grid_errors, strict=True):
            reached = "nothing" if bound is None else _range(bound)
            of_grid = "" if error is None else f"; half as many grid nodes change this by {math.degrees(error):.1f}°"
            yield f"within {time:g} s: {reached} reached and held{of_grid}"
        yield f"ever: {'nothing' if timed.static is None else _range(timed.static)} held"
        for gap in timed.unheld:
            yield f"{_range(gap)} can be passed, but not held: the person is too weak for this spring there"
    if (springs := found.map) is not None:
        if springs.best is None:
            yield "search: the joint does not rest within its limits with any of these springs"
        else:
            k, r = springs.best
            yield (
                f"search: widest within {springs.horizon:g} s is {math.degrees(springs.width[k, r]):.1f}°, with "
                f"{springs.stiffness[k]:.4g} N·m/rad and rest angle {math.degrees(springs.rest[r]):.0f}°"
            )
    if (graph := found.graph) is not None:
        for node in graph.nodes:
            text = "no suitable spring was found"
            if node.stiffness is not None and node.rest is not None:
                pairs = zip(node.stiffness, node.rest, strict=True)
                used = [f"{k:.4g} N·m/rad at {math.degrees(rest):.1f}°" for k, rest in pairs if k > 0]
                text = ", ".join(used) or "no spring is needed"
            yield f"sub-workspace {node.name} ({', '.join(node.tasks)}): {text}"
        for between, share, posture in graph.switches:
            first, other = (graph.nodes[k].name for k in between)
            at = ", ".join(f"{angle:.0f}°" for angle in np.degrees(graph.postures[posture]))
            yield f"switch between {first} and {other} at {at}; overlap {100 * share:.0f} % of the postures"
    for each in found.devices or ():
        joints = " and ".join(found.body.joints[joint] for joint in found.places[each.place].joints)
        flexion, extension = (f"{1e-5 * pressure:.2f} bar" for pressure in each.setting.pressures())
        yield f"device {each.device.keys.device} on {joints}: flexion {flexion}, extension {extension} (absolute)"
    if found.devices == ():
        yield "device: no spring was prescribed for the joints of the device"
    elif found.devices and several is not None:
        area, lost = found.device_area, several.area - found.device_area
        yield f"with the devices, {area:.4f} m² can be held: {lost:.4f} m² less than with linear springs"
    elif found.devices:
        lost = np.degrees(_find_lost_range(found) or 0.0)
        held = "nothing" if found.device_range is None else "{:.1f}° to {:.1f}°".format(*np.degrees(found.device_range))
        yield f"with the device, {held} can be held: {lost:.1f}° less than with the linear spring"
    if found.controlled is not None:
        yield from _controller_lines(found.controlled)


def _controller_lines(controlled: Controlled) -> Iterator[str]:
    """Yield sentences about nodes, tour and problems of a controller."""
    for node, held in zip(controlled.nodes, controlled.held, strict=True):
        bars = 1e-5 * node.pressures
        if controlled.made_for:
            pressures = f"{bars[0, 0]:.2f} bar and {bars[0, 1]:.2f} bar"
            intervals = _list_intervals(controlled.grid[:, 0], held)
            what = ", ".join(f"{low:.1f}° to {high:.1f}°" for low, high in intervals)
        else:
            pressures = "; ".join(
                f"joint {' and '.join(str(joint + 1) for joint in joints)} {pair[0]:.2f} bar and {pair[1]:.2f} bar"
                for joints, pair in zip(controlled.joints, bars, strict=True)
            )
            what = f"{100 * held.mean():.0f} % of the postures"
        yield f"node {node.name}: {pressures} hold {what}"
    reached = sum(visit.held for visit in controlled.visits)
    yield (
        f"tour of {controlled.tour.time[-1]:.0f} s: {reached} of {len(controlled.visits)} visits held, "
        f"{len(controlled.tour.switches)} changes, {1e3 * sum(controlled.gas):.2f} g of gas"
    )
    yield from (f"problem: {problem}" for problem in controlled.problems)


def _range(pair: tuple[float, float]) -> str:
    return f"{math.degrees(pair[0]):.1f}° to {math.degrees(pair[1]):.1f}°"
