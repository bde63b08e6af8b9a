"""What a filter engine is given and what it returns: the same for every engine."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation.process import ORDER
from mocap_id.estimation.sigma_points import SigmaPoints

START_SD = (1.0, 10.0, 200.0, 1e4)
"""What is known of a lost joint: standard deviations of its angle (rad), velocity, acceleration and jerk.

1 rad is also the limit at which a joint is lost: pi is then three standard deviations, beyond which the turn in which
the angle lies cannot be told any more. The derivatives are those of very fast movements; the velocity's must stay
below 1 rad a frame, or a joint is lost as soon as it is found.
"""

_START_STEP = 0.3
"""What velocity, acceleration and jerk may each add to a lost joint's angle within a frame, rad.

At low rates very fast movements would: the angle would count as lost again one frame after it was found.
"""


def start_sd(dt: float) -> FloatArray:
    """(4,) :data:`START_SD` at a time step, s: derivatives held to what a frame can tell from a turn."""
    return np.minimum(START_SD, (np.inf, _START_STEP / dt, _START_STEP / dt**2, _START_STEP / dt**3))


PATIENCE = 0.1
"""Time, s, after which a joint is lost if more than half of its segment's markers keep failing the gate.

Markers do not jump together for so long: it is the filter that went wrong.
"""

ANCHOR_SD = 0.1
"""Standard deviation of an angle, rad, above which markers are not put through the unscented transform.

Its points would lie so far apart (0.35 rad for three joints) that the curvature of the forward map biases the result;
the angles that the frame's markers give by themselves are then the measurement.
"""


@dataclass(frozen=True)
class Anchors:
    """Angles that each frame's markers give without any other frame: a linear measurement of the state.

    Parameters
    ----------
    angles : (F, n) array
        rad, finite; unobserved joints hold any angle.
    covariance : (F, n, n) array
        rad^2; unobserved joints have a variance beyond any prior and no covariance with the others.
    observed : (F, n) bool array
        The frame's markers determine the angle.
    used : (F, M) bool array
        The markers that the angles were found from.
    """

    angles: FloatArray
    covariance: FloatArray
    observed: BoolArray
    used: BoolArray


@dataclass(frozen=True)
class Problem:
    """A chain, its measured markers and the noise.

    Parameters
    ----------
    observed : (F, M, 2) array
        Measured markers, plane frame, m; NaN where missing. Markers of the base carry no information on the angles.
    dt : float
        Time step, s.
    centres : (n, 2) array
        Joint centres in the segment before, m.
    segment : (M,) int array
        Segment of each marker, 1 … n.
    local : (M, 2) array
        Coordinates in the segment frame, m.
    variance : (M,) array
        Of the measurement of each marker, m^2, per coordinate.
    gate_variance : (M,) array
        Variance that the gate grants each marker, m^2, at least ``variance``.
    gate : float
        A marker farther from its prediction than this many standard deviations (Mahalanobis) is left out.
    density : (n,) array
        Spectral density of each joint's snap, rad^2/s^7.
    anchors : Anchors
        For the start, and after gaps.
    sigma_points : SigmaPoints
        Parameters of the unscented transform.
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

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.centres)

    @property
    def patience(self) -> int:
        """Frames in a row for which a segment's markers may fail the gate."""
        return math.ceil(PATIENCE / self.dt)


@dataclass(frozen=True)
class Track:
    """What a filter returns, and a smoother: states in the order of :mod:`mocap_id.estimation.process`.

    Parameters
    ----------
    mean : (F, 4n) array
        Filtered, or after the smoother smoothed, state.
    covariance : (F, 4n, 4n) array
        Of the state.
    used : (F, M) bool array
        Markers that were measured and passed the gate.
    restarted : (F, n) bool array
        The joint was lost on the way to this frame: nothing before it tells anything about it.
    log_likelihood : float
        Of the innovations of all frames updated through the unscented transform.
    """

    mean: FloatArray
    covariance: FloatArray
    used: BoolArray
    restarted: BoolArray
    log_likelihood: float

    @property
    def sd(self) -> FloatArray:
        """Standard deviations (F, 4n) of the state."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    def by_joint(self) -> tuple[FloatArray, FloatArray]:
        """Means, the track's own numbers in another order, and standard deviations, (F, n, 4) each."""
        shape = (len(self.mean), ORDER, self.restarted.shape[1])
        mean, sd = (np.swapaxes(each.reshape(shape), 1, 2) for each in (self.mean, self.sd))
        return mean, sd

    @property
    def found(self) -> BoolArray:
        """Where (F, n) a joint that was lost is found: it starts over for the last time."""
        after = np.concatenate([self.restarted[1:], np.zeros_like(self.restarted[:1])])
        return np.asarray(self.restarted & ~after)
