"""Search for the best chain with single-marker segments, and for the markers that represent its joints.

The arc of an ankle is too short to determine its centre, and the markers do not determine an inner joint without a
rigid body on both sides. A marker near such a joint then represents it, with a standard deviation for the distance
between marker and joint, if this hardly raises the cost.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from mocap_id.kinematics.chain_equations import joint_positions
from mocap_id.kinematics.hypotheses import SegmentationProblem
from mocap_id.kinematics.link_fit import SCALE, LinkFit, Pin, costs_on_segments, fit_path, path_cost
from mocap_id.kinematics.link_markers import Path, average_track, find_linked_paths, group_points

_MOST_POINTS = 24  # most moving points of a conventional marker set; larger sets have rigid bodies
_TRIED = 4  # number of fitted paths for every number of segments
_OFF_AXIS = 0.012  # m; standard deviation of the distance of a marker from its joint
_MORE_THAN_STILL = 1.12  # least ratio of the scatters of an ankle marker and of the stillest markers; heels are stiller
_RISE = 2.0  # largest rise of the cost for an ankle at a marker
_INNER_RISE = 4.0  # the same for an inner joint
_NEAR = 0.04  # m; a marker this close to an inner joint may represent it
_INNER_FRAMES = 30.0  # weight of this marker in frames, because its error is the same in all of them


def find_best_links(problem: SegmentationProblem) -> LinkFit | None:
    """Return the chain with the lowest cost that has a single-marker segment; None if no chain is possible."""
    if len(list(group_points(problem.points, problem.lateral, problem.moving))) > _MOST_POINTS:
        return None
    paths = list(find_linked_paths(problem))
    costs = [path_cost(problem, path) for path in paths]
    fits: list[tuple[LinkFit, Path]] = []
    tried: Counter[int] = Counter()
    for index in np.argsort(costs):
        path = paths[index]
        if (
            not np.isfinite(costs[index])
            or tried[len(path)] >= _TRIED
            or problem.rules.count not in (None, len(path) + 1)
        ):
            continue
        tried[len(path)] += 1
        fit = fit_path(problem, path)
        if fit is None:
            continue
        members = [np.flatnonzero(fit.segment == k) for k in range(fit.segment.max() + 1)]
        if all(map(problem.constraints.allow, members)):
            fits.append((fit, path))
    if not fits:
        return None
    fit, path = min(fits, key=lambda each: each[0].cost)
    fit = _add_joint_markers(problem, path, fit)
    alone = [points for step, points in zip(path, fit.points, strict=True) if step.body is None]
    return fit if min(alone) < 2 else None  # other chains are found by the search for rigid bodies


def _add_joint_markers(problem: SegmentationProblem, path: Path, fit: LinkFit) -> LinkFit:
    """Return the fit in which markers represent the ankle and the inner joints, where this hardly raises the cost."""
    weight = (SCALE / _OFF_AXIS) ** 2
    units = list(group_points(problem.points, problem.lateral, problem.base.markers))
    moves = [float(np.mean(problem.base.scatter[unit])) for unit in units]
    best: LinkFit | None = None
    for unit, scatter in zip(units, moves, strict=True):
        if scatter < _MORE_THAN_STILL * min(moves):
            continue
        pinned = fit_path(problem, path, (Pin(0, unit, average_track(problem.points, unit), weight),))
        if pinned is not None and pinned.cost - fit.cost < _RISE and (best is None or pinned.cost < best.cost):
            best = pinned
    fit = best or fit
    for joint in range(1, len(path)):
        fit = _add_inner_marker(problem, path, fit, joint, weight) or fit
    return _assign_ankle_markers(problem, fit)


def _add_inner_marker(
    problem: SegmentationProblem, path: Path, fit: LinkFit, joint: int, weight: float
) -> LinkFit | None:
    """Return the fit with a nearby marker at an inner joint; None if no marker fits there."""
    moving = np.flatnonzero((fit.segment == joint) | (fit.segment == joint + 1))
    place, _ = joint_positions(fit.state)
    near = []
    for unit in group_points(problem.points, problem.lateral, moving):
        off = np.abs(average_track(problem.points, unit)[fit.used] - place[:, joint])
        if np.isfinite(off).any() and np.nanmedian(off) < _NEAR:
            near.append((float(np.nanmedian(off)), unit))
    for _, unit in sorted(near, key=lambda each: each[0]):
        pin = Pin(joint, unit, average_track(problem.points, unit), weight * min(_INNER_FRAMES / len(fit.used), 1.0))
        pinned = fit_path(problem, path, (*fit.pins, pin))
        if pinned is not None and pinned.cost - fit.cost < _INNER_RISE:
            return pinned
    return None


def _assign_ankle_markers(problem: SegmentationProblem, fit: LinkFit) -> LinkFit:
    """Return the fit with the still markers at joint 1 assigned to segment 1."""
    ankle = np.array([marker for pin in fit.pins if pin.joint == 0 for marker in pin.unit], dtype=np.int64)
    segment, local = fit.segment.copy(), fit.state.local.copy()
    segment[ankle] = 1
    local[ankle] = costs_on_segments(problem.points[fit.used], fit.state)[1][1, ankle]
    return replace(fit, segment=segment, state=replace(fit.state, local=local))
