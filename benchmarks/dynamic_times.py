"""How long ``identify-dim`` takes on a long trial, and its constrained solve: a part of benchmarks/dynamic_sweep.py."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any
from unittest.mock import patch

import numpy as np

from mocap_id.config import load
from mocap_id.dynamics import identify
from mocap_id.dynamics.consistent import fit_consistent
from mocap_id.runner import run_stage
from mocap_id.simulation import Options, simulate
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE
from mocap_id.store import Folder

FRAMES = 16_000
LONG = Options(rate=480, analog_rate=480, repetitions=5)  # longer than that
BEFORE = ("planarise", "segment", "fit-joints", "ukf-smooth")
CALLS = 10


def timing(seed: int) -> Mapping[str, tuple[float, float]]:
    """Seconds by the clock, and of this process alone, of the stage and of its constrained solve."""
    with tempfile.TemporaryDirectory() as place:
        configuration = simulate("sit-to-stand", Path(place) / "trial", replace(LONG, seed=seed))
        trial = load(configuration)
        for name in BEFORE:
            run_stage(trial, name)
        folder = Folder(trial.out)
        inputs: Any = {name: folder.read(name) for name in STAGE.inputs}
    for name in ("states.parquet", "wrench.parquet", "poses.parquet"):
        inputs[name] = replace(
            inputs[name], columns={key: values[:FRAMES] for key, values in inputs[name].columns.items()}
        )
    stage = _Timed(STAGE.function)
    with patch.object(identify, "fit_consistent", _Timed(fit_consistent)) as solve:
        for _ in range(CALLS):
            stage(Context(trial.keys, trial.settings[STAGE.name], inputs))
    return {"the whole stage": stage.quickest(), "of it, the constrained solve": solve.quickest()}


class _Timed:
    """A function whose calls are timed."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.calls: list[tuple[float, float]] = []

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        wall, own = perf_counter(), process_time()
        result = self.function(*arguments, **named)
        self.calls.append((perf_counter() - wall, process_time() - own))
        return result

    def quickest(self) -> tuple[float, float]:
        """Least of either time: what other processes on the machine disturbed least."""
        wall, own = np.min(self.calls, axis=0)
        return float(wall), float(own)
