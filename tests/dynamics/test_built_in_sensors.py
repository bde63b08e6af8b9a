"""Wrench sensors built into joints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from mocap_id.config import load
from mocap_id.runner import run
from mocap_id.store import Folder
from mocap_id_simulation import Options, simulate


def _wrist(folder: Path, *, sensor: bool) -> tuple[list[dict[str, Any]], list[float], Path]:
    options = Options(seed=320_002, repetitions=4, joint="wrist", joint_sensor=sensor)
    configuration = simulate("robot", folder, options)
    out = run(load(configuration)).folder
    truth = json.loads(configuration.with_name("truth.json").read_text())["base_parameters"]["values"]
    return json.loads((out / "summary.json").read_text())["dynamics"]["base"], truth, out


def test_a_sensor_makes_a_light_link_known(tmp_path: Path) -> None:
    alone, truth, _ = _wrist(tmp_path / "alone", sensor=False)
    both, _, out = _wrist(tmp_path / "both", sensor=True)
    inertia = truth[4]
    assert both[4]["sd"] < 0.2 * alone[4]["sd"], "errors of scale of the plate hardly reach what the sensor determines"
    assert abs(both[4]["value"] - inertia) < min(0.05 * inertia, 3 * both[4]["sd"])
    assert abs(both[0]["value"] - truth[0]) < 3 * both[0]["sd"]
    assert both[0]["value"] == pytest.approx(alone[0]["value"], rel=1e-3)
    wrench = Folder(out).read("wrench.parquet")
    assert wrench.facts["external"][0]["measures"] == "beyond"
    assert "Fx_external" not in Folder(out).read("dynamics.parquet").names
