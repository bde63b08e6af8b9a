"""Runs that are killed without a word at random instants: what is left must be whole, and resuming must give the same.

    python tests/faults/killing.py [KILLS [SEED]]

Each round copies a trial, starts a run of it in a process of its own, kills that with SIGKILL after a random time,
looks at everything that is left, lets a new run finish and compares its results with an undisturbed run's.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.config import load
from mocap_id.reporting.contents import FILES, SUMMARY_FILE
from mocap_id.runner import run
from mocap_id.stages import STAGES
from mocap_id.store import Folder, hash_bytes
from mocap_id.store.schemas import SCHEMAS


@dataclass(frozen=True)
class Round:
    """What one kill left."""

    after: float  # s
    computed: int  # stages that the new run had to compute


def contents(out: Path) -> dict[str, str]:
    """Content of everything that the stages write, but for the time that they took: artefacts by their own hash."""
    folder = Folder(out)
    summary = json.loads((out / SUMMARY_FILE).read_text("utf-8")) | {"time_s": None}
    figures = {file: hash_bytes((out / file).read_bytes()) for file in FILES if file.startswith("figures/")}
    artefacts = {file: folder.provenance(file).content for file in SCHEMAS}
    return artefacts | figures | {SUMMARY_FILE: json.dumps(summary)}


def kills(trial: Path, count: int, seed: int) -> Iterator[Round]:
    """Kill ``count`` runs of a trial; AssertionError where something half-written or something else is left."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="mocap-id-kills-") as name:
        whole, again = Path(name) / "whole", Path(name) / "again"
        for folder in (whole, again):
            shutil.copytree(trial.parent, folder)
        expected = contents(run(load(whole / trial.name)).folder)
        start = time.perf_counter()  # now that everything is imported and compiled
        run(load(again / trial.name))
        seconds = time.perf_counter() - start
        for number in range(count):
            here = Path(name) / f"round-{number}"
            shutil.copytree(trial.parent, here)
            yield _round(here / trial.name, float(rng.uniform(0.0, seconds)), expected)
            shutil.rmtree(here)


def _round(file: Path, after: float, expected: dict[str, str]) -> Round:
    process = multiprocessing.get_context("fork").Process(target=_run, args=(file,))
    process.start()
    process.join(after)
    if process.is_alive():
        assert process.pid is not None
        os.kill(process.pid, signal.SIGKILL)
    process.join()
    trial = load(file)
    check(trial.out)
    outcome = run(trial)
    assert contents(outcome.folder) == expected, f"killed after {after:.3f} s, another result"
    left = [path for path in outcome.folder.rglob("*") if path.name.endswith(".mocap-id.tmp")]
    assert not left, f"killed after {after:.3f} s, left over: {left}"
    return Round(after, sum(step.action == "computed" for step in outcome.steps))


def check(out: Path) -> None:
    """Whatever has its final name is whole: every artefact can be read, every stage's outputs belong together."""
    folder = Folder(out)
    for stage in STAGES:
        for file in stage.outputs:
            if file in SCHEMAS and folder.exists(file):
                folder.read(file)
    for file in ("summary.json", "report.html"):
        if (out / file).exists():
            assert (out / file).read_bytes().rstrip().endswith((b"}", b"</html>")), f"{file} is cut off"


def _run(file: Path) -> None:
    run(load(file))


def main() -> None:
    """Kill as many runs of the sample trials as asked for."""
    asked = [int(text) for text in sys.argv[1:]]
    count, seed = [*asked, *(200, 1)[len(asked) :]]
    root = Path(__file__).resolve().parents[2] / "sample_trials"
    files = sorted(root.glob("*/trial.yaml"))
    for number, file in enumerate(files):
        done = list(kills(file, count // len(files), seed + number))
        computed = np.bincount([one.computed for one in done], minlength=len(STAGES) + 1)
        print(
            f"{file.parent.name}: {len(done)} kills, resumed to the same results;", "stages left to compute:", computed
        )


if __name__ == "__main__":
    main()
