"""The twist of a segment about its long axis, and its rate."""

from __future__ import annotations

import numpy as np
from geometry_cases import laws, seeds
from hypothesis import given

from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialJoint

STEP = 1e-6


def drawn(seed: int) -> tuple[SpatialJoint, np.ndarray, np.ndarray, np.random.Generator]:
    """Return a ball, its swing by at most 140°, its rotation, and a generator."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    joint = SpatialJoint(
        "ball", 0, np.zeros(3), long_axis=axis / np.linalg.norm(axis), untwisted=so3.exp(rng.normal(size=3))
    )
    across = np.cross(joint.long_axis, rng.normal(size=3))
    swing = so3.exp(rng.uniform(0, np.radians(140)) * across / np.linalg.norm(across))
    twist = so3.exp(rng.uniform(-2.5, 2.5) * joint.long_axis)
    return joint, swing, joint.untwisted @ swing @ twist, rng


@laws
@given(seeds)
def test_the_twist_is_what_is_left_of_the_shortest_swing(seed: int) -> None:
    joint, swing, rotation, _ = drawn(seed)
    left = so3.exp(joint.twist(rotation) * joint.long_axis)
    np.testing.assert_allclose(joint.untwisted @ swing @ left, rotation, atol=1e-12)


@laws
@given(seeds)
def test_its_rate_is_the_derivative_and_not_the_velocity_about_the_axis(seed: int) -> None:
    joint, _, rotation, rng = drawn(seed)
    velocity = rng.normal(size=3)
    ahead, behind = (joint.twist(rotation @ so3.exp(step * velocity)) for step in (STEP, -STEP))
    np.testing.assert_allclose(joint.twist_axis(rotation) @ velocity, (ahead - behind) / (2 * STEP), atol=1e-7)
