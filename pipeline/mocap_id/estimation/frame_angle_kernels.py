"""Inner loops of the inverse kinematics: Gauss–Newton for the angles of single frames.

The forward map is eq. 3.18. A column of its Jacobian is z × (marker − joint), as in :mod:`mocap_id.geometry.planar`.
"""

from __future__ import annotations

import math

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.compilation import compiled


@compiled
def refine(  # noqa: PLR0917
    markers: FloatArray,
    used: BoolArray,
    angles: FloatArray,
    centres: FloatArray,
    segment: IntArray,
    local: FloatArray,
    damping: float,
    converged: float,
    iterations: int,
    normal: FloatArray,
) -> None:
    """Run Gauss–Newton from the given angles, in place, until no angle of the frame changes by more than ``converged``.

    Without iterations it only linearises: one function for both tasks, because each takes a third of a second to
    compile.

    Parameters
    ----------
    markers : (F, M, 2) array
        Positions, m.
    used : (F, M) bool array
    angles : (F, n) array
        Angles, rad; changed.
    centres, segment, local
        Geometry of the chain.
    damping : float
        Value added to the diagonal of Jᵀ J, m^2/rad^2.
    converged : float
        Largest change of an angle at convergence, rad.
    iterations : int
        Largest number of iterations.
    normal : (F, n, n) array
        Output: Jᵀ J at the last linearisation, m^2/rad^2.
    """
    n = angles.shape[1]
    damped, gradient = np.empty((n, n)), np.empty(n)
    poses, lever = np.empty((n + 1, 4)), np.empty((n, 2))
    for f in range(len(angles)):
        for iteration in range(iterations + 1):
            _linearise(markers[f], used[f], angles[f], centres, segment, local, poses, lever, damped, gradient)
            for j in range(n):
                for k in range(j + 1):
                    normal[f, j, k] = normal[f, k, j] = damped[j, k]
                damped[j, j] += damping
            if iteration == iterations:
                break
            _solve(damped, gradient)
            largest = 0.0
            for j in range(n):
                angles[f, j] += gradient[j]
                largest = max(largest, abs(gradient[j]))
            if largest <= converged:
                break


@compiled
def _linearise(  # noqa: PLR0917
    markers: FloatArray,
    used: BoolArray,
    angles: FloatArray,
    centres: FloatArray,
    segment: IntArray,
    local: FloatArray,
    poses: FloatArray,
    lever: FloatArray,
    normal: FloatArray,
    gradient: FloatArray,
) -> None:
    """Compute the lower triangle of Jᵀ J, and Jᵀ times the residuals, of one frame.

    ``poses`` (n + 1, 4) holds cosine, sine and origin of each segment, ``lever`` (n, 2) a marker's Jacobian.
    """
    n = len(angles)
    poses[0, 0], poses[0, 1], poses[0, 2], poses[0, 3] = 1.0, 0.0, 0.0, 0.0
    absolute = 0.0
    for j in range(n):
        c, s = poses[j, 0], poses[j, 1]
        absolute += angles[j]
        poses[j + 1, 2] = poses[j, 2] + c * centres[j, 0] - s * centres[j, 1]
        poses[j + 1, 3] = poses[j, 3] + s * centres[j, 0] + c * centres[j, 1]
        poses[j + 1, 0], poses[j + 1, 1] = math.cos(absolute), math.sin(absolute)
        gradient[j] = 0.0
        for k in range(j + 1):
            normal[j, k] = 0.0
    for m in range(len(segment)):
        if not used[m]:
            continue
        own = segment[m]
        c, s = poses[own, 0], poses[own, 1]
        x = poses[own, 2] + c * local[m, 0] - s * local[m, 1]
        y = poses[own, 3] + s * local[m, 0] + c * local[m, 1]
        for j in range(own):
            lever[j, 0], lever[j, 1] = poses[j + 1, 3] - y, x - poses[j + 1, 2]
            gradient[j] += lever[j, 0] * (markers[m, 0] - x) + lever[j, 1] * (markers[m, 1] - y)
            for k in range(j + 1):
                normal[j, k] += lever[j, 0] * lever[k, 0] + lever[j, 1] * lever[k, 1]


@compiled
def _solve(a: FloatArray, b: FloatArray) -> None:
    """Solve A x = b in place of b by Cholesky; A is positive definite, given by its lower triangle, and overwritten."""
    n = len(b)
    for j in range(n):
        for i in range(j, n):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = math.sqrt(total) if i == j else total / a[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= a[i, k] * b[k]
        b[i] /= a[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= a[k, i] * b[k]
        b[i] /= a[i, i]
