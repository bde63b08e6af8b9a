"""States of an arm from a skeleton, for the stage ukf-smooth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.anatomy.angles import SHOULDER, AngleDeviations, JointAngles
from mocap_id.arrays import FloatArray
from mocap_id.estimation.space.skeleton_smoothing import SkeletonNoise, bridge_gaps, smooth_skeleton, without_jumps
from mocap_id.estimation.space.space_smoothing import SpatialStates
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.kinematics.space.rigid_body import rigid_poses
from mocap_id.kinematics.space.skeleton import SensorNoise
from mocap_id.store import Tree
from mocap_id.store.views import Trajectories

_BRIDGED = 0.3
"""Longest gap, s, that is filled to estimate the noise of the movement."""
_GUESSED_SD = 0.03
"""Standard deviation of a joint that the sensor guessed, m."""
_LASTING_SD = 0.009
"""Standard deviation of the part of a joint's lasting error that changes with the posture, m."""
_WRONG_LENGTH = 3.0
"""Deviation of a bone's length, in standard deviations, at which a sample has a quarter of its weight."""
_SEEN_BIAS = float(np.radians(13.0))
"""Root mean square of the mean errors of the elevation of five recorded arms, rad: Kinect v2 (Keraal, UI-PRMD)."""
_LARGEST_SD = 0.6
"""Standard deviation of the axial rotation, rad, above which it has no value: a straight elbow does not show it."""


def smooth_skeleton_states(
    tree: Tree, view: Trajectories, points: FloatArray, chain: SpatialChain, gate: float
) -> SpatialStates:
    """Return the states of the chain of a skeleton.

    Parameters
    ----------
    tree : Tree
        ``chain.h5``.
    view : Trajectories
    points : (F, M, 3) array
        Joints of the skeleton on the chain, m.
    chain : SpatialChain
    gate : float
    """
    sd = np.maximum(tree.numbers("markers/residual"), 1e-3)
    trunk = chain.segment == 0
    points = without_jumps(points, gate * sd)
    lost = np.isnan(points[..., 0])
    points = bridge_gaps(points, round(_BRIDGED * view.rate))
    rotations, origins, _ = rigid_poses(points[:, trunk], chain.local[trunk], 1 / sd[trunk] ** 2)
    shift = np.einsum("fij,j->fi", rotations, np.array(tree.facts["wrist_offset_m"]))
    beyond = np.flatnonzero(chain.segment >= 2)
    points[:, beyond] -= shift[:, None]
    found = tree.facts["noise"]
    memory = SensorNoise(found["white"], found["memory_s"])
    shoulder = origins + np.einsum("fij,j->fi", rotations, chain.joints[0].centre)
    weight = _weights(tree, view, points, chain, shoulder)
    weight[lost] = 0.0
    noise = SkeletonNoise(
        sd,
        weight,
        lambda frequency: memory.relative_power(frequency, 1 / view.rate),
        tree.facts["lasting_scale"] * np.where(trunk, 0.5 * _LASTING_SD, _LASTING_SD),
    )
    return smooth_skeleton(points, view.rate, chain, (rotations, origins), noise, gate=gate)


def _weights(
    tree: Tree,
    view: Trajectories,
    points: FloatArray,
    chain: SpatialChain,
    shoulder: FloatArray,
) -> FloatArray:
    """Return the weights (F, M) of all samples; ``shoulder`` (F, 3) is the centre of the first joint."""
    sd = tree.numbers("markers/residual")
    weight = np.ones(points.shape[:2])
    inferred = view.planar.facts["skeleton"]["inferred"]
    for m, name in enumerate(tree.texts("markers/name")):
        for first, last in inferred.get(name, ()):
            weight[(view.time >= first) & (view.time <= last), m] = min((sd[m] / _GUESSED_SD) ** 2, 1.0)
    start = shoulder
    for length, segment in zip(tree.facts["noise"]["length_m"], range(1, 4), strict=False):
        m = int(np.flatnonzero(chain.segment == segment)[0])
        bone = float(np.linalg.norm(chain.local[m]))
        off = (np.linalg.norm(points[:, m] - start, axis=1) - bone) / (_WRONG_LENGTH * length)
        weight[:, m] /= np.where(np.isfinite(off), 1 + off**2, 1.0) ** 2
        start = points[:, m]
    return weight


def shown_by_skeleton(angles: JointAngles) -> JointAngles:
    """Return the angles without an axial rotation where a nearly straight elbow does not show it.

    The constant error of the elevation has the size that recorded cameras showed; a skeleton shows only a part of it.
    """
    if angles.names != SHOULDER:
        return angles
    hidden = np.zeros(angles.angle.shape, dtype=np.bool_)
    hidden[:, 2] = ~(angles.sd.angle[:, 2] < _LARGEST_SD)

    def shown(values: FloatArray) -> FloatArray:
        return np.where(hidden, np.nan, values)

    sd = AngleDeviations(shown(angles.sd.angle), shown(angles.sd.rate), shown(angles.sd.acceleration))
    constant = np.hypot(angles.constant_sd, [0.0, _SEEN_BIAS, 0.0])
    return replace(
        angles,
        angle=shown(angles.angle),
        rate=shown(angles.rate),
        acceleration=shown(angles.acceleration),
        sd=sd,
        constant_sd=constant,
    )
