"""Inertial sensors beside markers in the plane: the equations, and simulated sit-to-stands with exact truth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from mocap_id.arrays import FloatArray
from mocap_id.estimation import FilterSettings, States, smooth
from mocap_id.estimation.filter_kernels import Inertial, _force_rows
from mocap_id.estimation.filter_problem import MarkerChain
from mocap_id.estimation.inertial import SensorResult, SensorSignals
from mocap_id.estimation.inertial_tracking import smooth_with_sensors
from mocap_id_simulation import Options, generate
from mocap_id_simulation.forces import TrueState
from mocap_id_simulation.instruments import simulate_plane_sensors

GRAVITY = 9.81


@dataclass(frozen=True)
class Case:
    """A simulated person with the true chain."""

    observed: FloatArray
    chain: MarkerChain
    true: TrueState
    sensors: dict[int, SensorSignals]
    offsets: list[float]

    def run(self, observed: FloatArray, sensors: dict[int, SensorSignals]) -> tuple[States, dict[int, SensorResult]]:
        time = self.true.time
        return smooth_with_sensors(observed.copy(), time, self.chain, sensors=sensors, settings=FilterSettings())


@pytest.fixture(scope="module")
def case() -> Case:
    trial = generate("sit-to-stand", Options(seed=11, repetitions=2, analog_rate=100))
    scene, found = trial.scene, simulate_plane_sensors(11, trial.scene, trial.state, 1.0)
    markers = scene.markers
    chain = MarkerChain(scene.body.centres.copy(), markers.link.astype(np.int64), markers.local[:, :2].copy())
    sensors = {s: SensorSignals(each.time, each.gyro, each.acc) for s, (each, _) in enumerate(found.values(), start=1)}
    middle = float(trial.state.time.mean())
    offsets = [truth["offset_s"] + 1e-6 * truth["ppm"] * middle for _, truth in found.values()]
    points = np.ascontiguousarray(scene.plane.to_plane(trial.points)[..., :2])
    return Case(points, chain, trial.state, sensors, offsets)


@pytest.fixture(scope="module")
def both(case: Case) -> tuple[States, dict[int, SensorResult]]:
    return case.run(case.observed, case.sensors)


def _force(inertial: Inertial, s: int, x: FloatArray, centres: FloatArray) -> FloatArray:
    rows = np.zeros((2, len(x) + 1))
    _force_rows(inertial, s, x, centres, rows)
    return rows


def test_derivatives_of_the_force_equal_finite_differences() -> None:
    rng = np.random.default_rng(0)
    centres, place, share = rng.normal(size=(3, 2)), rng.normal(size=(3, 2)), 0.1 * rng.normal(size=(3, 3))
    none = np.empty((0, 3, 3))
    inertial = Inertial(np.arange(1, 4), place, share, rng.normal(size=3), none, none, GRAVITY)
    x, step = rng.normal(size=12), 1e-6
    for s in range(3):
        rows = _force(inertial, s, x, centres)
        for k in range(12):
            ends = [_force(inertial, s, x + sign * step * np.eye(12)[k], centres)[:, 12] for sign in (1, -1)]
            assert rows[:, k] == pytest.approx((ends[0] - ends[1]) / (2 * step), abs=1e-6)


def test_the_force_on_a_pendulum_is_that_of_its_position() -> None:
    time, step = 0.7, 1e-4
    centres, place = np.array([[0.0, 0.1], [0.0, 0.4]]), np.array([[0.05, 0.3]])

    def position(t: float) -> complex:
        first, second = 0.5 * math.sin(2 * t), 0.8 * math.cos(3 * t)
        return 0.4j * np.exp(1j * first) + complex(*place[0]) * np.exp(1j * (first + second))

    x = np.array(
        [
            *(0.5 * math.sin(2 * time), 0.8 * math.cos(3 * time), math.cos(2 * time), -2.4 * math.sin(3 * time)),
            *(-2 * math.sin(2 * time), -7.2 * math.cos(3 * time), 0.0, 0.0),
        ]
    )
    none = np.empty((0, 1, 3))
    inertial = Inertial(np.array([2]), place, np.zeros((1, 2)), np.zeros(2), none, none, GRAVITY)
    felt = _force(inertial, 0, x, centres)[:, 8]
    moved = (position(time + step) - 2 * position(time) + position(time - step)) / step**2
    expected = (moved + 1j * GRAVITY) * np.exp(-1j * (x[0] + x[1]))
    assert felt == pytest.approx([expected.real, expected.imag], abs=1e-5)


def test_sensors_improve_the_rates(case: Case, both: tuple[States, dict[int, SensorResult]]) -> None:
    alone = smooth(case.observed, 100.0, case.chain)
    error = [
        np.sqrt(np.mean((states.mean[50:-50, :, 2] - case.true.qdd[50:-50]) ** 2, axis=0))
        for states in (both[0], alone)
    ]
    assert np.mean(error[0] / error[1]) < 0.6


def test_clocks_are_found_or_said_to_be_unknown(case: Case, both: tuple[States, dict[int, SensorResult]]) -> None:
    for result, offset in zip(both[1].values(), case.offsets, strict=True):
        assert result.why is None
        clock = result.calibration.clock
        off = clock.offset + clock.drift * float(case.true.time.mean()) - offset
        assert abs(off) < 3 * clock.sd
        assert abs(off) < 2e-3 or not clock.observable


def test_two_seconds_without_markers(case: Case, both: tuple[States, dict[int, SensorResult]]) -> None:
    middle = int(np.argmax(np.abs(case.true.qd).sum(axis=1)))
    hidden = slice(middle - 100, middle + 100)
    observed = case.observed.copy()
    observed[hidden] = np.nan
    states, _ = case.run(observed, case.sensors)
    off = np.degrees(states.mean[hidden, :, 0] - case.true.q[hidden])
    assert np.abs(off).max() < 3
    assert not states.observed[hidden].any()
    assert np.isnan(smooth(observed, 100.0, case.chain).mean[middle, :, 0]).all()


def test_a_sensor_on_another_segment_is_left_out(case: Case) -> None:
    swapped = {1: case.sensors[3], 2: case.sensors[2]}
    states, results = case.run(case.observed, swapped)
    assert results[1].why is not None
    assert results[1].better_segment == 3
    assert results[2].why is None
    assert np.isfinite(states.mean).all()


def test_a_file_of_another_trial_changes_nothing(case: Case) -> None:
    rng = np.random.default_rng(3)
    other = case.sensors[2]
    strange = SensorSignals(other.time, rng.normal(size=other.gyro.shape), other.acc[::-1])
    states, results = case.run(case.observed, {2: strange})
    assert results[2].why is not None
    assert np.array_equal(states.mean, smooth(case.observed, 100.0, case.chain).mean)
