"""Two sit-to-stands of a person who keeps three inertial sensors on: with markers, and with the sensors alone."""

from __future__ import annotations

from pathlib import Path

from mocap_id.config import load
from mocap_id.runner.execution import run
from mocap_id_simulation import Options, simulate
from mocap_id_simulation.options import draw_subject


def without_recording(configuration: Path, **other: str) -> Path:
    """Return the configuration of the trial without its recording, with other lines replaced."""
    keys = {"calibration": "../calibration/trial.yaml"} | other
    lines = [line for line in configuration.read_text("utf-8").splitlines() if not line.startswith("recording:")]
    kept = [line for line in lines if line.split(":")[0] not in keys]
    file = configuration.with_name("alone.yaml")
    file.write_text("\n".join([*kept, *(f"{key}: {value}" for key, value in keys.items()), ""]), "utf-8")
    return file


def worn_sensors(folder: Path) -> Path:
    """Simulate and run both trials in a folder, and return it."""
    options = {"repetitions": 2, "analog_rate": 100, "imus": True, "subject": draw_subject(5, 1)}
    simulate("sit-to-stand", folder / "calibration", Options(seed=51, **options))  # type: ignore[arg-type]
    configuration = simulate("sit-to-stand", folder / "trial", Options(seed=52, **options))  # type: ignore[arg-type]
    outcome = run(load(without_recording(configuration, out="runs/alone")))
    assert outcome.refused is None
    return folder
