"""Reachable workspace: the points that the tip of a chain can reach within joint limits, with an interval (7.2).

W = {g(θ) : θ ∈ Q} (eq. 7.1) for the box Q of the limits. It is the alpha shape of the points to which low-discrepancy
samples of Q are mapped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.prescription.alpha_shape import RADIUS_FACTOR, AlphaShape, alpha_shape, covering_radius, enclosed
from mocap_id.prescription.arms import Arm
from mocap_id.prescription.joint_limits import JointLimits
from mocap_id.prescription.sampling import sample_box, sobol

SAMPLES = 10_000
"""Default number of postures, as in the thesis."""
_PARTS = (8, 4, 2, 1)  # divisors of the number of samples, to show the convergence
_LEAST = 64  # least number of samples for a useful shape


@dataclass(frozen=True)
class Workspace:
    """A reachable workspace.

    Parameters
    ----------
    shape : AlphaShape
        Shape of the points reached, m.
    postures : (N, n) array
        The postures that reach them, rad.
    measure : float
        Area, m², or volume, m³.
    interval : (low, high)
        95 % interval of the measure.
    sd : float
        Standard deviation of the measure from those of limits and dimensions.
    discretisation : float
        Largest difference to the measures from a half, a quarter and an eighth of the samples. If half of the samples
        have 1.6 times the error (a curved surface in space), this is three times the remaining error.
    convergence : tuple of (samples, radius, measure)
        For an eighth, a quarter, a half and all of the samples.
    """

    shape: AlphaShape
    postures: FloatArray
    measure: float
    interval: tuple[float, float]
    sd: float
    discretisation: float
    convergence: tuple[tuple[int, float, float], ...]


def compute_workspace(arm: Arm, limits: JointLimits, samples: int = SAMPLES, seed: int = 0) -> Workspace:
    """Compute the reachable workspace of an arm within joint limits.

    The radius of the alpha shape is :data:`~mocap_id.prescription.alpha_shape.RADIUS_FACTOR` times the largest distance
    between the tip in an equal number of other postures and the nearest sample.

    The interval is 1.96 standard deviations, widened on both sides by the discretisation. The standard deviation is
    computed by displacing each limit and dimension in turn by its own standard deviation. The topology of the edge
    stays the same.

    Parameters
    ----------
    arm : Arm
    limits : JointLimits
    samples : int
        Number of postures, at least 512.
    seed : int
        Seed of the samples.

    Raises
    ------
    ValueError
        There are too few samples, the number of limits is not that of the joints, or the tip's points have no area
        (volume).
    """
    if samples < _LEAST * max(_PARTS):
        raise ValueError(f"{samples} samples are too few to show convergence; expected at least {_LEAST * max(_PARTS)}")
    if limits.dimension != arm.joints:
        raise ValueError(f"there are limits for {limits.dimension} joints, but the chain has {arm.joints}")
    postures = sample_box(limits.lower, limits.upper, samples, seed, arm.dimension)
    points = arm.tips(postures)
    others = arm.tips(limits.lower + sobol(samples, arm.joints, seed + 1000) * (limits.upper - limits.lower))
    shapes = [_shape(points[: samples // part], others[: samples // part]) for part in _PARTS]
    measures = [shape.measure for shape in shapes]
    discretisation = max(abs(measures[-1] - fewer) for fewer in measures[:-1])
    sd = _deviation(arm, limits, postures, shapes[-1])
    reach = NORMAL_95 * sd + discretisation
    return Workspace(
        shape=shapes[-1],
        postures=postures,
        measure=measures[-1],
        interval=(max(measures[-1] - reach, 0.0), measures[-1] + reach),
        sd=sd,
        discretisation=discretisation,
        convergence=tuple(
            (len(shape.points), shape.radius, size) for shape, size in zip(shapes, measures, strict=True)
        ),
    )


def _shape(points: FloatArray, others: FloatArray) -> AlphaShape:
    return alpha_shape(points, RADIUS_FACTOR * covering_radius(points, others))


def _deviation(arm: Arm, limits: JointLimits, postures: FloatArray, shape: AlphaShape) -> float:
    """Return the standard deviation of the area or volume, from those of joint limits and dimensions of the arm."""
    facets = shape.boundary()
    used, corner = np.unique(facets, return_inverse=True)
    share = (postures[used] - limits.lower) / (limits.upper - limits.lower)

    def measure(moved: Arm, low: FloatArray, high: FloatArray) -> float:
        points = moved.tips(limits.lower + low + share * (limits.upper + high - limits.lower - low))
        return float(enclosed(points[corner.reshape(facets.shape)]))

    still = np.zeros(limits.dimension)
    halves = [measure(arm, step, still) - measure(arm, -step, still) for step in np.diag(limits.lower_sd)]
    halves += [measure(arm, still, step) - measure(arm, still, -step) for step in np.diag(limits.upper_sd)]
    halves += [measure(above, still, still) - measure(below, still, still) for above, below in arm.deviations()]
    return 0.5 * float(np.linalg.norm(halves))
