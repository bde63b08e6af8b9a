"""States of an arm from a skeleton recording, for the stage ukf-smooth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.anatomy.angles import SHOULDER, AngleDeviations, JointAngles
from mocap_id.arrays import FloatArray
from mocap_id.estimation.space import SpatialStates
from mocap_id.estimation.space.skeleton_smoothing import SkeletonNoise, bridge_gaps, remove_jumps, smooth_skeleton
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.kinematics.space.rigid_body import rigid_poses
from mocap_id.kinematics.space.skeleton import SensorNoise
from mocap_id.store import Tree
from mocap_id.store.views import Trajectories

_BRIDGED = 0.3  # s, longest gap that is filled to estimate the noise of the movement
_GUESSED_SD = 0.03  # m, standard deviation of a joint whose position the sensor guessed
_LASTING_SD = 0.009  # m, standard deviation of the part of a joint's lasting error that changes with the posture
_WRONG_LENGTH = 3.0  # standard deviations: with this error of a bone's length, a sample has a quarter of its weight
_ELEVATION_BIAS = float(np.radians(13.0))
"""Root mean square of the mean elevation errors of five recorded arms, rad (Kinect v2; Keraal, UI-PRMD)."""
_LARGEST_SD = 0.6  # rad; a more uncertain axial rotation is left out, because a straight elbow does not determine it


def smooth_skeleton_states(
    tree: Tree, view: Trajectories, points: FloatArray, chain: SpatialChain, gate: float
) -> SpatialStates:
    """Return the smoothed states of the chain, from the joints ``points`` (F, M, 3) of a skeleton recording, m.

    ``tree`` is the content of chain.h5. A sample farther than ``gate`` standard deviations from its prediction is left
    out.
    """
    sd = np.maximum(tree.numbers("markers/residual"), 1e-3)
    trunk = chain.segment == 0
    points = remove_jumps(points, gate * sd)
    missing = np.isnan(points[..., 0])
    points = bridge_gaps(points, round(_BRIDGED * view.rate))
    rotations, origins, _ = rigid_poses(points[:, trunk], chain.local[trunk], 1 / sd[trunk] ** 2)
    shift = np.einsum("fij,j->fi", rotations, np.array(tree.facts["wrist_offset_m"]))
    beyond = np.flatnonzero(chain.segment >= 2)
    points[:, beyond] -= shift[:, None]
    facts = tree.facts["noise"]
    memory = SensorNoise(facts["white"], facts["memory_s"])
    shoulder = origins + np.einsum("fij,j->fi", rotations, chain.joints[0].centre)
    weight = _weights(tree, view, points, chain, shoulder)
    weight[missing] = 0.0
    noise = SkeletonNoise(
        sd,
        weight,
        lambda frequency: memory.relative_power(frequency, 1 / view.rate),
        tree.facts["lasting_scale"] * np.where(trunk, 0.5 * _LASTING_SD, _LASTING_SD),
    )
    return smooth_skeleton(points, view.rate, chain, (rotations, origins), noise, gate=gate)


def _weights(
    tree: Tree, view: Trajectories, points: FloatArray, chain: SpatialChain, shoulder: FloatArray
) -> FloatArray:
    """Return the weights (F, M) of all samples; ``shoulder`` (F, 3) is the centre of the first joint, m."""
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


def limit_to_skeleton(angles: JointAngles) -> JointAngles:
    """Return the angles of a joint of a skeleton; only those of the shoulder change.

    The axial rotation of the shoulder becomes NaN where it is too uncertain, because the elbow is nearly straight. The
    constant error of the elevation is increased by its value in other recordings, because a skeleton recording contains
    only a part of it.
    """
    if angles.names != SHOULDER:
        return angles
    hidden = np.zeros(angles.angle.shape, dtype=np.bool_)
    hidden[:, 2] = ~(angles.sd.angle[:, 2] < _LARGEST_SD)

    def hide(values: FloatArray) -> FloatArray:
        return np.where(hidden, np.nan, values)

    return replace(
        angles,
        angle=hide(angles.angle),
        rate=hide(angles.rate),
        acceleration=hide(angles.acceleration),
        sd=AngleDeviations(hide(angles.sd.angle), hide(angles.sd.rate), hide(angles.sd.acceleration)),
        constant_sd=np.hypot(angles.constant_sd, [0.0, _ELEVATION_BIAS, 0.0]),
    )
