"""A simulated person keeps the centre of pressure inside the foot, and moves smoothly."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id_simulation import Options, generate
from mocap_id_simulation.scene import draw_scene, random_streams
from mocap_id_simulation.sit_to_stand import STRATEGIES, smoothstep

NAMES = sorted(STRATEGIES)


def person(seed: int, strategy: str = "normal", repetitions: int = 2):
    options = Options(seed=seed, strategy=strategy, repetitions=repetitions)
    scene = draw_scene("sit-to-stand", options, random_streams(seed))
    return scene, scene.at(np.arange(0, scene.motion.duration, 0.01))


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("seed", range(12))
def test_the_centre_of_pressure_stays_inside_the_foot(seed, strategy):
    scene, state = person(seed, strategy)
    low, high = scene.body.support
    assert low + 0.02 < state.cop_x.min()
    assert state.cop_x.max() < high - 0.02
    assert state.wrench[:, 1].min() > 0


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_the_chair_carries_nothing_from_seat_off_to_seat_on_and_never_pulls(strategy):
    scene, state = person(3, strategy)
    assert state.chair_force[:, 1].min() >= 0
    for each in scene.chair.schedule.repetitions:
        off = (state.time >= each.seat_off) & (state.time <= each.seat_on)
        assert not state.chair_force[off].any()
        before = (state.time > each.rise_start) & (state.time < each.seat_off - each.unload)
        assert state.chair_force[before, 1].min() > 0.4 * scene.body.mass * 9.81
        assert 0.2 <= each.unload <= 0.6


@pytest.mark.parametrize("seed", range(6))
def test_standing_weighs_m_g(seed):
    scene, state = person(seed)
    for each in scene.chair.schedule.repetitions:
        standing = (state.time > each.rise_end + 0.1) & (state.time < each.sit_start - 0.1)
        assert state.wrench[standing, 1].mean() == pytest.approx(9.81 * scene.body.mass, rel=0.01)


def test_the_order_of_a_repetition():
    scene, _ = person(1, repetitions=4)
    now = 0.0
    for each in scene.chair.schedule.repetitions:
        times = [each.rise_start, each.seat_off - each.unload, each.seat_off, each.rise_end]
        times += [each.sit_start, each.seat_on, each.seat_on + each.load, each.sit_end]
        assert times == sorted(times)
        assert each.rise_start > now
        now = each.sit_end
    assert now < scene.motion.duration


def test_strategies_differ_as_they_should():
    """Dynamic rising is quicker and leans further; stable rising moves over the feet before leaving the seat."""
    reached = {}
    for strategy in STRATEGIES:
        scene, state = person(5, strategy)
        first = scene.chair.schedule.repetitions[0]
        at_off = np.searchsorted(state.time, first.seat_off)
        over_feet = state.com[at_off, 0] - state.joint_xy[at_off, 0, 0]
        reached[strategy] = np.abs(state.qdd).max(), state.seg_angle[:, 2].max(), over_feet
    assert reached["stable"][0] < reached["normal"][0] < reached["dynamic"][0]
    assert reached["stable"][1] < reached["normal"][1] < reached["dynamic"][1]
    assert reached["stable"][2] < reached["normal"][2] < reached["dynamic"][2]


@pytest.mark.parametrize("kind", ["sit-to-stand", "robot"])
def test_derivatives_belong_together_and_the_snap_is_continuous(kind):
    scene = draw_scene(kind, Options(seed=2, repetitions=2), random_streams(2))
    time = np.linspace(0.5, scene.motion.duration - 0.5, 4001)
    step = 1e-4
    ahead, behind = scene.motion.at(time + step), scene.motion.at(time - step)
    for order in range(3):
        slope = (ahead[order] - behind[order]) / (2 * step)
        scale = np.abs(slope).max()
        np.testing.assert_allclose(slope, scene.motion.at(time)[order + 1], atol=1e-3 * scale)
    jumps = [np.abs(scene.motion.spline(time + h, 4) - scene.motion.spline(time, 4)).max() for h in (1e-4, 5e-5)]
    assert jumps[1] < 0.6 * jumps[0]


def test_the_knee_passes_the_gate_and_the_trunk_does_not_fold():
    for seed in range(6):
        _, state = person(seed)
        knee = state.q[:, 1]
        assert knee.min() < -1.5
        assert knee.max() > -0.2
        assert np.degrees(state.seg_angle[:, 2].max()) < 70


def test_smoothstep_goes_from_zero_to_one():
    phase = np.array([-1.0, 0.0, 0.5, 1.0, 2.0])
    np.testing.assert_allclose(smoothstep(phase), [0, 0, 0.5, 1, 1], atol=1e-15)


def test_noise_and_plate_leave_the_motion_alone():
    first = generate("sit-to-stand", Options(seed=4, repetitions=1))
    second = generate(
        "sit-to-stand", Options(seed=4, repetitions=1, marker_noise=0.002, occlusions=0, plate_moved=True)
    )
    np.testing.assert_array_equal(first.state.q, second.state.q)
    assert first.scene.plane.yaw == second.scene.plane.yaw
    assert generate("sit-to-stand", Options(seed=5, repetitions=1)).state.q[0, 0] != first.state.q[0, 0]
