"""The ball joint: its subspace and its rate against finite differences, at every angle."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import laws, seeds
from hypothesis import given

from mocap_id.geometry import Ball, so3

STEP = 1e-5
angles = pytest.mark.parametrize("angle", [0.0, 1e-7, 1e-3, 0.0499, 0.0501, 0.7, 3.0, 6.0])


def case(seed: int, angle: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    q = rng.normal(size=3)
    return angle * q / np.linalg.norm(q), rng.normal(size=3)


@angles
@laws
@given(seeds)
def test_the_angular_velocity_is_that_of_the_rotation(angle: float, seed: int) -> None:
    q, dq = case(seed, angle)
    change = (so3.exp(q + STEP * dq) - so3.exp(q - STEP * dq)) / (2 * STEP)
    expected = so3.vee(so3.exp(q).T @ change)
    np.testing.assert_allclose(Ball().subspace(q) @ dq, np.concatenate([np.zeros(3), expected]), atol=1e-8)


@angles
@laws
@given(seeds)
def test_the_rate_is_the_derivative(angle: float, seed: int) -> None:
    q, dq = case(seed, angle)
    expected = (Ball().subspace(q + STEP * dq) - Ball().subspace(q - STEP * dq)) / (2 * STEP)
    np.testing.assert_allclose(Ball().subspace_rate(q, dq), expected, atol=1e-8)
