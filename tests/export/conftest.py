"""Sample trials that were run and exported once for all tests."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from mocap_id.config import load
from mocap_id.recording import write_c3d
from mocap_id.recording.lab_plates import PlateSignals
from mocap_id.runner import run
from mocap_id.workflows.export import FORMATS, Export, export_run

ROOT = Path(__file__).resolve().parents[2]
ORACLE = Path(__file__).with_name("opensim_oracle.py")
RATE = 100.0
G = 9.81


@dataclass(frozen=True)
class Done:
    """A run and its export."""

    run: Path
    folder: Path
    exported: Export
    name: str

    def file(self, ending: str) -> Path:
        return self.folder / f"{self.name}{ending}"

    def table(self, name: str) -> pd.DataFrame:
        return pd.read_parquet(self.run / f"{name}.parquet")


def two_links() -> tuple[tuple[str, ...], np.ndarray, PlateSignals]:
    """Markers (F, M, 3) m, Z up, of two links on a fixed base, one with a gap, and the plate under them."""
    rng = np.random.default_rng(4)
    time = np.arange(600) / RATE
    q = np.column_stack([0.5 * np.sin(3.1 * time), 0.7 * np.sin(4.7 * time + 1)])
    base = np.array([[0.2, 0.1, 0.0], [-0.2, 0.1, 0.02], [0.2, -0.1, 0.05], [-0.2, -0.1, 0.0]])
    points = [np.broadcast_to(base, (len(time), 4, 3))]
    pivot, angle = np.tile([0.0, 0.3], (len(time), 1)), np.zeros(len(time))
    load = np.zeros((len(time), 3))  # Fx, Fz, My of the ground about the origin
    for k, length in enumerate((0.4, 0.35)):
        angle = angle + q[:, k]
        along = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
        across = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        local = np.array([[0.03, 0.1], [-0.03, 0.2], [0.04, length - 0.05], [-0.02, length]])
        at = pivot[:, None] + local[:, 0, None] * across[:, None] + local[:, 1, None] * along[:, None]
        depth = np.broadcast_to([0.03, -0.02, 0.01, -0.03], at.shape[:2])
        points.append(np.stack([at[..., 0], depth, at[..., 1]], axis=-1))
        middle = pivot + along * length / 2
        acceleration = np.gradient(np.gradient(middle, 1 / RATE, axis=0), 1 / RATE, axis=0)
        force = 4.0 * (acceleration + np.array([0.0, G]))
        load += np.column_stack([force, middle[:, 1] * force[:, 0] - middle[:, 0] * force[:, 1]])
        pivot = pivot + along * length
    markers = np.concatenate(points, axis=1)
    markers = markers + rng.normal(scale=3e-4, size=markers.shape)
    markers[200:230, 6] = np.nan
    markers[300:310, -1] = np.nan  # the last column, where a blank is easily lost
    labels = ("B 1", "B2", "B3", "B4", "L1", "L2", "L3", "L4", "M1", "M2", "M3", "M4")
    return labels, markers, plate(load)


def plate(load: np.ndarray) -> PlateSignals:
    """Return a plate at the origin, y towards -y and z down, with the load (F, 3) of the ground on the body."""
    corners = np.array([[0.3, -0.3, 0], [-0.3, -0.3, 0], [-0.3, 0.3, 0], [0.3, 0.3, 0]])
    below = -0.02
    channels = np.random.default_rng(5).normal(scale=1e-3, size=(len(load), 6))  # a channel of zeros counts as dead
    channels[:, [0, 2, 4]] += np.column_stack([load[:, 0], -load[:, 1], -load[:, 2] + below * load[:, 0]])
    return PlateSignals(2, np.repeat(channels, 10, axis=0), np.array([0.0, 0.0, below]), corners, 10 * RATE)


@pytest.fixture(scope="session")
def links(once: Callable[..., Any]) -> Callable[..., Path]:
    """Return the run folder of the two links, with or without their plate, with additional trial keys."""

    def made(with_plate: bool = True, **keys: Any) -> Path:
        def computed(folder: Path) -> Path:
            labels, markers, under = two_links()
            write_c3d(folder / "t.c3d", labels, markers, RATE, plates=(under,) if with_plate else ())
            trial = {"trial": "two-links", "recording": "t.c3d", "protocol": "free", **keys}
            (folder / "t.yaml").write_text(json.dumps(trial))
            return run(load(folder / "t.yaml")).folder

        asked = hashlib.sha256(json.dumps([with_plate, keys]).encode()).hexdigest()
        return Path(once(f"links-{asked[:8]}", computed))

    return made


@pytest.fixture(scope="session")
def exported(links: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Done]:
    """The two links, exported in every format."""
    done: dict[bool, Done] = {}

    def made(with_plate: bool = True) -> Done:
        if with_plate not in done:
            out = tmp_path_factory.mktemp("exported")
            done[with_plate] = Done(
                links(with_plate), out, export_run(links(with_plate), tuple(FORMATS), out), "two-links"
            )
        return done[with_plate]

    return made


@pytest.fixture(scope="session")
def opensim() -> Callable[..., dict[str, Any]]:
    """Run OpenSim on an export: ``opensim(folder, trial, markers_file)``."""
    python = Path(os.environ.get("MOCAP_ID_OPENSIM_PYTHON", ROOT / ".venv-opensim" / "bin" / "python"))
    if not python.is_file():
        pytest.skip(f"no Python with OpenSim at {python}: `make opensim`, or set MOCAP_ID_OPENSIM_PYTHON")

    def ask(folder: Path, trial: str, *markers: str) -> dict[str, Any]:
        answer = folder / "opensim.json"
        command = [str(python), str(ORACLE), str(folder), trial, str(answer), *markers]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        return dict(json.loads(answer.read_text()))

    return ask
