"""Time and memory of ``ukf-smooth`` against the length of the trial, and the time to compile it.

The function of the stage runs in memory, with its default settings, in a process of its own for each length. About
three minutes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tracemalloc
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from time import perf_counter

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from harness import KINEMATIC, command_line, markdown, publish, read_group, run_simulated

from mocap_id.simulation import Options
from mocap_id.stages.base import Context
from mocap_id.stages.ukf_smooth import STAGE
from mocap_id.store import Folder

FRAMES = (8_000, 16_000, 32_000, 64_000, 120_000)
REPEATS = 5
RATE = 100.0
MEGABYTE = 2**20


@dataclass(frozen=True)
class Cost:
    """Cost of one length: seconds, input and growth in MB, moving markers."""

    frames: int
    seconds: float
    input: float
    growth: float
    markers: int


def prepare(place: Path) -> Context:
    """Return the inputs of the stage."""
    run = run_simulated(place / "trial", Options(seed=5, rate=RATE, analog_rate=RATE), KINEMATIC[:-1])
    assert run is not None
    trial, folder = run[0], Folder(run[0].out)
    return Context(trial.keys, STAGE.settings(), {name: folder.read(name) for name in STAGE.inputs})


def of_length(context: Context, frames: int) -> Context:
    """Play the trial forwards and backwards for so many frames."""
    planar = context.long("planar.parquet")
    own, number = len(planar.frames), np.arange(frames)
    rows = np.resize(np.concatenate([np.arange(own), np.arange(own - 2, 0, -1)]), frames)
    values = {name: column[rows] for name, column in planar.values.items()}
    longer = replace(planar, frames=number, time=number / RATE, values=values)
    return replace(context, inputs={**context.inputs, "planar.parquet": longer})


def measure(place: Path, frames: int) -> Cost:
    """Return memory of the first full run, then times; to be called in a new process."""
    warm = prepare(place)
    STAGE.function(of_length(warm, 2_000))
    context = of_length(warm, frames)
    planar, group = context.long("planar.parquet"), read_group(context.tree("chain.h5"), "markers")
    tracemalloc.start()
    STAGE.function(context)
    growth = tracemalloc.get_traced_memory()[1] / MEGABYTE
    tracemalloc.stop()
    taken = []
    for _ in range(REPEATS):
        start = perf_counter()
        STAGE.function(context)
        taken.append(perf_counter() - start)
    size = sum(values.nbytes for values in planar.values.values()) / MEGABYTE
    return Cost(frames, median(taken), size, growth, int(np.count_nonzero(group["segment"] > 0)))


def first_run(place: Path) -> float:
    """Return how much longer the first of two runs takes, s."""
    context = of_length(prepare(place), 2_000)
    taken = []
    for _ in range(2):
        start = perf_counter()
        STAGE.function(context)
        taken.append(perf_counter() - start)
    return taken[0] - taken[1]


def in_new_process(what: str, **environment: str) -> str:
    """Return the standard output of this script in a process of its own."""
    command, surroundings = [sys.executable, __file__, what], {**os.environ, **environment}
    return subprocess.run(command, env=surroundings, capture_output=True, text=True, check=True).stdout


def main() -> None:
    """Measure all lengths, or one of the numbers in a process of its own."""
    parser = command_line(__doc__)
    parser.add_argument("--frames", type=int, help="print the cost of one length as JSON")
    parser.add_argument("--cold", action="store_true", help="print the seconds of compilation")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        if arguments.frames:
            print(json.dumps(measure(Path(place), arguments.frames).__dict__))
            return
        if arguments.cold:
            print(first_run(Path(place)))
            return
        cold = float(in_new_process("--cold", NUMBA_CACHE_DIR=place))
    found = [Cost(**json.loads(in_new_process(f"--frames={frames}"))) for frames in FRAMES]
    rows = []
    for cost in found:
        times = [
            f"{cost.frames / RATE / 60:.1f} min",
            f"{cost.seconds:.2f} s",
            f"{1e6 * cost.seconds / cost.frames:.0f}",
        ]
        rows.append([f"{cost.frames:,}", *times, f"{cost.input:.0f} MB", f"{cost.growth:.0f} MB"])
    slope = np.polyfit(np.log([c.frames for c in found]), np.log([c.seconds for c in found]), 1)[0]
    text = (
        "Measured by `benchmarks/stage_cost.py`: the function of `ukf-smooth` with its artefacts in memory, on a "
        f"simulated sit-to-stand at {RATE:g} Hz with {found[0].markers} moving markers and three joints. Medians of "
        f"{REPEATS} after a first run.\n\n"
        + markdown(["frames", "length", "time", "µs per frame", "input", "memory above it"], rows)
    )
    text += (
        f"\n\nTime grows with the frames to the power {slope:.2f} (from {FRAMES[0]:,} to {FRAMES[-1]:,}). The first "
        f"run in a process without compiled code takes {cold:.1f} s longer than the second."
    )
    publish({"states-cost": text}, write=arguments.write)


if __name__ == "__main__":
    main()
