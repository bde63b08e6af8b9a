"""The joint between two rigid bodies: the pair of body-fixed points that stay closest together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray
from mocap_id.kinematics.rigid import Body


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
    """Linear least-squares centre of rotation of two bodies (the two-sided form of 3.13).

    A joint with both bodies' markers uses how the bodies turn, which a circle through single markers does not; it
    needs no angle and no iteration. Where the bodies hardly turn against each other the centre is ill-determined:
    the smallest solution is taken, and ``arc`` says so.
    """
    both = np.isfinite(parent.rotation) & np.isfinite(child.rotation)
    if both.sum() < 3:
        return PairJoint(0j, 0j, np.inf, 0.0)
    r, s = parent.rotation[both], child.rotation[both]
    gap = child.position[both] - parent.position[both]
    design = np.block(
        [
            [r.real[:, None], -r.imag[:, None], -s.real[:, None], s.imag[:, None]],
            [r.imag[:, None], r.real[:, None], -s.imag[:, None], -s.real[:, None]],
        ]
    )
    target = np.concatenate([gap.real, gap.imag])
    solution, *_ = np.linalg.lstsq(design, target, rcond=1e-8)
    off = design @ solution - target
    residual = float(np.sqrt(np.sum(off**2) / both.sum()))
    return PairJoint(complex(*solution[:2]), complex(*solution[2:]), residual, arc(s * np.conj(r)))


def arc(rotation: ComplexArray) -> float:
    """Angle (rad) between the 2.5 and 97.5 % quantiles of a rotation (F,) followed continuously over the frames."""
    angle = continuous_angle(rotation)
    low, high = np.quantile(angle[np.isfinite(angle)], [0.025, 0.975])
    return float(high - low)


def continuous_angle(rotation: ComplexArray) -> FloatArray:
    """(F,) angle of a rotation without jumps, rad; NaN where it is unknown."""
    angle = np.full(len(rotation), np.nan)
    known = np.isfinite(rotation)
    angle[known] = np.unwrap(np.angle(rotation[known]))
    return angle
