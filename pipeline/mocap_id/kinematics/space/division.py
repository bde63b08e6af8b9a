"""Division of the markers into rigid bodies, with skin that twists told from a joint.

The skin of a limb follows only a part of the limb's rotation about its long axis, and least near the joint above. Two
groups of markers on the skin then turn against each other by several degrees, as two segments do. A joint shows more:
it also moves the markers across the long axis. A body is therefore divided only if the two parts fit its markers better
without their motion around the long axis, or if they fit far better than skin could explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.kinematics.space.bodies import LEAST, SpaceBodies, SpaceBody, around_mean
from mocap_id.kinematics.space.pair_joint import SpacePairJoint, fit_pair_joint, mean_rotation

GAIN = 1.4
"""Summed log gain across the long axis from which a division is real: skin reaches 1.4, a wrist of 14° 2.0 and more."""

_FAR_BETTER = float(np.log(3.5))  # mean log gain per marker that skin does not reach
_RIGID = 1.2e-3  # m; a joint that turns by 2° leaves more in a body
_UNKNOWN = 10.0  # m; residual on a body whose markers are on one line
_FLOOR = 1e-3  # m; smaller residuals are no better
_STAY = 0.5  # share of its residual for which a marker leaves its part of a division that was accepted
_MOST = 16  # bodies


@dataclass(frozen=True)
class Division:
    """One body, or the same markers as two.

    Parameters
    ----------
    whole : SpaceBody
    parts : tuple of two SpaceBody
    gain : float
        Summed log gain of the markers' residuals.
    across : float
        The same without their motion around the long axis of the body; ``gain`` for a body without neighbours.
    """

    whole: SpaceBody
    parts: tuple[SpaceBody, SpaceBody]
    gain: float
    across: float

    @property
    def evidence(self) -> float:
        """Return the evidence for two bodies, over what is required: 1 or more if they are real."""
        far = self.gain / len(self.whole.markers) / _FAR_BETTER
        return max(self.across / GAIN, far)


@dataclass
class Partition:
    """The bodies found so far, the joints between them, and the divisions that were tried.

    Parameters
    ----------
    bodies : list of SpaceBody
    joints : dict
        The joint of each pair of bodies i < j.
    made : list of Division
        Accepted divisions.
    refused : list of Division
        The best division of every body that stayed whole.
    """

    bodies: list[SpaceBody]
    joints: dict[tuple[int, int], SpacePairJoint] = field(default_factory=dict)
    made: list[Division] = field(default_factory=list)
    refused: list[Division] = field(default_factory=list)


def divide(sorter: SpaceBodies, start: Sequence[SpaceBody], needed: float = 1.0) -> Partition:
    """Divide bodies until each is rigid, the clearest division first.

    Parameters
    ----------
    sorter : SpaceBodies
    start : sequence of SpaceBody
        One body of all markers, or the bodies of an earlier division.
    needed : float
        Least ``evidence`` of a division.
    """
    found = Partition(list(start))
    joints: dict[bytes, SpacePairJoint] = {}
    tried: dict[bytes, Division | None] = {}
    while True:
        found.joints = _all_joints(found.bodies, joints)
        divisions = [_best_division(sorter, found, index, tried) for index in range(len(found.bodies))]
        known = [division for division in divisions if division is not None]
        best = max(known, key=lambda division: (division.evidence >= needed, division.gain), default=None)
        if best is None or best.evidence < needed or len(found.bodies) >= _MOST:
            found.refused = known
            return found
        found.made.append(best)
        others = [body.markers for body in found.bodies if body is not best.whole]
        divided = [*others, *(part.markers for part in best.parts)]
        settled = sorter.settled(divided, _STAY)
        found.bodies = [sorter.body(group) for group in divided] if len(settled) < len(divided) else list(settled)


def spanning_tree(joints: dict[tuple[int, int], SpacePairJoint], count: int) -> list[tuple[int, int]]:
    """Return the pairs of bodies that form the tree with the smallest joint residuals (Kruskal)."""
    group = list(range(count))
    edges = []
    for first, second in sorted(joints, key=lambda pair: joints[pair].residual):
        if group[first] != group[second] and np.isfinite(joints[first, second].residual):
            edges.append((first, second))
            group = [group[first] if each == group[second] else each for each in group]
    return edges


def _all_joints(
    bodies: Sequence[SpaceBody], known: dict[bytes, SpacePairJoint]
) -> dict[tuple[int, int], SpacePairJoint]:
    """Return the joint of each pair of bodies; ``known`` keeps them from step to step."""
    joints = {}
    for i, j in combinations(range(len(bodies)), 2):
        key = bodies[i].markers.tobytes() + b"|" + bodies[j].markers.tobytes()
        if key not in known:
            known[key] = fit_pair_joint(bodies[i], bodies[j])
        joints[i, j] = known[key]
    return joints


def _best_division(
    sorter: SpaceBodies, found: Partition, index: int, tried: dict[bytes, Division | None]
) -> Division | None:
    """Return the division of a body with the most evidence; None if it is rigid or has too few markers."""
    whole = found.bodies[index]
    if whole.usual <= _RIGID:
        return None
    axis = _long_axis(found, index)
    key = whole.markers.tobytes() + (b"" if axis is None else np.round(np.concatenate(axis), 2).tobytes())
    if key not in tried:
        every = [_weigh(sorter.points, whole, parts, axis) for parts in sorter.divisions(whole.markers)]
        tried[key] = max(every, key=lambda division: division.evidence, default=None)
    return tried[key]


def _long_axis(found: Partition, index: int) -> tuple[FloatArray, FloatArray] | None:
    """Return a point (3,) and the direction (3,) of a body's long axis in its frame; None for a body without joints.

    The axis leads through the two joints that are farthest apart, or from the only joint to the centroid.
    """
    places = [
        found.joints[i, j].in_first if i == index else found.joints[i, j].in_second
        for i, j in spanning_tree(found.joints, len(found.bodies))
        if index in (i, j)
    ]
    if not places:
        return None
    ends = [*places, np.zeros(3)] if len(places) == 1 else places
    first, second = max(combinations(ends, 2), key=lambda pair: float(np.linalg.norm(pair[1] - pair[0])))
    length = float(np.linalg.norm(second - first))
    return (first, (second - first) / length) if length > 0 else None


def _weigh(
    points: FloatArray,
    whole: SpaceBody,
    parts: tuple[SpaceBody, SpaceBody],
    axis: tuple[FloatArray, FloatArray] | None,
) -> Division:
    gain = sum(_log_gain(whole.residual[part.markers], part.residual[part.markers]) for part in parts)
    if axis is None:
        return Division(whole, parts, gain, gain)
    across = 0.0
    for part in parts:
        turn = np.swapaxes(part.rotation, 1, 2) @ whole.rotation
        shift = np.einsum("fji,fj->fi", part.rotation, whole.origin - part.origin)
        both = np.isfinite(shift[:, 0])
        if not both.any():
            return Division(whole, parts, gain, 0.0)
        mean = mean_rotation(turn[both])
        own = mean @ axis[0] + shift[both].mean(axis=0), mean @ axis[1]
        across += _log_gain(_across(points[:, part.markers], whole, axis), _across(points[:, part.markers], part, own))
    return Division(whole, parts, gain, across)


def _across(points: FloatArray, body: SpaceBody, axis: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return the rms distance (k,) of a body's markers from their places, without motion around an axis, m.

    The pose absorbs six of a frame's 3 k' coordinates of the body's markers k'.
    """
    off, mean, counts = around_mean(body.local(points))
    around = np.cross(axis[1], mean - axis[0])
    around /= np.maximum(np.linalg.norm(around, axis=1), 1e-9)[:, None]
    square = np.sum(off**2, axis=(0, 2)) - np.sum(np.einsum("fki,ki->fk", off, around) ** 2, axis=0)
    freedom = 3 * max(len(body.markers), LEAST)
    return np.asarray(np.sqrt(square / np.maximum(counts, 1) * freedom / (freedom - 6)))


def _log_gain(before: FloatArray, after: FloatArray) -> float:
    before, after = np.minimum(before, _UNKNOWN), np.minimum(after, _UNKNOWN)
    return float(np.sum(np.log((before**2 + _FLOOR**2) / (after**2 + _FLOOR**2))) / 2)
