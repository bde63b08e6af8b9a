"""Growth of the variance with missing markers, as far as their slides are forgotten."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_chains import swinging

from mocap_id.estimation import lasting_errors
from mocap_id.estimation.lasting_errors import compute_variance_growth
from mocap_id.estimation.smoothing import compute_forgotten_share
from mocap_id.geometry.planar import marker_jacobian


def test_the_growth_equals_that_of_least_squares() -> None:
    """The ratio of the variances of angles fitted to some and to all sliding markers."""
    rng = np.random.default_rng(0)
    moving = swinging(joints=3, per_segment=4, seconds=0.1, seed=6)
    jacobian = marker_jacobian(moving.truth[:1, :, 0], moving.centres, moving.segment, moving.local)
    used = np.ones((1, 12), dtype=bool)
    used[0, [1, 5, 6, 7, 11]] = False
    sd = rng.uniform(1e-3, 4e-3, 12)
    slides = rng.normal(0, 1, (20_000, 12, 2)) * sd[:, None]
    errors = []
    for kept in (np.ones(12, dtype=bool), used[0]):
        rows = jacobian[0][kept].reshape(-1, 3)
        errors.append(np.linalg.lstsq(rows, slides[:, kept].reshape(len(slides), -1).T, rcond=None)[0].var(axis=1))
    found = lasting_errors._compute_growth(
        jacobian, used, often=np.ones(12), slide=sd**2, forgotten=np.ones((1, 12)), marker_sd=1e-3
    )
    np.testing.assert_allclose(found[0], np.maximum(errors[1] / errors[0], 1.0), rtol=0.05)


def test_the_forgotten_share_is_the_conditional_variance_of_a_markov_process() -> None:
    rate, memory = 100.0, 90.0
    used = np.ones((300, 3), dtype=bool)
    used[100:160, 0], used[250:, 1], used[:, 2] = False, False, False
    found = compute_forgotten_share(used, np.arange(300), rate)
    at, ends = np.arange(100, 160), np.array([99, 160])
    between, among = (np.exp(-np.abs(a[:, None] - ends) / memory) for a in (at, ends))
    expected = 1.0 - np.einsum("ti,ij,tj->t", between, np.linalg.inv(among), between)
    np.testing.assert_allclose(found[100:160, 0], expected, atol=1e-12)
    np.testing.assert_allclose(found[250:, 1], 1.0 - np.exp(-2 * np.arange(1, 51) / memory), atol=1e-12)
    assert (found[:, 2] == 1.0).all()
    assert (found[used] == 0.0).all()


@pytest.mark.parametrize("gone", [1, 2, 3])
def test_missing_segments_increase_the_variance_of_their_neighbours_only_in_gaps(gone: int) -> None:
    moving = swinging(joints=3, per_segment=6, seconds=10.0, seed=7)
    frames = np.arange(0, 1000, 4)
    for start, stop in ((0, 0), (400, 600)):
        markers = moving.markers.copy()
        markers[start:stop, moving.segment == gone] = np.nan
        states = moving.smoothed_from(markers)
        angles = moving.truth[..., 0]
        found = compute_variance_growth(states, markers, angles, frames, rate=moving.rate, camera=2e-4)
        inside = (frames >= start) & (frames < stop)
        assert found.min() >= 1.0
        assert found[~inside].max() < 1.1
        if inside.any():
            assert found[inside].max() > 1.5
            assert found[frames == start][0].max() < 1.1
