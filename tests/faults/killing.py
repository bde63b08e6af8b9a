"""Runs killed at random times: all files left must be complete, and continuing must give the same results.

    python tests/faults/killing.py [KILLS [SEED [TRIAL.yaml ...]]]

Each round copies a trial, starts a run in a separate process, kills it with SIGKILL after a random time, checks all
files, lets a new run finish and compares its results with those of an undisturbed run. Random times seldom fall between
two files of one stage; therefore the run is also killed before every single rename.
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
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id.config import load
from mocap_id.reporting import SUMMARY_FILE
from mocap_id.runner import run
from mocap_id.stages import STAGES
from mocap_id.store import Artefact, Folder, Origin, Tree, hash_bytes, hdf5, parquet
from mocap_id.store.provenance import SCHEMAS


@dataclass(frozen=True)
class Round:
    """Result of one kill."""

    when: str
    killed: bool  # False if the run was done before
    computed: int  # stages that the new run had to compute


def contents(out: Path) -> dict[str, str]:
    """Return hashes of all outputs, without computation times."""
    folder = Folder(out)
    summary = json.loads((out / SUMMARY_FILE).read_text("utf-8")) | {"time_s": None}
    artefacts = {file: hash_bytes(encoded(folder.read(file))) for file in SCHEMAS}
    return artefacts | {SUMMARY_FILE: json.dumps(summary)}


def encoded(artefact: Artefact) -> bytes:
    """Return an artefact's bytes with a fixed computation time."""
    origin = Origin("any", 1, {}, {}, "", 0.0)
    return hdf5.encode_tree(artefact, origin) if isinstance(artefact, Tree) else parquet.encode_table(artefact, origin)


class Killing:
    """A trial, what an undisturbed run makes of it and how long that takes.

    Parameters
    ----------
    trial : Path
        Its file, in a folder of its own that holds no run.
    place : Path
        An empty folder.
    """

    def __init__(self, trial: Path, place: Path) -> None:
        self.trial, self.place = trial, place
        self.expected = contents(run(load(self._copy("whole"))).folder)
        again = self._copy("again")
        start = time.perf_counter()  # now that everything is imported and compiled
        run(load(again))
        self.seconds = time.perf_counter() - start

    def at_random(self, count: int, seed: int) -> Iterator[Round]:
        """Kill so many runs; AssertionError where something half-written or something else is left."""
        rng = np.random.default_rng(seed)
        while count:
            after = float(rng.uniform(0.0, self.seconds))
            found = self._round(f"after {after:.3f} s", after)
            count -= found.killed
            yield found

    def at_renamings(self, step: int = 1) -> Iterator[Round]:
        """Kill a run before each renaming, or some, until one gets to its end."""
        number, killed = 0, True
        while killed:
            found = self._round(f"before renaming {number}", None, number)
            number, killed = number + step, found.killed
            yield found

    def _round(self, when: str, after: float | None, renaming: int | None = None) -> Round:
        file = self._copy("round")
        process = multiprocessing.get_context("fork").Process(target=_run, args=(file, renaming))
        process.start()
        process.join(after)
        if process.is_alive():
            assert process.pid is not None
            os.kill(process.pid, signal.SIGKILL)
        process.join()
        assert process.exitcode in (0, -signal.SIGKILL), f"{when}: ended with {process.exitcode}"
        trial = load(file)
        check(trial.out)
        outcome = run(trial)
        assert contents(outcome.folder) == self.expected, f"killed {when}, another result"
        left = [path for path in outcome.folder.rglob("*") if path.name.endswith(".mocap-id.tmp")]
        assert not left, f"killed {when}, left over: {left}"
        return Round(when, process.exitcode != 0, sum(step.action == "computed" for step in outcome.steps))

    def _copy(self, name: str) -> Path:
        folder = self.place / name
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self.trial.parent, folder)
        return folder / self.trial.name


def check(out: Path) -> None:
    """Check that every artefact can be read and the outputs of every stage belong together."""
    folder = Folder(out)
    for stage in STAGES:
        for file in stage.outputs:
            if file in SCHEMAS and folder.exists(file):
                folder.read(file)
    for file in ("summary.json", "report.html"):
        if (out / file).exists():
            assert (out / file).read_bytes().rstrip().endswith((b"}", b"</html>")), f"{file} is cut off"


def _run(file: Path, renaming: int | None) -> None:
    rename, left = Path.replace, renaming

    def replace(path: Path, target: Path) -> Path:
        nonlocal left
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        left = None if left is None else left - 1
        return rename(path, target)

    Path.replace = replace  # type: ignore[method-assign, assignment]
    run(load(file))


def told(rounds: Iterable[Round]) -> str:
    """Return the number of kills by stage."""
    done = []
    for one in rounds:
        done.append(one)
        print(f"{one.when}: {'killed' if one.killed else 'done before'}, {one.computed} stages left", flush=True)
    names = [*(stage.name for stage in STAGES), "after the last stage"]
    stages = Counter(names[len(STAGES) - one.computed] for one in done if one.killed)
    each = ", ".join(f"{name} {stages[name]}" for name in names if stages[name])
    return f"{sum(stages.values())} kills, all resumed to the same results; killed in: {each}"


def main() -> None:
    """Kill the requested number of runs of the trials, or of the samples."""
    asked = [int(text) for text in sys.argv[1:3]]
    count, seed = [*asked, *(200, 1)[len(asked) :]]
    root = Path(__file__).resolve().parents[2] / "sample_trials"
    files = [Path(text).resolve() for text in sys.argv[3:]] or sorted(root.glob("*/trial.yaml"))
    for number, file in enumerate(files):
        with tempfile.TemporaryDirectory(prefix="mocap-id-kills-") as place:
            killing = Killing(file, Path(place))
            name, own = file.parent.name, count // len(files)
            print(f"{name}, at random times: {told(killing.at_random(own, seed + number))}", flush=True)
            print(f"{name}, before renamings: {told(killing.at_renamings())}", flush=True)


if __name__ == "__main__":
    main()
