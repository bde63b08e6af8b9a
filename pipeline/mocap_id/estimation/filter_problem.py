"""Input and output of a filter engine, common to all engines."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation.process_model import ORDER
from mocap_id.estimation.sigma_points import SigmaPoints

START_SD = (1.0, 10.0, 200.0, 1e4)
"""Initial standard deviations of a lost joint: angle (rad), velocity, acceleration and jerk.

A joint is lost beyond 1 rad: pi is then three standard deviations, and with more the number of whole turns is
ambiguous. The derivatives are those of very fast movements. The velocity must stay below 1 rad per frame, or a joint
would be lost as soon as it is found.
"""

_START_STEP = 0.3
"""Largest change of a lost joint's angle within a frame by each of velocity, acceleration and jerk, rad.

At low frame rates, larger changes would lose the joint again one frame after it is found.
"""


def start_sd(dt: float) -> FloatArray:
    """Return :data:`START_SD` (4,) at a time step, s; derivatives are limited to less than a turn in one frame."""
    return np.minimum(START_SD, (np.inf, _START_STEP / dt, _START_STEP / dt**2, _START_STEP / dt**3))


PATIENCE = 0.1
"""Time, s, after which a joint is lost if more than half of its segment's markers fail the gate.

Markers do not jump together for so long, so the filter must have diverged.
"""

ANCHOR_SD = 0.1
"""Standard deviation of an angle, rad, above which the unscented transform is not used.

Its points would be so far apart (0.35 rad for three joints) that the curvature of the forward map biases the result.
The measurement is then the angles from the frame's own markers.
"""


@dataclass(frozen=True)
class Anchors:
    """Angles of each frame from its own markers, as a linear measurement of the state.

    Parameters
    ----------
    angles : (F, n) array
        rad, finite; arbitrary for unobserved joints.
    covariance : (F, n, n) array
        rad^2; unobserved joints have a variance larger than any prior and no covariance with the others.
    observed : (F, n) bool array
        True if the frame's markers determine the angle.
    used : (F, M) bool array
        Markers behind the angles.
    """

    angles: FloatArray
    covariance: FloatArray
    observed: BoolArray
    used: BoolArray


@dataclass(frozen=True)
class InertialSignals:
    """Signals of K calibrated inertial sensors at the frames, in the axes of their segments.

    Parameters
    ----------
    segment : (K,) int array
        0 = base.
    place : (K, 2) array
        Position in the segment's frame, m.
    share : (K, n) array
        Turn of the skin under the sensor against its segment, for the turn of each joint.
    rest : (n,) array
        Joint angles without such a turn, rad.
    signal : (F, K, 3) array
        Angular velocity, rad/s, and specific force along the segment's x and y, m/s²; NaN where missing.
    variance : (F, K, 2) array
        Of the angular velocity, and of a component of the specific force.
    gravity : float
        m/s², along -y of the plane.
    """

    segment: IntArray
    place: FloatArray
    share: FloatArray
    rest: FloatArray
    signal: FloatArray
    variance: FloatArray
    gravity: float


@dataclass(frozen=True)
class FilterProblem:
    """A chain, its measured markers and the noise.

    Parameters
    ----------
    observed : (F, M, 2) array
        Measured markers, plane frame, m; NaN where missing. Base markers are left out: they carry no information.
    dt : float
        Time step, s.
    centres : (n, 2) array
        Joint centres in the frame of the segment before, m.
    segment : (M,) int array
        Segment of each marker, 1 … n.
    local : (M, 2) array
        Coordinates in the segment frame, m.
    variance : (M,) array
        Measurement variance of each marker per coordinate, m^2.
    gate_variance : (M,) array
        Variance of each marker in the gate, m^2, at least ``variance``.
    gate : float
        A marker farther from its prediction than this many standard deviations (Mahalanobis) is left out.
    density : (n,) array
        Spectral density of each joint's snap, rad^2/s^7.
    anchors : Anchors
        Angles for the start and after gaps.
    sigma_points : SigmaPoints
        Parameters of the unscented transform.
    inertial : InertialSignals or None
        Inertial sensors, for the compiled engine.
    """

    observed: FloatArray
    dt: float
    centres: FloatArray
    segment: IntArray
    local: FloatArray
    variance: FloatArray
    gate_variance: FloatArray
    gate: float
    density: FloatArray
    anchors: Anchors
    sigma_points: SigmaPoints
    inertial: InertialSignals | None = None

    @property
    def joints(self) -> int:
        """Return the number of joints n."""
        return len(self.centres)

    @property
    def patience(self) -> int:
        """Return the number of successive frames in which a segment's markers may fail the gate."""
        return math.ceil(PATIENCE / self.dt)


@dataclass(frozen=True)
class Track:
    """Result of a filter or smoother: states in the order of :mod:`mocap_id.estimation.process_model`.

    Parameters
    ----------
    mean : (F, 4n) array
        Filtered or smoothed state.
    covariance : (F, 4n, 4n) array
        Covariance of the state.
    used : (F, M) bool array
        Markers that were measured and passed the gate.
    restarted : (F, n) bool array
        The joint was lost before this frame, so earlier frames carry no information about it.
    log_likelihood : float
        Log-likelihood of the innovations of all frames updated through the unscented transform.
    """

    mean: FloatArray
    covariance: FloatArray
    used: BoolArray
    restarted: BoolArray
    log_likelihood: float

    @property
    def sd(self) -> FloatArray:
        """Return the standard deviations (F, 4n) of the state."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    def by_joint(self) -> tuple[FloatArray, FloatArray]:
        """Return means (a view of the track) and standard deviations, (F, n, 4) each."""
        shape = (len(self.mean), ORDER, self.restarted.shape[1])
        mean, sd = (np.swapaxes(each.reshape(shape), 1, 2) for each in (self.mean, self.sd))
        return mean, sd

    @property
    def found(self) -> BoolArray:
        """Return where (F, n) a lost joint is found, that is, restarts for the last time."""
        after = np.concatenate([self.restarted[1:], np.zeros_like(self.restarted[:1])])
        return np.asarray(self.restarted & ~after)
