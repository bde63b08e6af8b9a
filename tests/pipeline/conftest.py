"""Whole trials, each run once for all tests."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import CubicSpline
from typed_commands import Terminal

from mocap_id.config import load
from mocap_id.runner import Outcome, run
from mocap_id.store import Folder


@dataclass(frozen=True)
class Finished:
    """A run trial, and the truth of its recording if there is one."""

    outcome: Outcome
    source: Path

    @property
    def folder(self) -> Path:
        return self.outcome.folder

    @property
    def summary(self) -> dict[str, Any]:
        return dict(self.outcome.summary())

    def table(self, name: str) -> pd.DataFrame:
        return pd.read_parquet(self.folder / f"{name}.parquet")

    def facts(self, file: str) -> dict[str, Any]:
        """Return the facts of an artefact."""
        return dict(Folder(self.folder).read(file).facts)

    def centres(self) -> np.ndarray:
        with h5py.File(self.folder / "chain.h5") as file:
            return np.asarray(file["joints/centre"])

    @property
    def truth(self) -> dict[str, Any]:
        return dict(json.loads((self.source / "truth.json").read_text()))

    def true(self, key: str, time: np.ndarray) -> np.ndarray:
        """Return a true signal at the given times."""
        with np.load(self.source / "truth.npz") as arrays:
            return np.asarray(CubicSpline(arrays["t"], arrays[key])(time))

    def off_seat(self, time: np.ndarray) -> np.ndarray:
        """Return the times without load on the chair."""
        inside = [(time >= rep["seat_off"]) & (time <= rep["seat_on"]) for rep in self.truth["reps"]]
        return np.any(inside, axis=0)


@pytest.fixture(scope="session")
def trial(recordings: Path, once: Callable[..., Any]) -> Callable[..., Finished]:
    """Runs a trial of the shared recordings: ``trial("simulated/sts-normal", protocol="sit-to-stand")``."""

    def finished(source: str, **keys: Any) -> Finished:
        name = source.replace("/", "-") + "".join(f"-{key}" for key in sorted(keys) if key != "protocol")
        path = recordings / source

        def make(folder: Path) -> Outcome:
            recording: Any = str(path / "trial.c3d") if path.is_dir() else str(path)
            if path.suffix == ".trc":
                recording = {"markers": str(path), "forces": str(path.with_name(f"{path.stem}_grf.mot"))}
            yaml = folder / "trial.yaml"
            yaml.write_text(json.dumps({"trial": name.replace(".", "-"), "recording": recording, **keys}))
            return run(load(yaml))

        return Finished(once(f"trial-{name}", make), path)

    return finished


@pytest.fixture
def terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Terminal]:
    """A terminal in a new folder; the logging, which commands set up in this process, is restored."""
    monkeypatch.chdir(tmp_path)
    loggers = [logging.getLogger(name) for name in (None, "mocap_id", "py.warnings")]
    before = [(logger.level, list(logger.handlers)) for logger in loggers]
    yield Terminal(monkeypatch, capsys)
    logging.captureWarnings(False)
    for logger, (level, handlers) in zip(loggers, before, strict=True):
        logger.setLevel(level)
        logger.handlers[:] = handlers
