"""Variances of the states from skin that slides with the joints (docs/concepts/rotations-in-the-filter.md).

A marker's lasting error is proportional to the motion of the joints beside its segment. The pose follows it with the
gain of the weighted fit, and rates and accelerations follow with those of the joints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation.space.chain_model import degrees_of_freedom, group_columns
from mocap_id.estimation.space.segment_rates import JointRates, SegmentRates
from mocap_id.estimation.space.space_kernels import ChainModel, Pose, predict_markers
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain

TWIST_SHARE = 1.5
"""Twist of the skin about the long axis that all markers of a segment share, relative to each marker's lasting error.

The residuals show only how markers differ, so the size is assumed. It holds for simulated arms.
"""

ALIKE = 2.0
"""Variance of the pose from markers that slide partly alike, relative to independent ones; also assumed."""

_POSTURES = 40
_LEAST_MOTION = 0.01  # rad, rms; joints that move less carry no skin
_DAMPING = 1e-6  # m²/rad², for what no marker determines


@dataclass(frozen=True)
class SkinErrors:
    """Variances from skin.

    Parameters
    ----------
    pose : (T, 2 S, d, d) array
        Covariance of the pose at T postures from the skin of each segment, for one unit of its motion: markers that
        slide each on their own, then markers that twist together.
    postures : (T,) int array
        Frames of the postures.
    motion : (3, F, 2 S) array
        Squared motion behind each of these, its rate and acceleration, relative to the mean square of the motion.
    """

    pose: FloatArray
    postures: IntArray
    motion: FloatArray

    def at_frames(self, values: FloatArray) -> FloatArray:
        """Return values (F, …) interpolated from the postures (T, …)."""
        every = np.arange(self.motion.shape[1])
        upper = np.searchsorted(self.postures, every).clip(1, max(len(self.postures) - 1, 1))
        if len(self.postures) == 1:
            return np.repeat(values, len(every), axis=0)
        low, high = self.postures[upper - 1], self.postures[upper]
        share = ((every - low) / (high - low)).clip(0, 1).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[upper - 1] * (1 - share) + values[upper] * share)


def skin_errors(
    chain: SpatialChain,
    model: ChainModel,
    pose: Pose,
    joints: JointRates,
    *,
    lasting: FloatArray,
    weight: FloatArray,
    known: IntArray,
) -> SkinErrors:
    """Return the variances of the states that skin motion causes.

    Parameters
    ----------
    chain : SpatialChain
    model : ChainModel
    pose : Pose
        States of F frames.
    joints : JointRates
    lasting : (M,) array
        Variance of a coordinate's lasting error, m².
    weight : (M,) array
        Weight of each marker, 1/m².
    known : (K,) int array
        Frames with complete states.
    """
    postures = np.unique(known[np.linspace(0, len(known) - 1, _POSTURES).round().astype(np.int64)])
    d, count = degrees_of_freedom(model), len(model.segment)
    jacobian, positions = np.zeros((len(postures), count, 3, d)), np.empty((len(postures), count, 3))
    some = Pose(*(np.ascontiguousarray(each[postures]) for each in pose))
    predict_markers(model, some, positions, jacobian)
    normal = np.einsum("fmik,fmil,m->fkl", jacobian, jacobian, weight)
    normal += _DAMPING * weight.mean() * np.eye(d)
    gain = np.einsum("fkl,fmil,m->fmki", np.linalg.inv(normal), jacobian, weight)
    segments = len(chain.joints) + 1
    covariance = np.zeros((len(postures), 2 * segments, d, d))
    axes = _long_axes(chain)
    origins, turns = chain.place(some.origin, some.turn[:, 0], some.turn[:, 1:])
    for s in range(segments):
        mine = np.flatnonzero(model.segment == s)
        covariance[:, s] = ALIKE * np.einsum("fmki,fmli,m->fkl", gain[:, mine], gain[:, mine], lasting[mine])
        if s > 0:
            around = np.cross((turns[:, s] @ axes[s - 1])[:, None], positions[:, mine] - origins[:, s, None])
            around /= np.maximum(np.linalg.norm(around, axis=2, keepdims=True), 1e-9)
            moved = np.einsum("fmki,fmi,m->fk", gain[:, mine], around, np.sqrt(lasting[mine]))
            covariance[:, segments + s] = TWIST_SHARE**2 * moved[:, :, None] * moved[:, None, :]
    return SkinErrors(covariance, postures, _motion(chain, pose, joints, known, axes))


def without_twist_rates(skin: SkinErrors, counted: BoolArray) -> SkinErrors:
    """Return the variances without the rates of the common twist of segments (S,) where it is counted elsewhere."""
    motion = skin.motion.copy()
    motion[1:, :, len(counted) :][:, :, counted] = 0.0
    return replace(skin, motion=motion)


def cluster_variances(chain: SpatialChain) -> FloatArray:
    """Return the variance per axis (n + 1,) of each cluster's slide on its bone, m², half of that of its joints."""
    found = np.zeros(len(chain.joints) + 1)
    for k, joint in enumerate(chain.joints, start=1):
        found[[joint.parent, k]] += joint.slide_sd**2 / 2
    return found


