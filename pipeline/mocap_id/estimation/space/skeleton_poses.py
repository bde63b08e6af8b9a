"""Poses of the segments of an arm from single frames of a skeleton recording, in closed form."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.space.chain_model import degrees_of_freedom, make_track
from mocap_id.estimation.space.frame_poses import FramePoses, predict_positions
from mocap_id.estimation.space.space_kernels import ChainModel, Pose, predict_markers
from mocap_id.geometry.spatial_chain import SpatialChain

LEAST_FLEXION = float(np.radians(-10))
"""Smallest flexion of an elbow, rad. In a pose with a smaller flexion, the humerus is wrongly rotated by 180°."""

_STRAIGHT = float(np.sin(np.radians(15)))
"""Sine of the angle between the directions of upper arm and forearm below which the humerus's rotation is unknown."""
_WEAK = 1.0  # rad and m, prior standard deviation of degrees of freedom that no joint of the skeleton determines


def find_skeleton_poses(
    chain: SpatialChain, model: ChainModel, points: FloatArray, trunk: tuple[FloatArray, FloatArray], sd: FloatArray
) -> tuple[FramePoses, BoolArray]:
    """Return the poses of single frames, and whether each (F,) determines the axial rotation of the humerus.

    The segments of the chain are trunk, upper arm (ball joint), forearm (hinge) and, in some chains, hand (two-axis
    joint). Each segment of the arm has one joint of the skeleton. ``points`` (F, M, 3) are all joints of the skeleton,
    m, NaN where missing; ``sd`` (M,) is the standard deviation of their coordinates, m. ``trunk`` is the trunk's
    rotation (F, 3, 3) and position (F, 3), m; NaN where unknown. Where a joint of the skeleton is missing, the pose of
    the frame before is kept.
    """
    frames, segments = len(points), len(chain.joints) + 1
    track = make_track(model, frames)
    observed = np.zeros((frames, segments), dtype=np.bool_)
    rotation, origin = (_hold_last(each) for each in trunk)
    observed[:, 0] = np.isfinite(trunk[1]).all(axis=1)
    track.turn[:, 0], track.origin[:] = rotation, origin
    ends = [points[:, int(np.flatnonzero(chain.segment == s)[0])] for s in range(1, segments)]
    shoulder = origin + rotation @ chain.joints[0].centre
    upper, flexion, shown = _find_arm_pose(chain, ends[0] - shoulder, ends[1] - ends[0])
    observed[:, 1] = observed[:, 2] = observed[:, 0] & np.isfinite(flexion)
    upper, flexion = _hold_last(upper), _hold_last(flexion)
    track.turn[:, 1] = np.swapaxes(rotation, 1, 2) @ upper
    track.angle[:, 1, 0] = flexion
    track.turn[:, 2] = chain.joints[1].rotation(flexion[:, None])
    if segments > 3:
        forearm = upper @ track.turn[:, 2]
        hand = np.einsum("fji,fj->fi", forearm, ends[2] - ends[1])
        observed[:, 3] = observed[:, 2] & np.isfinite(hand).all(axis=1)
        lean = -np.arcsin(hand[:, 2] / np.linalg.norm(hand, axis=1))
        track.angle[:, 2] = _hold_last(np.stack([np.arctan2(hand[:, 0], -hand[:, 1]), lean], axis=1))
        track.turn[:, 3] = chain.joints[2].rotation(track.angle[:, 2])
    return _frame_poses(model, points, track, observed, sd), shown & observed[:, 1]


def _find_arm_pose(
    chain: SpatialChain, upper: FloatArray, lower: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the humerus's rotation (F, 3, 3), the flexion (F,), rad, and whether (F,) the axial rotation is known.

    ``upper`` and ``lower`` (F, 3) are the vectors from shoulder to elbow and from elbow to wrist, m.
    """
    wrist = chain.local[int(np.flatnonzero(chain.segment == 2)[0])]
    along = chain.joints[1].offset @ (wrist / np.linalg.norm(wrist))
    y = -upper / np.linalg.norm(upper, axis=1, keepdims=True)
    v = lower / np.linalg.norm(lower, axis=1, keepdims=True)
    rise = np.einsum("fi,fi->f", v, y)
    size, phase = np.hypot(along[0], along[1]), np.arctan2(along[0], along[1]) % (2 * np.pi)
    flexion = np.maximum(phase - np.arccos(np.clip(rise / size, -1, 1)), LEAST_FLEXION)
    forward = np.cos(flexion) * along[0] - np.sin(flexion) * along[1]
    across = v - rise[:, None] * y
    bent = np.linalg.norm(across, axis=1)
    first = across / np.maximum(bent, 1e-9)[:, None]
    second = np.cross(first, y)
    part = np.hypot(forward, along[2])
    x = (forward[:, None] * first - along[2] * second) / part[:, None]
    rotation = np.stack([x, y, np.cross(x, y)], axis=2)
    return rotation, flexion, np.asarray(bent > _STRAIGHT)


def _hold_last(values: FloatArray) -> FloatArray:
    """Return values (F, …) with NaN replaced by the last known frame, at the start by the first, or by zero."""
    known = np.isfinite(values).reshape(len(values), -1).all(axis=1)
    if not known.any():
        return np.zeros_like(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.asarray(values[np.where(last < 0, int(np.argmax(known)), last)])


def _frame_poses(model: ChainModel, points: FloatArray, track: Pose, observed: BoolArray, sd: FloatArray) -> FramePoses:
    d, (frames, count) = degrees_of_freedom(model), points.shape[:2]
    jacobian = np.zeros((frames, count, 3, d))
    predict_markers(model, track, np.empty((frames, count, 3)), jacobian)
    seen = np.asarray(np.isfinite(points).all(axis=2))
    weight = np.sqrt(seen) / sd
    rows = (jacobian * weight[..., None, None]).reshape(frames, -1, d)
    normal = np.swapaxes(rows, 1, 2) @ rows + np.eye(d) / _WEAK**2
    variance = np.diagonal(np.linalg.inv(normal), axis1=1, axis2=2).copy()
    residual = points - predict_positions(model, track)
    return FramePoses(track, variance, observed, seen, residual, np.zeros((frames, count)), np.zeros(points.shape))
