"""A small recording for tests with bad input."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mocap_id.recording.lab_plates import PlateSignals
from mocap_id.recording.writer import write_c3d, write_trc
from mocap_id.runner import RUN_LOG
from swinging_link import LABELS, RATE


@dataclass(frozen=True)
class Trial:
    """A trial.yaml with its recording in a temporary folder."""

    folder: Path

    @property
    def yaml(self) -> Path:
        return self.folder / "trial.yaml"

    @property
    def out(self) -> Path:
        return self.folder / "runs" / "pendulum"

    def say(self, recording: str, **keys: object) -> Path:
        self.yaml.write_text(json.dumps({"trial": "pendulum", "recording": recording, **keys}))
        return self.yaml

    def c3d(self, points: np.ndarray, labels: tuple[str, ...] = LABELS, plates: tuple[PlateSignals, ...] = ()) -> Path:
        write_c3d(self.folder / "trial.c3d", labels, points, RATE, plates=plates)
        return self.say("trial.c3d")

    def trc(self, points: np.ndarray, labels: tuple[str, ...] = LABELS) -> Path:
        write_trc(self.folder / "trial.trc", labels, points, RATE)
        return self.say("trial.trc")

    def inputs(self) -> dict[str, str]:
        """Content hashes of the user's files."""
        files = [path for path in self.folder.iterdir() if path.is_file()]
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}

    def made(self) -> list[str]:
        """Visible files in the run folder, including any half-written ones."""
        if not self.out.is_dir():
            return []
        files = [path.relative_to(self.out) for path in self.out.rglob("*") if path.is_file() and path.name != RUN_LOG]
        return sorted(path.as_posix() for path in files if ".mocap-id" not in path.parts or ".tmp" in path.name)

    def summary(self) -> dict[str, object]:
        return dict(json.loads((self.out / "summary.json").read_text()))


@pytest.fixture
def trial(tmp_path: Path) -> Trial:
    return Trial(tmp_path)
