"""Dead reckoning of a planar chain: a double pendulum whose sensors are computed from its positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from mocap_id.arrays import FloatArray
from mocap_id.estimation.inertial import Clock, SensorCalibration, SensorSignals
from mocap_id.estimation.inertial_tracking import DeadReckoning, KnownChain, Reckoning

RATE, LENGTH, GRAVITY = 100.0, 0.4, 9.81
PLACES = (0.03 + 0.2j, -0.05 + 0.3j)
TIME = np.arange(100, 2100) / RATE


def _angles(time: FloatArray) -> FloatArray:
    """Return the angles (F, 2) of both segments, rad."""
    first = 0.3 * np.sin(1.7 * time) + 0.1 * np.sin(4.1 * time)
    return np.stack([first, first - 0.9 + 0.5 * np.cos(2.3 * time)], axis=1)


def _signals(k: int, shift: float, bias: float) -> SensorSignals:
    """Return what a sensor measures, by numerical derivatives of its position; its clock is ahead by ``shift`` s."""
    stamps = np.arange(2300) / RATE
    fine = np.arange(-400, 5200) / 200.0
    angle = _angles(fine)
    place = 1j * LENGTH * np.exp(1j * angle[:, 0]) * k + PLACES[k] * np.exp(1j * angle[:, k])
    position, turn = make_interp_spline(fine, place, k=5), make_interp_spline(fine, angle[:, k], k=5)
    true = stamps - shift
    force = (position(true, 2) + 1j * GRAVITY) * np.exp(-1j * turn(true))
    gyro, acc = np.zeros((len(stamps), 3)), np.zeros((len(stamps), 3))
    gyro[:, 2], acc[:, 0], acc[:, 1] = turn(true, 1) + bias, force.real, force.imag
    return SensorSignals(stamps, gyro, acc)


def _reckon(shift: float = 0.0, biases: tuple[float, float] = (0.0, 0.0)) -> tuple[DeadReckoning, Reckoning]:
    zero = np.zeros(3)
    found = SensorCalibration(
        Clock(0.0), np.eye(3), zero, 0.0, zero, zero, zero, zero, {}, np.array([0.01, 0.02]), np.full(2, 10.0), 1.0
    )
    found = replace(found, sd={"lag": np.zeros(1), **dict.fromkeys(("turn", "gyro_scale", "gyro_bias"), zero)})
    places = [np.array([each.real, each.imag, 0.0]) for each in PLACES]
    worn = tuple(replace(found, place=place) for place in places)
    centres = np.array([[0.0, 0.1], [0.0, LENGTH]])
    chain = KnownChain(centres, worn, np.zeros((2, 2)), np.zeros(2), np.ones(2))
    reckoned = DeadReckoning([_signals(0, 0.0, biases[0]), _signals(1, shift, biases[1])], TIME, chain)
    return reckoned, reckoned.solve()


def test_exact_signals_give_the_angles() -> None:
    _, found = _reckon()
    assert np.degrees(np.abs(found.angle - _angles(TIME)).max()) < 0.2
    assert np.abs(found.shift).max() < 1e-3


def test_bias_and_clock_are_found_within_their_deviations() -> None:
    _, found = _reckon(shift=0.04, biases=(0.004, -0.006))
    assert found.shift[1] == pytest.approx(0.04, abs=2e-3)
    assert abs(found.shift[1] - 0.04) < 3 * found.shift_sd[1]
    off = found.gyro_bias - [0.004, -0.006]
    assert np.abs(off).max() < 1e-3
    assert (np.abs(off) < 3 * found.gyro_bias_sd).all()
    away = np.abs(found.angle - _angles(TIME))
    assert np.degrees(away.max()) < 0.5


def test_without_accelerometers_the_angles_would_drift() -> None:
    reckoned, found = _reckon(biases=(0.004, -0.006))
    gyro, _ = reckoned.sample(tuple(found.shift))
    drift = np.cumsum(gyro, axis=0)[-1] / RATE - (_angles(TIME)[-1] - _angles(TIME)[0])
    assert (np.degrees(np.abs(drift)) > 4).all()
    ends = (found.angle - _angles(TIME))[[0, -1]]
    assert np.degrees(np.abs(np.diff(ends, axis=0))).max() < 0.5
