"""Feet that change their place are followed; feet that stay, rest or lift are not moved."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.arrays import FloatArray
from mocap_id.kinematics.base_motion import BaseMotion, find_base_motion, find_heel_lift
from mocap_id_simulation.sit_to_stand import smoothstep

RATE = 100.0
TIME = np.arange(2000) / RATE
FEET = np.array([[0.1, 0.1, 0.05], [-0.12, 0.12, 0.04], [0.1, -0.1, 0.05], [-0.12, -0.12, 0.04]])
PLATE = np.array([[0.3, 0.3, 0.0], [-0.3, 0.3, 0.0], [0.3, -0.3, 0.0]])
CHANGE = smoothstep((TIME - 9.0) / 1.0)


def person(shift: FloatArray, turn: float, noise: float = 5e-4) -> tuple[FloatArray, FloatArray]:
    """Return markers (F, 15, 3) of plate, feet and a swinging body, of one who moves at 9 to 10 s and one who stays."""
    rng = np.random.default_rng(0)
    place = np.concatenate([FEET, np.column_stack([rng.uniform(-0.2, 0.2, (8, 2)), rng.uniform(0.6, 1.6, 8)])])
    swing = np.sin(2 * np.pi * TIME / 4)[:, None] * np.repeat([0, 1], [4, 8])
    stays = place + swing[..., None] * [0.3, 0.0, 0.1]
    angle, away = turn * CHANGE[:, None], CHANGE[:, None] * shift
    c, s, (x, y, z) = np.cos(angle), np.sin(angle), np.moveaxis(stays, -1, 0)
    moved = np.stack([c * x - s * y, s * x + c * y, z], axis=-1) + np.column_stack([away, 0 * TIME])[:, None]
    plate = np.broadcast_to(PLATE, (len(TIME), 3, 3))
    error = noise * rng.standard_normal((len(TIME), 15, 3))
    return np.concatenate([plate, moved], axis=1) + error, np.concatenate([plate, stays], axis=1) + error


def found(positions: FloatArray) -> BaseMotion:
    motion = find_base_motion(positions, TIME[: len(positions)], RATE)
    assert motion is not None
    return motion


@pytest.mark.parametrize(
    ("shift", "turn_deg"), [([0.02, 0.0], 0.0), ([-0.05, 0.03], 0.0), ([0.0, 0.0], 10.0), ([0.03, 0.02], -15.0)]
)
def test_a_person_who_moves_is_expressed_like_one_who_stays(shift: list[float], turn_deg: float) -> None:
    moved, stays = person(np.array(shift), np.radians(turn_deg))
    motion = found(moved)
    assert motion.rigid
    assert np.degrees(motion.stretches[1].turn) == pytest.approx(turn_deg, abs=0.1)
    assert motion.stretches[0].end < 9.1
    assert motion.stretches[1].start > 9.9
    np.testing.assert_allclose(motion.undo_positions(moved, TIME), stays, atol=3e-3)
    np.testing.assert_array_equal(motion.undo_positions(moved, TIME)[:, :3], moved[:, :3])


def test_the_wrench_moves_with_the_body() -> None:
    """The force keeps its line of action in the body, and its moment about every point of the body."""
    moved, _ = person(np.array([0.04, -0.02]), np.radians(8.0), noise=0.0)
    motion = found(moved)
    rng = np.random.default_rng(1)
    force, moment = rng.normal(size=(2, len(TIME), 3))
    point = moved[:, 5]
    back_force, back_moment = motion.undo_wrench(force, moment, TIME)
    back_point = motion.undo_positions(moved, TIME)[:, 5]
    before, after = moment - np.cross(point, force), back_moment - np.cross(back_point, back_force)
    np.testing.assert_allclose(np.linalg.norm(back_force, axis=1), np.linalg.norm(force, axis=1))
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1))
    np.testing.assert_allclose(np.sum(after * back_force, axis=1), np.sum(before * force, axis=1), atol=1e-12)
    np.testing.assert_allclose(after[:, 2], before[:, 2], atol=1e-12)


@pytest.mark.parametrize("shift", [0.0, 0.004])
def test_a_base_that_keeps_its_place_is_left_alone(shift: float) -> None:
    assert find_base_motion(person(np.array([shift, 0.0]), 0.0)[0], TIME, RATE) is None


def test_feet_that_move_one_by_one_are_not_one_base() -> None:
    moved, _ = person(np.zeros(2), 0.0)
    moved[:, 3:5, 0] += 0.05 * CHANGE[:, None]
    motion = found(moved)
    assert not motion.rigid
    assert motion.stretches[1].turn == 0
    assert motion.stretches[1].misfit == pytest.approx(0.025, abs=3e-3)


@pytest.mark.parametrize("seconds", [4.0, 8.0, 20.0])
@pytest.mark.parametrize("slide", [0.015, 0.03])
def test_feet_that_slide_slowly_are_followed(slide: float, seconds: float) -> None:
    """A millimetre per second looks like standing still in every step, and adds up."""
    _, stays = person(np.zeros(2), 0.0)
    course = slide * np.clip((TIME - 10.0) / seconds + 0.5, 0, 1)
    moved = stays + np.column_stack([course, 0 * TIME, 0 * TIME])[:, None] * np.repeat([0, 1], [3, 12])[:, None]
    motion = found(moved)
    assert motion.rigid
    off = motion.undo_positions(moved, TIME) - stays
    assert np.abs(off - np.median(off, axis=0))[:, 3:].max() < 0.005


@pytest.mark.parametrize("course", [CHANGE, TIME / TIME[-1]])
def test_one_foot_that_slides_alone_is_not_one_base(course: FloatArray) -> None:
    moved, _ = person(np.zeros(2), 0.0)
    moved[:, 3:5, 0] += 0.015 * course[:, None]
    assert not found(moved).rigid


def test_skin_that_returns_with_every_repetition_is_no_slide() -> None:
    _, stays = person(np.zeros(2), 0.0)
    stays[:, 3, 0] += 0.006 * np.sin(2 * np.pi * TIME / 8) ** 2
    assert find_base_motion(stays, TIME, RATE) is None


def test_feet_that_slide_while_the_body_moves_for_a_short_time_are_found() -> None:
    moved, _ = person(np.array([0.02, 0.0]), 0.0)
    assert found(moved[600:1300]).rigid


def test_a_rest_and_a_walk_have_no_base_that_moves() -> None:
    still = np.broadcast_to(person(np.zeros(2), 0.0)[0][:1], (2000, 15, 3))
    assert find_base_motion(still, TIME, RATE) is None
    walk = still + np.column_stack([TIME, 0 * TIME, 0 * TIME])[:, None]
    assert find_base_motion(walk, TIME, RATE) is None


def lifted(turn_deg: float) -> FloatArray:
    """Return markers of a person whose right foot turns about its toes for a second in every 4 s."""
    moved, _ = person(np.zeros(2), 0.0)
    angle = np.radians(turn_deg) * np.maximum(0, np.sin(2 * np.pi * TIME / 4)) ** 4
    arm = moved[:, 3] - [-0.14, 0.1, 0.0]
    c, s = np.cos(angle), np.sin(angle)
    moved[:, 3, 0] = -0.14 + c * arm[:, 0] - s * arm[:, 2]
    moved[:, 3, 2] = s * arm[:, 0] + c * arm[:, 2]
    arm = moved[:, 4] - [-0.14, 0.1, 0.0]
    moved[:, 4, 0] = -0.14 + c * arm[:, 0] - s * arm[:, 2]
    moved[:, 4, 2] = s * arm[:, 0] + c * arm[:, 2]
    return moved


@pytest.mark.parametrize("turn_deg", [5.0, 8.0, 20.0])
def test_a_heel_that_lifts_is_found(turn_deg: float) -> None:
    lift = find_heel_lift(lifted(turn_deg), TIME, RATE)
    assert lift is not None
    assert lift[:2] == (3, 4)
    assert np.degrees(lift[3]) == pytest.approx(turn_deg, rel=0.15)


@pytest.mark.parametrize("turn_deg", [0.0, 2.0])
def test_feet_that_stay_flat_do_not_lift(turn_deg: float) -> None:
    assert find_heel_lift(lifted(turn_deg), TIME, RATE) is None
