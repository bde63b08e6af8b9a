"""Wrenches of the surroundings, other than the ground's, on single segments: a chair, a rail in the hand (eq. 4.23).

With Y φ the wrench that the whole body's motion needs, W_0 the ground's and W_k those on the segments s_k, each of the
surroundings on the body and about the origin,

    Y φ = W_0 + Σ_k W_k,        τ_j = J_jᵀ (Y φ)_{segments ≥ j} - Σ_{k: s_k ≥ j} J_jᵀ W_k,

with J_j the unit twist of joint j. So an external wrench stands where a segment's share of the regressor stands, with
a minus: whatever is done with the one is done with the other, in space (6 rows) as in the plane (3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.regressor import through_joints

SEAT = "seat"
"""Name of the chair's wrench, from a force plate of its own."""


@dataclass(frozen=True)
class External:
    """One external wrench, measured.

    Parameters
    ----------
    name : str
        What exerts it.
    segment : int
        The segment that it acts on, 0 = base.
    wrench : (T, 3) array
        (Fx, Fy, tauz) of the surroundings on the body about the plane-frame origin, N and N·m; NaN where unknown.
    by_plates : bool
        Its samples are stamped by the clock of the ground's plates; else by the cameras'.
    """

    name: str
    segment: int
    wrench: FloatArray
    by_plates: bool


def relief(
    jacobian: FloatArray, joint: IntArray, wrenches: FloatArray, segment: IntArray
) -> tuple[FloatArray, FloatArray]:
    """What external wrenches take off the ground and off the joints.

    Parameters
    ----------
    jacobian, joint
        As in :func:`mocap_id.dynamics.regressor.through_joints`.
    wrenches : (..., c, K) array
        About the origin.
    segment : (K,) int array
        The segment that each acts on.

    Returns
    -------
    ground : (..., c) array
        To be taken off Y φ.
    torque : (..., N) array
        To be taken off the joint torques.
    """
    return wrenches.sum(axis=-1), through_joints(jacobian, joint, wrenches, segment).sum(axis=-1)


def stacked(external: tuple[External, ...], wrenches: list[FloatArray], samples: int) -> tuple[FloatArray, IntArray]:
    """Wrenches (T, 3, K) and segments (K,) in the form of :func:`relief`, none included."""
    segment = np.array([each.segment for each in external], dtype=np.int64)
    return np.stack(wrenches, axis=-1) if wrenches else np.zeros((samples, 3, 0)), segment
