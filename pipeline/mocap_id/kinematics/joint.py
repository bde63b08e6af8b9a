"""Joint between two rigid bodies: the pair of body-fixed points that stay closest together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.rigid_body import RigidBody, fit_body

_RIDGE = 1e-13  # larger than rounding errors; without rotation, the smallest solution is returned
_NORMAL_MEDIAN = 0.6745  # median modulus of a standard normal variable
_ASIDE = 0.03  # m; markers closer to the mid-plane are on neither side
_THIRD_DIFFERENCE = 20.0  # variance of a third difference of white noise of variance 1


@dataclass(frozen=True)
class PairJoint:
    """Hinge between a parent and a child body."""

    in_parent: complex  # centre of the joint in the parent's frame, m
    in_child: complex  # centre of the joint in the child's frame, m
    residual: float  # rms distance between the two points over the frames, m
    arc: float  # 2.5 to 97.5 % range of the relative angle, rad


def fit_joint(parent: RigidBody, child: RigidBody) -> PairJoint:
    """Fit the centre of rotation of two bodies by linear least squares, corrected for the bias from angle noise.

    With the bodies' rotations r and s (unit complex numbers) and the vector g between their origins, the coincident
    points p of the parent and q of the child satisfy r p - s q = g (the two-sided form of 3.13). Least squares over the
    frames gives

        [ 1    -C ] [p]   [ f]        C = mean(r* s),
        [-C*    1 ] [q] = [-h],       f = mean(r* g),  h = mean(s* g).

    Angle noise of variance v multiplies the mean of a rotation by 1 - v/2. C, f and h then belong to the points (1 -
    v_r/2) p and (1 - v_s/2) q, but r* r on the diagonal stays 1 instead of (1 - v_r/2)^2. This error moves the centre
    towards the markers. Therefore v_r and v_s are subtracted from the diagonal (:func:`_angle_noise`). The noise of a
    body's origin, its centroid, is independent of the noise of its angle.

    At most half of the variance of the relative angle is subtracted, and nothing if noise could explain all of it. The
    centre is then poorly determined and stays near the noisier body's centroid; ``arc`` is then small.
    """
    both = np.isfinite(parent.rotation) & np.isfinite(child.rotation)
    frames = int(both.sum())
    if frames < 3:
        return PairJoint(0j, 0j, np.inf, 0.0)
    r, s = parent.rotation[both], child.rotation[both]
    gap = child.position[both] - parent.position[both]
    relative = np.conj(r) * s
    angle = np.unwrap(np.angle(relative))
    c, f, h = complex(relative.mean()), complex(np.vdot(r, gap)) / frames, complex(np.vdot(s, gap)) / frames
    noise = _angle_noise(angle, 1 - abs(c) ** 2, (parent, r), (child, s))
    first, second = 1 - noise + _RIDGE
    determinant = first * second - abs(c) ** 2
    p, q = (second * f - c * h) / determinant, (np.conj(c) * f - first * h) / determinant
    off = r * p - s * q - gap
    return PairJoint(complex(p), complex(q), float(np.sqrt(np.vdot(off, off).real / frames)), _measure_range(angle))


def _angle_noise(angle: FloatArray, variance: float, *bodies: tuple[RigidBody, ComplexArray]) -> FloatArray:
    """Return the variances (2,) to subtract for the two bodies' rotations, rad^2.

    The residual of a body and the variance of its rotation are both upper limits of its angle noise (the base has
    none). Skin that slides with the angle also leaves a residual, but no angle noise. The sum of the two variances is
    therefore limited to the white part of the relative ``angle`` (F,): the variance of its third differences, to which
    the movement contributes little, divided by 20. The median of the differences ignores frames with fast movement.
    """
    stated = np.array([min(body.angle_noise**2, max(1 - abs(u.mean()) ** 2, 0)) for body, u in bodies])
    total = float(stated.sum())
    if total == 0 or variance <= 0 or len(angle) < 4:
        return np.zeros(2)
    third = np.sort(np.abs(angle[3:] - angle[:-3] + 3 * (angle[1:-2] - angle[2:-1])))
    white = min(total, (third[len(third) // 2] / _NORMAL_MEDIAN) ** 2 / _THIRD_DIFFERENCE)
    believed = np.clip(variance / white - 1, 0, 1) if white > 0 else 0.0
    return np.asarray(stated * (believed * white / total))


def arc(rotation: ComplexArray) -> float:
    """Return the 2.5 to 97.5 % range of an unwrapped rotation (F,), rad."""
    angle = unwrap_rotation(rotation)
    return _measure_range(angle[np.isfinite(angle)])


def _measure_range(angle: FloatArray) -> float:
    """Return the 2.5 to 97.5 % range of angles (F,), rad; ``np.quantile`` takes twenty times as long."""
    last = len(angle) - 1
    low, high = np.interp([0.025 * last, 0.975 * last], np.arange(len(angle)), np.sort(angle))
    return float(high - low)


def unwrap_rotation(rotation: ComplexArray) -> FloatArray:
    """Return the unwrapped angle (F,) of a rotation, rad; NaN where it is unknown."""
    angle = np.full(len(rotation), np.nan)
    known = np.isfinite(rotation)
    angle[known] = np.unwrap(np.angle(rotation[known]))
    return angle


def measure_asymmetry(points: ComplexArray, lateral: FloatArray, segment: IntArray) -> FloatArray:
    """Return the standard deviation (n,) of the angle between left and right side of segments 1 … n, rad.

    A sagittal segment represents both sides, which assumes that this angle is nearly constant. The result is NaN with
    fewer than two markers on a side. ``points`` (F, M) are trajectories in the plane, m, ``lateral`` (M,) mean
    out-of-plane coordinates, m, and ``segment`` (M,) is 0 on the base and -1 on no segment.
    """
    middle = np.nanmean(lateral[segment > 0])
    return np.array(
        [_compare_sides(points, lateral - middle, np.flatnonzero(segment == k)) for k in range(1, segment.max() + 1)]
    )


def _compare_sides(points: ComplexArray, lateral: FloatArray, members: IntArray) -> float:
    """Return the standard deviation of the angle between the left and the right markers of a segment, rad."""
    sides = members[lateral[members] < -_ASIDE], members[lateral[members] > _ASIDE]
    if min(len(side) for side in sides) < 2:
        return np.nan
    left, right = (fit_body(points, side) for side in sides)
    difference = unwrap_rotation(left.rotation * np.conj(right.rotation))
    known = difference[np.isfinite(difference)]
    return float(np.std(known)) if len(known) else np.nan
