"""Commands of docs/assist.md print what the page shows; its figures are those of the commands."""

from __future__ import annotations

import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pages_of_docs import DOCS, ROOT, blocks
from typer.testing import CliRunner

from mocap_id.config.device import load_device
from mocap_id_assist.devices import TorqueLog, predict_torque
from mocap_id_cli.commands import build

PAGE = DOCS / "assist.md"


def write_log(device: Path, file: Path) -> None:
    """Write a log of torque and angle of a device that differs from its description."""
    config = load_device(device)
    true = replace(config.keys.cylinder(), area_flexion=3.1e-4, dead_extension=0.07, exponent=1.1)
    settings = tuple(config.condition(name).setting() for name in ("2", "4", "5"))
    time = np.linspace(0, 18, 900)
    angle, velocity, which = 1.2 + 0.9 * np.sin(1.3 * time), 1.17 * np.cos(1.3 * time), np.arange(900) // 300
    torque = predict_torque(true, TorqueLog(angle, angle, velocity, settings, which))
    torque += 0.05 * np.random.default_rng(0).normal(size=900)
    lines = ["time_s,angle_rad,torque_Nm,flexion_Pa,extension_Pa"]
    for t, q, tau, k in zip(time, angle, torque, which, strict=True):
        lines.append(f"{t:.4f},{q:.5f},{tau:.4f},{settings[k].flexion},{settings[k].extension}")
    file.write_text("\n".join(lines) + "\n", "utf-8")


def shown() -> list[tuple[str, str]]:
    """Return every command of the page with its output."""
    found = []
    for block in blocks(PAGE):
        if block.kind == "console":
            for part in block.text.split("$ ")[1:]:
                command, _, output = part.partition("\n")
                found.append((command, output))
    return found


@pytest.mark.slow
def test_the_commands_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    monkeypatch.chdir(tmp_path)
    write_log(Path("configs/devices/elbow.yaml"), Path("log.csv"))
    for command, expected in shown():
        result = CliRunner().invoke(build(), shlex.split(command)[1:])
        assert result.exit_code == 0, command
        assert result.stdout == expected, command
    result = CliRunner().invoke(
        build(), ["pneumatic", "curve", "configs/devices/elbow.yaml", "--condition", "5", "--out", "elbow"]
    )
    assert result.exit_code == 0
    for name in ("curve.svg", "controller.svg"):
        ours, page = (folder / name for folder in (Path("elbow"), DOCS / "assist"))
        assert abs(ours.stat().st_size - page.stat().st_size) < 0.1 * page.stat().st_size, f"draw {page} again"


def test_the_files_of_the_page_are_the_examples() -> None:
    texts = [block.text for block in blocks(PAGE) if block.kind == "yaml"]
    device, prescription = (next(t for t in texts if f"{key}:" in t) for key in ("pulley_radius_m", "prescription"))
    assert device.splitlines() == (ROOT / "configs" / "devices" / "elbow.yaml").read_text("utf-8").splitlines()
    example = (ROOT / "configs" / "prescriptions" / "elbow.yaml").read_text("utf-8")
    plain = [line.partition("#")[0].rstrip() for line in example.splitlines()]
    assert prescription.splitlines() == [line for line in plain if line]
