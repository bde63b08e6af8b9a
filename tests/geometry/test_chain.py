"""Forward map, product of exponentials and Jacobians of random chains in SE(3)."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import laws, random_chain, random_pose, seeds
from hypothesis import given
from hypothesis import strategies as st

from mocap_id.geometry import Chain, Revolute, body_jacobian, body_product, se3, spatial_jacobian, spatial_product


def random_case(seed: int, joints: int):
    rng = np.random.default_rng(seed)
    return random_chain(rng, joints), random_pose(rng), rng.normal(size=joints)


def derivative(function, q):
    """Return central differences (N, 4, 4) of a pose with respect to each coordinate."""
    step = 1e-6
    return np.stack([(function(q + e) - function(q - e)) / (2 * step) for e in step * np.eye(len(q))])


@laws
@given(seeds, st.integers(1, 6))
def test_spatial_body_and_link_by_link_products_agree(seed, joints):
    """Eq. 2.37, 2.40, 2.42."""
    chain, tool, q = random_case(seed, joints)
    expected = chain.tool_pose(q, tool)
    np.testing.assert_allclose(spatial_product(chain, q, tool), expected, atol=1e-12)
    np.testing.assert_allclose(body_product(chain, q, tool), expected, atol=1e-12)


@laws
@given(seeds, st.integers(1, 6))
def test_jacobians_are_the_derivative_of_the_forward_map(seed, joints):
    """Spatial velocity is ġ g⁻¹, body velocity g⁻¹ ġ (eq. 2.30, 2.31, 2.47, 2.48)."""
    chain, tool, q = random_case(seed, joints)
    g = chain.tool_pose(q, tool)
    change = derivative(lambda x: chain.tool_pose(x, tool), q)
    np.testing.assert_allclose(spatial_jacobian(chain, q).T, se3.vee_twist(change @ se3.inverse(g)), atol=1e-7)
    np.testing.assert_allclose(body_jacobian(chain, q, tool).T, se3.vee_twist(se3.inverse(g) @ change), atol=1e-7)


@laws
@given(seeds, st.integers(1, 6))
def test_jacobian_columns_are_the_primed_twists(seed, joints):
    """Column i is the home twist transformed by the previous exponentials (eq. 2.45)."""
    chain, _, q = random_case(seed, joints)
    before = np.eye(4)
    for i, (joint, home) in enumerate(zip(chain.joints, chain.home, strict=True)):
        twist = se3.Ad(home) @ joint.twists[:, 0]
        np.testing.assert_allclose(spatial_jacobian(chain, q)[:, i], se3.Ad(before) @ twist, atol=1e-11)
        before = before @ se3.exp_twist(twist * q[i])


def test_a_turn_about_a_shifted_axis():
    """A quarter turn about z at (1, 0, 0) moves the world's origin to (1, -1, 0)."""
    chain = Chain((Revolute((0, 0, 2.0)),), se3.pose(np.eye(3), np.array([[1.0, 0, 0]])))
    tool = se3.pose(np.eye(3), np.array([-1.0, 0, 0]))
    np.testing.assert_allclose(chain.tool_pose(np.array([np.pi / 2]), tool)[:3, 3], [1, -1, 0], atol=1e-15)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_leading_axes(shape):
    rng = np.random.default_rng(3)
    chain, tool = random_chain(rng, 3), random_pose(rng)
    q = rng.normal(size=(*shape, 3))
    assert chain.poses(q).shape == (*shape, 4, 4, 4)
    together = [
        spatial_product(chain, q, tool),
        body_product(chain, q, tool),
        spatial_jacobian(chain, q),
        body_jacobian(chain, q, tool),
    ]
    for index in np.ndindex(shape):
        alone = [
            spatial_product(chain, q[index], tool),
            body_product(chain, q[index], tool),
            spatial_jacobian(chain, q[index]),
            body_jacobian(chain, q[index], tool),
        ]
        for whole, part in zip(together, alone, strict=True):
            np.testing.assert_allclose(whole[index], part, atol=1e-13)


def test_placements_must_match_the_joints():
    with pytest.raises(ValueError, match=r"needs placements of shape \(1, 4, 4\), not \(2, 4, 4\)"):
        Chain((Revolute((0, 0, 1.0)),), np.zeros((2, 4, 4)))


@pytest.mark.parametrize("axis", [(0.0, 0.0, 0.0), (np.nan, 0.0, 1.0), (np.inf, 0.0, 0.0)])
def test_an_axis_without_direction_is_refused(axis):
    with pytest.raises(ValueError, match="axis of a revolute joint"):
        Revolute(axis)
