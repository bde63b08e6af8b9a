"""Laws of SE(3): exponentials, adjoints, twists and wrenches."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import laws, poses, twists, vectors
from hypothesis import given
from scipy.linalg import expm

from mocap_id.geometry import se3


@laws
@given(twists())
def test_exp_is_the_matrix_exponential(twist):
    np.testing.assert_allclose(se3.exp_twist(twist), expm(se3.hat_twist(twist)), atol=1e-13)
    np.testing.assert_array_equal(se3.vee_twist(se3.hat_twist(twist)), twist)


@laws
@given(twists())
def test_the_inverse_has_the_negative_twist(twist):
    g = se3.exp_twist(twist)
    np.testing.assert_allclose(se3.inverse(g), se3.exp_twist(-twist), atol=1e-13)
    np.testing.assert_allclose(se3.inverse(g) @ g, np.eye(4), atol=1e-13)


@laws
@given(poses(), poses(), vectors(3))
def test_points_move_as_the_group_does(g, h, point):
    np.testing.assert_allclose(se3.act(g @ h, point), se3.act(g, se3.act(h, point)), atol=1e-12)


@laws
@given(poses(), poses())
def test_the_adjoint_is_a_homomorphism(g, h):
    np.testing.assert_allclose(se3.Ad(g @ h), se3.Ad(g) @ se3.Ad(h), atol=1e-12)
    np.testing.assert_allclose(se3.Ad(se3.inverse(g)), np.linalg.inv(se3.Ad(g)), atol=1e-12)


@laws
@given(poses(), twists())
def test_the_adjoint_is_conjugation(g, twist):
    """Eq. 2.32, 2.33."""
    conjugated = g @ se3.hat_twist(twist) @ se3.inverse(g)
    np.testing.assert_allclose(se3.hat_twist(se3.Ad(g) @ twist), conjugated, atol=1e-11)
    np.testing.assert_allclose(se3.exp_twist(se3.Ad(g) @ twist), g @ se3.exp_twist(twist) @ se3.inverse(g), atol=1e-11)


@laws
@given(twists(), twists())
def test_the_small_adjoint_is_the_bracket(a, b):
    """Eq. 2.35 as corrected, 2.36."""
    bracket = se3.hat_twist(a) @ se3.hat_twist(b) - se3.hat_twist(b) @ se3.hat_twist(a)
    np.testing.assert_allclose(se3.hat_twist(se3.ad(a) @ b), bracket, atol=1e-12)


@laws
@given(twists())
def test_the_small_adjoint_generates_the_large_one(twist):
    np.testing.assert_allclose(se3.Ad(se3.exp_twist(twist)), expm(se3.ad(twist)), atol=1e-11)


@laws
@given(poses(), twists(), vectors(6))
def test_power_is_the_same_in_both_frames(g, twist, wrench):
    """Ad_gᵀ moves wrenches so that their power on a twist does not change (eq. 2.54 in the form of 2.57)."""
    power = se3.move_wrench(g, wrench) @ se3.Ad(g) @ twist
    assert power == pytest.approx(wrench @ twist, abs=1e-10)


def test_a_force_moved_to_another_origin_gains_its_moment():
    g = se3.pose(np.eye(3), np.array([0.0, 2.0, 0.0]))
    np.testing.assert_allclose(se3.move_wrench(g, np.array([3.0, 0, 0, 0, 0, 0])), [3, 0, 0, 0, 0, -6])


@pytest.mark.parametrize("shape", [(), (4,), (2, 3), (0,)])
def test_leading_axes(shape):
    rng = np.random.default_rng(0)
    twist, wrench = rng.normal(size=(2, *shape, 6))
    g = se3.exp_twist(twist)
    moved = se3.move_wrench(g, wrench)
    for index in np.ndindex(shape):
        np.testing.assert_allclose(g[index], se3.exp_twist(twist[index]), atol=1e-15)
        np.testing.assert_allclose(moved[index], se3.move_wrench(g[index], wrench[index]), atol=1e-14)
