"""Process model of the joint states (eq. 3.17): angle, velocity, acceleration and jerk, driven by noise in the snap.

The state of n joints is ordered by derivative, then by joint: all angles, all velocities, all accelerations, all jerks.
Because the angles come first, only the first n columns of the lower Cholesky factor of the covariance change an angle.
An unscented transform through the forward kinematics then needs 2n + 1 evaluations instead of 8n + 1.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from mocap_id.arrays import FloatArray

ORDER = 4  # quantities in the state of one joint: angle, velocity, acceleration, jerk


def transition(dt: float) -> FloatArray:
    """Return the transition matrix (4, 4) of one joint over a time step, s (eq. 3.17).

    Entry (i, j) is dt^(j-i) / (j-i)! on and above the diagonal, otherwise zero.

    Examples
    --------
    >>> transition(0.5)[0].tolist()
    [1.0, 0.5, 0.125, 0.020833333333333332]
    """
    powers = [[dt ** (j - i) / factorial(j - i) if j >= i else 0.0 for j in range(ORDER)] for i in range(ORDER)]
    return np.array(powers)


def noise_shape(dt: float) -> FloatArray:
    """Return the process noise covariance (4, 4) of one joint over a time step, s, for a snap of unit spectral density.

    Entry (i, j) is dt^(7-i-j) / ((3-i)! (3-j)! (7-i-j)). The snap is white with spectral density q, in (rad/s^4)^2 s.
    The matrix for q is q times the result. Because the snap is integrated over the step, q is independent of the frame
    rate. The snap of the thesis has the standard deviation sigma_v and is constant over one frame; it corresponds to q
    = sigma_v^2 dt. Both give the jerk the variance (sigma_v dt)^2 per frame. The variances of the other derivatives
    differ by a factor of at most 2.3.
    """
    i = np.arange(ORDER)
    integral = 2 * ORDER - 1 - i[:, None] - i[None, :]
    factorials = np.array([factorial(ORDER - 1 - k) for k in i], dtype=float)
    return np.asarray(dt**integral / (factorials[:, None] * factorials[None, :] * integral))


def joint_transition(dt: float, joints: int) -> FloatArray:
    """Return the transition matrix (4n, 4n) of all joints over a time step, s, in the order of this module."""
    return np.asarray(np.kron(transition(dt), np.eye(joints)), dtype=np.float64)


def joint_noise(dt: float, density: FloatArray) -> FloatArray:
    """Return the process noise (4n, 4n) of all joints over a time step, s, for their snap densities (n,), rad^2/s^7."""
    return np.asarray(np.kron(noise_shape(dt), np.diag(density)), dtype=np.float64)
