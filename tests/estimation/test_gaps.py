"""In gaps, states are bridged within their standard deviations or are NaN; never silently wrong."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_chains import Moving, swinging

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation import States

FRAMES, RATE = 600, 100.0


@pytest.fixture(scope="module")
def moving() -> Moving:
    return swinging(joints=3, seconds=FRAMES / RATE, rate=RATE, seed=2)


def without(moving: Moving, start: int, stop: int, gone: BoolArray) -> FloatArray:
    markers = moving.markers.copy()
    markers[start:stop, gone] = np.nan
    return markers


def assert_honest(moving: Moving, states: States, within: float = 6.0) -> None:
    """Check that every finite angle is within this many standard deviations, and not off by a turn."""
    error = np.abs(states.mean - moving.truth)
    given = np.isfinite(error)
    assert np.all(error[given] <= within * states.sd[given] + 1e-9)
    assert np.all(np.isfinite(states.sd))
    assert np.all(np.isnan(states.mean).all(axis=2) == (states.sd[..., 0] > 0.2))


@settings(max_examples=25, deadline=None)
@given(
    start=st.integers(0, FRAMES - 1),
    length=st.sampled_from([10, 30, 50, 80, 150, 300]),
    which=st.sampled_from(["all", "1", "2", "3", "one"]),
)
def test_no_gap_gives_a_wrong_number(moving: Moving, start: int, length: int, which: str) -> None:
    gone = {
        "all": moving.segment > 0,
        "one": np.arange(len(moving.segment)) == 9,
    }.get(which, moving.segment == (int(which) if which.isdigit() else 0))
    states = moving.smoothed_from(without(moving, start, start + length, gone))
    assert_honest(moving, states)
    outside = np.r_[0:start, min(start + length, FRAMES) : FRAMES]
    assert states.observed[outside].all()


def test_uncertainty_grows_towards_the_middle_of_a_gap(moving: Moving) -> None:
    states = moving.smoothed_from(without(moving, 300, 340, moving.segment == 3))
    sd = states.sd[300:340, 2, 0]
    middle = int(np.argmax(sd))
    assert 15 <= middle <= 25
    assert np.all(np.diff(sd[: middle + 1]) > 0)
    assert np.all(np.diff(sd[middle:]) < 0)
    assert sd[middle] > 5 * states.sd[250, 2, 0]
    assert not states.observed[300:340, 2].any()
    assert np.isfinite(states.mean[300:340]).all()


def test_a_long_gap_affects_its_own_joint_only(moving: Moving) -> None:
    states = moving.smoothed_from(without(moving, 200, 500, moving.segment == 3))
    assert np.isnan(states.mean[300:400, 2]).all()
    assert np.isfinite(states.mean[:, :2]).all()
    assert np.isnan(states.predicted[300:400, moving.segment == 3]).all()
    assert np.isfinite(states.predicted[:, moving.segment < 3]).all()


def test_markers_farther_out_observe_the_joints_before_them(moving: Moving) -> None:
    """The pose of segment 3 determines its joint, so two coordinates determine two angles."""
    states = moving.smoothed_from(without(moving, 0, FRAMES, moving.segment == 2))
    assert states.observed.mean() > 0.9
    assert_honest(moving, states)


def test_a_marker_on_the_segment_alone_observes_its_angle_and_none_beyond(moving: Moving) -> None:
    kept = np.isin(np.arange(len(moving.segment)), [0, 4])
    states = moving.smoothed_from(without(moving, 100, 130, ~kept))
    assert states.observed[100:130, :2].all()
    assert not states.observed[100:130, 2].any()


def test_the_first_frames_may_have_no_marker(moving: Moving) -> None:
    states = moving.smoothed_from(without(moving, 0, 150, moving.segment > 0))
    assert np.isnan(states.mean[:50]).all()
    assert not states.observed[:150].any()
    np.testing.assert_allclose(states.mean[160:, :, 0], moving.truth[160:, :, 0], atol=0.01)


def test_a_segment_that_is_never_seen_has_no_angle(moving: Moving) -> None:
    states = moving.smoothed_from(without(moving, 0, FRAMES, moving.segment == 3))
    assert np.isnan(states.mean[:, 2]).all()
    assert not states.observed[:, 2].any()
    np.testing.assert_allclose(states.mean[:, :2, 0], moving.truth[:, :2, 0], atol=0.01)


def test_no_marker_at_all_gives_no_angle(moving: Moving) -> None:
    states = moving.smoothed_from(np.full_like(moving.markers, np.nan))
    assert np.isnan(states.mean).all()
    assert not states.observed.any()


def test_a_joint_that_turned_during_a_gap_is_found_in_its_own_turn() -> None:
    """Two full turns in the trial, half a turn of them unseen."""
    moving = swinging(joints=1, seconds=4.0, noise=5e-4)
    time = np.arange(len(moving.truth)) / moving.rate
    truth = np.zeros_like(moving.truth)
    truth[:, 0, 0], truth[:, 0, 1] = np.pi * time, np.pi
    local = moving.local
    c, s = np.cos(truth[:, :, 0]), np.sin(truth[:, :, 0])
    markers = moving.centres[0] + np.stack(
        [c * local[:, 0] - s * local[:, 1], s * local[:, 0] + c * local[:, 1]], axis=-1
    )
    markers[150:200] = np.nan
    turning = Moving(truth, markers, moving.rate, moving.centres, moving.segment, local)
    states = turning.smoothed()
    np.testing.assert_allclose(states.mean[:, 0, 0], truth[:, 0, 0], atol=1e-3)


def test_a_gap_longer_than_the_filter_can_bridge_is_entered_and_left_in_the_same_turn(moving: Moving) -> None:
    states = moving.smoothed_from(without(moving, 100, 500, moving.segment > 0))
    np.testing.assert_allclose(states.mean[505:, :, 0], moving.truth[505:, :, 0], atol=0.01)
    assert np.isnan(states.mean[200:400]).all()
    assert np.isfinite(states.mean[np.r_[:110, 490:600]]).all()
    assert_honest(moving, states)
