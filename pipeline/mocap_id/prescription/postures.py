"""Sampled postures of a planar chain with springs, and the count of those that a person can hold (eq. 7.6, at rest)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.compilation import compiled
from mocap_id.prescription.arms import PlanarArm
from mocap_id.prescription.gravity_torques import ChainMasses
from mocap_id.prescription.joint_limits import JointLimits
from mocap_id.prescription.sampling import sobol

_CELLS = 8  # average number of postures per cell: few cells are missed
_REACHED = 1e-4  # m


@dataclass(frozen=True)
class SpringPlace:
    """A possible linear spring, which pulls the sum of its joints' angles towards its rest angle.

    Parameters
    ----------
    joints : tuple of int
        One joint, or two that the spring spans, counted from 0.
    stiffest : float
        Largest stiffness, N·m/rad.
    rest : (low, high)
        Allowed rest angles of the sum, rad.
    """

    joints: tuple[int, ...]
    stiffest: float
    rest: tuple[float, float] = (-2 * np.pi, 2 * np.pi)


@dataclass(frozen=True)
class Postures:
    """Sampled postures that represent a functional workspace.

    Parameters
    ----------
    gravity : (N, n) array
        Torque that holds each joint without a spring, N·m.
    stretch : (N, S) array
        Sum of the angles of each spring's joints, rad.
    cell : (N,) int array
        Cell of the plane that contains the tip; required points have cells of their own, after all others.
    cells : int
        Number C of cells of the workspace.
    required : int
        Number R of required points; their cells are C … C + R - 1.
    size : float
        Area of a cell, m².
    q, tips : (N, n), (N, 2) arrays
        rad, m.
    """

    gravity: FloatArray
    stretch: FloatArray
    cell: IntArray
    cells: int
    required: int
    size: float
    q: FloatArray
    tips: FloatArray


def sample_postures(  # noqa: PLR0917
    arm: PlanarArm,
    weights: ChainMasses,
    limits: JointLimits,
    places: Sequence[SpringPlace],
    required: FloatArray,
    count: int = 4096,
    seed: int = 0,
) -> Postures:
    """Sample postures evenly over the box, and some that reach each required point.

    Parameters
    ----------
    arm : PlanarArm
    weights : ChainMasses
    limits : JointLimits
    places : sequence of SpringPlace
    required : (R, 2) array
        Points at which the tip must be held, in the plane frame, m.
    count, seed : int
        Number and seed of the samples.

    Raises
    ------
    ValueError
        A required point cannot be reached.
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
        found = _reaching(arm, limits, point, q[np.argsort(np.linalg.norm(tips - point, axis=1))[:48]])
        if not len(found):
            raise ValueError(f"the required point ({point[0]:g}, {point[1]:g}) m cannot be reached")
        parts.append(found)
        owners.append(np.full(len(found), cells + k, dtype=np.int64))
    q = np.concatenate(parts)
    stretch = np.zeros((len(q), len(places)))
    for s, place in enumerate(places):
        stretch[:, s] = q[:, list(place.joints)].sum(axis=1)
    return Postures(weights.torques(q), stretch, np.concatenate(owners), cells, len(required), side**2, q, arm.tips(q))


def _reaching(arm: PlanarArm, limits: JointLimits, point: FloatArray, starts: FloatArray) -> FloatArray:
    """Return postures (K, n) within the limits whose tip is at the point, by Gauss–Newton from each start."""
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
    there = q[np.linalg.norm(arm.tips(q) - point, axis=1) < _REACHED]
    apart = np.unique(np.round(there, 6), axis=0, return_index=True)[1]
    return np.asarray(there[np.sort(apart)])


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
    """Count the cells with a posture that springs within a box may hold; an upper bound for all springs of the box.

    If both corners are the same, it is the exact count for these springs.

    Parameters
    ----------
    gravity, stretch, cell, cells, required
        As in :class:`Postures`.
    across : (S, n) bool array
        Whether spring s pulls at joint j.
    torque : (n, 2) array
        The person's limits, N·m.
    low, high : (S, 2) arrays
        Corners of the box: stiffness, N·m/rad, and rest angle, rad, of each spring.

    Returns
    -------
    int
        -1 where a required point cannot be held.
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
