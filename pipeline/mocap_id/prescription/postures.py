"""Sampled postures of a planar chain with springs, and the number of holdable postures (eq. 7.6, at rest)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.compilation import compiled
from mocap_id.prescription.arms import PlanarArm
from mocap_id.prescription.joint_limits import JointLimits
from mocap_id.prescription.one_joint import ChainMasses
from mocap_id.prescription.sampling import sobol

_CELLS = 8  # average number of postures per cell, so that few cells contain no posture
_REACHED = 1e-4  # m: largest distance of the tip from a reached point


@dataclass(frozen=True)
class SpringPlace:
    """A possible linear spring, which pulls the sum of its joints' angles towards its rest angle."""

    joints: tuple[int, ...]  # one joint, or two joints that the spring spans, counted from 0
    stiffest: float  # largest stiffness, N·m/rad
    rest: tuple[float, float] = (-2 * np.pi, 2 * np.pi)  # smallest and largest rest angle of the sum, rad


@dataclass(frozen=True)
class Postures:
    """N sampled postures that represent a functional workspace."""

    gravity: FloatArray  # (N, n) torque that holds each joint without a spring, N·m
    stretch: FloatArray  # (N, S) sum of the angles of each spring's joints, rad
    cell: IntArray  # (N,) cell of the plane that contains the tip; each required point has its own cell
    cells: int  # number C of cells of the workspace
    required: int  # number R of required points; their cells are C … C + R - 1
    size: float  # area of a cell, m²
    q: FloatArray  # (N, n) rad
    tips: FloatArray  # (N, 2) m


def sample_postures(  # noqa: PLR0917
    arm: PlanarArm,
    weights: ChainMasses,
    limits: JointLimits,
    places: Sequence[SpringPlace],
    required: FloatArray,
    count: int = 4096,
    seed: int = 0,
) -> Postures:
    """Sample postures evenly within the joint limits, and find further postures that reach each required point.

    ``required`` (R, 2) are points in the plane frame at which the tip must be held, m. ``count`` and ``seed`` determine
    the samples.

    ValueError is raised if a required point cannot be reached.
    """
    q = limits.lower + sobol(count, limits.dimension, seed) * (limits.upper - limits.lower)
    tips = arm.tips(q)
    low, high = tips.min(axis=0), tips.max(axis=0)
    side = float(np.sqrt(np.prod(high - low) / (count / _CELLS)))
    index = np.floor((tips - low) / side).astype(np.int64)
    _, cell = np.unique(index @ np.array([1 << 20, 1]), return_inverse=True)
    cells = int(cell.max()) + 1
    parts, owners = [q], [cell.astype(np.int64)]
    for k, point in enumerate(required):
        postures = _find_postures(arm, limits, point, q[np.argsort(np.linalg.norm(tips - point, axis=1))[:48]])
        if not len(postures):
            raise ValueError(f"the required point ({point[0]:g}, {point[1]:g}) m cannot be reached")
        parts.append(postures)
        owners.append(np.full(len(postures), cells + k, dtype=np.int64))
    q = np.concatenate(parts)
    stretch = np.zeros((len(q), len(places)))
    for s, place in enumerate(places):
        stretch[:, s] = q[:, list(place.joints)].sum(axis=1)
    return Postures(weights.torques(q), stretch, np.concatenate(owners), cells, len(required), side**2, q, arm.tips(q))


def _find_postures(arm: PlanarArm, limits: JointLimits, point: FloatArray, starts: FloatArray) -> FloatArray:
    """Return postures (K, n) within the limits that reach the point, by Gauss–Newton steps from each start."""
    q = starts.copy()
    step, n = 1e-6, limits.dimension
    for _ in range(40):
        off = point - arm.tips(q)
        columns = [
            (arm.tips(q + step * np.eye(n)[j]) - arm.tips(q - step * np.eye(n)[j])) / (2 * step) for j in range(n)
        ]
        jacobian = np.stack(columns, axis=-1)  # (K, 2, n)
        normal = jacobian @ np.swapaxes(jacobian, -1, -2) + 1e-10 * np.eye(2)
        move = np.swapaxes(jacobian, -1, -2) @ np.linalg.solve(normal, off[..., None])
        q = np.clip(q + move[..., 0], limits.lower, limits.upper)
    reached = q[np.linalg.norm(arm.tips(q) - point, axis=1) < _REACHED]
    distinct = np.unique(np.round(reached, 6), axis=0, return_index=True)[1]
    return np.asarray(reached[np.sort(distinct)])


@compiled
def count_cells(  # noqa: PLR0917
    gravity: FloatArray,
    stretch: FloatArray,
    cell: IntArray,
    cells: int,
    required: int,
    across: BoolArray,
    torque: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> int:  # pragma: no cover
    """Return an upper bound of the number of cells with a posture that can be held, for all springs of a box.

    The number is exact if both corners of the box are the same. It is -1 if a required point cannot be held. The first
    parameters are fields of :class:`Postures`. ``across`` (S, n) is True if the spring spans the joint; ``torque`` (n,
    2) are the person's limits, N·m; ``low`` and ``high`` (S, 2) are the corners of the box: stiffness, N·m/rad, and
    rest angle, rad, of each spring.
    """
    held = np.zeros(cells + required, np.bool_)
    joints, springs = gravity.shape[1], stretch.shape[1]
    for i in range(gravity.shape[0]):
        if held[cell[i]]:
            continue
        fits = True
        for j in range(joints):
            least, most = gravity[i, j], gravity[i, j]
            for s in range(springs):
                if across[s, j]:
                    under, over = stretch[i, s] - high[s, 1], stretch[i, s] - low[s, 1]
                    least += min(low[s, 0] * under, high[s, 0] * under)
                    most += max(low[s, 0] * over, high[s, 0] * over)
            if most < torque[j, 0] or least > torque[j, 1]:
                fits = False
                break
        if fits:
            held[cell[i]] = True
    for r in range(required):
        if not held[cells + r]:
            return -1
    return int(held[:cells].sum())
