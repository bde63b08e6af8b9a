"""Plates that slide on the bones as a whole."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.kinematics.space.chain_fit import fit_spatial_chain
from mocap_id.stages.skin_motion import correct_cluster_slides, fit_cluster_poses
from mocap_id_simulation import simulate_arm

_CENTRE = np.array([0.1, -0.05, 0.15])
_RATE = 60.0


def _two_plates(slide: float) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return the markers of two plates on a ball joint (F, 6, 3), their segments, and the rotations (F, 2, 3, 3)."""
    rng = np.random.default_rng(3)
    time = np.arange(900) / _RATE
    turns = np.stack(
        [
            so3.exp(0.1 * np.stack([np.sin(0.7 * time), np.cos(0.5 * time), np.sin(0.3 * time)], axis=1)),
            so3.exp(0.6 * np.stack([np.sin(1.1 * time), np.cos(0.9 * time), np.sin(0.6 * time)], axis=1)),
        ],
        axis=1,
    )
    shape = np.array([[0.02, 0, 0], [-0.02, 0.01, 0.01], [0.0, -0.01, 0.03]])
    away = slide * np.stack([np.sin(0.8 * time), np.sin(0.6 * time + 1), np.cos(0.4 * time)], axis=1)
    base = shape @ np.swapaxes(turns[:, 0], 1, 2)
    middle = turns[:, 0] @ _CENTRE + away
    child = (shape + np.array((0.02, -0.15, 0.0))) @ np.swapaxes(turns[:, 1], 1, 2) + middle[:, None]
    points = np.concatenate([base, child], axis=1)
    return points + rng.normal(0, 1e-4, points.shape), np.repeat([0, 1], 3), turns


def test_a_sliding_plate_keeps_its_rotation() -> None:
    points, segment, turns = _two_plates(0.008)
    chain = fit_spatial_chain(points, segment, (0,)).chain
    assert 0.003 < chain.joints[0].slide_sd < 0.009
    steady = correct_cluster_slides(points, chain, _RATE)
    before, after = (fit_cluster_poses(each, chain) for each in (points, steady))
    assert np.allclose(before[0], after[0])
    joint = chain.joints[0]

    def apart(rotations: FloatArray, origins: FloatArray) -> FloatArray:
        return origins[:, 1] - origins[:, 0] - np.einsum("fij,j->fi", rotations[:, 0], joint.centre)

    assert apart(*after)[30:-30].std() < 0.2 * apart(*before).std()
    found, true = (np.swapaxes(each[:, 0], 1, 2) @ each[:, 1] for each in (after[0], turns))
    from_start = [np.linalg.norm(so3.log(np.swapaxes(each[:1], 1, 2) @ each), axis=1) for each in (found, true)]
    assert np.degrees(np.abs(from_start[0] - from_start[1]).max()) < 1.5


def test_plates_on_bones_and_single_markers_on_skin_do_not_slide_as_a_whole() -> None:
    points, segment, _ = _two_plates(0.0)
    chain = fit_spatial_chain(points, segment, (0,)).chain
    assert chain.joints[0].slide_sd == 0
    assert correct_cluster_slides(points, chain, _RATE) is points
    arm = simulate_arm(2, "hard", cycles=1)
    up = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    fit = fit_spatial_chain(arm.positions @ up.T, arm.assignment, (0, 1, 2))
    assert not any(joint.slide_sd for joint in fit.chain.joints)
