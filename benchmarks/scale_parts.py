"""Measurements of processes, stages, batches and long recordings: parts of benchmarks/scale.py."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import pyarrow.parquet as pq
from harness import ROOT, find_recordings, write_real_trial
from scale_recordings import Wanted, make

HERE = Path(__file__).parent
PROGRAM = (sys.executable, "-m", "mocap_id_cli")
ONE_CORE = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "MKL", "OMP", "NUMBA")}
STAGES = ("planarise", "segment", "fit-joints", "ukf-smooth", "identify-dim", "report")
WARM = Wanted(1_000)
REPEATED = 1_000_000  # marker-frames up to which a run is repeated
SAMPLE = ROOT / "sample_trials" / "sit-to-stand"
CLUSTER = "kind: local\nworkers: 2\n"
BARE = {
    "Python, nothing imported": "pass",
    "libraries only: numpy, pandas, pyarrow, h5py": "import numpy, pandas, pyarrow.parquet, h5py",
}
RUN, RUN_AGAIN = "mocap-id run", "mocap-id run again"
PERSON = "a run of STS1, a person, 14 s at 100 Hz"
EARLIER = "a run by an earlier commit"
ONE, TWO, APART, DASK, AGAIN = (
    "one process (`--jobs 1`)",
    "two processes (`--jobs 2`)",
    "two commands of one process each, half the trials each, started together",
    "Dask, two workers (`--cluster`)",
    "the same again, nothing to do (`--jobs 2`)",
)
Say = Callable[[str], object]


@dataclass(frozen=True)
class Spent:
    """Wall and processor time, s, and the largest resident memory of any one process, MB (1e6 bytes)."""

    wall: float
    cpu: float
    peak: float


def spend_together(commands: Sequence[Sequence[str]], place: Path) -> list[Spent]:
    """Measure commands that start at the same time; raise RuntimeError with the message of one that fails."""
    words: list[str] = []
    for command in commands:
        words += [*(["--and"] if words else []), *command]
    found = run_script("scale_measure.py", *words, place=place)
    for command, one in zip(commands, found, strict=True):
        if one["code"]:
            raise RuntimeError(f"{' '.join(command)} ended with {one['code']}: {one['said']}")
    return [Spent(one["wall"], one["cpu"], one["peak"]) for one in found]


def spend(command: Sequence[str], place: Path) -> Spent:
    """Measure one command."""
    return spend_together([command], place)[0]


def run_script(name: str, *words: str, place: Path) -> Any:
    """Return the JSON output of a script of this folder, which runs in a new process."""
    command = [sys.executable, str(HERE / name), *words]
    done = subprocess.run(command, cwd=place, env=os.environ | ONE_CORE, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{name} {' '.join(words)} ended with {done.returncode}: {done.stderr[-2000:]}")
    return json.loads(done.stdout)


def measure_in_turns(measures: Mapping[str, Callable[[], Spent]], repeats: int) -> dict[str, Spent]:
    """Return median times and largest memories of measurements that are made in turns.

    Other work then disturbs all of them alike.
    """
    found: dict[str, list[Spent]] = {name: [] for name in measures}
    for _ in range(repeats):
        for name, measure in measures.items():
            found[name].append(measure())
    return {
        name: Spent(median(one.wall for one in each), median(one.cpu for one in each), max(one.peak for one in each))
        for name, each in found.items()
    }


def run_anew(trial: Path, place: Path, before: Path | None = None) -> Spent:
    """Measure ``mocap-id run`` without earlier results; ``before`` is the source tree of another commit, or None."""
    shutil.rmtree(trial.parent / "runs", ignore_errors=True)
    other = [] if before is None else ["env", f"PYTHONPATH={before / 'pipeline'}:{before / 'cli'}"]
    return spend([*other, *PROGRAM, "run", "--quiet", str(trial)], place)


def measure_starts(
    place: Path, repeats: int, filterpy_frames: int, spare: Wanted, before: Path | None
) -> dict[str, Any]:
    """Measure whole processes in turns, and programs that do a part of the work.

    They use the reference recording, or without MOCAP_ID_RECORDINGS the simulated recording ``spare``. ``before`` is a
    source tree of an earlier commit, which is run in turns with this one, or None.
    """
    folder, person = find_recordings(), None
    if folder is None:
        trial, what = make(spare, place), f"a simulated sit-to-stand of {spare.frames} frames at {spare.rate:g} Hz"
    else:
        shutil.copyfile(folder / "simulated" / "sts-normal" / "trial.c3d", place / "sts-normal.c3d")
        trial, what = place / "sts-normal.yaml", "the reference recording simulated/sts-normal"
        trial.write_text("trial: sts-normal\nrecording: sts-normal.c3d\nprotocol: sit-to-stand\n", encoding="utf-8")
        person = write_real_trial(folder / "sit-to-stand" / "STS1", place / "sts1.yaml")
    measures: dict[str, Callable[[], Spent]] = {
        name: partial(spend, [sys.executable, "-c", code], place) for name, code in BARE.items()
    }
    measures |= {f"mocap-id {word}": partial(spend, [*PROGRAM, word], place) for word in ("--version", "--help")}
    measures[RUN] = partial(run_anew, trial, place)
    measures[RUN_AGAIN] = partial(spend, [*PROGRAM, "run", "--quiet", str(trial)], place)
    if person is not None:
        measures[PERSON] = partial(run_anew, person, place)
    if before is not None:
        measures[EARLIER] = partial(run_anew, trial, place, before)
    for name in {RUN, PERSON, EARLIER} & measures.keys():
        measures[name]()  # compiles
    found = measure_in_turns(measures, repeats)
    return {
        "recording": what,
        "spent": {name: asdict(one) for name, one in found.items()},
        "floor": run_script("scale_floor.py", str(trial.with_suffix(".c3d")), place=place),
        "filters": run_script("filter.py", f"--frames={filterpy_frames}", place=place),
        "repeats": repeats,
    }


def measure_lengths(wanted: Sequence[Wanted], place: Path, repeats: int, say: Say) -> list[dict[str, Any]]:
    """Measure recordings: their stages in a warm process, whole runs in new processes, and the floor."""
    return [_measure_length(one, place, repeats if one.marker_frames <= REPEATED else 1, say) for one in wanted]


def _measure_length(wanted: Wanted, place: Path, repeats: int, say: Say) -> dict[str, Any]:
    file, warm = make(wanted, place), make(WARM, place)
    runs = []
    for _ in range(repeats):
        shutil.rmtree(place / "runs", ignore_errors=True)
        runs.append(run_script("scale_trial.py", str(file), str(warm), place=place))
        names = [(one["stage"], one["action"]) for one in runs[-1]["stages"]]
        if names != [(name, "computed") for name in STAGES]:
            raise RuntimeError(f"{file}: {names}, verdict {runs[-1]['verdict']} {runs[-1]['codes']}")
    whole = measure_in_turns({"run": partial(run_anew, file, place)}, repeats)["run"]
    shutil.rmtree(place / "runs", ignore_errors=True)
    floor = run_script("scale_floor.py", str(file.with_suffix(".c3d")), "--quick", place=place)
    say(f"{wanted.name}: {whole.wall:.1f} s, {whole.peak:.0f} MB")
    return {
        "wanted": asdict(wanted),
        "stages": {name: _summarise([run["stages"][k] for run in runs]) for k, name in enumerate(STAGES)},
        "whole": asdict(whole),
        "floor": floor,
        **{key: runs[0][key] for key in ("verdict", "codes", "segments")},
    }


def _summarise(each: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """Return the median times of a stage, and its largest memory and growth of memory; None where unknown."""
    known = [one for one in each if one["peak"] is not None]
    return {
        **{key: median(one[key] for one in each) for key in ("wall", "cpu", "computing")},
        "peak": max((one["peak"] for one in known), default=None),
        "growth": max((one["peak"] - one["first"] for one in known), default=None),
    }


def measure_batches(place: Path, trials: int, rounds: int, say: Say) -> dict[str, Any]:
    """Measure each way to run the same trials, in turns, and return medians over the rounds."""
    every = str(place / "batch" / "*.yaml")
    halves = _write_trials(place / "batch", trials)
    (place / "cluster.yml").write_text(CLUSTER, encoding="utf-8")
    ways: Mapping[str, Callable[[], Spent]] = {
        ONE: partial(_run_batch, place, [every], "--jobs", "1"),
        TWO: partial(_run_batch, place, [every], "--jobs", "2"),
        AGAIN: partial(_run_batch, place, [every], "--jobs", "2", keep=True),
        APART: partial(_run_batch, place, halves, "--jobs", "1"),
        DASK: partial(_run_batch, place, [every], "--cluster", str(place / "cluster.yml")),
    }
    found: dict[str, list[dict[str, float]]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            one = asdict(way()) | {"trial": _read_median_seconds(place)}
            found[name].append(one)
            say(f"{name}: {one['wall']:.1f} s, {one['trial']:.2f} s a trial")
    keys = ("wall", "cpu", "peak", "trial")
    medians = {name: {key: median(one[key] for one in each) for key in keys} for name, each in found.items()}
    return {"trials": trials, "rounds": rounds, "ways": medians}


def _write_trials(folder: Path, count: int) -> list[str]:
    """Write trials of the sample recording, half of them called a, half b, and return their patterns."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copyfile(SAMPLE / "trial.c3d", folder / "trial.c3d")
    text = (SAMPLE / "trial.yaml").read_text("utf-8")
    for k in range(count):
        name = f"{'ab'[k % 2]}-{k:05}"
        (folder / f"{name}.yaml").write_text(text.replace('trial: "sit-to-stand"', f"trial: {name}"), encoding="utf-8")
    return [str(folder / f"{half}-*.yaml") for half in "ab"]


