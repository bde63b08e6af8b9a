"""A whole trial of a left arm with inertial sensors, from its files to the summary and the page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from mocap_id.config import load
from mocap_id.errors import ConfigError
from mocap_id.recording.imu_log import read_imu
from mocap_id.runner.execution import run
from mocap_id_simulation import ArmOptions, Options, simulate, write_arm


def test_a_left_arm_with_sensors(tmp_path: Path) -> None:
    """The sensor of the upper arm is an export without times, whose rate the configuration gives."""
    file = write_arm(tmp_path / "trial", ArmOptions(seed=12, cycles=1, side="left", imus=True))
    log = read_imu(file.parent / "imu_upper_arm.csv")
    rate = round(1.0 / float(np.median(np.diff(log.time))))
    rows = np.column_stack([np.round((log.time - log.time[0]) * rate), log.gyro, log.acc])
    names = ["PacketCounter", "Gyr_X", "Gyr_Y", "Gyr_Z", "Acc_X", "Acc_Y", "Acc_Z"]
    lines = ["\t".join(names), *("\t".join(f"{value:.6f}" for value in row) for row in rows)]
    (file.parent / "upper_arm.txt").write_text("\n".join(lines) + "\n", "utf-8")
    text = file.read_text("utf-8")
    given = f"upper_arm: {{file: upper_arm.txt, rate_hz: {rate}}}"
    file.write_text(text.replace("upper_arm: imu_upper_arm.csv", given), "utf-8")
    assert file.read_text("utf-8") != text
    trial = load(file)
    run(trial)
    summary = json.loads((trial.out / "summary.json").read_text("utf-8"))
    truth = json.loads((file.parent / "truth.json").read_text("utf-8"))["imu"]
    assert set(summary["imus"]) == set(truth)
    assert all(entry["used"] for entry in summary["imus"].values())
    found = summary["imus"]["forearm"]
    middle = 15.0
    off = found["clock_offset_s"] - truth["forearm"]["offset_s"]
    off += 1e-6 * middle * (found["ppm"] - truth["forearm"]["ppm"])
    assert found["observable"]
    assert abs(off) < min(2e-3, 3 * found["sd_s"])
    assert "Inertial sensors" in (trial.out / "report.html").read_text("utf-8")


def test_a_sit_to_stand_with_sensors(tmp_path: Path) -> None:
    file = simulate("sit-to-stand", tmp_path / "trial", Options(seed=2, repetitions=2, analog_rate=100, imus=True))
    trial = load(file)
    run(trial)
    summary = json.loads((trial.out / "summary.json").read_text("utf-8"))
    assert list(summary["imus"]) == ["shank", "thigh", "torso"]
    assert all(entry["used"] for entry in summary["imus"].values())
    assert "Inertial sensors" in (trial.out / "report.html").read_text("utf-8")
    file.write_text(file.read_text("utf-8").replace("shank: imu", "shin: imu"), "utf-8")
    with pytest.raises(ConfigError, match="foot, shank, thigh, torso"):
        run(load(file))


@pytest.mark.slow
def test_repeated_rows_of_a_sensor_change_no_acceleration(tmp_path: Path) -> None:
    found = []
    for lost in (False, True):
        folder = tmp_path / str(lost)
        file = simulate("sit-to-stand", folder, Options(seed=2, repetitions=2, analog_rate=100, imus=True))
        for log in folder.glob("imu_*.csv"):
            rows = log.read_text("utf-8").splitlines()
            for first in (300, 700) if lost else ():
                for k in range(first, first + 50):
                    rows[k] = ",".join([rows[k].split(",")[0], *rows[first - 1].split(",")[1:]])
            log.write_text("\n".join(rows) + "\n", "utf-8")
        trial = load(file)
        run(trial)
        found.append(pq.read_table(trial.out / "states.parquet").to_pandas())
    summary = json.loads((trial.out / "summary.json").read_text("utf-8"))
    assert [r["code"] for r in summary["verdict"]["reasons"]].count("samples-held") == 3
    good, held = found
    for name in [column for column in good if column.startswith("ddtheta")]:
        off = good[name] - held[name]
        assert np.sqrt(np.nanmean(off**2)) < 0.3, name  # rad/s²; 6 with the repeated rows


def test_sensors_need_markers(tmp_path: Path) -> None:
    file = tmp_path / "trial.yaml"
    lines = "recording: {skeleton: kinect.csv}\nspace: 3d\nimus: {thorax: imu.csv}\n"
    file.write_text(f"trial: t\n{lines}", "utf-8")
    with pytest.raises(ConfigError, match="skeleton"):
        load(file)
