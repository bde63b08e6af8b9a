"""Laws of SO(3)."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import angles, directions, laws, rotation_vectors, vectors
from hypothesis import given
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from mocap_id.geometry import so3


@laws
@given(vectors(3), vectors(3))
def test_hat_is_the_cross_product(u, v):
    np.testing.assert_allclose(so3.hat(u) @ v, np.cross(u, v), atol=1e-14)
    np.testing.assert_array_equal(so3.vee(so3.hat(u)), u)


@laws
@given(rotation_vectors())
def test_exp_is_the_matrix_exponential_and_a_rotation(omega):
    rotation = so3.exp(omega)
    np.testing.assert_allclose(rotation, expm(so3.hat(omega)), atol=1e-14)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1)


@laws
@given(rotation_vectors())
def test_log_is_the_inverse_of_exp(omega):
    np.testing.assert_allclose(so3.log(so3.exp(omega)), omega, rtol=1e-12, atol=1e-14)


@laws
@given(directions())
def test_log_at_half_a_turn_gives_the_axis_up_to_its_sign(axis):
    found = so3.log(so3.exp(np.pi * axis))
    assert np.linalg.norm(found) == pytest.approx(np.pi, abs=1e-12)
    assert abs(found @ axis) == pytest.approx(np.pi, abs=1e-12)


@laws
@given(rotation_vectors())
def test_log_agrees_with_scipy(omega):
    expected = Rotation.from_rotvec(omega)
    np.testing.assert_allclose(so3.exp(omega), expected.as_matrix(), atol=1e-14)


@laws
@given(rotation_vectors(), rotation_vectors())
def test_a_rotated_axis_has_the_conjugated_hat(omega, other):
    """Eq. 2.15 as corrected: R hat(ω) Rᵀ = hat(R ω)."""
    rotation = so3.exp(other)
    np.testing.assert_allclose(rotation @ so3.hat(omega) @ rotation.T, so3.hat(rotation @ omega), atol=1e-14)


@laws
@given(directions(), angles, angles)
def test_rotations_about_one_axis_add(axis, first, second):
    np.testing.assert_allclose(
        so3.exp(axis * first) @ so3.exp(axis * second), so3.exp(axis * (first + second)), atol=1e-14
    )


@pytest.mark.parametrize("shape", [(), (4,), (2, 3), (0,)])
def test_leading_axes(shape):
    omega = np.random.default_rng(0).normal(size=(*shape, 3))
    rotation = so3.exp(omega)
    assert rotation.shape == (*shape, 3, 3)
    assert so3.log(rotation).shape == (*shape, 3)
    for index in np.ndindex(shape):
        np.testing.assert_array_equal(rotation[index], so3.exp(omega[index]))
