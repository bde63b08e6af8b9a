"""Markers with inertial sensors: derivatives of the measurements, clocks, gaps, and sensors that contradict."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from spatial_cases import UP, mixed_chain, true_chain

from mocap_id.estimation.inertial import SensorSignals
from mocap_id.estimation.space import SpatialStates, smooth_in_space
from mocap_id.estimation.space.frame_poses import degrees_of_freedom, make_chain_model, make_track
from mocap_id.estimation.space.skeleton_smoothing import SensorResult, fuse_in_space
from mocap_id.estimation.space.space_kernels import Pose, Sensors, predict_sensors
from mocap_id.geometry import so3
from mocap_id.recording.imu_log import ImuLog
from mocap_id.stages.skin_motion import add_axial_rotation_errors
from mocap_id_simulation import ArmOptions, SimulatedSpaceTrial, generate_arm
from mocap_id_simulation.arm_files import simulate_sensors

ON = (0, 1, 2)
GAP = slice(840, 960)  # one second


@pytest.fixture(scope="module")
def case() -> tuple[SimulatedSpaceTrial, list[tuple[ImuLog, dict[str, Any]]]]:
    options = ArmOptions(seed=21, cycles=1)
    trial = generate_arm(options)
    sensors = simulate_sensors(trial, options)
    return trial, [sensors[name] for name in trial.segments]


def fused(
    trial: SimulatedSpaceTrial, sensors: dict[int, tuple[ImuLog, dict[str, Any]]], points: np.ndarray | None = None
) -> tuple[SpatialStates, dict[int, SensorResult]]:
    seen = trial.positions @ UP.T if points is None else points
    given = {s: SensorSignals(each.time, each.gyro, each.acc) for s, (each, _) in sensors.items()}
    return fuse_in_space(seen, trial.time, true_chain(trial), given)


@pytest.fixture(scope="module")
def both(case) -> tuple[SpatialStates, dict[int, SensorResult]]:
    trial, sensors = case
    return fused(trial, {s: sensors[s] for s in ON})


def acceleration_error(trial: SimulatedSpaceTrial, states: SpatialStates, s: int) -> float:
    off = (states.alpha[:, s] - trial.alpha[:, s] @ UP.T)[trial.time > trial.still + 0.5]
    return float(np.sqrt(np.nanmean(np.sum(off**2, axis=1))))


def sensed(chain, model, pose: Pose, rng: np.random.Generator, *, jacobian: bool = False):
    count = len(chain.joints) + 1
    none, axes = np.zeros((1, count, 3)), np.array([[0.0, 1.0, 0.0], *(each.long_axis for each in chain.joints)])
    place, lag = 0.2 * rng.standard_normal((count, 3)), np.array([0.0, *rng.uniform(0, 0.3, count - 1)])
    variance, parent = np.zeros((1, count, 2)), np.array([0, *(each.parent for each in chain.joints)])
    rest = np.array([[0.0, 1.0, 0.0], *(each.untwisted @ each.long_axis for each in chain.joints)])
    sensors = Sensors(np.arange(count), place, lag, axes, parent, rest, none, none, variance, variance[0], 9.81)
    gyro, force = np.zeros((1, count, 3)), np.zeros((1, count, 3))
    rows = np.zeros((int(jacobian), count, 6, 3 * degrees_of_freedom(model)))
    predict_sensors(model, pose, sensors, gyro, force, rows)
    return np.concatenate([gyro, force], axis=2)[0], rows, place, lag, axes


def moved(chain, model, pose: Pose, by: np.ndarray) -> Pose:
    """Move one frame by a tangent vector (3 d,) of pose, velocity and acceleration."""
    d = degrees_of_freedom(model)
    new = Pose(*(each.copy() for each in pose))
    new.origin[0] += by[:3]
    new.turn[0, 0] = new.turn[0, 0] @ so3.exp(by[3:6])
    for k, joint in enumerate(chain.joints):
        own = by[model.first[k + 1] : model.first[k + 1] + joint.dimension]
        if joint.kind == "ball":
            new.turn[0, k + 1] = new.turn[0, k + 1] @ so3.exp(own)
        else:
            new.angle[0, k, : len(own)] += own
            new.turn[0, k + 1] = joint.rotation(new.angle[0, k, : len(own)])
    new.rate[0, :2] += by[d:].reshape(2, d)
    return new


@pytest.mark.parametrize("seed", [0, 1])
def test_derivatives_of_what_sensors_measure(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chain = mixed_chain(rng)
    for joint in chain.joints:
        joint.glide[:] = 0.0  # the derivatives by the glide are approximate
    model = make_chain_model(chain)
    d = degrees_of_freedom(model)
    pose = moved(chain, model, make_track(model, 1), rng.standard_normal(3 * d))
    rows = sensed(chain, model, pose, np.random.default_rng(9), jacobian=True)[1][0]
    for c in range(3 * d):
        step = 1e-6 * np.eye(3 * d)[c]
        near = (moved(chain, model, pose, by) for by in (step, -step))
        ends = [sensed(chain, model, each, np.random.default_rng(9))[0] for each in near]
        np.testing.assert_allclose(rows[:, :, c], (ends[0] - ends[1]) / 2e-6, atol=1e-6)


def test_measurements_are_derivatives_along_a_movement() -> None:
    """The predictions agree with differences of positions and rotations, the glide included."""
    rng = np.random.default_rng(3)
    chain = mixed_chain(rng)
    model = make_chain_model(chain)
    d, step = degrees_of_freedom(model), 1e-4
    start = moved(chain, model, make_track(model, 1), np.concatenate([rng.standard_normal(d), np.zeros(2 * d)]))
    rate, grows = rng.standard_normal(d), rng.standard_normal(d)
    start.rate[0, :2] = rate, grows
    values, _, place, lag, axes = sensed(chain, model, start, np.random.default_rng(9))
    poses = []
    for t in (-step, 0.0, step):
        by = np.concatenate([t * rate + t**2 / 2 * grows, np.zeros(2 * d)])
        at = moved(chain, model, start, by)
        origins, turns = chain.place(at.origin, at.turn[:, 0], at.turn[:, 1:])
        twists = [0.0, *(joint.twist(at.turn[0, k]) for k, joint in enumerate(chain.joints, start=1))]
        poses.append((origins[0] + np.einsum("sij,sj->si", turns[0], place), turns[0], np.array(twists)))
    turn = poses[1][1]
    force = (poses[0][0] - 2 * poses[1][0] + poses[2][0]) / step**2 + [0.0, 9.81, 0.0]
    np.testing.assert_allclose(values[:, 3:], np.einsum("sji,sj->si", turn, force), atol=1e-5)
    spin = so3.log(np.swapaxes(poses[0][1], 1, 2) @ poses[2][1]) / (2 * step)
    twist = lag * (poses[2][2] - poses[0][2]) / (2 * step)
    np.testing.assert_allclose(values[:, :3], spin - twist[:, None] * axes, atol=1e-6)


def test_accelerations_are_better_and_intervals_hold(case, both) -> None:
    trial, _ = case
    alone = smooth_in_space(trial.positions @ UP.T, trial.rate, true_chain(trial))
    states, results = both
    assert all(each.why is None for each in results.values())
    for s in (1, 2):
        assert acceleration_error(trial, states, s) < 0.6 * acceleration_error(trial, alone, s)
    off = np.abs(states.alpha[:, 2] - trial.alpha[:, 2] @ UP.T)
    assert np.mean(off < 1.96 * states.sd_alpha[:, 2, None]) > 0.88


def test_the_share_that_skin_misses_under_a_sensor_sets_the_rates(case, both) -> None:
    trial, _ = case
    plain = true_chain(trial)
    chain = replace(plain, skin=np.where(plain.segment == 1, 0.2, 0.0), skin_sd=np.full(len(plain.segment), 0.05))
    known = np.isfinite(both[0].sd_alpha[:, 1])
    wide, narrow, soft = (
        add_axial_rotation_errors(both[0], chain, common=0.1, missed=missed) for missed in (None, {1: 0.05}, {1: 0.5})
    )
    for name in ("sd_omega", "sd_alpha"):
        small, middle, large = (getattr(each, name)[known, 1] for each in (narrow, wide, soft))
        assert np.all(small <= middle)
        assert np.all(middle <= large)
        assert np.all(large >= getattr(both[0], name)[known, 1])
    np.testing.assert_array_equal(narrow.joint_covariance[:, 0, :3, :3], wide.joint_covariance[:, 0, :3, :3])


def test_clocks_are_found_or_said_to_be_unknown(case, both) -> None:
    trial, sensors = case
    middle = trial.time[len(trial.time) // 2]
    for s, result in both[1].items():
        truth = sensors[s][1]
        off = (middle - truth["offset_s"]) / (1 + 1e-6 * truth["ppm"]) - float(result.calibration.clock.stamps(middle))
        assert abs(off) < 3 * result.calibration.clock.sd
        assert abs(off) < 2e-3 or not result.calibration.clock.observable
        bias = (np.array(truth["gyro_bias_start"]) + truth["gyro_bias_end"]) / 2
        assert np.all(np.abs(result.calibration.gyro_bias - bias) < 4 * result.calibration.sd["gyro_bias"] + 1e-3)
    assert both[1][2].calibration.clock.observable


def test_a_gap_stays_bounded(case, both) -> None:
    trial, sensors = case
    points = trial.positions @ UP.T
    points[GAP] = np.nan
    states, _ = fused(trial, {s: sensors[s] for s in ON}, points)
    between = np.swapaxes(both[0].rotations[GAP], 2, 3) @ states.rotations[GAP]
    off = np.degrees(np.linalg.norm(so3.log(between), axis=-1))[:, :3]
    assert off.max() < 3.0
    assert np.mean(off < 1.96 * np.sqrt(3) * np.degrees(states.sd_rotation[GAP, :3])) > 0.88


def test_two_seconds_without_markers_do_not_interpolate_the_twist(case, both) -> None:
    trial, sensors = case
    twist = np.unwrap(np.asarray(trial.angles["shoulder_axial"] + trial.angles["shoulder_plane"]))
    starts = range(600, len(twist) - 600, 60)
    first = max(starts, key=lambda k: np.abs(twist[k : k + 240] - np.linspace(twist[k], twist[k + 239], 240)).max())
    gap = slice(first, first + 240)
    points = trial.positions @ UP.T
    points[gap] = np.nan
    states, _ = fused(trial, {s: sensors[s] for s in ON}, points)
    between = np.swapaxes(both[0].rotations[gap], 2, 3) @ states.rotations[gap]
    off = np.degrees(np.linalg.norm(so3.log(between), axis=-1))[:, :3]
    assert np.abs(twist[gap] - np.linspace(twist[first], twist[first + 239], 240)).max() > 0.2
    assert off.max() < 1.5


def test_an_accelerometer_without_gravity_is_left_out(case) -> None:
    trial, sensors = case
    log, truth = sensors[0]
    slow = replace(log, acc=log.acc - log.acc.mean(axis=0))
    _, results = fused(trial, {0: (slow, truth)})
    assert "gravity was probably removed" in str(results[0].why)


def test_swapped_sensors_are_named_and_left_out(case) -> None:
    trial, sensors = case
    alone = smooth_in_space(trial.positions @ UP.T, trial.rate, true_chain(trial))
    states, results = fused(trial, {1: sensors[2], 2: sensors[1]})
    assert {s: each.better_segment for s, each in results.items()} == {1: 2, 2: 1}
    assert all(each.why for each in results.values())
    np.testing.assert_array_equal(states.alpha, alone.alpha)