def _long_axes(chain: SpatialChain) -> FloatArray:
    """Return the direction (n, 3) from each joint to the next one, or to the markers, in the child's frame."""
    found = np.zeros((len(chain.joints), 3))
    for s in range(1, len(found) + 1):
        ahead = [joint.centre for joint in chain.joints if joint.parent == s]
        own = chain.local[chain.segment == s]
        towards = ahead[0] if ahead else own.mean(axis=0) if len(own) else np.zeros(3)
        found[s - 1] = towards / max(float(np.linalg.norm(towards)), 1e-9)
    return found


def _motion(chain: SpatialChain, pose: Pose, joints: JointRates, known: IntArray, axes: FloatArray) -> FloatArray:
    """Return the squared motion (3, F, 2 S) beside each segment, then about its long axis; its mean is one."""
    frames, n = joints.velocity.shape[:2]
    squares = np.zeros((3, frames, 2 * (n + 1)))
    for k, joint in enumerate(chain.joints):
        u, _, v = np.linalg.svd(pose.turn[known, k + 1].mean(axis=0))
        middle = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
        bent = so3.log(middle.T @ pose.turn[:, k + 1])
        moves = (bent, joints.velocity[:, k], joints.acceleration[:, k])
        for s in (k + 1, joint.parent):
            squares[:, :, s] += [np.sum(each**2, axis=1) for each in moves]
        squares[:, :, n + 2 + k] = [(each @ axes[k]) ** 2 for each in moves]
    usual = squares[0, known].mean(axis=0)
    return np.asarray(np.where(usual > _LEAST_MOTION**2, squares / np.maximum(usual, _LEAST_MOTION**2), 0.0))


def segment_variances(
    skin: SkinErrors, spin: FloatArray, origin: FloatArray, rates: SegmentRates
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return variances (F, n + 1) per axis of origin, rotation, omega and alpha from skin.

    Parameters
    ----------
    skin : SkinErrors
    spin, origin : (T, n + 1, 3, d) arrays
        Change of the segments' rotations and origins by the pose, at the postures.
    rates : SegmentRates
    """
    turning, shifting = (
        skin.at_frames(np.einsum("tgik,tskl,tgil->tsg", each, skin.pose, each) / 3) for each in (spin, origin)
    )
    still, rate, grows = (np.einsum("fs,fsg->fg", motion, turning) for motion in skin.motion)
    shifted = np.einsum("fs,fsg->fg", skin.motion[0], shifting)
    return shifted, still, rate, grows + np.sum(rates.omega**2, axis=2) * rate


def joint_variances(skin: SkinErrors, model: ChainModel, joints: JointRates, k: int) -> tuple[FloatArray, FloatArray]:
    """Return covariances of a joint from skin.

    Returns
    -------
    (F, 9, 9) array
        Of rotation error, velocity and acceleration in the child's axes.
    (F, 3, c) array
        Variances of the coordinates, their velocities and accelerations.
    """
    own = group_columns(model)[k + 1]
    c = own.stop - own.start
    block = skin.pose[:, :, own, own]
    map_here = joints.maps[k][skin.postures, :3, :c]
    turned = skin.at_frames(np.einsum("tik,tskl,tjl->tsij", map_here, block, map_here))
    still, rate, grows = (np.einsum("fs,fsij->fij", motion, turned) for motion in skin.motion)
    carried = np.tile(np.eye(9), (len(still), 1, 1))
    velocity, acceleration = so3.hat(joints.velocity[:, k]), so3.hat(joints.acceleration[:, k])
    carried[:, 3:6, :3], carried[:, 6:, :3], carried[:, 6:, 3:6] = velocity, acceleration, velocity
    parts = np.zeros((len(still), 9, 9))
    parts[:, :3, :3], parts[:, 3:6, 3:6], parts[:, 6:, 6:] = still, rate, grows
    alone = skin.at_frames(np.diagonal(block, axis1=2, axis2=3))
    coordinates = np.stack([np.einsum("fs,fsc->fc", motion, alone) for motion in skin.motion], axis=1)
    return carried @ parts @ np.swapaxes(carried, 1, 2), coordinates
