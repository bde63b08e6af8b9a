"""The joint between two rigid bodies: the pair of body-fixed points that stay closest together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray
from mocap_id.kinematics.rigid import Body

_RIDGE = 1e-13  # beyond rounding; bodies that turn by less than a microradian get the smallest solution
_NORMAL_MEDIAN = 0.6745  # median modulus of a standard normal variable
_THIRD_DIFFERENCE = 20.0  # variance of a third difference of white noise of variance 1


@dataclass(frozen=True)
class PairJoint:
    """A revolute joint between a parent and a child body.

    Parameters
    ----------
    in_parent, in_child : complex
        The joint's centre in either body's frame, m.
    residual : float
        rms distance between the two points over the frames, m.
    arc : float
        Relative angle travelled, from its 2.5 to its 97.5 % quantile, rad.
    """

    in_parent: complex
    in_child: complex
    residual: float
    arc: float


def fit_joint(parent: Body, child: Body) -> PairJoint:
    """Linear least-squares centre of rotation of two bodies (the two-sided form of 3.13), less what noise does to it.

    With r, s the bodies' rotations (unit complex numbers) and g the gap between their origins, the points p and q of
    parent and child that meet obey r p - s q = g. Least squares over the frames is

        [ 1    -C ] [p]   [ f]        C = mean(r* s),
        [-C*    1 ] [q] = [-h],       f = mean(r* g),  h = mean(s* g).

    Angle noise of variance v shrinks the mean of a rotation by 1 - v/2, so that C, f and h are those of points
    (1 - v_r/2) p and (1 - v_s/2) q, but for the diagonal: r* r stays 1 where (1 - v_r/2)^2 was due. Left so, the centre
    is drawn towards the markers by the noise's share in the variance 1 - |C|^2 of the relative angle. Hence v_r and v_s
    come off the diagonal (:func:`_angle_noise`); a body's origin is its centroid, whose noise is not that of its angle.
    No more than half the variance is ever taken off, and nothing where noise would explain all of it: there the centre
    is ill-determined, stays where least squares has it, near the noisier body's centroid, and ``arc`` says so.
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
    return PairJoint(complex(p), complex(q), float(np.sqrt(np.vdot(off, off).real / frames)), _travelled(angle))


def _angle_noise(angle: FloatArray, variance: float, *bodies: tuple[Body, ComplexArray]) -> FloatArray:
    """(2,) variances to take out of the two bodies' rotations, rad^2.

    A body's residual bounds the noise of its angle, and so does how much it turns: the base has none. But skin that
    slips leaves a residual too, and as it slips with the angle it does not scatter it. So both together are no more
    than what is new in every frame of the relative ``angle`` (F,): the variance of its third differences, of which the
    movement itself has little, over 20. Their median leaves out where it has more.
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
    """Angle (rad) between the 2.5 and 97.5 % quantiles of a rotation (F,) followed continuously over the frames."""
    angle = continuous_angle(rotation)
    return _travelled(angle[np.isfinite(angle)])


def _travelled(angle: FloatArray) -> float:
    """Between the 2.5 and 97.5 % quantiles of the angles (F,), rad; ``np.quantile`` takes twenty times as long."""
    last = len(angle) - 1
    low, high = np.interp([0.025 * last, 0.975 * last], np.arange(len(angle)), np.sort(angle))
    return float(high - low)


def continuous_angle(rotation: ComplexArray) -> FloatArray:
    """(F,) angle of a rotation without jumps, rad; NaN where it is unknown."""
    angle = np.full(len(rotation), np.nan)
    known = np.isfinite(rotation)
    angle[known] = np.unwrap(np.angle(rotation[known]))
    return angle
