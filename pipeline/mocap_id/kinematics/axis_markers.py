"""Still markers that are not the base's: those on the axis of the first joint (malleoli)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import IntArray
from mocap_id.kinematics.hypotheses import Scene
from mocap_id.kinematics.rigid import Body, fit_body, marker_residuals

_PREFER_MOVING = 1.25  # a still marker goes to segment 1 unless that holds it worse than the base by this factor
_LIKE = 0.03  # m; two markers on either side this near to each other, as seen from the side, are a pair
_FEWEST = 2  # markers left to the base


@dataclass(frozen=True)
class AxisMarkers:
    """Which of the base's markers segment 1 takes over.

    Parameters
    ----------
    residual : dict
        Of each that does (its column), rms from its place on segment 1, m.
    margin : float
        How far the closest decision was from falling the other way: the ratio of what segment 1 and the base make of
        the marker over the one at which it changes sides, or the inverse, at least 1; inf where there was none to take.
    """

    residual: dict[int, float]
    margin: float


def on_first_axis(scene: Scene, first: Body, on_segment: IntArray) -> AxisMarkers:
    """Still markers that belong to segment 1.

    A marker on the axis of joint 1 hardly moves, so rigidity puts it on the base; on the segment it pins the joint. The
    segment is fitted anew with each one: judged from outside, a few degrees of soft tissue would reject it; and with
    those taken before, so that a heel cannot follow where a malleolus has pinned the axis. A left and a right marker
    in the same place are judged together: people are symmetric, and so are those who put markers on them.

    Parameters
    ----------
    first : Body
        Segment 1.
    on_segment : int array
        The markers that are on it already, those it was fitted to and others.
    """
    points, constraints = scene.points, scene.constraints
    held = marker_residuals(scene.ground, points)
    taken: dict[int, float] = {}
    margin = np.inf
    alone = np.bincount(constraints.unit)[constraints.unit] == 1
    left = list(_pairs(scene, scene.ground.markers[alone[scene.ground.markers]]))
    while left:
        members = np.concatenate([first.markers, np.array(list(taken), dtype=np.int64)])
        there = np.concatenate([on_segment, np.array(list(taken), dtype=np.int64)])
        left = [unit for unit in left if constraints.allow(np.append(there, unit))]
        spare = len(scene.ground.markers) - len(taken) - _FEWEST
        tried = [(_ratio(scene, members, unit, held), unit) for unit in left if len(unit) <= spare]
        if not tried:
            break
        (ratio, residual), best = min(tried, key=lambda each: each[0][0])
        margin = min(margin, max(ratio / _PREFER_MOVING, _PREFER_MOVING / ratio))
        if ratio > _PREFER_MOVING:
            break
        taken.update(zip(best, residual, strict=True))
        left.remove(best)
    return AxisMarkers(taken, float(margin))


def _ratio(scene: Scene, members: IntArray, unit: tuple[int, ...], held: np.ndarray) -> tuple[float, list[float]]:
    """What segment 1 makes of some markers over what the base makes of them, and their residuals on it, m."""
    body = fit_body(scene.points, np.append(members, unit))
    residual = marker_residuals(body, scene.points[:, list(unit)])
    before = float(np.sqrt(np.mean(held[list(unit)] ** 2)))
    after = float(np.sqrt(np.mean(residual**2)))
    return (after / before if before > 0 else np.inf), [float(each) for each in residual]


def _pairs(scene: Scene, markers: IntArray) -> Iterator[tuple[int, ...]]:
    """The markers, left and right ones in the same place as pairs."""
    if not len(markers):
        return
    place = np.nanmean(scene.points[:, markers], axis=0)
    side = scene.lateral[markers] - np.median(scene.lateral[scene.moving])
    apart = np.abs(place[:, None] - place)
    apart[(side[:, None] * side) >= 0] = np.inf
    mate = np.argmin(apart, axis=1)
    for i, j in enumerate(mate):
        if apart[i, j] < _LIKE and mate[j] == i:
            if i < j:
                yield int(markers[i]), int(markers[j])
        else:
            yield (int(markers[i]),)
