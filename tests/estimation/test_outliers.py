"""Jumping markers are left out, and markers left out by mistake are used again."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_chains import Moving, kicked, rms, swinging

from mocap_id.estimation.filter_problem import MarkerChain
from mocap_id.estimation.noise import find_frame_angles

BURSTS = 60


@pytest.fixture(scope="module")
def moving() -> Moving:
    return swinging(joints=3, per_segment=6, seconds=20.0, rate=200.0, seed=4)


def with_bursts(moving: Moving, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return 60 bursts of 20 to 80 mm and 5 to 100 frames on single markers, and their places."""
    rng = np.random.default_rng(seed)
    markers, hit = moving.markers.copy(), np.zeros(moving.markers.shape[:2], dtype=bool)
    for _ in range(BURSTS):
        start, length = rng.integers(0, len(markers) - 100), rng.integers(5, 100)
        marker, angle = rng.integers(0, markers.shape[1]), rng.uniform(-np.pi, np.pi)
        stretch = slice(start, start + length)
        markers[stretch, marker] += rng.uniform(0.02, 0.08) * np.array([np.cos(angle), np.sin(angle)])
        hit[stretch, marker] = True
    return markers, hit


def test_bursts_cost_almost_nothing(moving: Moving) -> None:
    markers, hit = with_bursts(moving, 1)
    clean, states = moving.smoothed(), moving.smoothed_from(markers)
    ratio = rms((states.mean - moving.truth)[20:-20]) / rms((clean.mean - moving.truth)[20:-20])
    assert np.all(ratio[:, 2] < 1.1)
    assert np.mean(states.used[hit]) < 0.01
    assert np.mean(~states.used[~hit]) < 0.001
    assert states.marker_sd == pytest.approx(clean.marker_sd, rel=0.1)


def test_without_the_gate_bursts_distort_the_states(moving: Moving) -> None:
    markers, _ = with_bursts(moving, 1)
    open_gate = moving.smoothed_from(markers, gate=1e9)
    clean = moving.smoothed()
    assert np.all(rms(open_gate.mean - moving.truth)[:, 2] > 5 * rms(clean.mean - moving.truth)[:, 2])


def test_the_filter_is_not_locked_out_by_its_own_gate(moving: Moving) -> None:
    """All markers jump together and come back, as if the chain were wrong for a while."""
    markers = moving.markers.copy()
    markers[1000:1400] += 0.3
    states = moving.smoothed_from(markers)
    np.testing.assert_allclose(states.mean[1500:, :, 0], moving.truth[1500:, :, 0], atol=0.01)
    assert states.used[1500:].mean() > 0.99


def test_outliers_are_found_although_they_distort_the_fit_of_others(moving: Moving) -> None:
    markers = moving.markers.copy()
    markers[500, [0, 7, 13]] += [[0.08, 0.0], [0.0, 0.06], [-0.05, 0.05]]
    frames = find_frame_angles(markers, MarkerChain(moving.centres, moving.segment, moving.local), 5.0, 5e-5)
    assert np.flatnonzero(~frames.used[500]).tolist() == [0, 7, 13]
    np.testing.assert_allclose(frames.angles[500], moving.truth[500, :, 0], atol=5e-3)


def test_a_marker_with_bursts_in_a_third_of_the_trial_is_an_outlier(moving: Moving) -> None:
    """Its own residuals alone would set a limit above the bursts."""
    markers, hit = moving.markers.copy(), np.zeros(len(moving.markers), dtype=bool)
    for start in range(100, len(markers) - 200, 300):
        hit[start : start + 100] = True
    markers[hit, 3] += [0.03, -0.04]
    states, clean = moving.smoothed_from(markers), moving.smoothed()
    assert hit.mean() > 0.3
    assert states.used[hit, 3].mean() < 0.01
    assert states.used[~hit, 3].mean() > 0.99
    assert np.all(rms(states.mean - moving.truth)[:, 2] < 1.1 * rms(clean.mean - moving.truth)[:, 2])


@pytest.mark.parametrize("rate", [100.0, 300.0])
def test_a_movement_that_outruns_the_process_noise_is_followed(rate: float) -> None:
    """No marker is wrong, so none may be lost, although the gate around the prediction is too tight."""
    fast = kicked(rate=rate)
    states = fast.smoothed()
    assert states.used.mean() > 0.99
    assert states.observed.all()
    np.testing.assert_allclose(states.mean[..., 0], fast.truth[..., 0], atol=0.05)
