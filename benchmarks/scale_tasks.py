"""Cost of distributing many trials that take no time: ``scale_tasks.py here|dask|table|finding|study COUNT``.

Prints JSON: count, seconds and peak memory of this process, MB. ``here`` and ``dask`` give trials without work to two
workers, as ``mocap-id batch`` does. ``table`` makes the batch's table from copies of one summary. ``finding`` reads the
files of many trials, and ``study`` the file of a study with many trials.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import scale_tasks
from scale_parts import PROGRAM, SAMPLE, spend
from scale_trial import read_memory

from mocap_id.config import Trial, load
from mocap_id.config.study import load_study
from mocap_id.reporting.results import ResultTable
from mocap_id.workflows.batch import BATCH, find_trials, make_row
from mocap_id.workflows.parallel import Backend, DaskBackend, LocalBackend, TrialRun, run_trials
from mocap_id.workflows.trial_outcome import TrialOutcome, read_summary


def do_nothing(trial: Trial) -> TrialRun:
    """Return the record of a trial that takes no time."""
    return TrialRun(trial.name, 0, None, None, "0" * 64, computed=True, seconds=0.0)


def make_trials(count: int) -> list[Trial]:
    one = load(SAMPLE / "trial.yaml")
    names = [f"s{k // 100:04}-trial-{k:06}" for k in range(count)]
    return [
        replace(one, keys=one.keys.model_copy(update={"trial": name}), out=one.out.with_name(name)) for name in names
    ]


def time_trials(backend: Backend, count: int) -> dict[str, float]:
    """Return the seconds until all trials were done, and until the first was reported."""
    wanted, first = make_trials(count), []
    start = perf_counter()
    run = scale_tasks.do_nothing  # workers find it by the name of its module, which here is __main__
    done = run_trials(wanted, backend, lambda _: first or first.append(perf_counter() - start), run=run)
    taken = perf_counter() - start
    if [one.trial for one in done] != [one.name for one in wanted]:
        raise RuntimeError("not every trial was done")
    return {"seconds": taken, "first": first[0]}


def time_table(count: int) -> dict[str, float]:
    """Return the seconds to make the table from copies of one summary, and its bytes."""
    with tempfile.TemporaryDirectory() as place:
        for name in ("trial.c3d", "trial.yaml"):
            shutil.copyfile(SAMPLE / name, Path(place) / name)
        file = Path(place) / "trial.yaml"
        spend([*PROGRAM, "run", "--quiet", str(file)], Path(place))  # in another process, whose memory does not count
        wanted = [replace(one, out=load(file).out) for one in make_trials(count)]
        start = perf_counter()
        rows = []
        for one in wanted:
            run = do_nothing(one)
            done = TrialOutcome(run=run, summary=read_summary(one.out, run))
            rows.append(make_row(done, one.file, one.out, Path(place)))
        content = ResultTable.of(BATCH, rows).parquet("batch")
    return {"seconds": perf_counter() - start, "bytes": len(content)}


def time_finding(count: int) -> dict[str, float]:
    """Return the seconds to read a folder with the files of ``count`` trials."""
    with tempfile.TemporaryDirectory() as place:
        for k in range(count):
            text = (SAMPLE / "trial.yaml").read_text("utf-8").replace("sit-to-stand", f"t{k:06}", 2)
            Path(place, f"t{k:06}.yaml").write_text(
                text.replace(f"protocol: t{k:06}", "protocol: sit-to-stand"), "utf-8"
            )
        start = perf_counter()
        found, unreadable = find_trials([place])
        taken = perf_counter() - start
    if len(found) != count or unreadable:
        raise RuntimeError(f"{len(found)} of {count} trials were found, {len(unreadable)} unreadable")
    return {"seconds": taken}


def time_study(count: int) -> dict[str, float]:
    """Return the seconds to read a study's file with three trials per person."""
    people = [f"  p{k:04}: {{height: 1.75, mass: 70}}" for k in range(count // 3 + 1)]
    lines = [
        f"  - {{trial: t{k:05}, subject: p{k // 3:04}, strategy: normal, recording: p{k // 3:04}/t{k:05}.c3d}}"
        for k in range(count)
    ]
    text = "\n".join(["study: many", "defaults: {protocol: sit-to-stand}", "subjects:", *people, "trials:", *lines])
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "study.yaml"
        file.write_text(text + "\n", "utf-8")
        start = perf_counter()
        load_study(file)
        return {"seconds": perf_counter() - start}


TASKS: dict[str, Callable[[int], dict[str, float]]] = {
    "here": lambda count: time_trials(LocalBackend(2), count),
    "dask": lambda count: time_trials(DaskBackend(cluster={"kind": "local", "workers": 2}), count),
    "table": time_table,
    "finding": time_finding,
    "study": time_study,
}


def main() -> None:
    what, count = sys.argv[1], int(sys.argv[2])
    before = read_memory("VmRSS") or 0.0
    found: dict[str, Any] = TASKS[what](count)
    print(json.dumps({"count": count, **found, "before": before, "peak": read_memory("VmHWM") or 0.0}))


if __name__ == "__main__":
    main()
