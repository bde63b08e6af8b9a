"""Positions of hip and ankle, corrected with measured poses of the bodies beside the joint.

A measured body has the origin p and the angle a. If a joint is at h in body 1 and at c in body 2, then

    p_1 + e^{i a_1} h = p_2 + e^{i a_2} c.

This equation is solved by least squares, with a normal prior.

Hip: if a body consists of trunk and pelvis, its markers rotate mostly with the trunk. If the pelvis rotates relative to
the trunk in proportion to the hip angle, a joint fit finds a centre between hip and lumbar spine, with small residuals.
However, a marker at the front of the pelvis then moves along the trunk by s, and the hip moves across the trunk by v s.
The position c becomes c + v s. The lumbar joint is about as far above the hip as it is behind the front of the pelvis,
so v is near one. The imaginary part of v, a motion along the trunk, is near zero. The movement determines v in part,
and the prior the rest.

Ankle: a joint fit assumes a fixed base, so motion of the foot changes the fitted position of the ankle. The prior is
the position from the joint fit, so that an ankle that hardly rotates stays there. If a heel rises by h, the foot
rotates by h divided by its length, and the ankle moves with it. Skin and shoe slide without this: the ankle stays where
the joint fit placed it if a foot at rest explains the shank's motion as well, and it is never moved farther than the
rotation of the foot allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray

_RATIO, _RATIO_SD = 0.8, 0.4  # v: height of the lumbar joint above the hip, over its distance behind the marker
_INDEPENDENT = 3.0  # independent observations in one trial, because gaps recur with the movement
_RANGE = 0.5  # rad; least range of the hip. A motion of 10 mm in proportion to it then shifts the hip by about 15 mm
_FEWEST = 10  # frames
_LEAST_GAP = 1e-5  # m; least gap, so that an ankle without rotation stays in place in recordings without noise
_EXPLAINED = 0.5  # largest part of the ankle's motion that a foot leaves that really lifts; 0.06 to 0.1 in simulations
_FOOT_M = 0.25  # length of a foot: if the heel rises by h, the foot rotates by h / length
_ANKLE_SD = 0.01  # m; standard deviation of the ankle from a joint fit if the foot moves

REMAINING = 0.4
"""Fraction of the hip's error from a bending trunk that remains after the correction, as a standard deviation."""

BENDS_M = 0.0025
"""Least displacement of the hip by a trunk that bends, m; skin on a rigid trunk causes up to 1 mm."""


@dataclass(frozen=True)
class HipShift:
    """Displacement of the hip by a trunk that bends; zero if it is unknown."""

    place: complex = 0j  # change of the hip's position in the thigh's frame, m
    slide: float = 0.0  # range of the pelvis markers' motion along the trunk, m
    across: FloatArray | None = None  # (F,) motion of the hip across the thigh relative to a rigid trunk, m; has NaN


@dataclass(frozen=True)
class AnklePosition:
    """Position of the ankle."""

    foot: complex  # position in the foot's frame, m
    shank: complex  # position in the shank's frame, m
    sd: float  # standard deviation in one direction, m


def estimate_hip_shift(
    thigh: tuple[ComplexArray, FloatArray], trunk: tuple[ComplexArray, FloatArray], marker: ComplexArray
) -> HipShift:
    """Return the displacement of the hip by a bending trunk; zero if unknown.

    If the hip rotates little, its shift and its motion with the trunk cannot be separated, and the result is 0. Each
    body is given by the origin (F,), m, and the angle (F,), rad, of its frame; the trunk's y axis points from the hip
    upwards. ``marker`` (F,) is a pelvis marker in the plane frame, m. All are NaN where unknown.
    """
    below, above = np.exp(1j * thigh[1]), np.exp(1j * trunk[1])
    local = np.conj(above) * (marker - trunk[0])
    known = np.isfinite(local) & np.isfinite(thigh[0]) & np.isfinite(below)
    if np.count_nonzero(known) < _FEWEST:
        return HipShift()
    if np.ptp(np.unwrap((trunk[1] - thigh[1])[known])) < _RANGE:
        return HipShift()
    below, above, local, apart = (each[known] for each in (below, above, local, trunk[0] - thigh[0]))
    forwards = np.sign(local.real.mean())
    slide = forwards * (local.imag - local.imag.mean())
    columns = np.column_stack([below, -above, -above * slide])
    normal, target = columns.conj().T @ columns / len(columns), columns.conj().T @ apart / len(columns)
    rigid = np.linalg.solve(normal[:2, :2], target[:2])
    gap = float(np.mean(np.abs(apart - columns[:, :2] @ rigid) ** 2)) / 2
    weight = gap / (_INDEPENDENT * _RATIO_SD**2)
    normal[2, 2] += weight
    target[2] += weight * _RATIO
    place, beyond, ratio = np.linalg.solve(normal, target)
    across = np.full(len(known), np.nan)
    across[known] = (np.conj(below) * above * (beyond - rigid[1] + ratio * slide)).real
    return HipShift(complex(place - rigid[0]), float(np.ptp(np.quantile(slide, (0.01, 0.99)))), across)


def locate_ankle(
    foot: tuple[ComplexArray, FloatArray], shank: tuple[ComplexArray, FloatArray], ankle: complex
) -> AnklePosition | None:
    """Return the position of the ankle between a moving foot and the shank; None with fewer than ten common frames.

    It is that of the joint fit if only the skin of the foot moves.

    Each body is given by the origin (F,), m, and the angle (F,), rad, of its frame, NaN where unknown. ``ankle`` is the
    position in the foot's frame from the joint fit, m.
    """
    below, above = np.exp(1j * foot[1]), np.exp(1j * shank[1])
    apart = shank[0] - foot[0] - below * ankle
    known = np.isfinite(apart) & np.isfinite(above)
    if np.count_nonzero(known) < _FEWEST:
        return None
    columns, apart, still = np.column_stack([below, -above])[known], apart[known], shank[0][known]
    normal, target = columns.conj().T @ columns / len(columns), columns.conj().T @ apart / len(columns)
    gap = _measure_gap(columns, apart)
    on_still_foot = _measure_gap(np.column_stack([np.ones_like(still), columns[:, 1]]), still)
    turn = float(np.ptp(np.quantile(foot[1][known], (0.02, 0.98))))
    farthest = turn * _FOOT_M if gap < _EXPLAINED * on_still_foot else 0.0
    gap = max(gap, _LEAST_GAP**2)
    normal[0, 0] += gap / (_INDEPENDENT * _ANKLE_SD**2)
    shift = complex(np.linalg.solve(normal, target)[0])
    variance = gap / _INDEPENDENT * float(np.linalg.inv(normal)[0, 0].real)
    shift *= min(1.0, farthest / max(abs(shift), _LEAST_GAP))
    beyond = (target[1] - normal[1, 0] * shift) / normal[1, 1]
    return AnklePosition(ankle + shift, complex(beyond), float(np.sqrt(variance)))


def _measure_gap(columns: ComplexArray, apart: ComplexArray) -> float:
    """Return the mean square per coordinate, m², of what ``columns`` (F, k) do not explain of a distance (F,), m."""
    return float(np.mean(np.abs(apart - columns @ np.linalg.lstsq(columns, apart)[0]) ** 2)) / 2
