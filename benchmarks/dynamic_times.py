"""Time of ``identify-dim`` and of its constrained fit on a long trial: a part of benchmarks/dynamic_sweep.py."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any
from unittest.mock import patch

import numpy as np
from harness import run_simulated

from mocap_id.dynamics import identification
from mocap_id.dynamics.consistency import fit_consistent
from mocap_id.simulation import Options
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE
from mocap_id.store import Folder

FRAMES = 16_000
LONG = Options(rate=480, analog_rate=480, repetitions=5)  # has more frames
CALLS = 10


def measure_times(seed: int) -> Mapping[str, tuple[float, float]]:
    """Return wall and processor time, s, of the stage and of its constrained fit."""
    with tempfile.TemporaryDirectory() as place:
        done = run_simulated(Path(place) / "trial", replace(LONG, seed=seed))
        assert done is not None
        trial = done[0]
        folder = Folder(trial.out)
        inputs: Any = {name: folder.read(name) for name in STAGE.inputs}
    for name in ("states.parquet", "wrench.parquet", "poses.parquet"):
        inputs[name] = replace(
            inputs[name], columns={key: values[:FRAMES] for key, values in inputs[name].columns.items()}
        )
    stage = _Timed(STAGE.function)
    with patch.object(identification, "fit_consistent", _Timed(fit_consistent)) as solve:
        for _ in range(CALLS):
            stage(Context(trial.keys, trial.settings[STAGE.name], inputs))
    return {"the whole stage": stage.fastest(), "its constrained fit": solve.fastest()}


class _Timed:
    """A function that records the times of its calls."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.calls: list[tuple[float, float]] = []

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        wall, own = perf_counter(), process_time()
        result = self.function(*arguments, **named)
        self.calls.append((perf_counter() - wall, process_time() - own))
        return result

    def fastest(self) -> tuple[float, float]:
        """Return the shortest wall and processor time."""
        wall, own = np.min(self.calls, axis=0)
        return float(wall), float(own)