def _run_batch(place: Path, patterns: Sequence[str], *how: str, keep: bool = False) -> Spent:
    """Measure one batch for each pattern, all started together; ``keep`` keeps earlier results."""
    if not keep:
        shutil.rmtree(place / "batch" / "runs", ignore_errors=True)
    for old in place.glob("batch-*.parquet"):
        old.unlink()
    commands = [
        [*PROGRAM, "batch", pattern, *how, "--out", str(place / f"batch-{k}.parquet"), "--quiet"]
        for k, pattern in enumerate(patterns)
    ]
    each = spend_together(commands, place)
    return Spent(max(one.wall for one in each), sum(one.cpu for one in each), max(one.peak for one in each))


def _read_median_seconds(place: Path) -> float:
    """Return the median time of the trials in the tables of a batch, s."""
    tables = [pq.read_table(file).to_pydict() for file in sorted(place.glob("batch-*.parquet"))]
    if any(code != 0 for table in tables for code in table["exit_code"]):
        raise RuntimeError("a trial of the batch did not go through")
    return median(one for table in tables for one in table["seconds"])


def measure_tasks(place: Path, counts: Sequence[int], dask: Sequence[int], say: Say) -> dict[str, Any]:
    """Measure trials that take no time, and the work before and after them."""
    found: dict[str, Any] = {}
    for what, sizes in (("here", counts), ("dask", dask), ("table", counts), ("finding", counts), ("study", counts)):
        most = {"finding": 10_000, "study": 3_000}.get(what, max(sizes))
        found[what] = []
        for count in dict.fromkeys(min(size, most) for size in sizes):
            one = run_script("scale_tasks.py", what, str(count), place=place)
            say(f"{what}: {one['count']:,} in {one['seconds']:.1f} s, {one['peak']:.0f} MB")
            found[what].append(one)
    return found


def measure_storage(place: Path) -> dict[str, Any]:
    """Return the bytes of each file in a sample trial's run folder."""
    folder = place / "storage"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in ("trial.c3d", "trial.yaml"):
        shutil.copyfile(SAMPLE / name, folder / name)
    spend([*PROGRAM, "run", "--quiet", str(folder / "trial.yaml")], place)
    out = next((folder / "runs").iterdir())
    files = {file.relative_to(out).as_posix(): file.stat().st_size for file in out.rglob("*") if file.is_file()}
    return {"files": files, "recording": (folder / "trial.c3d").stat().st_size}
