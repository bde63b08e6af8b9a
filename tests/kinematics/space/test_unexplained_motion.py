"""Motion that the joints next to a body explain, as skin does, and motion of its own, as a hidden joint has."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.kinematics.space.bodies import (
    SpatialBody,
    fit_spatial_body,
    gain_of_parts,
    unexplained_distance_sd,
    unexplained_motion,
)
from mocap_id.kinematics.space.segmentation import segment_in_space
from mocap_id_simulation import simulate_arm

FRAMES = 300
PARTS = (np.arange(4), np.arange(4, 8))
ELBOW = 1.2 * np.sin(np.linspace(0, 31, FRAMES))
WRIST = np.radians(6) * np.sin(np.linspace(0, 47, FRAMES) + 1)


def limb(turned: FloatArray) -> tuple[FloatArray, SpatialBody, SpatialBody]:
    """Return a base, and a limb whose far half turns by angles (F,) about x: all points, the limb and the base."""
    rng = np.random.default_rng(0)
    base, near, far = rng.uniform(-0.05, 0.05, (3, 4, 3))
    near[:, 0] += 0.2
    far[:, 0] += 0.4
    moved = far @ np.swapaxes(so3.exp(turned[:, None] * np.array([1.0, 0, 0])), 1, 2)
    local = np.concatenate([np.broadcast_to(near, (FRAMES, 4, 3)), moved], axis=1)
    arm = local @ np.swapaxes(so3.exp(ELBOW[:, None] * np.array([0, 0.6, 0.8])), 1, 2)
    points = np.concatenate([arm, np.broadcast_to(base, (FRAMES, 4, 3))], axis=1)
    points = points + rng.normal(0, 0.0003, points.shape)
    return points, fit_spatial_body(points, np.arange(8)), fit_spatial_body(points, np.arange(8, 12))


def test_skin_that_follows_a_joint_has_no_motion_of_its_own() -> None:
    points, body, base = limb(0.2 * ELBOW + 0.03 * ELBOW**2)
    motion, shape = unexplained_motion(points, body, [base])
    before, _ = unexplained_motion(points, body, [])
    assert gain_of_parts(before, shape, PARTS) > 3
    assert gain_of_parts(motion, shape, PARTS) < 0.5
    assert unexplained_distance_sd(motion, shape).max() < 0.5 * unexplained_distance_sd(before, shape).max()


def test_a_hidden_joint_keeps_its_motion() -> None:
    points, body, base = limb(WRIST)
    motion, shape = unexplained_motion(points, body, [base])
    assert gain_of_parts(motion, shape, PARTS) > 2
    deviation = unexplained_distance_sd(motion, shape)
    assert deviation[:4, :4].max() < deviation[:4, 4:].max() / 2


def test_gaps_do_no_harm() -> None:
    points, body, base = limb(WRIST)
    points[40:90, 3] = np.nan
    points[:, 5] = np.nan
    motion, shape = unexplained_motion(points, fit_spatial_body(points, body.markers), [base])
    assert np.isfinite(motion).all()
    assert (motion[40:90, 3] == 0).all()
    assert (motion[:, 5] == 0).all()
    assert gain_of_parts(motion, shape, PARTS) > 0.7


@pytest.mark.parametrize("seed", [604, 616, 636])
def test_a_hand_that_hardly_moves_on_soft_skin_is_a_segment(seed: int) -> None:
    trial = simulate_arm(seed, "hard", cycles=1, severity=0.5, anonymous=True)
    found = segment_in_space(trial.positions)
    here = np.array([name != "AC" for name in trial.names])
    np.testing.assert_array_equal(found.segment[here], trial.assignment[here])
