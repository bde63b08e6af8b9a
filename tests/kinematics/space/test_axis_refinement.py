"""Axes of a calibration, corrected by the motion of another trial."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint
from mocap_id.kinematics.space.chain_fit import refine_axes

TRUE = SpatialJoint(
    "two-axis",
    0,
    np.zeros(3),
    first_axis=np.array([0.0, 0.0, 1.0]),
    second_axis=np.array([0.0, 1.0, 0.0]),
    axes_covariance=np.radians(3) ** 2 * np.stack([np.diag([1.0, 1, 0]), np.diag([1.0, 0, 1])]),
    offset=so3.exp(np.array([-0.2, 0.0, 0.0])),
)


def believed(tilt: FloatArray) -> SpatialChain:
    """The joint as a calibration has it: the first axis tilted by a rotation vector."""
    turn = so3.exp(tilt)
    axis, offset = turn @ TRUE.first_axis, turn @ TRUE.offset
    spread = turn @ TRUE.axes_covariance[0] @ turn.T
    joint = SpatialJoint(
        "two-axis",
        0,
        np.zeros(3),
        first_axis=axis,
        second_axis=TRUE.second_axis,
        axes_covariance=np.stack([spread, TRUE.axes_covariance[1]]),
        offset=offset,
    )
    return SpatialChain((joint,), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, bool))


def motion(flexion: float) -> FloatArray:
    phase = np.linspace(0, 6 * np.pi, 200)
    q = np.stack([flexion * (1 - np.cos(phase)) / 2, 0.1 * np.sin(0.3 * phase)], axis=1)
    turn = TRUE.rotation(q)
    return np.stack([np.broadcast_to(np.eye(3), turn.shape), turn], axis=1)


@pytest.mark.parametrize("tilt", [(0.07, 0.0, 0.0), (-0.05, 0.05, 0.0)])
def test_a_large_motion_corrects_the_axis(tilt: tuple[float, float, float]) -> None:
    chain, refined = refine_axes(believed(np.array(tilt)), motion(1.8))
    joint = chain.joints[0]
    assert refined == (0,)
    assert np.arccos(joint.first_axis @ TRUE.first_axis) < 0.5 * np.linalg.norm(tilt)
    assert np.sqrt(np.trace(joint.axes_covariance[0])) < np.radians(3)
    assert joint.first_axis @ joint.offset @ joint.second_axis == pytest.approx(
        TRUE.first_axis @ TRUE.offset @ TRUE.second_axis, abs=0.05
    )


def test_a_small_motion_leaves_the_chain_of_the_calibration() -> None:
    start = believed(np.array([0.07, 0.0, 0.0]))
    chain, refined = refine_axes(start, motion(0.1))
    assert not refined
    assert chain.joints[0] is start.joints[0]


def test_unknown_frames_and_axes_without_covariance_change_nothing() -> None:
    start = believed(np.zeros(3))
    assert refine_axes(start, np.full((5, 2, 3, 3), np.nan))[0].joints == start.joints
    loose = SpatialChain((SpatialJoint("two-axis", 0, np.zeros(3)),), start.segment, start.local, start.on_glide)
    assert refine_axes(loose, motion(1.8))[1] == ()
