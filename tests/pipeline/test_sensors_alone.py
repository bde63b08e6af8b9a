"""A sit-to-stand with inertial sensors alone, on the chain of a trial of the same person with markers."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry import so3
from mocap_id.recording.imu_log import read_imu
from mocap_id.runner.dependencies import collect_parameters, find_user_files
from mocap_id.runner.execution import run
from mocap_id.stages import STAGES
from mocap_id.stages.base import Context
from mocap_id.stages.ukf_smooth.inertial import _calibrate_chain
from mocap_id.store import Folder
from mocap_id.store.artefacts import Skeleton
from mocap_id.workflows.sensitivity.study import study_sensitivity
from worn_sensors import without_recording, worn_sensors


@pytest.fixture(scope="module")
def place(once: Callable[[str, Callable[[Path], Any]], Any]) -> Path:
    found: Path = once("sensors-alone", worn_sensors)
    return found


@pytest.fixture(scope="module")
def summary(place: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((place / "trial/runs/alone/summary.json").read_text("utf-8"))
    return found


def _errors(place: Path) -> tuple[FloatArray, FloatArray]:
    """Return errors and standard deviations (F, 3, 3) of the states; the axes of the segments are the calibration's."""
    states = Folder(place / "trial/runs/alone").read("states.parquet")
    clock = json.loads((place / "trial/truth.json").read_text("utf-8"))["imu"]["shank"]
    shown = Folder(place / "calibration/runs/calibration").read("states.parquet")
    orders = ("theta", "dtheta", "ddtheta")

    def of(table: Any, prefix: str = "") -> FloatArray:
        return np.stack([table.stack([f"{prefix}{name}_{j}" for j in (1, 2, 3)]) for name in orders], axis=2)

    def true(trial: str, time: FloatArray) -> FloatArray:
        with np.load(place / trial / "truth.npz") as arrays:
            return np.stack([CubicSpline(arrays["t"], arrays[name])(time) for name in ("q", "qd", "qdd")], axis=2)

    time = clock["offset_s"] + states["time"] * (1 + 1e-6 * clock["ppm"])
    off = of(states) - true("trial", time)
    off[..., 0] -= np.mean((of(shown) - true("calibration", shown["time"]))[..., 0], axis=0)
    return off[20:-20], of(states, "sd_")[20:-20]


def test_angles_do_not_drift_and_rates_are_accurate(place: Path) -> None:
    off, _ = _errors(place)
    assert np.degrees(np.abs(off[..., 0]).max()) < 3
    assert np.sqrt(np.mean(off[..., 1] ** 2)) < 0.03
    assert np.sqrt(np.mean(off[..., 2] ** 2)) < 0.15


def test_intervals_hold(place: Path) -> None:
    off, sd = _errors(place)
    within = np.mean(np.abs(off) < 1.96 * sd, axis=(0, 1))
    assert (within > 0.8).all()
    assert np.degrees(sd[..., 0].mean()) < 1.5


def test_no_frame_counts_as_seen_by_cameras(place: Path, summary: dict[str, Any]) -> None:
    states = Folder(place / "trial/runs/alone").read("states.parquet")
    assert not any(states[f"observed_{j}"].any() for j in (1, 2, 3))
    assert summary["markers"]["missing_fraction"] == 1.0


def test_the_verdict_says_what_is_not_known(summary: dict[str, Any]) -> None:
    reasons = {each["code"]: each for each in summary["verdict"]["reasons"]}
    assert "vertical" in reasons["imus-alone"]["message"]
    assert summary["verdict"]["level"] == "caution"
    assert "imu-moved" not in reasons
    for each in summary["imus"].values():
        assert abs(each["heading_deg"]) < 3 * each["heading_sd_deg"]
        assert each["heading_sd_deg"] > 3  # not hidden: a gyroscope alone drifts


def test_clocks_between_sensors(place: Path, summary: dict[str, Any]) -> None:
    truth = json.loads((place / "trial/truth.json").read_text("utf-8"))["imu"]
    for name in ("thigh", "torso"):
        off = summary["imus"][name]["clock_offset_s"] - (truth[name]["offset_s"] - truth["shank"]["offset_s"])
        assert abs(off) < 3 * summary["imus"][name]["sd_s"]


def test_rises_are_counted_without_a_plate(summary: dict[str, Any]) -> None:
    assert sum(each["stand_s"] is not None for each in summary["repetitions"]) == 2


def test_a_sensor_that_was_turned_is_said(place: Path, summary: dict[str, Any]) -> None:
    log, mount = read_imu(place / "trial/imu_torso.csv"), np.array(summary["imus"]["torso"]["mounting"])
    turn = mount.T @ so3.exp(np.radians([8.0, 0.0, 5.0])) @ mount
    rows = np.column_stack([log.time, log.gyro @ turn, log.acc @ turn])
    head = "time_s,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z"
    np.savetxt(place / "trial/turned.csv", rows, delimiter=",", header=head, comments="", fmt="%.6f")
    imus = "{shank: imu_shank.csv, thigh: imu_thigh.csv, torso: turned.csv}"
    out = run(load(without_recording(place / "trial/trial.yaml", imus=imus, out="runs/turned"))).folder
    codes = [each["code"] for each in json.loads((out / "summary.json").read_text("utf-8"))["verdict"]["reasons"]]
    assert "imu-moved" in codes


