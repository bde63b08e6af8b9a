"""A whole trial of curls with a device and a calibration, from its files to the summary and the page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.runner.execution import run
from mocap_id.store import Folder
from mocap_id_simulation import ArmOptions, write_arm


def test_curls_with_a_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocap_id_simulation.arm_files.POINTS", 2**8)  # the true volume is not needed
    write_arm(tmp_path / "reach", ArmOptions(seed=21, subject=21, cycles=1, severity=0.1, rate=60))
    options = ArmOptions(
        seed=22,
        subject=21,
        movement="curl",
        repetitions=4,
        failed=1,
        condition="5",
        calibration="../reach/trial.yaml",
        rate=60,
    )
    file = write_arm(tmp_path / "curls", options)
    trial = load(file)
    run(trial)
    curls = json.loads((trial.out / "summary.json").read_text("utf-8"))["curls"]
    truth = json.loads(file.with_name("truth.json").read_text("utf-8"))
    assert [curls[name] for name in ("count", "partial", "condition", "end_rule")] == [4, 1, "5", "stopped"]
    for name in ("plane", "elevation"):
        found = np.array(curls["compensation"][f"shoulder_{name}"]["range_deg"][:4])
        true = np.degrees([each["compensation_rad"][name] for each in truth["repetitions"]])
        assert np.abs(found - true).max() < 1.5
    dynamics, true_torques = Folder(trial.out).read("dynamics.parquet"), np.load(file.with_name("truth.npz"))
    used = dynamics["time"] > 3
    at = np.searchsorted(true_torques["t"], dynamics["time"] - 1e-6)
    for column, name in (("elbow_torque", "tau_total"), ("elbow_torque_person", "tau_human")):
        error = (dynamics[column] - true_torques[name][at])[used]
        assert np.sqrt(np.nanmean(error**2)) < 1
        assert np.nanmean(np.abs(error) < 1.96 * dynamics[f"sd_{column}"][used]) > 0.8
    page = (trial.out / "report.html").read_text("utf-8")
    assert "Phase portraits" in page
    assert "(stopped); 1 failed" in page
