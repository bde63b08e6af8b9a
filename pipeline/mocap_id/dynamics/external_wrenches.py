"""Wrenches on single segments that are not from the ground, but from a chair or a handrail, for example (eq. 4.23).

Let Y φ be the wrench that the motion of the whole body requires, W_0 the wrench of the ground and W_k the wrenches on
the segments s_k. Each is exerted by the surroundings on the body and taken about the origin. Then

    Y φ = W_0 + Σ_k W_k,        τ_j = J_jᵀ (Y φ)_{segments ≥ j} - Σ_{k: s_k ≥ j} J_jᵀ W_k,

where J_j is the unit twist of joint j. An external wrench therefore enters like a segment's part of Y φ, with a minus
sign. The equations are valid in space (6 rows) and in the plane (3 rows).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.regressor import project_on_joints

SEAT = "seat"
"""Name of the chair's wrench, if a separate force plate measures it."""


@dataclass(frozen=True)
class ExternalWrench:
    """A measured wrench of the surroundings on one segment, other than the ground's wrench."""

    name: str  # name of the object that exerts the wrench
    segment: int  # segment on which it acts; 0 is the base
    # (T, 3) (Fx, Fy, tauz) of the surroundings on the body about the origin of the plane frame, N and N·m; NaN where
    # missing
    wrench: FloatArray
    # whether the samples follow the clock of the ground's plates; otherwise they follow the clock of the cameras
    by_plates: bool


def sum_external(
    jacobian: FloatArray, joint: IntArray, wrenches: FloatArray, segment: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return how much external wrenches reduce the ground's wrench (..., c) and the joint torques (..., N).

    ``wrenches`` (..., c, K) are about the origin and act on ``segment`` (K,). ``jacobian`` and ``joint`` are as for
    :func:`mocap_id.dynamics.regressor.project_on_joints`.
    """
    return wrenches.sum(axis=-1), project_on_joints(jacobian, joint, wrenches, segment).sum(axis=-1)


def stack_wrenches(
    external: tuple[ExternalWrench, ...], wrenches: list[FloatArray], samples: int
) -> tuple[FloatArray, IntArray]:
    """Return wrenches (T, 3, K) and segments (K,) as arguments of :func:`sum_external`; K may be 0."""
    segment = np.array([each.segment for each in external], dtype=np.int64)
    return np.stack(wrenches, axis=-1) if wrenches else np.zeros((samples, 3, 0)), segment
