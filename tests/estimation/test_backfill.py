"""Backfill of states before a joint is found, as long as they are certain enough."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated_chains import Moving, swinging

from mocap_id.config import load
from mocap_id.estimation.filter_problem import filter_forwards, smooth_backwards
from mocap_id.estimation.smoothing import backfill
from mocap_id.runner import run_stage
from mocap_id.store import Folder, Table

UNSEEN = 12


@pytest.fixture(scope="module")
def moving() -> Moving:
    """Return three joints at 100 Hz, with the last segment unseen at first."""
    made = swinging(joints=3, seconds=3.0, seed=3)
    made.markers[:UNSEEN, made.segment == 3] = np.nan
    return made


def test_the_first_frames_are_filled_from_later_ones(moving: Moving) -> None:
    states = moving.smoothed()
    error, sd = np.abs(states.mean - moving.truth)[:UNSEEN, 2], states.sd[:UNSEEN, 2]
    assert np.isfinite(states.mean).all()
    assert np.all(error <= 5 * sd)
    assert np.all(np.diff(sd, axis=0) < 0)
    assert not states.observed[:UNSEEN, 2].any()
    assert states.observed[:, :2].all()


def test_the_backfill_has_the_distribution_of_the_reversed_process(moving: Moving) -> None:
    """Comparison with random draws of the reversed process; all other states are unchanged."""
    problem = moving.problem(marker_sd=5e-4, sigma_v=100.0)
    track = smooth_backwards(problem, filter_forwards(problem))
    mean, sd = track.by_joint()
    before = mean.copy(), sd.copy()
    filled = backfill(problem, track, mean, sd)
    assert np.array_equal(filled, np.arange(len(mean))[:, None] < np.array([0, 0, UNSEEN]))
    np.testing.assert_array_equal(mean[~filled], before[0][~filled])
    np.testing.assert_array_equal(sd[~filled], before[1][~filled])
    rng = np.random.default_rng(0)
    own = np.arange(4) * 3 + 2
    step = np.linalg.cholesky(_noise(problem.dt) * problem.density[2])
    draws = (
        mean[UNSEEN, 2]
        + rng.standard_normal((20_000, 4)) @ np.linalg.cholesky(track.covariance[UNSEEN][np.ix_(own, own)]).T
    )
    for _ in range(UNSEEN):  # x = F^-1 (x' - w), drawn
        draws = (draws - rng.standard_normal(draws.shape) @ step.T) @ np.linalg.inv(_transition(problem.dt)).T
    np.testing.assert_allclose(draws.std(axis=0), sd[0, 2], rtol=0.03)
    np.testing.assert_allclose(draws.mean(axis=0), mean[0, 2], atol=5 * sd[0, 2].max() / 100)


def _transition(dt: float) -> np.ndarray:
    return np.array(
        [[dt ** (j - i) / np.prod(range(1, j - i + 1)) if j >= i else 0.0 for j in range(4)] for i in range(4)]
    )


def _noise(dt: float) -> np.ndarray:
    """Return the integral of white snap in steps of a thousandth."""
    fine = dt / 1000
    step, push = _transition(fine), np.array([fine**4 / 24, fine**3 / 6, fine**2 / 2, fine])
    total = np.zeros((4, 4))
    for _ in range(1000):
        total = step @ total @ step.T + np.outer(push, push) / fine
    return total


def test_only_the_end_of_a_long_start_without_markers_is_filled() -> None:
    moving = swinging(joints=2, seconds=4.0, seed=1)
    moving.markers[:200] = np.nan
    states = moving.smoothed()
    given = np.isfinite(states.mean[:, :, 0])
    assert not given[:100].any()
    assert given[195:].all()
    off = np.abs(states.mean - moving.truth)[given] / states.sd[given]
    assert off.max() < 6


@pytest.mark.recordings
def test_no_frame_is_lost_if_every_marker_is_seen(recordings: Path, tmp_path: Path) -> None:
    """At first two of four thigh markers do not fit, so this joint and those beyond are undetermined."""
    file = recordings / "c3d" / "stoop1_t169_f620f800.c3d"
    configuration = tmp_path / "stoop.yaml"
    configuration.write_text(f"trial: stoop\nrecording: {file}\nprotocol: free\n")
    trial = load(configuration)
    for name in ("planarise", "segment", "fit-joints", "ukf-smooth"):
        run_stage(trial, name)
    states = Folder(trial.out).read("states.parquet")
    assert isinstance(states, Table)
    assert np.isfinite(states.frame.to_numpy(dtype=np.float64)).all()
    assert not [reason for reason in states.reasons if reason.code == "gap"]
    assert not states.frame.loc[0, ["observed_3", "observed_4", "observed_5"]].any()
