"""Shape and poses of a marker cluster in space."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.kinematics.space.bodies import fit_shape, rigid_poses

SEEDS = st.integers(0, 1000)
FRAMES = 80


def tumbling(seed: int, markers: int = 4, noise: float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return trajectories, the true shape about its centroid, and the true poses."""
    rng = np.random.default_rng([seed, markers])
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1], [-1, 0.3, 0]])
    local = 0.08 * corners[:markers] + rng.uniform(-0.03, 0.03, (markers, 3))
    local -= local.mean(axis=0)
    rotation = so3.exp(np.cumsum(rng.normal(0, 0.1, (FRAMES, 3)), axis=0))
    origin = np.cumsum(rng.normal(0, 0.02, (FRAMES, 3)), axis=0)
    points = origin[:, None] + np.einsum("fij,kj->fki", rotation, local)
    return points + noise * rng.standard_normal(points.shape), local, rotation, origin


def distances(local: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(local[:, None] - local, axis=2))


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_the_poses_are_exact_where_three_markers_are_seen(seed: int) -> None:
    points, local, rotation, origin = tumbling(seed)
    points[np.random.default_rng(seed).uniform(size=points.shape[:2]) < 0.3] = np.nan
    found, place, seen = rigid_poses(points, local)
    counts = np.isfinite(points).all(axis=2).sum(axis=1)
    assert (seen == counts).all()
    assert (np.isfinite(place[:, 0]) == (counts >= 3)).all()
    known = counts >= 3
    np.testing.assert_allclose(found[known], rotation[known], atol=1e-9)
    np.testing.assert_allclose(place[known], origin[known], atol=1e-9)


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_the_shape_is_exact_in_spite_of_gaps_and_without_a_complete_frame(seed: int) -> None:
    points, local, _, _ = tumbling(seed, markers=5)
    points[np.arange(FRAMES), np.arange(FRAMES) % 5] = np.nan
    np.testing.assert_allclose(distances(fit_shape(points)), distances(local), atol=1e-6)


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_turning_the_lab_turns_the_poses_and_keeps_the_shape(seed: int) -> None:
    points, _, _, _ = tumbling(seed, noise=1e-3)
    turn, shift = so3.exp(np.array([0.4, -1.1, 2.0])), np.array([1.0, -2.0, 0.5])
    turned = points @ turn.T + shift
    local = fit_shape(points)
    np.testing.assert_allclose(distances(fit_shape(turned)), distances(local), atol=1e-6)
    rotation, origin, _ = rigid_poses(points, local)
    rotation_turned, origin_turned, _ = rigid_poses(turned, local)
    np.testing.assert_allclose(rotation_turned, turn @ rotation, atol=1e-9)
    np.testing.assert_allclose(origin_turned, origin @ turn.T + shift, atol=1e-9)


def test_noise_averages_out_of_the_shape_and_bursts_do_not_spoil_it() -> None:
    points, local, _, _ = tumbling(3, noise=5e-4)
    points[10:14, 1] += 0.3
    assert np.abs(distances(fit_shape(points)) - distances(local)).max() < 3e-4


def from_places(points: FloatArray, local: FloatArray, rotation: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the distance (F, k) of every sample from its place on a body in every pose."""
    return np.linalg.norm(points - origin[:, None] - np.einsum("fij,kj->fki", rotation, local), axis=2)


def test_weights_favour_a_marker() -> None:
    points, local, _, _ = tumbling(5)
    points[:, 0] += 0.01
    equal = from_places(points, local, *rigid_poses(points, local)[:2])
    without = rigid_poses(points, local, np.array([0.0, 1, 1, 1]))
    assert (without[2] == 3).all()
    assert np.abs(from_places(points, local, *without[:2])[:, 1:]).max() < 1e-9 < equal[:, 1:].min()


@pytest.mark.parametrize("markers", [2, 3])
def test_markers_on_a_line_have_no_rotation(markers: int) -> None:
    points = np.zeros((4, markers, 3))
    points[..., 0] = np.linspace(0, 0.2, markers) + np.arange(4)[:, None]
    rotation, origin, seen = rigid_poses(points, points[0])
    assert np.isnan(rotation).all()
    assert np.isnan(origin).all()
    assert (seen == markers).all()


def test_reflections_are_never_returned() -> None:
    points, local, _, _ = tumbling(7, noise=0.02)
    assert np.linalg.det(rigid_poses(points, local)[0]).min() > 0.999


def test_a_marker_that_is_never_seen_has_no_place() -> None:
    points, local, _, _ = tumbling(8)
    points[:, 2] = np.nan
    shape = fit_shape(points)
    assert np.isnan(shape[2]).all()
    known = [0, 1, 3]
    np.testing.assert_allclose(distances(shape[known]), distances(local[known]), atol=1e-6)


@given(SEEDS, st.integers(3, 5))
@settings(max_examples=25, deadline=None)
def test_the_poses_are_those_of_the_singular_value_decomposition(seed: int, markers: int) -> None:
    """Also for three markers, which lie in one plane, and with weights."""
    rng = np.random.default_rng(seed)
    points, local, *_ = tumbling(seed, markers, noise=0.003)
    weights = rng.uniform(0.2, 2, points.shape[:2])
    rotation, origin, _ = rigid_poses(points, local, weights)
    share = (weights / weights.sum(axis=1, keepdims=True))[..., None]
    here, there = (share * points).sum(axis=1), (share * local).sum(axis=1)
    moment = np.swapaxes(share * (points - here[:, None]), 1, 2) @ (local - there[:, None])
    left, _, right = np.linalg.svd(moment)
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    np.testing.assert_allclose(rotation, left @ right, atol=1e-9)
    np.testing.assert_allclose(origin, here - np.einsum("fij,fj->fi", left @ right, there), atol=1e-9)
