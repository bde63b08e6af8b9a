"""Noise estimation by maximum likelihood recovers the simulated noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_chains import Moving, measured, rms, swinging

from mocap_id.estimation import filter_problem
from mocap_id.estimation.filter_problem import noise_shape, transition
from mocap_id.estimation.noise import SIGMA_V_BOUNDS


def random_walk(sigma_v: tuple[float, ...], marker_sd: float, seconds: float, rate: float = 100.0) -> Moving:
    """Return a chain driven by white snap; a weak spring, not in the model, keeps it in place."""
    rng = np.random.default_rng(5)
    dt = 1.0 / rate
    f, q = transition(dt), noise_shape(dt) * dt
    root = np.linalg.cholesky(q)
    pull = -dt * np.array([1.0, 4.0, 6.0, 4.0])  # poles at 1 rad/s, far below the filter's
    truth = np.zeros((int(seconds * rate), len(sigma_v), 4))
    for j, sigma in enumerate(sigma_v):
        x = np.zeros(4)
        for k in range(len(truth)):
            x = f @ x + sigma * root @ rng.standard_normal(4)
            x[3] += pull @ x
            truth[k, j] = x
    return measured(truth, rate, marker_sd, rng, per_segment=3)


def test_marker_and_process_noise_are_recovered() -> None:
    sigma_v, marker_sd = (1500.0, 4000.0), 1e-4
    noise = random_walk(sigma_v, marker_sd, seconds=120.0, rate=200.0).smoothed()
    assert noise.marker_sd == pytest.approx(marker_sd, rel=0.01)
    np.testing.assert_allclose(noise.sigma_v, sigma_v, rtol=0.06)


def test_the_search_on_single_angles_agrees_with_the_whole_filter() -> None:
    moving = random_walk((1500.0, 4000.0), 5e-4, seconds=20.0)
    found = moving.smoothed()
    problem = moving.problem(marker_sd=found.marker_sd, sigma_v=1.0)

    def likelihood(factor: float) -> float:
        density = (factor * found.sigma_v) ** 2 * problem.dt
        return filter_problem.filter_forwards(replace(problem, density=density)).log_likelihood

    assert likelihood(1.0) > max(likelihood(0.8), likelihood(1.25))


def test_intervals_cover_the_truth_with_white_noise() -> None:
    moving = random_walk((1500.0, 4000.0), 5e-4, seconds=40.0)
    states = moving.smoothed()
    inside = np.abs(states.mean - moving.truth) <= 1.96 * states.sd
    np.testing.assert_allclose(inside.mean(axis=0), 0.95, atol=0.03)


def test_the_spectral_density_is_independent_of_the_rate() -> None:
    """With every second frame, sigma_v grows by the root of two and the density stays."""
    moving = random_walk((2000.0,), 5e-4, seconds=80.0)
    halved = replace(moving, truth=moving.truth[::2], markers=moving.markers[::2], rate=moving.rate / 2)
    full, half = moving.smoothed().sigma_v[0], halved.smoothed().sigma_v[0]
    assert half**2 / halved.rate == pytest.approx(full**2 / moving.rate, rel=0.15)


def test_recordings_without_noise_get_the_floor_and_stay_smooth() -> None:
    moving = swinging(joints=3, rate=200.0, noise=0.0)
    states = moving.smoothed()
    error = rms((states.mean - moving.truth)[20:-20])
    assert states.marker_sd == 5e-5
    assert np.degrees(error[:, 0]).max() < 0.002
    assert error[:, 2].max() < 0.05


def test_given_noise_is_used_unchanged() -> None:
    noise = swinging(joints=2, seconds=1.0).smoothed(marker_sd=1e-3, sigma_v=1e2)
    assert noise.marker_sd == 1e-3
    np.testing.assert_array_equal(noise.sigma_v, [1e2, 1e2])


def test_a_chain_that_stands_still_is_estimated_too() -> None:
    moving = swinging(joints=2, seconds=2.0, noise=0.0)
    states = moving.smoothed_from(np.repeat(moving.markers[:1], 200, axis=0))
    assert np.all(states.sigma_v <= 1.1 * SIGMA_V_BOUNDS[0])
    np.testing.assert_allclose(states.mean[..., 0], np.broadcast_to(moving.truth[0, :, 0], (200, 2)), atol=1e-5)
    np.testing.assert_allclose(states.mean[..., 1], 0.0, atol=1e-4)


@pytest.mark.parametrize("rate", [20.0, 25.0])
def test_slow_cameras_do_not_drive_the_process_noise_to_its_bound(rate: float) -> None:
    moving = swinging(seconds=30.0, rate=rate)
    states = moving.smoothed()
    assert (states.sigma_v < 1e-2 * SIGMA_V_BOUNDS[1]).all()
    off = states.mean[..., 2] - moving.truth[..., 2]
    assert (1 - np.mean(off**2, axis=0) / np.var(moving.truth[..., 2], axis=0) > 0.9).all()
