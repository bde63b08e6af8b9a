"""Time of `segment` and `fit-joints` against the length of the recording: ``python benchmarks/segments.py``.

The stages' own functions on a simulated sit-to-stand of 50 markers, artefacts in memory, after one run to warm up; the
median of five. The last column is what doubling the frames does.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from mocap_id.config import Trial, load
from mocap_id.runner import run
from mocap_id.simulation import Options, simulate
from mocap_id.stages import STAGES
from mocap_id.stages.base import Context
from mocap_id.store import Artefact, Folder, LongTable, Table, Tree

RATES = (250.0, 500.0, 1000.0)
REPEATS = 5
STAGE = {stage.name: stage for stage in STAGES}


def recording(place: Path, rate: float) -> tuple[Trial, LongTable]:
    """A trial of about 20 s and its trajectories in the plane."""
    options = Options(seed=5, repetitions=2, rate=rate, analog_rate=rate)
    trial = load(simulate("sit-to-stand", place / f"{rate:.0f}", options))
    planar = Folder(run(trial, STAGES[:1]).folder).read("planar.parquet")
    assert isinstance(planar, LongTable)
    return trial, planar


def compute(name: str, trial: Trial, inputs: Mapping[str, Artefact]) -> Artefact:
    """The output of a stage's function."""
    output = STAGE[name].function(Context(trial.keys, trial.settings[name], inputs))[0]
    assert isinstance(output, Table | Tree)
    return output


def timed(work: Callable[[], object]) -> float:
    """Median time of several calls, s, after one that does not count."""
    work()
    taken = []
    for _ in range(REPEATS):
        start = perf_counter()
        work()
        taken.append(perf_counter() - start)
    return median(taken)


def main() -> None:
    """Measure and print."""
    sys.stdout.write("frames x markers   segment   fit-joints   together   times the row before\n")
    previous = None
    with tempfile.TemporaryDirectory() as place:
        for rate in RATES:
            trial, planar = recording(Path(place), rate)
            inputs: dict[str, Artefact] = {"planar.parquet": planar}
            segments = compute("segment", trial, inputs)
            with_segments = {**inputs, "segments.parquet": segments}
            first = timed(partial(compute, "segment", trial, inputs))
            second = timed(partial(compute, "fit-joints", trial, with_segments))
            markers = len(planar.labels)
            ratio = "" if previous is None else f"{(first + second) / previous:.2f}"
            previous = first + second
            size = f"{len(planar.frames)} x {markers}"
            sys.stdout.write(f"{size:16s} {first:7.2f} s {second:10.2f} s {previous:8.2f} s   {ratio}\n")


if __name__ == "__main__":
    main()
