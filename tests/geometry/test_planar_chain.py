"""The planar chain agrees with the chain in SE(3), and its Jacobian with its derivative."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import laws, seeds
from hypothesis import given
from hypothesis import strategies as st

from mocap_id.geometry import planar, se3, spatial_jacobian


def random_case(seed: int, joints: int, markers: int = 6):
    rng = np.random.default_rng(seed)
    segment = rng.integers(0, joints + 1, markers)
    return rng.normal(size=joints), rng.normal(size=(joints, 2)), segment, rng.normal(size=(markers, 2))


@laws
@given(seeds, st.integers(1, 6))
def test_planar_and_spatial_chains_place_markers_alike(seed, joints):
    q, centres, segment, local = random_case(seed, joints)
    poses = planar.spatial_chain(centres).poses(q)
    expected = se3.act(poses[segment], np.column_stack([local, np.zeros(len(local))]))
    np.testing.assert_allclose(planar.marker_positions(q, centres, segment, local), expected[:, :2], atol=1e-13)
    angle, origin = planar.segment_poses(q, centres)
    np.testing.assert_allclose(origin, poses[:, :2, 3], atol=1e-13)
    np.testing.assert_allclose(planar.rotate(angle, np.array([1.0, 0.0])), poses[:, :2, 0], atol=1e-13)


@laws
@given(seeds, st.integers(1, 6))
def test_marker_jacobian_is_the_derivative(seed, joints):
    q, centres, segment, local = random_case(seed, joints)
    step = 1e-6
    change = [
        (
            planar.marker_positions(q + e, centres, segment, local)
            - planar.marker_positions(q - e, centres, segment, local)
        )
        / (2 * step)
        for e in step * np.eye(joints)
    ]
    found = planar.marker_jacobian(q, centres, segment, local)
    np.testing.assert_allclose(found, np.stack(change, axis=-1), atol=1e-8)


@laws
@given(seeds, st.integers(1, 6))
def test_marker_jacobian_agrees_with_the_spatial_jacobian(seed, joints):
    """The velocity of a point of the last link is v + ω × p of the spatial twist (eq. 2.47)."""
    q, centres, _, local = random_case(seed, joints)
    segment = np.full(len(local), joints)
    twist = spatial_jacobian(planar.spatial_chain(centres), q)  # (6, n)
    position = planar.marker_positions(q, centres, segment, local)
    x = twist[0] - twist[5] * position[:, 1:]
    y = twist[1] + twist[5] * position[:, :1]
    found = planar.marker_jacobian(q, centres, segment, local)
    np.testing.assert_allclose(found, np.stack([x, y], axis=1), atol=1e-12)


def test_base_markers_never_move():
    q, centres, _, local = random_case(0, 3)
    segment = np.zeros(len(local), dtype=np.int64)
    np.testing.assert_array_equal(planar.marker_positions(q, centres, segment, local), local)
    assert not planar.marker_jacobian(q, centres, segment, local).any()


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_leading_axes(shape):
    _, centres, segment, local = random_case(1, 3)
    q = np.random.default_rng(2).normal(size=(*shape, 3))
    angle, origin = planar.segment_poses(q, centres)
    positions = planar.marker_positions(q, centres, segment, local)
    jacobian = planar.marker_jacobian(q, centres, segment, local)
    assert (angle.shape, origin.shape) == ((*shape, 4), (*shape, 4, 2))
    assert (positions.shape, jacobian.shape) == ((*shape, 6, 2), (*shape, 6, 2, 3))
    for index in np.ndindex(shape):
        np.testing.assert_allclose(positions[index], planar.marker_positions(q[index], centres, segment, local))
        np.testing.assert_allclose(jacobian[index], planar.marker_jacobian(q[index], centres, segment, local))
