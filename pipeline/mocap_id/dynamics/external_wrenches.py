"""External wrenches on single segments, other than the ground's, such as a chair or a rail in the hand (eq. 4.23).

Let Y φ be the wrench that the motion of the whole body requires, W_0 that of the ground and W_k those on the segments
s_k, each exerted by the surroundings on the body and taken about the origin. Then

    Y φ = W_0 + Σ_k W_k,        τ_j = J_jᵀ (Y φ)_{segments ≥ j} - Σ_{k: s_k ≥ j} J_jᵀ W_k,

where J_j is the unit twist of joint j. An external wrench therefore enters like a segment's share of the regressor,
with a minus sign, in space (6 rows) and in the plane (3 rows).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.regressor import through_joints

SEAT = "seat"
"""Name of the chair's wrench, measured by a force plate of its own."""


@dataclass(frozen=True)
class ExternalWrench:
    """A measured external wrench.

    Parameters
    ----------
    name : str
        What exerts the wrench.
    segment : int
        The segment that it acts on; 0 is the base.
    wrench : (T, 3) array
        (Fx, Fy, tauz) of the surroundings on the body about the plane-frame origin, N and N·m; NaN where unknown.
    by_plates : bool
        Whether the samples follow the clock of the ground's plates; otherwise they follow that of the cameras.
    """

    name: str
    segment: int
    wrench: FloatArray
    by_plates: bool


def external_effect(
    jacobian: FloatArray, joint: IntArray, wrenches: FloatArray, segment: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return by how much external wrenches reduce the ground's wrench and the joint torques.

    Parameters
    ----------
    jacobian, joint
        As in :func:`mocap_id.dynamics.regressor.through_joints`.
    wrenches : (..., c, K) array
        Wrenches about the origin.
    segment : (K,) int array
        The segment that each wrench acts on.

    Returns
    -------
    ground : (..., c) array
        Wrench to subtract from Y φ.
    torque : (..., N) array
        Torques to subtract from the joint torques.
    """
    return wrenches.sum(axis=-1), through_joints(jacobian, joint, wrenches, segment).sum(axis=-1)


def stack_wrenches(
    external: tuple[ExternalWrench, ...], wrenches: list[FloatArray], samples: int
) -> tuple[FloatArray, IntArray]:
    """Return wrenches (T, 3, K) and segments (K,) as arguments of :func:`external_effect`; K may be 0."""
    segment = np.array([each.segment for each in external], dtype=np.int64)
    return np.stack(wrenches, axis=-1) if wrenches else np.zeros((samples, 3, 0)), segment
