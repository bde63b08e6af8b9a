"""Process model (eq. 3.17), input and output of the filter engines, and the compiled engine."""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import factorial

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.errors import ConfigError, NumericalError
from mocap_id.estimation.filter_kernels import FilterModel, Inertial, Measurements, run_filter, run_smoother

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


START_SD = (1.0, 10.0, 200.0, 1e4)
"""Standard deviations with which a joint starts: angle (rad), velocity, acceleration and jerk.

A joint starts again if its angle becomes more uncertain than 1 rad, because π is then only three standard deviations,
and the number of whole rotations becomes ambiguous. The derivatives suit very fast movements. The velocity must stay
below 1 rad per frame, because otherwise a joint would start again in every frame.
"""

PATIENCE = 0.1
"""Time, s, after which a joint starts again if more than half of its segment's markers fail the gate.

Markers are not wrong together for so long, so the filter must have diverged.
"""

ANCHOR_SD = 0.1
"""Standard deviation of an angle, rad, above which the unscented transform is not used.

The sigma points would be so far apart (0.35 rad for three joints) that the curvature of the forward kinematics biases
the result. Instead, the angles from the frame's own markers are used as the measurement.
"""

_START_STEP = 0.3
"""Limit of the angle's change in one frame, rad, due to each starting standard deviation of the derivatives.

With a larger change, as at low frame rates, the joint would start again one frame later.
"""


def start_sd(dt: float) -> FloatArray:
    """Return :data:`START_SD` (4,), with the values for the derivatives limited for the time step ``dt``, s."""
    return np.minimum(START_SD, (np.inf, _START_STEP / dt, _START_STEP / dt**2, _START_STEP / dt**3))


@dataclass(frozen=True)
class MarkerChain:
    """Geometry of a chain of n joints with M markers."""

    centres: FloatArray  # (n, 2) joint centres in the frame of the segment before, m
    segment: IntArray  # (M,) segment of each marker, 0 = base
    local: FloatArray  # (M, 2) coordinates in the segment frame, m


@dataclass(frozen=True)
class Anchors:
    """Angles of each frame from its own markers, as a linear measurement of the state."""

    angles: FloatArray  # (F, n) rad, finite; arbitrary for unobserved joints
    covariance: FloatArray  # (F, n, n) rad^2; unobserved joints have a large variance and no covariance with others
    observed: BoolArray  # (F, n) the frame's markers determine the angle
    used: BoolArray  # (F, M) markers from which the angles are computed


@dataclass(frozen=True)
class FilterProblem:
    """A chain of n joints, its M measured markers on moving segments, and the noise."""

    observed: FloatArray  # (F, M, 2) markers in the plane frame, m; NaN where missing
    dt: float  # time step, s
    chain: MarkerChain
    variance: FloatArray  # (M,) measurement variance of each marker per coordinate, m^2
    gate_variance: FloatArray  # (M,) variance of each marker in the gate, m^2, at least ``variance``
    gate: float  # a marker farther from its prediction than this is left out, in standard deviations (Mahalanobis)
    density: FloatArray  # (n,) spectral density of each joint's snap, rad^2/s^7
    anchors: Anchors  # angles for the start and after gaps
    inertial: Inertial | None = None  # inertial sensors, for the compiled engine only

    @property
    def joints(self) -> int:
        return len(self.chain.centres)

    @property
    def patience(self) -> int:
        """Number of successive frames in which more than half of a segment's markers may fail the gate."""
        return math.ceil(PATIENCE / self.dt)


