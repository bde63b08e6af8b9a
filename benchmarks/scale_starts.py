"""Time of whole processes, and a run beside filterpy: a part of benchmarks/scale.py."""

from __future__ import annotations

import shutil
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from harness import recordings, write_real_trial
from scale_processes import PROGRAM, Spent, in_turns, read_script, spend
from scale_recordings import Wanted, make

BARE = {
    "Python, nothing imported": "pass",
    "libraries only: numpy, pandas, pyarrow, h5py": "import numpy, pandas, pyarrow.parquet, h5py",
}
RUN, AGAIN = "mocap-id run", "mocap-id run again"
PERSON = "a run of STS1, a person, 14 s at 100 Hz"
EARLIER = "a run by an earlier commit"
_TRIAL = "trial: sts-normal\nrecording: sts-normal.c3d\nprotocol: sit-to-stand\n"


def measure(
    place: Path, repeats: int, filterpy_frames: int, spare: Wanted, before: Path | None = None
) -> dict[str, Any]:
    """Measure whole processes in turns, then the floors, on the reference recording or a simulated one.

    ``before`` is a source tree of an earlier commit, which is run in turns with this one.
    """
    trial, what = reference(place, spare)
    measures: dict[str, Any] = {
        name: (lambda code=code: spend([sys.executable, "-c", code], place)) for name, code in BARE.items()
    }
    measures |= {
        f"mocap-id {word}": (lambda word=word: spend([*PROGRAM, word], place)) for word in ("--version", "--help")
    }
    measures |= {RUN: lambda: _fresh(trial, place), AGAIN: lambda: spend(_run(trial), place)}
    if (person := _person(place)) is not None:
        measures[PERSON] = lambda: _fresh(person, place)
    if before is not None:
        measures[EARLIER] = lambda: _fresh(trial, place, before)
    for name in {RUN, PERSON, EARLIER} & measures.keys():
        measures[name]()  # compiles
    found = in_turns(measures, repeats)
    floor = read_script("scale_floor.py", str(trial.with_suffix(".c3d")), place=place)
    filters = read_script("filter.py", f"--frames={filterpy_frames}", place=place)
    return {
        "recording": what,
        "spent": {name: asdict(one) for name, one in found.items()},
        "floor": floor,
        "filters": filters,
        "repeats": repeats,
    }


def _run(trial: Path, before: Path | None = None) -> list[str]:
    other = [] if before is None else ["env", f"PYTHONPATH={before / 'pipeline'}:{before / 'cli'}"]
    return [*other, *PROGRAM, "run", "--quiet", str(trial)]


def _fresh(trial: Path, place: Path, before: Path | None = None) -> Spent:
    shutil.rmtree(trial.parent / "runs", ignore_errors=True)
    return spend(_run(trial, before), place)


def _person(place: Path) -> Path | None:
    """Write the configuration of a person's trial at 100 Hz; None without the shared recordings."""
    folder = recordings()
    if not folder:
        return None
    return write_real_trial(folder / "sit-to-stand" / "STS1", place / "sts1.yaml")


def reference(place: Path, spare: Wanted) -> tuple[Path, str]:
    """Write the configuration beside a copy of the reference recording."""
    folder = recordings()
    if not folder:
        return make(spare, place), f"a simulated sit-to-stand of {spare.frames} frames at {spare.rate:g} Hz"
    shutil.copyfile(folder / "simulated" / "sts-normal" / "trial.c3d", place / "sts-normal.c3d")
    trial = place / "sts-normal.yaml"
    trial.write_text(_TRIAL, encoding="utf-8")
    return trial, "the reference recording simulated/sts-normal"
