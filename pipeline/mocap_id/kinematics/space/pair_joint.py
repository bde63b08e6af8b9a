"""Joint between two rigid bodies in space: the pair of body-fixed points that stay closest together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.kinematics.space.bodies import SpatialBody
from mocap_id.kinematics.space.rigid_body import mean_rotation

_RIDGE = 1e-4  # selects, of the many common points of a hinge, the point nearest to the markers
_FEWEST = 10  # frames


@dataclass(frozen=True)
class SpatialPairJoint:
    """Point that two bodies share, and their rotation about it.

    Two bodies that hardly move against each other share any point, so ``residual`` of a joint is far below ``free``.
    """

    in_first: FloatArray  # (3,) point in the first body's frame, m
    in_second: FloatArray  # (3,) point in the second body's frame, m
    residual: float  # rms distance between the two points over the frames, m; inf if hardly visible together
    free: float  # rms motion of one body's markers in the other's frame, m; the smaller of the two
    arc: float  # 2.5 to 97.5 % range of the relative rotation about its main axis, rad


def fit_pair_joint(first: SpatialBody, second: SpatialBody) -> SpatialPairJoint:
    """Fit the common point of two bodies by linear least squares (SCoRE).

    The points x of the first and y of the second body satisfy ``x - C y = d`` in the first body's frame, with the
    relative rotation C and the second body's origin d.
    """
    turn = np.swapaxes(first.rotation, 1, 2) @ second.rotation
    shift = np.einsum("fji,fj->fi", first.rotation, second.origin - first.origin)
    both = np.isfinite(shift[:, 0])
    if both.sum() < _FEWEST:
        return SpatialPairJoint(np.zeros(3), np.zeros(3), np.inf, 0.0, 0.0)
    turn, shift = turn[both], shift[both]
    mean, back = turn.mean(axis=0), -np.einsum("fji,fj->fi", turn, shift)
    normal = np.block([[np.eye(3), -mean], [-mean.T, np.eye(3)]]) + _RIDGE * np.eye(6)
    solution = np.linalg.solve(normal, np.concatenate([shift.mean(axis=0), back.mean(axis=0)]))
    off = solution[:3] - turn @ solution[3:] - shift
    free = min(_rms(first.residual[second.markers]), _rms(second.residual[first.markers]))
    return SpatialPairJoint(solution[:3], solution[3:], _rms(np.linalg.norm(off, axis=1)), free, _arc(turn))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _arc(turn: FloatArray) -> float:
    """Return the 2.5 to 97.5 % range of rotations (F, 3, 3) about their main axis, rad."""
    vector = so3.log(mean_rotation(turn).T @ turn)
    _, axes = np.linalg.eigh(vector.T @ vector)
    angle = np.sort(vector @ axes[:, 2])
    last = len(angle) - 1
    low, high = np.interp([0.025 * last, 0.975 * last], np.arange(len(angle)), angle)
    return float(high - low)
