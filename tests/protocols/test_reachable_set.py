"""The set that a wrist reaches: shells, scaling, membership, and an independent volume."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mocap_id_simulation.arm_files as truth
from mocap_id.geometry import so3
from mocap_id.protocols.reach import (
    ReachableSet,
    ReachArm,
    compute_reach_surface,
    compute_reachable_set,
    find_visited_region,
)
from mocap_id_simulation.arm import draw_arm

X, Y, Z = np.eye(3)
ARM = ReachArm(np.array([0.0, -0.3, 0.0]), 0.25, np.array([-0.15, 0.02, -0.01]), 0.0)
BOX = np.radians([[-30.0, 110.0], [15.0, 120.0], [-60.0, 70.0], [15.0, 140.0]])
GRID = (24, 48, 32)


def wrists(arm: ReachArm, postures: np.ndarray) -> np.ndarray:
    """Return the wrist (K, 3) from the shoulder by turning the arm, at plane, elevation, axial and flexion (K, 4)."""
    plane, elevation, axial, flexion = postures.T
    turned = so3.exp(plane[:, None] * Y) @ so3.exp(-elevation[:, None] * X) @ so3.exp(axial[:, None] * Y)
    return np.asarray(np.einsum("kij,kj->ki", turned, arm.wrist(flexion)))


def share_inside(found: ReachableSet, points: np.ndarray) -> float:
    """Return the share of points (K, 3) that lie in an arc of their cell."""
    r = np.linalg.norm(points, axis=1)
    row = np.clip(np.searchsorted(found.distance, r) - 1, 0, len(found.distance) - 2)
    column = np.clip(np.searchsorted(found.cosine, points[:, 1] / r) - 1, 0, len(found.cosine) - 2)
    azimuth = np.mod(np.arctan2(points[:, 0], points[:, 2]), 2 * np.pi)[:, None]
    start, end = found.start[row, column], found.end[row, column]
    inside = ((start <= azimuth) & (azimuth <= end)) | (azimuth + 2 * np.pi <= end)
    return float(inside.any(axis=1).mean())


def test_a_shoulder_that_turns_freely_reaches_a_shell() -> None:
    free = np.array([[-np.pi, np.pi], [0.0, np.pi], [-np.pi, np.pi], [0.2, 2.4]])
    reach = np.linalg.norm(ARM.wrist(np.linspace(0.2, 2.4, 500)), axis=1)
    shell = 4 / 3 * np.pi * (reach.max() ** 3 - reach.min() ** 3)
    assert compute_reachable_set(ARM, free, GRID).volume == pytest.approx(shell, rel=0.002)
    *_, radius, areas = compute_reach_surface(ARM, free)
    assert areas["total"] == pytest.approx((reach.max() / ARM.length) ** 2, rel=0.01)
    assert areas["upper_medial"] == pytest.approx(areas["total"] / 4, rel=1e-6)
    assert np.nanmax(radius) == pytest.approx(reach.max(), rel=1e-9)


def test_the_volume_scales_with_the_cube_of_the_arm_and_grows_with_the_limits() -> None:
    volume = compute_reachable_set(ARM, BOX, GRID).volume
    larger = replace(ARM, elbow=1.2 * ARM.elbow, forearm=1.2 * ARM.forearm)
    assert compute_reachable_set(larger, BOX, GRID).volume == pytest.approx(1.2**3 * volume, rel=1e-9)
    turned = BOX + np.array([[0.7, 0.7], [0, 0], [0, 0], [0, 0]])
    assert compute_reachable_set(ARM, turned, GRID).volume == pytest.approx(volume, rel=1e-9)
    for k in range(4):
        wider = BOX.copy()
        wider[k, 1] += 0.1
        assert compute_reachable_set(ARM, wider, GRID).volume > volume


def test_the_grid_converges() -> None:
    fine = compute_reachable_set(ARM, BOX, (48, 96, 64)).volume
    grids = (6, 12, 8), (24, 48, 32)
    errors = [abs(compute_reachable_set(ARM, BOX, grid).volume / fine - 1) for grid in grids]
    assert errors[1] < 0.005
    assert errors[1] < errors[0]


def test_every_posture_of_the_box_is_in_the_set() -> None:
    postures = np.random.default_rng(0).uniform(BOX[:, 0], BOX[:, 1], (4000, 4))
    found = compute_reachable_set(ARM, BOX, GRID)
    assert share_inside(found, wrists(ARM, postures)) > 0.98
    beyond = wrists(ARM, postures) * [-1, 1, 1]  # behind the body
    assert share_inside(found, beyond) < 0.6


def test_the_volume_is_that_of_an_independent_method(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(truth, "POINTS", 2**12)
    body = draw_arm(3, 0.015)
    expected, _ = truth.reach_volume(body, BOX, 1.0)
    flexion = np.linspace(0.0, 2.6, 60)
    carried = so3.exp(X * body.carrying) @ so3.exp(body.pronation_axis * 1.0)
    along = -(so3.exp(flexion[:, None] * body.elbow_axis) @ carried)[:, :, 1]
    carrying, seen = np.arcsin(-along[:, 2]), np.arctan2(along[:, 0], -along[:, 1])
    design = np.stack([np.ones(60), np.cos(seen), np.sin(seen)], axis=1)
    arm = ReachArm(body.elbow, body.forearm, np.linalg.lstsq(design, carrying, rcond=None)[0], float(body.glide[1]))
    assert np.allclose(arm.wrist(seen), body.elbow + body.forearm * along, atol=1e-4)
    limits = BOX.copy()
    limits[3] = np.interp(BOX[3], flexion, seen)
    assert compute_reachable_set(arm, limits, GRID).volume == pytest.approx(expected, rel=0.04)


def test_a_region_as_large_as_the_box_reaches_as_far() -> None:
    corners = np.stack(np.meshgrid(*BOX, indexing="ij"), axis=-1).reshape(-1, 4)
    inner = np.random.default_rng(1).uniform(BOX[:, 0], BOX[:, 1], (200, 4))
    region = find_visited_region(np.concatenate([corners, inner]), BOX)
    assert region is not None
    assert np.allclose(region[0], BOX)
    grid = (12, 24, 48)
    box, same = compute_reachable_set(ARM, BOX, grid), compute_reachable_set(ARM, region[0], grid, region[1])
    assert same.volume == pytest.approx(box.volume, rel=0.01)


def test_postures_between_visited_ones_add_nothing_to_the_region() -> None:
    random = np.random.default_rng(2)
    visited = random.uniform(BOX[:, 0], BOX[:, 1], (60, 4))
    between = 0.5 * (visited[random.integers(0, 60, 150)] + visited[random.integers(0, 60, 150)])
    grid = (8, 16, 24)
    first, second = (find_visited_region(each, BOX) for each in (visited, np.concatenate([visited, between])))
    assert first is not None and second is not None
    volumes = [compute_reachable_set(ARM, limits, grid, planes).volume for limits, planes in (first, second)]
    assert volumes[1] == pytest.approx(volumes[0], rel=1e-6)
    assert volumes[0] < 0.9 * compute_reachable_set(ARM, BOX, grid).volume
    half = random.random((300, 1))
    flat = BOX[:, 0] + half * (BOX[:, 1] - BOX[:, 0])
    assert find_visited_region(flat, BOX) is None
