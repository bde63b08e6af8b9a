"""Batches: workers, Dask, and the cost of distributing 100,000 trials: a part of benchmarks/scale.py."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

import pyarrow.parquet as pq
from scale_processes import PROGRAM, Spent, read_script, spend, together

SAMPLE = Path(__file__).resolve().parents[1] / "sample_trials" / "sit-to-stand"
CLUSTER = "kind: local\nworkers: 2\n"
ONE, TWO, APART, DASK, AGAIN = (
    "one process (`--jobs 1`)",
    "two processes (`--jobs 2`)",
    "two commands of one process each, half the trials each, started together",
    "Dask, two workers (`--cluster`)",
    "the same again, nothing to do (`--jobs 2`)",
)


def batches(place: Path, trials: int, rounds: int, say: Callable[[str], object]) -> dict[str, Any]:
    """Measure each way to run the same trials, in turns; medians over the rounds."""
    folder = place / "batch"
    halves = _trials(folder, trials)
    every = str(folder / "*.yaml")
    (place / "cluster.yml").write_text(CLUSTER, encoding="utf-8")
    ways: Mapping[str, Callable[[], Spent]] = {
        ONE: lambda: _batch(place, [every], "--jobs", "1"),
        TWO: lambda: _batch(place, [every], "--jobs", "2"),
        AGAIN: lambda: _batch(place, [every], "--jobs", "2", keep=True),
        APART: lambda: _batch(place, halves, "--jobs", "1"),
        DASK: lambda: _batch(place, [every], "--cluster", str(place / "cluster.yml")),
    }
    found: dict[str, list[dict[str, float]]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            one = asdict(way()) | _table(place)
            found[name].append(one)
            say(f"{name}: {one['wall']:.1f} s, of which {one['working']:.1f} s in trials")
    keys = ("wall", "cpu", "peak", "working", "trial")
    ways_found = {name: {key: median(one[key] for one in each) for key in keys} for name, each in found.items()}
    return {"trials": trials, "rounds": rounds, "ways": ways_found, "each": found}


def _trials(folder: Path, count: int) -> list[str]:
    """Write trials of the sample recording, half of them called a, half b, and return their patterns."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copyfile(SAMPLE / "trial.c3d", folder / "trial.c3d")
    text = (SAMPLE / "trial.yaml").read_text("utf-8")
    for k in range(count):
        name = f"{'ab'[k % 2]}-{k:05}"
        (folder / f"{name}.yaml").write_text(text.replace('trial: "sit-to-stand"', f"trial: {name}"), encoding="utf-8")
    return [str(folder / f"{half}-*.yaml") for half in "ab"]


def _batch(place: Path, patterns: Sequence[str], *how: str, keep: bool = False) -> Spent:
    if not keep:
        shutil.rmtree(place / "batch" / "runs", ignore_errors=True)
    for old in place.glob("batch-*.parquet"):
        old.unlink()
    commands = [
        [*PROGRAM, "batch", pattern, *how, "--out", str(place / f"batch-{k}.parquet"), "--quiet"]
        for k, pattern in enumerate(patterns)
    ]
    each = together(commands, place)
    return Spent(max(one.wall for one in each), sum(one.cpu for one in each), max(one.peak for one in each))


def _table(place: Path) -> dict[str, float]:
    """Return the seconds that all trials took, and their median."""
    tables = [pq.read_table(file).to_pydict() for file in sorted(place.glob("batch-*.parquet"))]
    if any(code != 0 for table in tables for code in table["exit_code"]):
        raise RuntimeError("a trial of the batch did not go through")
    seconds = [one for table in tables for one in table["seconds"]]
    return {"working": sum(seconds), "trial": median(seconds)}


def distribute(place: Path, counts: Sequence[int], dask: Sequence[int], say: Callable[[str], object]) -> dict[str, Any]:
    """Measure trials that take no time, and the work before and after them."""
    found: dict[str, Any] = {}
    for what, sizes in (("here", counts), ("dask", dask), ("table", counts), ("finding", counts), ("study", counts)):
        found[what] = []
        for count in sizes:
            most = {"finding": 10_000, "study": 3_000}.get(what, count)
            if count > most and found[what] and found[what][-1]["count"] >= most:
                continue
            one = read_script("scale_tasks.py", what, str(min(count, most)), place=place)
            say(f"{what}: {one['count']:,} in {one['seconds']:.1f} s, {one['peak']:.0f} MB")
            found[what].append(one)
    return found


def storage(place: Path) -> dict[str, Any]:
    """Return the bytes of a sample trial's run folder, by file."""
    folder = place / "storage"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in ("trial.c3d", "trial.yaml"):
        shutil.copyfile(SAMPLE / name, folder / name)
    spent = spend([*PROGRAM, "run", "--quiet", str(folder / "trial.yaml")], place)
    out = next((folder / "runs").iterdir())
    files = {file.relative_to(out).as_posix(): file.stat().st_size for file in out.rglob("*") if file.is_file()}
    return {"files": files, "recording": (folder / "trial.c3d").stat().st_size, "run": asdict(spent)}
