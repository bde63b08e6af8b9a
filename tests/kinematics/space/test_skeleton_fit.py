"""A chain of constant lengths from the joints of a skeleton: lasting errors, noise, and poses in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.errors import Refused
from mocap_id.estimation.space.frame_poses import make_chain_model, predict_positions
from mocap_id.estimation.space.skeleton_smoothing import (
    LEAST_FLEXION,
    bridge_short_gaps,
    find_skeleton_poses,
    remove_jumps,
)
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint
from mocap_id.kinematics.space.skeleton import fit_bone, fit_sensor_noise, fit_trunk, sensor_noise_power

TRUNK = {
    "near_shoulder": np.array([0.0, 0.0, 0.17]),
    "far_shoulder": np.array([0.0, 0.0, -0.17]),
    "near_hip": np.array([0.02, -0.48, 0.08]),
    "far_hip": np.array([0.02, -0.48, -0.08]),
    "pelvis": np.array([0.0, -0.45, 0.0]),
    "spine_top": np.array([0.0, 0.0, 0.0]),
}
OFFSET = so3.exp(np.array([np.radians(-10), 0.0, 0.0]))
CHAIN = SpatialChain(
    (
        SpatialJoint("ball", 0, np.array([0.0, 0.0, 0.17])),
        SpatialJoint("hinge", 1, np.array([0.0, -0.3, 0.0]), offset=OFFSET),
        SpatialJoint("two-axis", 2, np.array([0.02, -0.24, 0.01]), second_axis=np.array([1.0, 0.0, 0.0])),
    ),
    np.array([0, 0, 0, 1, 2, 3]),
    np.array([[0, 0, 0.17], [0, 0, -0.17], [0, -0.45, 0], [0, -0.3, 0], [0.02, -0.24, 0.01], [0, -0.08, 0]]),
    np.zeros(6, dtype=np.bool_),
)


def directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return unit vectors (count, 3) over half a sphere."""
    found = rng.normal(0, 1, (count, 3))
    found[:, 0] = np.abs(found[:, 0])
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def test_the_axes_of_the_trunk_are_those_of_its_joints_in_any_pose() -> None:
    rng = np.random.default_rng(2)
    turn = so3.exp(rng.normal(0, 1, (80, 3)))
    place = rng.normal(0, 1, (80, 3))
    tracks = {role: turn @ at + place + rng.normal(0, 1e-4, (80, 3)) for role, at in TRUNK.items()}
    trunk = fit_trunk(tracks)
    assert np.allclose(trunk.local, [TRUNK[role] for role in trunk.roles], atol=5e-4)
    assert np.linalg.norm(so3.log(np.swapaxes(turn, 1, 2) @ trunk.rotations), axis=1).max() < 3e-3


def test_a_trunk_without_the_other_shoulder_is_refused() -> None:
    still = {role: np.tile(at, (30, 1)) for role, at in TRUNK.items() if role != "far_shoulder"}
    with pytest.raises(Refused, match="both shoulders"):
        fit_trunk(still)


def test_a_lasting_error_between_two_joints_is_found_from_the_sphere_that_the_bone_makes() -> None:
    rng = np.random.default_rng(3)
    error = np.array([0.02, -0.015, 0.01])
    tips = 0.3 * directions(rng, 900) + error + rng.normal(0, 0.003, (900, 3))
    bone = fit_bone(tips, np.zeros(3), 0.03, rate=30.0)
    sd = np.sqrt(np.diag(bone.covariance))
    assert np.all(np.abs(bone.centre - error) < 3 * sd[:3] + 1e-3)
    assert bone.length == pytest.approx(0.3, abs=0.004)
    assert sd[:3].max() < 0.012


def test_a_bone_that_hardly_moves_keeps_its_measured_centre_and_says_how_uncertain_it_is() -> None:
    rng = np.random.default_rng(4)
    tips = np.array([0.3, 0.0, 0.0]) + rng.normal(0, 0.003, (300, 3))
    bone = fit_bone(tips, np.zeros(3), 0.03, rate=30.0)
    assert np.linalg.norm(bone.centre) < 0.01
    assert np.sqrt(bone.covariance[1, 1]) == pytest.approx(0.03, rel=0.2)


def test_the_memory_of_noise_is_found_and_its_power_sums_to_its_variance() -> None:
    rng = np.random.default_rng(5)
    fades, slow = np.exp(-1 / (30 * 0.25)), np.zeros((4000, 6))
    for k in range(1, 4000):
        slow[k] = fades * slow[k - 1] + np.sqrt(1 - fades**2) * rng.normal(0, 1, 6)
    white, memory = fit_sensor_noise(np.sqrt(0.8) * slow + np.sqrt(0.2) * rng.normal(0, 1, slow.shape), 30.0)
    assert white == pytest.approx(0.2, abs=0.1)
    assert memory == pytest.approx(0.25, rel=0.3)
    frequency = (np.arange(20000) + 0.5) / 20000 * 15
    assert sensor_noise_power(0.2, 0.25, frequency, 1 / 30).mean() == pytest.approx(1, rel=1e-3)


def test_poses_in_closed_form_are_those_that_placed_the_joints_and_no_elbow_is_mirrored() -> None:
    rng = np.random.default_rng(6)
    model = make_chain_model(CHAIN)
    trunk = (so3.exp(rng.normal(0, 1, (60, 3))), rng.normal(0, 1, (60, 3)))
    upper = so3.exp(rng.normal(0, 1.5, (60, 3)))
    flexion = rng.uniform(0.4, 2.5, 60)
    hand = rng.uniform(-0.5, 0.5, (60, 2))
    turns = np.stack([upper, CHAIN.joints[1].rotation(flexion[:, None]), CHAIN.joints[2].rotation(hand)], axis=1)
    origins, rotations = CHAIN.place(trunk[1], trunk[0], turns)
    points = np.stack([origins[:, s] + rotations[:, s] @ at for s, at in zip(CHAIN.segment, CHAIN.local)], axis=1)  # noqa: B905
    found, shown = find_skeleton_poses(CHAIN, model, points, trunk, np.full(6, 0.01))
    assert np.allclose(found.track.turn[:, 1], upper, atol=1e-7)
    assert np.allclose(found.track.angle[:, 1, 0], flexion)
    assert np.allclose(predict_positions(model, found.track), points)
    assert shown.all()
    noisy, _ = find_skeleton_poses(CHAIN, model, points + rng.normal(0, 0.15, points.shape), trunk, np.full(6, 0.01))
    assert noisy.track.angle[:, 1, 0].min() >= LEAST_FLEXION


def test_jumps_are_left_out_and_short_gaps_are_filled() -> None:
    time = np.arange(90) / 30
    points = np.stack([np.sin(3 * time), np.cos(3 * time), time], axis=1)[:, None] * 0.3
    hit = points.copy()
    hit[40, 0] += 0.1
    kept = remove_jumps(hit, np.array([0.04]))
    assert np.flatnonzero(np.isnan(kept[:, 0, 0])).tolist() == [40]
    assert np.allclose(bridge_short_gaps(kept, 3), points, atol=2e-3)
    kept[50:60] = np.nan
    assert np.isnan(bridge_short_gaps(kept, 3)[50:60]).all()
