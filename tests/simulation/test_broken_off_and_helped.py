"""Failed, stopped and supported rises: forces agree with momentum and with the options."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.errors import ConfigError
from mocap_id.geometry import planar
from mocap_id_simulation import Options
from mocap_id_simulation.forces import HAND, TRUNK
from mocap_id_simulation.scene import Scene, draw_scene, random_streams

STEP = 2e-3


def scene(**options: float) -> Scene:
    return draw_scene("sit-to-stand", Options(seed=21, repetitions=2, **options), random_streams(21))


@pytest.mark.parametrize("options", [{"attempts": 1}, {"hold": 0.8}, {"rail": 0.2}])
def test_all_forces_together_move_the_centre_of_mass(options: dict[str, float]) -> None:
    made = scene(**options)
    time = np.linspace(1.0, made.motion.duration - 1.0, 300)
    before, now, after = (made.at(time + h).com for h in (-STEP, 0.0, STEP))
    state = made.at(time)
    acceleration = (after - 2 * now + before) / STEP**2 + np.array([0.0, 9.81])
    np.testing.assert_allclose(state.wrench_total[:, :2], made.body.mass * acceleration, atol=0.5)


def test_what_the_plate_and_the_chair_do_not_carry_is_the_rail_s() -> None:
    made = scene(rail=0.2)
    time = np.linspace(0.0, made.motion.duration, 500)
    state = made.at(time)
    x, y = state.chair_point.T
    fx, fy = state.chair_force.T
    missing = state.wrench_total - state.wrench - np.column_stack([fx, fy, x * fy - y * fx])
    share = missing[:, 1] / state.wrench_total[:, 1]
    assert share.max() == pytest.approx(0.2, abs=1e-3)
    assert np.abs(missing[:, 0]).max() < 1e-9
    angle, origin = planar.segment_poses(state.q, made.body.centres)
    hand = origin[:, TRUNK] + planar.rotate(angle[:, TRUNK], np.array(HAND))
    np.testing.assert_allclose(missing[:, 2], hand[:, 0] * missing[:, 1], atol=1e-6)
    for each in made.protocol["reps"]:
        standing = (time > each["rise_end"]) & (time < each["sit_start"])
        assert np.abs(share[standing]).max() < 1e-9


def test_an_attempt_releases_the_chair_and_comes_back() -> None:
    made = scene(attempts=1)
    (attempt,) = made.protocol["attempts"]
    at_rest, at_top, back = made.at(np.array([attempt["start"], attempt["top"], attempt["end"]])).chair_force[:, 1]
    assert abs(at_top) < 1e-6 * at_rest
    assert back == pytest.approx(at_rest, rel=0.05)
    hips = made.at(np.linspace(0.0, made.motion.duration, 2000)).joint_xy[:, 2, 1]
    rise = np.ptp(hips)
    top = made.at(np.array([attempt["start"], attempt["top"]])).joint_xy[:, 2, 1]
    assert 0.08 * rise < top[1] - top[0] < 0.5 * rise


def test_a_hold_keeps_the_hips_where_they_are_half_way() -> None:
    made, plain = scene(hold=1.0), scene()
    hold, last = made.protocol["hold"], made.protocol["reps"][-1]
    assert hold["repetition"] == 1
    assert last["rise_end"] - last["seat_off"] == pytest.approx(
        1.0 + plain.protocol["reps"][-1]["rise_end"] - plain.protocol["reps"][-1]["seat_off"]
    )
    time = np.linspace(0.0, made.motion.duration, 4000)
    hips = made.at(time).joint_xy[:, 2, 1]
    height = (hips - hips.min()) / np.ptp(hips)
    middle = (time > last["seat_off"]) & (time < last["rise_end"]) & (height > 0.2) & (height < 0.9)
    speed = np.abs(np.gradient(height, time))
    assert np.ptp(time[middle & (speed < 0.05)]) == pytest.approx(1.0, abs=0.45)


@pytest.mark.parametrize("options", [{"attempts": 3}, {"attempts": -1}, {"hold": 11.0}, {"rail": 0.6}])
def test_options_out_of_range_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(options))):
        Options(repetitions=2, **options)