@pytest.mark.parametrize(
    ("imus", "level"),
    [
        ("{shank: imu_thigh.csv, thigh: imu_shank.csv, torso: imu_torso.csv}", "refused"),
        ("{shank: imu_shank.csv, thigh: imu_thigh.csv, torso: slow.csv}", "caution"),
    ],
)
def test_sensors_that_contradict_each_other(place: Path, imus: str, level: str) -> None:
    """Two exchanged sensors, and a clock that is 1 % slow."""
    log = read_imu(place / "trial/imu_torso.csv")
    head = "time_s,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z"
    rows = np.column_stack([log.time * 0.99, log.gyro, log.acc])
    np.savetxt(place / "trial/slow.csv", rows, delimiter=",", header=head, comments="", fmt="%.6f")
    outcome = run(load(without_recording(place / "trial/trial.yaml", imus=imus, out=f"runs/contradict-{level}")))
    verdict = json.loads((outcome.folder / "summary.json").read_text("utf-8"))["verdict"]
    assert verdict["level"] == level
    assert "imus-contradict" in [each["code"] for each in verdict["reasons"]]


def test_a_segment_without_a_sensor_is_refused(place: Path) -> None:
    configuration = without_recording(place / "trial/trial.yaml", imus="{shank: imu_shank.csv, torso: imu_torso.csv}")
    refused = run(load(configuration)).refused
    assert refused is not None
    assert refused.code == "imus-alone-incomplete"
    assert "thigh" in str(refused)


def test_what_a_configuration_without_markers_needs(place: Path) -> None:
    lines = {
        "trial: t\nimus: {shank: a.csv}\n": "recording",
        "trial: t\nspace: 3d\nimus: {thorax: a.csv}\ncalibration: trial.yaml\n": "in space",
        "trial: t\nimus: {shank: a.csv}\ncalibration: bare.yaml\n": "no `imus`",
        "trial: t\nrecording: trial.c3d\ncalibration: trial.yaml\n": "space",
    }
    folder = place / "trial"
    (folder / "bare.yaml").write_text("trial: bare\nrecording: trial.c3d\n", "utf-8")
    for text, expected in lines.items():
        (folder / "wrong.yaml").write_text(text, "utf-8")
        with pytest.raises(ConfigError, match=expected):
            load(folder / "wrong.yaml")


def test_perturbations_need_markers(place: Path) -> None:
    with pytest.raises(ConfigError, match="choose a trial with markers"):
        study_sensitivity(without_recording(place / "trial/trial.yaml", out="runs/alone"), out=place / "perturbed")


def test_forces_need_markers(place: Path) -> None:
    sensor = "[{file: a.csv, name: rail, segment: shank, at: [0, 0, 0]}]"
    with pytest.raises(ConfigError, match="need markers"):
        load(without_recording(place / "trial/trial.yaml", external=sensor))


def test_logs_of_a_calibration_without_common_time_are_named(place: Path) -> None:
    keys = load(without_recording(place / "trial/trial.yaml", out="runs/alone")).keys
    assert keys.calibration is not None
    file, late = keys.calibration.imus["torso"], place / "calibration/late_torso.csv"
    head, *rows = file.read_text("utf-8").splitlines()
    times = (row.split(",", 1) for row in rows)
    late.write_text("\n".join([head, *(f"{float(t) + 1000:.6f},{rest}" for t, rest in times), ""]), "utf-8")
    calibration = keys.calibration.model_copy(update={"imus": {**keys.calibration.imus, "torso": late}})
    trial = keys.model_copy(update={"calibration": calibration})
    skeleton = Skeleton(Folder(place / "calibration/runs/calibration").tree("chain.h5"))
    with pytest.raises(RecordingError, match=r"late_torso\.csv.*0\.0 s in common.*use logs of one recording"):
        _calibrate_chain(Context(trial, None, {}), skeleton)


def test_only_without_markers_the_sensors_are_read_before_the_filter(place: Path) -> None:
    (first,) = (stage for stage in STAGES if stage.name == "planarise")
    alone = load(without_recording(place / "trial/trial.yaml", out="runs/alone"))
    seen = load(place / "trial/trial.yaml")
    assert seen.keys.imus
    assert not {role for role in find_user_files(seen, first) if role.startswith(("imus", "calibration"))}
    assert not {"imus", "calibration"} & collect_parameters(seen, first).keys()
    assert {"imus.torso", "calibration.chain"} <= find_user_files(alone, first).keys()
    assert {"imus", "calibration"} <= collect_parameters(alone, first).keys()


def test_a_method_without_sensors_is_an_error(place: Path) -> None:
    file = without_recording(place / "trial/trial.yaml")
    file.write_text(f"{file.read_text('utf-8')}\nukf-smooth: {{method: butterworth}}\n", "utf-8")
    with pytest.raises(ConfigError, match="method: rts"):
        run(load(file))
