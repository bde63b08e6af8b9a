"""Facing direction from unlabelled markers."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.recording.sample_checks import find_body_facing

X = np.array([1.0, 0.0])


def sitting_down(front: float, *, hands: bool = False, trunk: bool = True) -> np.ndarray:
    """Return markers (F, M, 3) of a person who sits down and rises, facing +x (front = 1) or -x (front = -1)."""
    bend = 0.5 - 0.5 * np.cos(np.linspace(0, 4 * np.pi, 200))
    shank, thigh, lean = 0.15 * bend, 1.4 * bend, 0.5 * bend
    knee = np.stack([0.45 * np.sin(shank), 0.08 + 0.45 * np.cos(shank)])
    hip = knee + 0.42 * np.stack([np.sin(shank - thigh), np.cos(shank - thigh)])
    up = np.stack([np.sin(lean), np.cos(lean)])
    points = [np.stack([0 * bend + x, 0 * bend + 0.02]) for x in (-0.05, 0.12)]
    points += [np.stack([0 * bend, 0 * bend + 0.08]) + s * (knee - [[0.0], [0.08]]) for s in (0.4, 0.7, 0.95)]
    points += [knee + s * (hip - knee) for s in (0.2, 0.5, 0.8)] + [hip]
    if trunk:
        points += [hip + s * up for s in (0.3, 0.5, 0.75)]
    if hands:
        points += [hip + 0.5 * up + np.stack([0.5 * bend + d, -0.45 + 0.4 * bend]) for d in (0.0, 0.03, 0.06)]
    plane = np.stack(points, axis=1)  # (2, M, F)
    return np.stack([front * plane[0].T, 0.1 + 0 * plane[0].T, plane[1].T], axis=2)


@pytest.mark.parametrize("front", [1.0, -1.0])
@pytest.mark.parametrize("options", [{}, {"hands": True}, {"trunk": False}])
def test_knees_of_people_who_sit_down_are_in_front(front: float, options: dict[str, bool]) -> None:
    found = find_body_facing(sitting_down(front, **options), X)
    assert found.rule == "knees"
    assert found.forwards == (front > 0)
    assert found.sure


def test_the_direction_turns_with_the_person() -> None:
    positions = sitting_down(1.0)
    turned = positions[..., [1, 0, 2]]
    assert find_body_facing(turned, np.array([0.0, 1.0])).forwards
    assert not find_body_facing(turned, np.array([0.0, -1.0])).forwards


@pytest.mark.parametrize("front", [1.0, -1.0])
def test_moving_arms_are_in_front(front: float) -> None:
    swing = np.linspace(0.2, 1.4, 100)
    trunk = np.array([[-0.05, 0, 1.4], [0.03, 0, 1.5], [0.0, 0, 1.3]])
    hand = np.stack([front * 0.6 * np.sin(swing), 0 * swing, 1.4 - 0.6 * np.cos(swing)], axis=1)
    positions = np.concatenate([np.broadcast_to(trunk, (100, 3, 3)), hand[:, None]], axis=1)
    found = find_body_facing(positions, X)
    assert found.rule == "reach"
    assert found.forwards == (front > 0)


def test_a_motionless_body_has_no_facing_direction() -> None:
    found = find_body_facing(np.broadcast_to(sitting_down(1.0)[:1], (50, 12, 3)), X)
    assert not found.sure
    assert not found.forwards
    assert not find_body_facing(np.full((10, 2, 3), np.nan), X).sure
