"""Division of the markers into rigid bodies, which distinguishes sliding skin from a joint.

The skin of a limb slides, and follows only a part of the limb's axial rotation. Two groups of its markers then rotate
relative to each other by several degrees, as two segments do. However, this rotation follows the joints next to the
body (:mod:`.unexplained_motion`), unlike the rotation of an undetected joint inside the body. A body is therefore
divided only if the two parts clearly reduce the motion that these joints do not explain, or reduce the residuals by
more than skin could cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.kinematics.space.bodies import SpatialBodies, SpatialBody, SpatialPairJoint, fit_pair_joint
from mocap_id.kinematics.space.unexplained_motion import gain_of_parts, unexplained_distance_sd, unexplained_motion

_GAIN_END = 0.7  # least summed log gain to divide a body with one joint; skin alone reaches 0.5
_GAIN_BETWEEN = 1.15  # the same between two joints, whose rotations explain less; skin alone reaches 1.1

_FAR_BETTER = float(np.log(3.5))  # mean log gain per marker, larger than by skin
_RIGID = 1.2e-3  # m; residual of a body without a joint; a joint with 2° of rotation leaves more
_NEARLY_RIGID = 0.01  # m; largest residual of a body with at most a small joint rotation
_UNKNOWN = 10.0  # m; residual on a body whose markers are on one line
_FLOOR = 1e-3  # m; smaller residuals do not increase a gain
_STAY = 0.5  # after an accepted division, a marker changes its body if its residual is reduced to this fraction
_MOST = 16  # largest number of bodies


@dataclass(frozen=True)
class Division:
    """Division of a body into two, and the evidence for it."""

    whole: SpatialBody
    parts: tuple[SpatialBody, SpatialBody]
    gain: float  # summed log gain of the markers' residuals
    own: float  # the same for motion that the neighbouring joints do not explain; ``gain`` without neighbours
    needed: float  # least ``own`` of a real division

    @property
    def evidence(self) -> float:
        """Evidence for two bodies, relative to the required evidence: 1 or more if the bodies are real."""
        far = self.gain / len(self.whole.markers) / _FAR_BETTER
        return max(self.own / self.needed, far)


@dataclass
class Partition:
    """Bodies found so far, joints between them, and divisions that were tested."""

    bodies: list[SpatialBody]
    joints: dict[tuple[int, int], SpatialPairJoint] = field(default_factory=dict)  # joint of each pair of bodies i < j
    made: list[Division] = field(default_factory=list)  # accepted divisions
    refused: list[Division] = field(default_factory=list)  # best division of every body that was not divided


def divide(sorter: SpatialBodies, start: Sequence[SpatialBody], needed: float = 1.0) -> Partition:
    """Divide bodies, best division first, until there are 16 or no division has the evidence ``needed``."""
    partition = Partition(list(start))
    joints: dict[bytes, SpatialPairJoint] = {}
    tried: dict[bytes, Division | None] = {}
    while True:
        partition.joints = _fit_all_joints(partition.bodies, joints)
        divisions = [_best_division(sorter, partition, index, tried) for index in range(len(partition.bodies))]
        known = [division for division in divisions if division is not None]
        best = max(known, key=lambda division: (division.evidence >= needed, division.gain), default=None)
        if best is None or best.evidence < needed or len(partition.bodies) >= _MOST:
            partition.refused = known
            return partition
        partition.made.append(best)
        others = [body.markers for body in partition.bodies if body is not best.whole]
        divided = [*others, *(part.markers for part in best.parts)]
        settled = sorter.reassign_markers(divided, _STAY)
        partition.bodies = [sorter.body(group) for group in divided] if len(settled) < len(divided) else list(settled)


def build_partition(bodies: Sequence[SpatialBody]) -> Partition:
    """Return bodies with the joints of all pairs, without testing divisions."""
    return Partition(list(bodies), _fit_all_joints(bodies, {}))


def spanning_tree(joints: dict[tuple[int, int], SpatialPairJoint], count: int) -> list[tuple[int, int]]:
    """Return the pairs of bodies that form the tree with the smallest joint residuals (Kruskal's algorithm)."""
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
    """Return the joint of each pair of bodies; new joints are added to the cache ``known``."""
    joints = {}
    for i, j in combinations(range(len(bodies)), 2):
        key = bodies[i].markers.tobytes() + b"|" + bodies[j].markers.tobytes()
        if key not in known:
            known[key] = fit_pair_joint(bodies[i], bodies[j])
        joints[i, j] = known[key]
    return joints


def _best_division(
    sorter: SpatialBodies, partition: Partition, index: int, cached: dict[bytes, Division | None]
) -> Division | None:
    """Return the division of a body with the most evidence; None if it is rigid or has too few markers."""
    whole = partition.bodies[index]
    if whole.rms_residual <= _RIGID:
        return None
    neighbours = [
        partition.bodies[j if i == index else i]
        for i, j in spanning_tree(partition.joints, len(partition.bodies))
        if index in (i, j)
    ]
    key = b"|".join(body.markers.tobytes() for body in (whole, *neighbours))
    if key not in cached:
        every = _weigh_divisions(sorter, whole, neighbours)
        cached[key] = max(every, key=lambda division: division.evidence, default=None)
    return cached[key]


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
    """Return the summed log ratio of residuals before and after a division."""
    before, after = np.minimum(before, _UNKNOWN), np.minimum(after, _UNKNOWN)
    return float(np.sum(np.log((before**2 + _FLOOR**2) / (after**2 + _FLOOR**2))) / 2)
