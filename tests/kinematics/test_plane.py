"""The plane of motion: exact for planar motion, independent of marker places, robust against bursts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_id.kinematics.base_motion import propose_window
from mocap_id.kinematics.plane import fit_plane


def planar_motion(yaw: float, seed: int = 0, noise: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 10, 300)
    along = rng.uniform(0.02, 0.3, 8) * np.sin(t[:, None] + rng.uniform(0, 3, 8))
    up = rng.uniform(0.02, 0.3, 8) * np.cos(t[:, None])
    place = rng.uniform(-1, 1, (8, 3))
    motion = np.stack([np.cos(yaw) * along, np.sin(yaw) * along, up], axis=2) + place
    return motion + noise * rng.standard_normal(motion.shape)


@given(st.floats(-1.57, 1.57), st.integers(0, 20))
def test_planar_motion_gives_its_yaw_and_no_out_of_plane_share(yaw: float, seed: int) -> None:
    fit = fit_plane(planar_motion(yaw, seed))
    assert np.sin(fit.yaw - yaw) == pytest.approx(0, abs=1e-9)
    assert fit.planarity == pytest.approx(0, abs=1e-12)


def test_marker_places_do_not_matter() -> None:
    motion = planar_motion(0.4, noise=1e-3)
    moved = motion + np.random.default_rng(1).uniform(-5, 5, (1, 8, 3))
    assert fit_plane(moved).yaw == pytest.approx(fit_plane(motion).yaw, abs=1e-12)


def test_a_burst_does_not_turn_the_plane() -> None:
    motion = planar_motion(0.4, noise=5e-4)
    plain = fit_plane(motion).yaw
    motion[100:110, 3] += [0.5, -0.4, 0.2]
    assert np.degrees(fit_plane(motion).yaw - plain) == pytest.approx(0, abs=0.02)


def test_gaps_are_left_out() -> None:
    motion = planar_motion(-0.7)
    motion[50:120, 2] = np.nan
    motion[:, 5] = np.nan
    assert fit_plane(motion).yaw == pytest.approx(-0.7, abs=1e-9)


def test_isotropic_motion_is_not_planar() -> None:
    motion = np.random.default_rng(0).standard_normal((2000, 4, 3))
    assert fit_plane(motion).planarity == pytest.approx(1 / 3, abs=0.03)


def test_nothing_moves() -> None:
    fit = fit_plane(np.ones((10, 3, 3)))
    assert (fit.yaw, fit.planarity) == (0.0, 0.0)
    assert fit_plane(np.full((10, 3, 3), np.nan)).planarity == 0.0


def test_window_is_the_whole_recording_with_a_fixed_base() -> None:
    motion = np.concatenate([planar_motion(0.1), np.zeros((300, 2, 3))], axis=1)
    assert propose_window(motion, 30.0) == (0, 300)


def test_window_is_the_longest_stretch_with_still_feet() -> None:
    rate, frames = 100.0, 1500
    motion = planar_motion(0.1)[np.linspace(0, 299, frames).astype(int)]
    feet = np.zeros((frames, 2, 3))
    walk = np.linspace(0, 2, 400)[:, None]
    feet[:400, :, 0] = walk - 2
    feet[1300:, :, 0] = np.linspace(0, 1, 200)[:, None]
    first, stop = propose_window(np.concatenate([motion, feet], axis=1), rate)
    assert 390 <= first <= 460
    assert 1240 <= stop <= 1310


def test_steps_are_no_window() -> None:
    rate, frames = 100.0, 600
    phase = (np.arange(frames) // 60) % 2
    left = np.cumsum(np.where(phase == 0, 0.01, 0.0))
    right = np.cumsum(np.where(phase == 1, 0.01, 0.0))
    motion = np.zeros((frames, 4, 3))
    motion[:, :2, 0] = left[:, None]
    motion[:, 2:, 0] = right[:, None]
    assert propose_window(motion, rate) == (0, frames)


def held_then_waved(frames: int, rate: float, waved: slice) -> np.ndarray:
    """Return two still markers that for a while swing with a period of one second."""
    motion = np.zeros((frames, 4, 3))
    motion[:, 2:] = np.linspace(0, 5, frames)[:, None, None]
    swing = 0.2 * np.sin(2 * np.pi * np.arange(frames) / rate)
    motion[waved, :2, 0] = swing[waved, None]
    return motion


def test_markers_that_swing_with_a_period_of_a_second_are_not_still() -> None:
    rate = 100.0
    first, stop = propose_window(held_then_waved(1500, rate, slice(0, 1000)), rate)
    assert 1000 <= first <= 1060
    assert stop == 1500


def test_short_gaps_are_still_but_unseen_markers_are_not() -> None:
    rate = 100.0
    motion = held_then_waved(1500, rate, slice(0, 900))
    motion[1100:1130, :2] = np.nan
    motion[1000:1020, 0] = np.nan
    assert propose_window(motion, rate)[1] == 1500
    motion[1250:, :2] = np.nan
    assert 1240 <= propose_window(motion, rate)[1] <= 1260


def test_a_wait_before_the_movement_is_no_window() -> None:
    rate = 100.0
    motion = planar_motion(0.1)[np.linspace(0, 299, 800).astype(int)]
    wait = np.repeat(motion[:1], 1200, axis=0)
    walk = motion[:1] + np.linspace(0, 2, 200)[:, None, None] * [1.0, 0.0, 0.0]
    body = np.concatenate([wait, walk, motion + np.array([2.0, 0.0, 0.0])])
    feet = np.zeros((2200, 2, 3))
    feet[1200:1400] = np.linspace(0, 2, 200)[:, None, None] * [1.0, 0.0, 0.0]
    feet[1400:, :, 0] = 2.0
    first, stop = propose_window(np.concatenate([body, feet], axis=1), rate)
    assert 1390 <= first <= 1460
    assert stop == 2200


@pytest.mark.parametrize("lean_deg", [5.0, -10.0])
def test_a_plane_that_leans_is_found_and_turned_upright(lean_deg: float) -> None:
    yaw, lean = 0.4, np.radians(lean_deg)
    upright = planar_motion(yaw, noise=5e-4)
    forwards, across = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    x, y, z = upright @ forwards, upright[..., 2], upright @ across
    leaning = x[..., None] * forwards + (np.sin(lean) * y + np.cos(lean) * z)[..., None] * across
    leaning[..., 2] = np.cos(lean) * y - np.sin(lean) * z
    fit = fit_plane(leaning)
    assert np.degrees([fit.yaw, fit.lean]) == pytest.approx([np.degrees(yaw), lean_deg], abs=0.1)
    assert fit.planarity < 1e-4
    np.testing.assert_allclose(fit.straighten(leaning, np.zeros(3)), upright, atol=5e-3)
    assert fit_plane(upright).lean == 0
