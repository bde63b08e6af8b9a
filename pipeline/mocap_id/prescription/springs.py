"""Springs on the joints of a planar chain, and which postures a person can hold with them (eq. 7.6, at rest)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.prescription.compiled import compiled
from mocap_id.prescription.gravity import Weights
from mocap_id.prescription.limits import Limits
from mocap_id.prescription.reach import PlanarArm
from mocap_id.prescription.sampling import sobol

_CELLS = 8  # postures to a cell, about: few cells are missed
_REACHED = 1e-4  # m


@dataclass(frozen=True)
class Place:
    """Where a linear spring may be: it pulls the sum of its joints' angles towards its rest angle.

    Parameters
    ----------
    joints : tuple of int
        One joint, or two that it goes across, counted from 0.
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
    """Postures by which a functional workspace is counted.

    Parameters
    ----------
    gravity : (N, n) array
        What holds each joint without a spring, N·m.
    stretch : (N, S) array
        Sum of the angles that each spring feels, rad.
    cell : (N,) int array
        Cell of the plane that the tip is in; those of required points come after all others.
    cells : int
        Cells of the workspace, C.
    required : int
        Required points R; their cells are C … C + R - 1.
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


def postures(  # noqa: PLR0917
    arm: PlanarArm,
    weights: Weights,
    limits: Limits,
    places: Sequence[Place],
    required: FloatArray,
    count: int = 4096,
    seed: int = 0,
) -> Postures:
    """Postures evenly spread over the box, and some that reach each required point.

    Parameters
    ----------
    arm : PlanarArm
    weights : Weights
    limits : Limits
    places : sequence of Place
    required : (R, 2) array
        Points that the tip must be held at, plane frame, m.
    count, seed : int
        Of the samples.

    Raises
    ------
    ValueError
        A required point is outside every reach.
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
            raise ValueError(f"the required point ({point[0]:g}, {point[1]:g}) m is outside every reach")
        parts.append(found)
        owners.append(np.full(len(found), cells + k, dtype=np.int64))
    q = np.concatenate(parts)
    stretch = np.zeros((len(q), len(places)))
    for s, place in enumerate(places):
        stretch[:, s] = q[:, list(place.joints)].sum(axis=1)
    return Postures(weights.torques(q), stretch, np.concatenate(owners), cells, len(required), side**2, q, arm.tips(q))


def _reaching(arm: PlanarArm, limits: Limits, point: FloatArray, starts: FloatArray) -> FloatArray:
    """Postures (K, n) within the limits whose tip is at the point: damped Gauss–Newton from each start."""
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
def counted(  # noqa: PLR0917
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
    """How many cells hold a posture that some springs between two corners of a box of springs may hold.

    With both corners the same it is what these springs do hold.

    Parameters
    ----------
    gravity, stretch, cell, cells, required
        As in :class:`Postures`.
    across : (S, n) bool array
        Whether spring s pulls at joint j.
    torque : (n, 2) array
        The person's limits, N·m.
    low, high : (S, 2) arrays
        Stiffness, N·m/rad, and rest angle, rad, of each spring.

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
