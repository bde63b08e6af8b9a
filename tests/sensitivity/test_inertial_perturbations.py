"""Perturbations of inertial sensors: what they do to a log, and to a sit-to-stand with sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_id.errors import ConfigError
from mocap_id.recording.imu_log import ImuLog
from mocap_id.workflows.sensitivity.perturbations import (
    ALL_KINDS,
    COMPONENTS,
    KINDS,
    KindSelection,
    Perturbation,
    RerunInputs,
    SensitivityOptions,
    locate_trial,
    read_rerun_inputs,
)
from mocap_id.workflows.sensitivity.study import _select_possible, perturb, study_sensitivity
from worn_sensors import worn_sensors

TIME = np.arange(2000) / 100.0


@pytest.fixture(scope="module")
def trial(once: Callable[[str, Callable[[Path], Any]], Any]) -> RerunInputs:
    place: Path = once("sensors-alone", worn_sensors)
    return read_rerun_inputs(locate_trial(place / "calibration/trial.yaml"))


def _changed(kind: str, level: float) -> tuple[ImuLog, ImuLog]:
    rng = np.random.default_rng(2)
    log = ImuLog(TIME, rng.normal(size=(2000, 3)), rng.normal((0.0, 0.0, 9.81), 1.0, (2000, 3)))
    return log, KINDS[kind].change_log(log, level, np.random.default_rng(3))


def test_a_clock_wanders_by_its_level() -> None:
    log, now = _changed("imu-clock", 0.01)
    assert np.abs(now.time - log.time).max() == pytest.approx(0.01, rel=0.01)
    assert (np.diff(now.time) > 0).all()


def test_a_bias_drifts_from_minus_to_plus_its_level() -> None:
    log, now = _changed("imu-bias", 0.02)
    off = now.gyro - log.gyro
    assert np.linalg.norm(off[[0, -1]], axis=1) == pytest.approx([0.02, 0.02])
    assert off[0] == pytest.approx(-off[-1])
    assert np.array_equal(now.acc, log.acc)


def test_a_sensor_turns_by_its_level_and_measures_this_turn() -> None:
    log, now = _changed("imu-mounting", 0.3)
    assert np.array_equal(now.acc[:900], log.acc[:900])
    assert np.linalg.norm(now.acc, axis=1) == pytest.approx(np.linalg.norm(log.acc, axis=1))
    angle = np.arccos(np.sum(now.acc * log.acc, axis=1) / np.sum(log.acc**2, axis=1))[1100:]
    assert angle.max() == pytest.approx(0.3, abs=0.01)  # a force across the axis turns by the whole angle
    turned = np.linalg.norm(np.sum(now.gyro - log.gyro, axis=0)[None] / 100.0, axis=1)[0]
    assert turned < 10.0


def test_no_perturbation_changes_nothing_and_a_turn_is_seen(trial: RerunInputs) -> None:
    same = perturb(trial, Perturbation("imu-bias", "", 0.0)).table("states.parquet")
    own = trial.table("states.parquet")
    assert all(np.array_equal(same[name], own[name], equal_nan=True) for name in own.names)
    now = perturb(trial, Perturbation("imu-mounting", "", 0.3)).table("states.parquet")
    off = np.sqrt(np.mean((now["ddtheta_3"] - own["ddtheta_3"]) ** 2))
    assert 1e-3 < off < 0.5


def test_without_a_plate_no_tolerance_of_sensors_is_claimed(trial: RerunInputs) -> None:
    wrench = trial.table("wrench.parquet")
    unknown = {name: np.full_like(wrench[name], np.nan) for name in COMPONENTS}
    bare = trial.with_artefacts(replace(wrench, columns={**wrench.columns, **unknown}))
    assert {one.kind for one in _select_possible(ALL_KINDS, trial)[0]} == set(KINDS)
    selections, note = _select_possible(ALL_KINDS, bare)
    assert {one.kind for one in selections} == {kind.name for kind in KINDS.values() if kind.entry == "fit-joints"}
    assert note.startswith(
        "there is no force plate: only lengths and states are compared; left out, because they do not change lengths: "
        "the filter's noise, angle bias, angle noise, clock offset"
    )
    assert "wander of the inertial sensors' clocks, drift of" in note
    with pytest.raises(ConfigError, match=r"has no force plate, so there is nothing .* not change lengths: wander"):
        _select_possible((KindSelection("imu-clock"),), bare)


def test_a_trial_without_sensors_says_so(robot_file: Path) -> None:
    with pytest.raises(ConfigError, match="no inertial sensors"):
        study_sensitivity(robot_file, SensitivityOptions(selections=(KindSelection("imu-clock"),)))