@dataclass(frozen=True)
class Track:
    """Result of a filter or smoother: states in the order of :mod:`mocap_id.estimation.filter_problem`."""

    mean: FloatArray  # (F, 4n) filtered or smoothed state
    covariance: FloatArray  # (F, 4n, 4n) covariance of the state
    used: BoolArray  # (F, M) markers that were measured and passed the gate
    restarted: BoolArray  # (F, n) the joint started again, so earlier frames carry no information about it
    log_likelihood: float  # of the innovations of all frames updated through the unscented transform

    @property
    def sd(self) -> FloatArray:
        """Standard deviations (F, 4n) of the state."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    def by_joint(self) -> tuple[FloatArray, FloatArray]:
        """Return the means (F, n, 4), a view of ``mean``, and their standard deviations (F, n, 4)."""
        shape = (len(self.mean), ORDER, self.restarted.shape[1])
        mean, sd = (np.swapaxes(each.reshape(shape), 1, 2) for each in (self.mean, self.sd))
        return mean, sd


_EMPTY = np.empty((0, 0))
_NO_SENSORS = Inertial(
    np.empty(0, dtype=np.int64), _EMPTY, _EMPTY, np.empty(0), np.empty((1, 0, 0)), np.empty((1, 0, 0)), 0.0
)


def filter_forwards(problem: FilterProblem) -> Track:
    """Return the filtered states of all frames; NumericalError if a covariance is not positive definite."""
    frames, markers = problem.observed.shape[:2]
    n = problem.joints
    outputs = (
        np.empty((frames, 4 * n)),
        np.empty((frames, 4 * n, 4 * n)),
        np.zeros((frames, markers), dtype=np.bool_),
        np.zeros((frames, n), dtype=np.bool_),
    )
    anchors = problem.anchors
    measured = Measurements(
        np.ascontiguousarray(problem.observed),
        np.ascontiguousarray(anchors.angles),
        np.ascontiguousarray(anchors.covariance),
        np.ascontiguousarray(anchors.observed),
        np.ascontiguousarray(anchors.used),
    )
    failed, log_likelihood = run_filter(_make_model(problem), measured, problem.inertial or _NO_SENSORS, *outputs)
    if failed >= 0:
        raise NumericalError(f"the filter's covariance is not positive definite at sample {failed} of {frames}")
    return Track(*outputs, log_likelihood)


def smooth_backwards(problem: FilterProblem, track: Track) -> Track:
    """Smooth a track in place (Rauch–Tung–Striebel); NumericalError if a covariance is not positive definite."""
    failed = run_smoother(_make_model(problem), track.restarted, track.mean, track.covariance)
    if failed >= 0:
        raise NumericalError(f"the smoother's covariance is not positive definite at sample {failed}")
    return track


def _make_model(problem: FilterProblem) -> FilterModel:
    """Return the constants for the kernels.

    Of the 2L + 1 points of the scaled unscented transform (Merwe) for a state of L components, the others than the mean
    are at the mean ± sqrt(c) times each column of the lower Cholesky factor of its covariance. With alpha = 1, beta = 2
    and kappa = 0, c is L, the mean point has no weight in the mean, and no weight is negative, so the innovation
    covariance is positive definite for any measurement function. The angles of a tracked chain have standard deviations
    of a few mrad. For three joints, the points are sqrt(12) standard deviations away, and the forward kinematics is
    still nearly linear between them.
    """
    size, chain = 4 * problem.joints, problem.chain
    if not size:
        raise ConfigError("sigma points: alpha^2 (L + kappa) is 0 for L = 0; it must be positive")
    return FilterModel(
        step=transition(problem.dt)[0],
        shape=noise_shape(problem.dt),
        density=np.ascontiguousarray(problem.density),
        start=start_sd(problem.dt) ** 2,
        anchor_limit=ANCHOR_SD**2,
        centres=np.ascontiguousarray(chain.centres),
        segment=np.ascontiguousarray(chain.segment),
        local=np.ascontiguousarray(chain.local),
        variance=np.ascontiguousarray(problem.variance),
        gate_variance=np.ascontiguousarray(problem.gate_variance),
        gate=float(problem.gate),
        patience=problem.patience,
        weights=(0.0, 2.0, 0.5 / size),
        spread=float(size),
    )
