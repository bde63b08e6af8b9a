"""Division of the markers into rigid bodies, which distinguishes sliding skin from a joint.

The skin of a limb slides, and follows only a part of the limb's rotation about its long axis. Two groups of markers on
it then turn against each other by several degrees, as two segments do. But they do so with the joints next to the body
(:mod:`.unexplained_motion`), and a joint that hides in the body does not. A body is therefore divided only if the two
parts fit its markers better where those joints do not explain their motion, or if they fit far better than skin could
explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.kinematics.space.bodies import SpatialBodies, SpatialBody
from mocap_id.kinematics.space.pair_joint import SpatialPairJoint, fit_pair_joint
from mocap_id.kinematics.space.unexplained_motion import gain_of_parts, unexplained_distance_sd, unexplained_motion

_GAIN_END = 0.7  # summed log gain of the own motion from which a body with one joint is two: skin reaches 0.5
_GAIN_BETWEEN = 1.15  # the same between two joints, whose large rotations explain less: skin reaches 1.1

_FAR_BETTER = float(np.log(3.5))  # mean log gain per marker that skin does not reach
_RIGID = 1.2e-3  # m; a joint that turns by 2° leaves more in a body
_NEARLY_RIGID = 0.01  # m; residual of a body with no more than a small joint in it
_UNKNOWN = 10.0  # m; residual on a body whose markers are on one line
_FLOOR = 1e-3  # m; smaller residuals are no better
_STAY = 0.5  # share of its residual for which a marker leaves its part of a division that was accepted
_MOST = 16  # bodies


@dataclass(frozen=True)
class Division:
    """One body, or the same markers as two.

    Parameters
    ----------
    whole : SpatialBody
    parts : tuple of two SpatialBody
    gain : float
        Summed log gain of the markers' residuals.
    own : float
        The same of the motion that the joints next to the body do not explain; ``gain`` for a body without neighbours.
    needed : float
        Least ``own`` of a division that is real.
    """

    whole: SpatialBody
    parts: tuple[SpatialBody, SpatialBody]
    gain: float
    own: float
    needed: float

    @property
    def evidence(self) -> float:
        """Return the evidence for two bodies, over what is required: 1 or more if they are real."""
        far = self.gain / len(self.whole.markers) / _FAR_BETTER
        return max(self.own / self.needed, far)


@dataclass
class Partition:
    """The bodies found so far, the joints between them, and the divisions that were tried.

    Parameters
    ----------
    bodies : list of SpatialBody
    joints : dict
        The joint of each pair of bodies i < j.
    made : list of Division
        Accepted divisions.
    refused : list of Division
        The best division of every body that stayed whole.
    """

    bodies: list[SpatialBody]
    joints: dict[tuple[int, int], SpatialPairJoint] = field(default_factory=dict)
    made: list[Division] = field(default_factory=list)
    refused: list[Division] = field(default_factory=list)


def divide(sorter: SpatialBodies, start: Sequence[SpatialBody], needed: float = 1.0) -> Partition:
    """Divide bodies until each is rigid, the clearest division first.

    Parameters
    ----------
    sorter : SpatialBodies
    start : sequence of SpatialBody
        One body of all markers, or the bodies of an earlier division.
    needed : float
        Least ``evidence`` of a division.
    """
    found = Partition(list(start))
    joints: dict[bytes, SpatialPairJoint] = {}
    tried: dict[bytes, Division | None] = {}
    while True:
        found.joints = _fit_all_joints(found.bodies, joints)
        divisions = [_best_division(sorter, found, index, tried) for index in range(len(found.bodies))]
        known = [division for division in divisions if division is not None]
        best = max(known, key=lambda division: (division.evidence >= needed, division.gain), default=None)
        if best is None or best.evidence < needed or len(found.bodies) >= _MOST:
            found.refused = known
            return found
        found.made.append(best)
        others = [body.markers for body in found.bodies if body is not best.whole]
        divided = [*others, *(part.markers for part in best.parts)]
        settled = sorter.reassign_markers(divided, _STAY)
        found.bodies = [sorter.body(group) for group in divided] if len(settled) < len(divided) else list(settled)


def build_partition(bodies: Sequence[SpatialBody]) -> Partition:
    """Return bodies with the joints of all pairs; no division is tried."""
    return Partition(list(bodies), _fit_all_joints(bodies, {}))


def spanning_tree(joints: dict[tuple[int, int], SpatialPairJoint], count: int) -> list[tuple[int, int]]:
    """Return the pairs of bodies that form the tree with the smallest joint residuals (Kruskal)."""
    group = list(range(count))
    edges = []
    for first, second in sorted(joints, key=lambda pair: joints[pair].residual):
        if group[first] != group[second] and np.isfinite(joints[first, second].residual):
            edges.append((first, second))
            group = [group[first] if each == group[second] else each for each in group]
    return edges


def _fit_all_joints(
    bodies: Sequence[SpatialBody], known: dict[bytes, SpatialPairJoint]
) -> dict[tuple[int, int], SpatialPairJoint]:
    """Return the joint of each pair of bodies; ``known`` keeps them from step to step."""
    joints = {}
    for i, j in combinations(range(len(bodies)), 2):
        key = bodies[i].markers.tobytes() + b"|" + bodies[j].markers.tobytes()
        if key not in known:
            known[key] = fit_pair_joint(bodies[i], bodies[j])
        joints[i, j] = known[key]
    return joints


def _best_division(
    sorter: SpatialBodies, found: Partition, index: int, tried: dict[bytes, Division | None]
) -> Division | None:
    """Return the division of a body with the most evidence; None if it is rigid or has too few markers."""
    whole = found.bodies[index]
    if whole.rms_residual <= _RIGID:
        return None
    neighbours = [
        found.bodies[j if i == index else i]
        for i, j in spanning_tree(found.joints, len(found.bodies))
        if index in (i, j)
    ]
    key = b"|".join(body.markers.tobytes() for body in (whole, *neighbours))
    if key not in tried:
        every = _weigh_divisions(sorter, whole, neighbours)
        tried[key] = max(every, key=lambda division: division.evidence, default=None)
    return tried[key]


def _weigh_divisions(sorter: SpatialBodies, whole: SpatialBody, neighbours: Sequence[SpatialBody]) -> list[Division]:
    """Return the divisions of a body, with their gains."""
    motion, shape = unexplained_motion(sorter.points, whole, neighbours)
    needed = _GAIN_BETWEEN if len(neighbours) > 1 else _GAIN_END
    divisions = []
    deviation = unexplained_distance_sd(motion, shape) if neighbours and whole.rms_residual <= _NEARLY_RIGID else None
    for parts in sorter.divisions(whole.markers, deviation):
        gain = sum(_log_gain(whole.residual[part.markers], part.residual[part.markers]) for part in parts)
        rows = [np.searchsorted(whole.markers, part.markers) for part in parts]
        own = gain_of_parts(motion, shape, rows) if neighbours else gain
        divisions.append(Division(whole, parts, gain, own, needed))
    return divisions


def _log_gain(before: FloatArray, after: FloatArray) -> float:
    before, after = np.minimum(before, _UNKNOWN), np.minimum(after, _UNKNOWN)
    return float(np.sum(np.log((before**2 + _FLOOR**2) / (after**2 + _FLOOR**2))) / 2)
