"""Poses of marker clusters: exact for rigid motion, and robust against errors of single markers."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.kinematics.clusters import ClusterPose, measure_cluster

TIME = np.arange(900) / 100
ANGLE = 0.4 + np.sin(2 * TIME)
PLACE = 0.5 * np.exp(0.3j * TIME) + 0.2j * TIME
SHAPE = np.array([0.05 + 0.02j, 0.31 - 0.04j, 0.12 + 0.2j, 0.28 + 0.17j, -0.04 + 0.11j, 0.16 + 0.05j])


def moved(local: np.ndarray, angle: np.ndarray = ANGLE, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """Return markers (F, m) on a body with its frame at PLACE, with ``noise`` in each coordinate."""
    rng = np.random.default_rng(seed)
    points = PLACE[:, None] + np.exp(1j * angle)[:, None] * local
    return points + noise * (rng.normal(size=points.shape) + 1j * rng.normal(size=points.shape))


def measured(points: np.ndarray, wanted: np.ndarray | None = None) -> ClusterPose:
    pose = measure_cluster(points, wanted)
    assert pose is not None
    return pose


def centroid(local: np.ndarray, angle: np.ndarray = ANGLE) -> np.ndarray:
    return PLACE + np.exp(1j * angle) * local.mean()


@pytest.mark.parametrize("markers", [2, 3, 6])
def test_a_rigid_motion_is_recovered(markers: int) -> None:
    local = SHAPE[:markers]
    pose = measured(moved(local), local)
    np.testing.assert_allclose(pose.angle, ANGLE, atol=1e-9)
    np.testing.assert_allclose(pose.position, centroid(local), atol=1e-9)
    np.testing.assert_allclose(pose.local, local, atol=1e-9)
    assert (pose.count == markers).all()
    assert pose.residual < 1e-9


@pytest.mark.parametrize("turns", [-7.3, 11.0])
def test_many_turns_have_no_jumps(turns: float) -> None:
    angle = 2 * np.pi * turns * TIME / TIME[-1]
    pose = measured(moved(SHAPE, angle), SHAPE)
    np.testing.assert_allclose(np.diff(pose.angle), np.diff(angle), atol=1e-9)
    assert np.ptp(pose.angle) == pytest.approx(2 * np.pi * abs(turns))
    whole = (pose.angle[0] - angle[0]) / (2 * np.pi)
    assert whole == pytest.approx(round(whole), abs=1e-9)


def test_missing_markers_are_left_out() -> None:
    points, rng = moved(SHAPE), np.random.default_rng(1)
    points[rng.uniform(size=points.shape) < 0.5] = np.nan
    points[100, 1:], points[200] = np.nan, np.nan
    count = np.isfinite(points).sum(axis=1)
    pose = measured(points, SHAPE)
    known = count >= 2
    assert 0 < known.sum() < len(points)
    np.testing.assert_array_equal(pose.count, count)
    np.testing.assert_allclose(pose.angle[known], ANGLE[known], atol=1e-7)
    np.testing.assert_allclose(pose.position[known], centroid(SHAPE)[known], atol=1e-7)
    assert np.isnan(pose.angle[~known]).all()
    assert np.isnan(pose.position[~known]).all()


@pytest.mark.parametrize("jump", [0.03, 0.1, 0.5])
@pytest.mark.parametrize("markers", [4, 6])
def test_a_jumping_marker_is_left_out_of_these_frames(markers: int, jump: float) -> None:
    local, frames = SHAPE[:markers], np.array([150, 400, 777])
    points = moved(local, noise=2e-4)
    points[frames, 1] += jump * np.exp(1j * frames)
    pose = measured(points, local)
    assert (pose.count[frames] == markers - 1).all()
    assert (np.delete(pose.count, frames) == markers).all()
    assert np.abs(pose.position - centroid(local)).max() < 2e-3
    assert np.abs(pose.angle - ANGLE).max() < 2e-2


def test_of_three_markers_none_can_be_left_out() -> None:
    points = moved(SHAPE[:3], noise=2e-4)
    points[300, 1] += 0.1
    assert (measured(points, SHAPE[:3]).count == 3).all()


@pytest.mark.parametrize("frame", [1003, 2005, 2006, 3001])
def test_a_marker_that_is_hardly_ever_seen_does_no_harm(frame: int) -> None:
    """It may be missing from all frames used for the shape of the cluster."""
    time = np.arange(5000) / 100
    angle, place = np.sin(time), 0.5 * np.exp(0.3j * time)
    points = place[:, None] + np.exp(1j * angle)[:, None] * SHAPE
    points[np.arange(5000) != frame, 1] = np.nan
    pose = measured(points, SHAPE)
    others = np.arange(len(SHAPE)) != 1
    assert pose.markers.tolist() == np.flatnonzero(others).tolist()
    np.testing.assert_allclose(pose.local, SHAPE[others], atol=1e-6)
    np.testing.assert_allclose(pose.angle, angle, atol=1e-6)
    np.testing.assert_allclose(pose.position, place + np.exp(1j * angle) * pose.local.mean(), atol=1e-6)


def test_the_body_has_the_wanted_frame() -> None:
    """Small errors of the coordinates turn and shift the whole frame; unknown coordinates are ignored."""
    wanted = SHAPE + 1e-3 * np.exp(1j * np.arange(len(SHAPE)))
    wanted[2] = np.nan
    pose = measured(moved(SHAPE), wanted)
    np.testing.assert_allclose(
        np.abs(pose.local[:, None] - pose.local), np.abs(SHAPE[:, None] - SHAPE), atol=1e-9
    )  # still the same body
    known = np.isfinite(wanted)
    off = pose.local[known] - wanted[known]
    assert abs(off.mean()) < 1e-12
    arm = wanted[known] - wanted[known].mean()
    assert np.imag(np.sum(np.conj(arm) * off)) == pytest.approx(0.0, abs=1e-12)  # no rotation brings them closer
    body = np.exp(-1j * pose.angle)[:, None] * (moved(SHAPE) - pose.position[:, None]) + pose.local.mean()
    np.testing.assert_allclose(body, np.broadcast_to(pose.local, body.shape), atol=1e-9)


def test_without_a_wanted_frame_it_is_parallel_to_the_plane_on_average() -> None:
    pose = measured(moved(SHAPE))
    assert np.angle(np.exp(1j * pose.angle).mean()) == pytest.approx(0.0, abs=1e-9)
    assert abs(pose.local.mean()) < 1e-12
    np.testing.assert_allclose(np.diff(pose.angle), np.diff(ANGLE), atol=1e-9)


def test_too_few_markers_have_no_pose() -> None:
    never = moved(SHAPE[:2])
    never[::2, 0], never[1::2, 1] = np.nan, np.nan
    assert measure_cluster(moved(SHAPE[:1])) is None
    assert measure_cluster(np.zeros((50, 0), dtype=complex)) is None
    assert measure_cluster(moved(np.array([0.1, 0.1, 0.1 + 1e-4j]))) is None
    assert measure_cluster(never) is None
    assert measure_cluster(np.full((50, 4), np.nan + 0j)) is None


@pytest.mark.parametrize("noise", [3e-4, 3e-3])
def test_the_residual_is_the_noise_not_absorbed_by_the_pose(noise: float) -> None:
    """The pose absorbs three of the 2 m coordinates of a frame."""
    count = len(SHAPE)
    expected = noise * np.sqrt(2 * (2 * count - 3) / (2 * count))
    assert measured(moved(SHAPE, noise=noise), SHAPE).residual == pytest.approx(expected, rel=0.03)
