"""Coordinate frame of the plane of motion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_id.geometry.planar import PlaneFrame

ANGLES = st.floats(-np.pi, np.pi)
VECTORS = st.tuples(*[st.floats(-10, 10)] * 3).map(np.array)


@given(ANGLES)
def test_axes_are_a_rotation_with_y_up(yaw: float) -> None:
    axes = PlaneFrame(yaw, np.zeros(3)).axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.cross(axes[0], axes[1]), axes[2], atol=1e-12)
    np.testing.assert_array_equal(axes[1], [0, 0, 1])


@given(ANGLES, VECTORS, VECTORS)
def test_there_and_back(yaw: float, origin: np.ndarray, point: np.ndarray) -> None:
    frame = PlaneFrame(yaw, origin)
    np.testing.assert_allclose(frame.from_plane(frame.to_plane(point)), point, atol=1e-9)
    np.testing.assert_allclose(frame.to_plane(origin), 0, atol=1e-12)


@given(ANGLES, VECTORS, VECTORS, VECTORS)
def test_the_wrench_of_a_force_in_the_plane(
    yaw: float, origin: np.ndarray, point: np.ndarray, force: np.ndarray
) -> None:
    """The moment of a force at a point about the plane's z is x Fy - y Fx in plane coordinates."""
    frame = PlaneFrame(yaw, origin)
    fx, fy, tauz = frame.wrench_to_plane(force, np.cross(point, force))
    local, arm = frame.axes @ force, frame.to_plane(point)
    assert (fx, fy) == (pytest.approx(local[0]), pytest.approx(local[1]))
    assert tauz == pytest.approx(arm[0] * local[1] - arm[1] * local[0], abs=1e-9)


def test_leading_axes_are_kept() -> None:
    frame = PlaneFrame(0.3, np.array([1.0, 2.0, 0.0]))
    points = np.random.default_rng(0).normal(size=(4, 5, 3))
    assert frame.to_plane(points).shape == (4, 5, 3)
    assert frame.wrench_to_plane(points, points).shape == (4, 5, 3)
    np.testing.assert_allclose(frame.to_plane(points)[2, 3], frame.to_plane(points[2, 3]))
    assert np.isnan(frame.to_plane(np.full(3, np.nan))).all()
