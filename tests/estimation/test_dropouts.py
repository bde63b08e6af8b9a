"""Dropouts: the angle does not step when a marker vanishes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from simulated_chains import Moving, rms, swinging

from mocap_id.estimation import smoothing
from mocap_id.estimation.filter_problem import MarkerChain
from mocap_id.estimation.noise import FrameAngles, find_frame_angles
from mocap_id.geometry.planar import marker_positions, rotate, segment_poses

MARKER_SD = 2e-3


@pytest.fixture(scope="module")
def slid() -> Moving:
    """Return markers displaced by 3 mm, without noise, at a rate so high that a gap takes no time."""
    moving = swinging(joints=3, per_segment=5, seconds=0.3, rate=2000.0, noise=0.0, seed=8)
    off = np.random.default_rng(1).normal(0, 3e-3, moving.local.shape)
    markers = marker_positions(moving.truth[..., 0], moving.centres, moving.segment, moving.local + off)
    return Moving(moving.truth, markers, moving.rate, moving.centres, moving.segment, moving.local)


def compensated(moving: Moving, markers: np.ndarray) -> tuple[np.ndarray, FrameAngles, FrameAngles]:
    """Return the compensated markers and angles, and the angles before."""
    chain, moved = MarkerChain(moving.centres, moving.segment, moving.local), markers.copy()
    frames = find_frame_angles(markers, chain, 1e3, 5e-5)
    return moved, smoothing.compensate_dropouts(moved, frames, chain, MARKER_SD, moving.rate), frames


def test_without_gaps_nothing_changes(slid: Moving) -> None:
    markers, after, before = compensated(slid, slid.markers)
    assert (markers == slid.markers).all()
    assert (after.angles == before.angles).all()


@pytest.mark.parametrize("gone", [[3], [1, 6], [0, 1, 2, 3], [5, 6, 7, 8, 9]])
def test_the_angle_stays_at_the_fit_of_all_markers(slid: Moving, gone: list[int]) -> None:
    """This includes a whole segment that its neighbours still determine."""
    whole = compensated(slid, slid.markers)[2].angles
    gap = np.arange(300, 308)
    markers = slid.markers.copy()
    markers[np.ix_(gap, gone)] = np.nan
    moved, after, before = compensated(slid, markers)
    step = np.abs(before.angles - whole)[gap].max()
    assert step > 5e-4
    assert np.abs(after.angles - whole)[gap].max() < 0.05 * step
    chain = MarkerChain(slid.centres, slid.segment, slid.local)
    found = find_frame_angles(moved, chain, 1e3, 5e-5).angles
    np.testing.assert_allclose(found[gap], after.angles[gap], atol=0.05 * step)


def test_overlapping_gaps(slid: Moving) -> None:
    whole = compensated(slid, slid.markers)[2].angles
    markers = slid.markers.copy()
    for k, marker in enumerate((0, 4, 6, 7, 11, 13)):
        markers[200 + 3 * k : 208 + 4 * k, marker] = np.nan
    _, after, before = compensated(slid, markers)
    stretch = slice(200, 230)
    assert np.abs(after.angles - whole)[stretch].max() < 0.1 * np.abs(before.angles - whole)[stretch].max()


def test_undetermined_angles_stay_unchanged(slid: Moving) -> None:
    markers = slid.markers.copy()
    markers[100:140, slid.segment == 3] = np.nan
    _, after, before = compensated(slid, markers)
    assert (after.angles[100:140, 2] == before.angles[100:140, 2]).all()
    assert np.abs(after.angles - before.angles).max() < 0.05


def test_the_bridge_is_the_conditional_mean_of_a_markov_process() -> None:
    memory, length = 30.0, 50
    since = np.arange(1, length)
    ends = np.array([0.0, length])
    between = np.exp(-np.abs(since[:, None] - ends) / memory)
    among = np.exp(-np.abs(ends[:, None] - ends) / memory)
    values = np.array([[0.004, -0.001], [-0.002, 0.003]])
    expected = between @ np.linalg.solve(among, values)
    gap, until = np.zeros(length - 1, dtype=np.int64), (length - since) / memory
    gaps = smoothing.Gaps(since, gap, since / memory, until, (since[:0], since[:0]))
    found = gaps.bridge(values[:1], values[1:])
    np.testing.assert_allclose(found, expected, atol=1e-12)
    alone = replace(gaps, until=np.full(length - 1, np.inf)).bridge(values[:1], values[1:])
    np.testing.assert_allclose(alone, between[:, :1] * values[0], atol=1e-12)


def test_dropouts_cost_little_more_with_skin_than_without(monkeypatch: pytest.MonkeyPatch) -> None:
    moving = swinging(joints=3, per_segment=6, seconds=20.0, noise=5e-4, seed=5)
    rng = np.random.default_rng(3)
    seen = np.ones(moving.markers.shape[:2], dtype=bool)
    for _ in range(60):
        start, length = rng.integers(0, 1900), rng.integers(5, 100)
        seen[start : start + length, rng.integers(0, 18)] = False
    slow = gaussian_filter1d(rng.normal(0, 1, (len(seen), *moving.local.shape)), 0.5 * moving.rate, axis=0)
    slides = 3e-3 * slow / slow.std()
    angle = segment_poses(moving.truth[..., 0], moving.centres)[0][:, moving.segment]
    skin = rotate(angle, slides)
    without, cost = loss(moving, moving.markers, seen), loss(moving, moving.markers + skin, seen)
    monkeypatch.setattr("mocap_id.estimation.smoothing.compensate_dropouts", lambda observed, frames, *_: frames)
    stepping = loss(moving, moving.markers + skin, seen)
    assert np.all(stepping > 1.3)
    assert np.all(cost - without < 0.3 * (stepping - without))


def loss(moving: Moving, markers: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the rms error (n,) of the accelerations with dropouts over that without."""
    some = np.where(seen[..., None], markers, np.nan)
    whole, part = (rms((moving.smoothed_from(m).mean - moving.truth)[20:-20])[:, 2] for m in (markers, some))
    return part / whole
