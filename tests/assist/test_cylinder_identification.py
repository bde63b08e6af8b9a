"""Parameters of a cylinder from simulated logs: intervals hold the truth, and what is not shown is said."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from mocap_id.dynamics.cylinder import Cylinder, Setting
from mocap_id.errors import NumericalError
from mocap_id_assist.devices import TorqueLog, identify_cylinder, predict_torque

DESCRIBED = Cylinder(0.03, 2.8e-4, 2.5e-4, 0.08, 0.08, 0.08, 2.44, 1.2)
MODES = (Setting(446e3, 101_325.0), Setting(101_325.0, 446e3), Setting(446e3, 446e3))


def trials(count: int, settings: tuple[Setting, ...]) -> Iterator[tuple[Cylinder, TorqueLog]]:
    time = np.linspace(0, 20, 1600)
    angle, velocity = 1.2 + 0.9 * np.sin(1.3 * time), 1.17 * np.cos(1.3 * time)
    which = np.arange(len(time)) * len(settings) // len(time)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        sizes = np.array([2.8e-4, 2.5e-4, 0.08, 0.08]) * np.exp([0.1, 0.1, 0.2, 0.2] * rng.normal(size=4))
        true = Cylinder(0.03, *sizes, 0.08, 2.44 + 0.03 * rng.normal(), rng.uniform(1.05, 1.35), 0.2, 0.02)
        exact = predict_torque(true, TorqueLog(angle, angle, velocity, settings, which))
        yield true, TorqueLog(angle, exact + 0.05 * rng.normal(size=len(time)), velocity, settings, which)


def test_intervals_hold_the_truth() -> None:
    inside = []
    for true, log in trials(12, MODES):
        cylinder, interval, determined, _ = identify_cylinder(DESCRIBED, log)
        assert all(determined[name] for name in determined if name != "exponent")
        inside += [low <= getattr(true, name) <= high for name, (low, high) in interval.items()]
        assert np.sqrt(np.mean((predict_torque(cylinder, log) - predict_torque(true, log)) ** 2)) < 0.02
    assert 0.88 <= np.mean(inside) <= 0.99


def test_an_error_that_lasts_widens_the_intervals() -> None:
    """A shift of the torque is taken for a parameter only without its column."""
    inside = {True: [], False: []}
    for k, (true, log) in enumerate(trials(6, MODES)):
        shape = np.ones((len(log.angle), 1)) * 0.4
        shifted = replace(log, torque=log.torque + (-1) ** k * shape[:, 0])
        for told in inside:
            _, interval, *_ = identify_cylinder(DESCRIBED, replace(shifted, lasting=shape) if told else shifted)
            inside[told] += [low <= getattr(true, name) <= high for name, (low, high) in interval.items()]
    assert np.mean(inside[True]) >= 0.88
    assert np.mean(inside[False]) < 0.8


def test_what_one_setting_does_not_show() -> None:
    for _, log in trials(2, MODES[:1]):
        _, _, determined, _ = identify_cylinder(DESCRIBED, log)
        assert determined["area_flexion"]
        assert determined["coulomb"]
        assert not determined["area_extension"]
        assert not determined["exponent"]


def test_friction_needs_a_velocity_and_a_foreign_log_is_refused() -> None:
    _, log = next(trials(1, MODES))
    still = TorqueLog(log.angle, log.torque, None, log.settings, log.which)
    assert "coulomb" not in identify_cylinder(DESCRIBED, still)[2]
    with pytest.raises(NumericalError, match="signs"):
        identify_cylinder(DESCRIBED, TorqueLog(log.angle, -log.torque, log.velocity, log.settings, log.which))
