"""Reachable workspace of a chain's tip within joint limits, and the overlay of two workspaces (thesis 7.2).

W = {g(θ) : θ ∈ Q} (eq. 7.1) for the box Q of the limits. It is the alpha shape of the points to which low-discrepancy
samples of Q are mapped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray
from mocap_id.prescription.alpha_shape import (
    RADIUS_FACTOR,
    AlphaShape,
    compute_alpha_shape,
    compute_measure,
    covering_radius,
)
from mocap_id.prescription.arms import Arm
from mocap_id.prescription.joint_limits import JointLimits
from mocap_id.prescription.sampling import sample_box, sobol

SAMPLES = 10_000
"""Default number of postures, as in the thesis."""
_PARTS = (8, 4, 2, 1)  # divisors of the number of samples, to measure the convergence
_LEAST = 64  # least number of samples for a useful shape
_OVERLAY_POINTS = 1 << 16


@dataclass(frozen=True)
class Workspace:
    """A reachable workspace."""

    shape: AlphaShape  # shape of the reached points, m
    postures: FloatArray  # (N, n) postures that reach these points, rad
    measure: float  # area, m², or volume, m³
    interval: tuple[float, float]  # 95 % interval of the measure
    sd: float  # standard deviation of the measure, from the uncertain limits and dimensions
    discretisation: float  # bound of the error from the number of samples (`_bound_discretisation`)
    convergence: tuple[tuple[int, float, float], ...]  # samples, radius and measure of each fraction


def compute_workspace(arm: Arm, limits: JointLimits, samples: int = SAMPLES, seed: int = 0) -> Workspace:
    """Return the reachable workspace of an arm within joint limits.

    The radius of the alpha shape is :data:`~mocap_id.prescription.alpha_shape.RADIUS_FACTOR` times the largest distance
    between the tip in an equal number of other postures and the nearest sample. The interval is 1.96 standard
    deviations, widened on both sides by the discretisation. The standard deviation follows from displacing each limit
    and dimension in turn by its standard deviation; the topology of the edge stays the same.

    ValueError is raised if there are too few samples, the number of limits differs from the number of joints, or the
    points of the tip have no area (or volume).

    Parameters
    ----------
    arm : Arm
    limits : JointLimits
    samples : int
        Number of postures, at least 512.
    seed : int
        Seed of the samples.
    """
    if samples < _LEAST * max(_PARTS):
        raise ValueError(
            f"{samples} samples are too few to measure the convergence; expected at least {_LEAST * max(_PARTS)}"
        )
    if limits.dimension != arm.joints:
        raise ValueError(f"there are limits for {limits.dimension} joints; expected {arm.joints}, as in the chain")
    postures = sample_box(limits.lower, limits.upper, samples, seed, arm.dimension)
    points = arm.tips(postures)
    others = arm.tips(limits.lower + sobol(samples, arm.joints, seed + 1000) * (limits.upper - limits.lower))
    shapes = [_shape(points[: samples // part], others[: samples // part]) for part in _PARTS]
    measures = [shape.measure for shape in shapes]
    discretisation = _bound_discretisation(shapes)
    sd = _measure_sd(arm, limits, postures, shapes[-1])
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
    return compute_alpha_shape(points, RADIUS_FACTOR * covering_radius(points, others))


def _bound_discretisation(shapes: list[AlphaShape]) -> float:
    """Return a bound of the error from the number of samples, m² or m³; the last two shapes have a half and all.

    Chords cut off a curved edge: a half of the samples has 1.6 times the error in space, and more in the plane. The
    error is then at most 1.7 times the difference between a half and all, with the *same* radius, because a larger
    radius also fills bays and cavities. What the radius fills is added. Differences with each number's own radius are
    not enough: around a cavity both effects can cancel. They count if they are larger.
    """
    half, whole = shapes[-2:]
    with_radius_of_half = whole.with_radius(half.radius).measure
    cut_off, filled = abs(with_radius_of_half - half.measure), abs(with_radius_of_half - whole.measure)
    return max(2 * cut_off + filled, *(abs(whole.measure - fewer.measure) for fewer in shapes[:-1]))


def _measure_sd(arm: Arm, limits: JointLimits, postures: FloatArray, shape: AlphaShape) -> float:
    """Return the standard deviation of the area or volume from the uncertain joint limits and dimensions of the arm."""
    facets = shape.boundary()
    used, corner = np.unique(facets, return_inverse=True)
    share = (postures[used] - limits.lower) / (limits.upper - limits.lower)

    def measure(moved: Arm, low: FloatArray, high: FloatArray) -> float:
        points = moved.tips(limits.lower + low + share * (limits.upper + high - limits.lower - low))
        return float(compute_measure(points[corner.reshape(facets.shape)]))

    still = np.zeros(limits.dimension)
    halves = [measure(arm, step, still) - measure(arm, -step, still) for step in np.diag(limits.lower_sd)]
    halves += [measure(arm, still, step) - measure(arm, still, -step) for step in np.diag(limits.upper_sd)]
    halves += [measure(above, still, still) - measure(below, still, still) for above, below in arm.perturbed_pairs()]
    return 0.5 * float(np.linalg.norm(halves))


@dataclass(frozen=True)
class Overlay:
    """Intersection and differences of two workspaces; areas in m², or volumes in m³."""

    gained: float  # only in the later workspace
    lost: float  # only in the earlier workspace
    kept: float  # in both
    sd: float  # standard deviation of each of these areas or volumes, from the number of counted points
    points: FloatArray  # (M, d) points in any of the workspaces, in the frame of the earlier one, m
    before: BoolArray  # (M,) whether a point is in the earlier workspace
    after: BoolArray  # (M,) whether a point is in the later workspace


def overlay_workspaces(before: AlphaShape, after: AlphaShape, shift: FloatArray, seed: int = 0) -> Overlay:
    """Compare two workspaces of the same dimension.

    ``shift`` (d,) is the translation from the frame of the later workspace to the frame of the earlier one, m. The
    counted points are evenly spread over a box around both; ``seed`` is their seed.
    """
    both = np.concatenate([before.points, after.points + shift])
    low, high = both.min(axis=0), both.max(axis=0)
    points = low + sobol(_OVERLAY_POINTS, both.shape[1], seed) * (high - low)
    inside, later = before.contains(points), after.contains(points - shift)
    box = float(np.prod(high - low))
    shares = [float(np.mean(part)) for part in (later & ~inside, inside & ~later, inside & later)]
    either = inside | later
    return Overlay(
        gained=shares[0] * box,
        lost=shares[1] * box,
        kept=shares[2] * box,
        sd=box * float(np.sqrt(max(share * (1 - share) for share in shares) / _OVERLAY_POINTS)),
        points=points[either],
        before=inside[either],
        after=later[either],
    )
