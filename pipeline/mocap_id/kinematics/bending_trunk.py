"""Place of the hip under a trunk that bends, from a pelvis marker that moves relative to the trunk.

If a body consists of trunk and pelvis, its markers turn mostly with the trunk. Where the pelvis turns against the trunk
in step with the hip, a joint fit finds a centre between hip and lumbar spine, with small residuals. But a marker at the
front of the pelvis then moves along the trunk by s, and the hip moves across it by v s. With the frames of thigh and
trunk (origin p, angle a), the hip h in the thigh and c in the trunk:

    p_t + e^{i a_t} h = p_b + e^{i a_b} (c + v s).

The lumbar joint is about as far above the hip as it is behind the front of the pelvis, so v is near one; its imaginary
part, a motion along the trunk, is near zero. The movement determines v in part, and a normal prior the rest. If the hip
turns little, a shift of its place and its motion in step cannot be told apart, and no shift is returned.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray

_RATIO, _RATIO_SD = 0.8, 0.4  # v: height of the lumbar joint above the hip, over its distance behind the marker
_INDEPENDENT = 3.0  # observations of v that one trial counts as: gaps recur with the movement
_RANGE = 0.5  # rad, least range of the hip: a motion of 10 mm in step then shifts the hip by about 15 mm
LEFT = 0.4
"""Share of the hip's error by a bending trunk that is left, as a standard deviation."""


def estimate_hip_shift(
    thigh: tuple[ComplexArray, FloatArray], trunk: tuple[ComplexArray, FloatArray], marker: ComplexArray
) -> complex:
    """Return the change of the hip's place in the thigh's frame that the bending trunk explains, m; 0 if unknown.

    Parameters
    ----------
    thigh, trunk : ((F,) complex array, (F,) array)
        Origin in the plane frame, m, and angle, rad, of each body's frame; NaN where unknown. The trunk's y axis points
        from the hip upwards.
    marker : (F,) complex array
        Pelvis marker in the plane frame, m; NaN where unseen.
    """
    below, above = np.exp(1j * thigh[1]), np.exp(1j * trunk[1])
    local = np.conj(above) * (marker - trunk[0])
    known = np.isfinite(local) & np.isfinite(thigh[0]) & np.isfinite(below)
    if np.count_nonzero(known) < 10:  # frames; fewer unknowns than half of the equations
        return 0j
    if np.ptp(np.unwrap((trunk[1] - thigh[1])[known])) < _RANGE:
        return 0j
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
    return complex(np.linalg.solve(normal, target)[0] - rigid[0])
