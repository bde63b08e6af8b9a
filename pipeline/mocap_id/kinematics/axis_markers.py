"""Still markers on the axis of the first joint, such as malleolus markers, which belong to segment 1."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import IntArray
from mocap_id.kinematics.hypotheses import SegmentationProblem
from mocap_id.kinematics.rigid_body import RigidBody, fit_body, marker_residuals

_PREFER_MOVING = 1.25  # a still marker stays on the base if its residual on segment 1 is larger by this factor
_PAIR = 0.03  # m; a left and a right marker this close in the side view are a pair
_LEAST_BASE = 2  # markers that stay on the base


@dataclass(frozen=True)
class AxisMarkers:
    """Base markers that are reassigned to segment 1."""

    residual: dict[int, float]  # column of each marker to its rms distance from its position on segment 1, m
    margin: float  # factor between the threshold and the nearest residual ratio, at least 1; inf without candidates


def find_axis_markers(problem: SegmentationProblem, first: RigidBody, on_segment: IntArray) -> AxisMarkers:
    """Find still markers that belong to segment 1.

    A marker on the axis of joint 1 hardly moves, so rigidity alone assigns it to the base. If it is assigned to segment
    1, it locates the joint. Segment 1 is fitted again with each candidate, because soft tissue moves the candidate by a
    few degrees relative to a fit without it. The fit includes the markers accepted before: when a malleolus has located
    the axis, a heel marker no longer fits. A left and a right marker at the same position are judged together.
    ``first`` is segment 1, and ``on_segment`` are the columns of all markers on it, also of markers that were not used
    in its fit.
    """
    points, constraints = problem.points, problem.constraints
    on_base = marker_residuals(problem.ground, points)
    reassigned: dict[int, float] = {}
    margin = np.inf
    alone = np.bincount(constraints.unit)[constraints.unit] == 1
    left = list(_pair_markers(problem, problem.ground.markers[alone[problem.ground.markers]]))
    while left:
        members = np.concatenate([first.markers, np.array(list(reassigned), dtype=np.int64)])
        there = np.concatenate([on_segment, np.array(list(reassigned), dtype=np.int64)])
        left = [unit for unit in left if constraints.allow(np.append(there, unit))]
        spare = len(problem.ground.markers) - len(reassigned) - _LEAST_BASE
        candidates = [
            (_compare_residuals(problem, members, unit, on_base), unit) for unit in left if len(unit) <= spare
        ]
        if not candidates:
            break
        (ratio, residual), best = min(candidates, key=lambda each: each[0][0])
        margin = min(margin, max(ratio / _PREFER_MOVING, _PREFER_MOVING / ratio))
        if ratio > _PREFER_MOVING:
            break
        reassigned.update(zip(best, residual, strict=True))
        left.remove(best)
    return AxisMarkers(reassigned, float(margin))


def _compare_residuals(
    problem: SegmentationProblem, members: IntArray, unit: tuple[int, ...], on_base: np.ndarray
) -> tuple[float, list[float]]:
    """Return the rms residual on segment 1 divided by that on the base, and each marker's residual on segment 1, m."""
    body = fit_body(problem.points, np.append(members, unit))
    residual = marker_residuals(body, problem.points[:, list(unit)])
    before = float(np.sqrt(np.mean(on_base[list(unit)] ** 2)))
    after = float(np.sqrt(np.mean(residual**2)))
    return (after / before if before > 0 else np.inf), [float(each) for each in residual]


def _pair_markers(problem: SegmentationProblem, markers: IntArray) -> Iterator[tuple[int, ...]]:
    """Yield tuples of one marker, or of a left and a right marker at the same position in the side view."""
    if not len(markers):
        return
    place = np.nanmean(problem.points[:, markers], axis=0)
    side = problem.lateral[markers] - np.median(problem.lateral[problem.moving])
    apart = np.abs(place[:, None] - place)
    apart[(side[:, None] * side) >= 0] = np.inf
    mate = np.argmin(apart, axis=1)
    for i, j in enumerate(mate):
        if apart[i, j] < _PAIR and mate[j] == i:
            if i < j:
                yield int(markers[i]), int(markers[j])
        else:
            yield (int(markers[i]),)
