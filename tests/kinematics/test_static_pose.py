"""The joint angles of a static pose: those with which the markers were placed, wherever the person looks."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.geometry.planar import PlaneFrame, marker_positions
from mocap_id.kinematics.chain_fit import fit_static_pose

CENTRES = np.array([[0.02, 0.08], [0.0, 0.41], [0.0, 0.42]])
SEGMENT = np.repeat([0, 1, 2, 3], 4)
LOCAL = np.array(
    [
        *([-0.06, 0.03], [0.15, 0.02], [-0.06, 0.03], [0.15, 0.02]),
        *([0.05, 0.1], [-0.04, 0.3], [0.05, 0.1], [-0.04, 0.3]),
        *([0.06, 0.1], [0.05, 0.3], [0.06, 0.1], [0.05, 0.3]),
        *([0.08, 0.1], [-0.09, 0.12], [0.08, 0.1], [0.07, 0.4]),
    ]
)
LATERAL = np.tile([-0.12, -0.12, 0.12, 0.12], 4)
POSE = np.array([0.16, -0.11, -0.3])


def place(yaw: float, at: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Return the markers in the lab of a person who stands at ``at`` and looks along ``yaw``."""
    plane = np.column_stack([marker_positions(POSE, CENTRES, SEGMENT, LOCAL), LATERAL])[keep]
    return plane @ PlaneFrame(yaw).axes + at


@pytest.mark.parametrize("yaw", [0.0, 0.4, 1.9, 3.1, -2.3])
def test_the_pose_is_found_for_any_direction_and_place(yaw: float) -> None:
    everything = np.arange(len(SEGMENT))
    theta, _, residual = fit_static_pose(
        place(yaw, np.array([0.7, -1.2, 0.0]), everything), LATERAL, SEGMENT, LOCAL, CENTRES
    )
    assert np.degrees(np.abs(theta - POSE)).max() < 0.01
    assert residual < 1e-4


def test_a_segment_with_one_marker_is_held_by_its_joint() -> None:
    keep = np.flatnonzero((SEGMENT != 1) | (np.arange(len(SEGMENT)) == 5))
    points = place(0.8, np.zeros(3), keep)
    theta, _, _ = fit_static_pose(points, LATERAL[keep], SEGMENT[keep], LOCAL[keep], CENTRES)
    assert np.degrees(np.abs(theta - POSE)).max() < 0.01


def test_an_angle_that_no_marker_shows_is_unknown() -> None:
    keep = np.flatnonzero(SEGMENT != 3)
    points = place(0.8, np.zeros(3), keep)
    theta, _, _ = fit_static_pose(points, LATERAL[keep], SEGMENT[keep], LOCAL[keep], CENTRES)
    assert np.isnan(theta).tolist() == [False, False, True]


def test_errors_of_the_markers_are_within_the_standard_deviation() -> None:
    random = np.random.default_rng(3)
    everything, away = np.arange(len(SEGMENT)), []
    for _ in range(40):
        points = place(1.1, np.zeros(3), everything) + random.normal(0.0, 0.005, (len(SEGMENT), 3))
        theta, sd, _ = fit_static_pose(points, LATERAL, SEGMENT, LOCAL, CENTRES)
        away.append((theta - POSE) / sd)
    assert 0.5 < np.sqrt(np.mean(np.square(away))) < 1.3
