"""The process model of eq. 3.17 and its noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.linalg import expm

from mocap_id.estimation.filter_problem import joint_noise, joint_transition, noise_shape, transition

steps = st.floats(1e-3, 0.5)


@given(steps)
def test_transition_is_the_exponential_of_the_integrator_chain(dt: float) -> None:
    np.testing.assert_allclose(transition(dt), expm(np.eye(4, k=1) * dt), rtol=1e-13)


@given(steps, steps)
def test_two_steps_make_one(first: float, second: float) -> None:
    f = transition(second)
    np.testing.assert_allclose(transition(first + second), f @ transition(first), rtol=1e-12)
    both = f @ noise_shape(first) @ f.T + noise_shape(second)
    np.testing.assert_allclose(noise_shape(first + second), both, rtol=1e-10)


def test_noise_is_white_snap_integrated_over_the_step() -> None:
    dt = 0.2
    for i in range(4):
        for j in range(4):
            integral = quad(lambda s, i=i, j=j: transition(dt - s)[i, 3] * transition(dt - s)[j, 3], 0.0, dt)[0]
            assert noise_shape(dt)[i, j] == pytest.approx(integral, rel=1e-9)


def test_the_thesis_snap_held_over_a_frame_gives_the_jerk_the_same_variance() -> None:
    dt, sigma_v = 1 / 480, 1e2
    assert sigma_v**2 * dt * noise_shape(dt)[3, 3] == pytest.approx((sigma_v * dt) ** 2)


def test_joints_do_not_mix() -> None:
    f, q = joint_transition(0.1, 2), joint_noise(0.1, np.array([1.0, 4.0]))
    np.testing.assert_array_equal(f[::2, ::2], transition(0.1))
    np.testing.assert_allclose(q[1::2, 1::2], 4.0 * noise_shape(0.1))
    assert not f[::2, 1::2].any()
    assert not q[::2, 1::2].any()
