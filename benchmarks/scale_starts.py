"""What a process costs before it does anything, and a warm run beside filterpy: a part of benchmarks/scale.py."""

from __future__ import annotations

import os
import shutil
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from scale_processes import PROGRAM, Spent, in_turns, spend, told
from scale_recordings import Wanted, make

BARE = {
    "python, nothing imported": "pass",
    "the libraries alone: numpy, pandas, pyarrow, h5py": "import numpy, pandas, pyarrow.parquet, h5py",
}
RUN, AGAIN = "mocap-id run", "mocap-id run once more"
_TRIAL = "trial: sts-normal\nrecording: sts-normal.c3d\nprotocol: sit-to-stand\n"


def measure(place: Path, repeats: int, filterpy_frames: int, spare: Wanted) -> dict[str, Any]:
    """Whole processes in turns, then the floors; of the reference recording, or of one as long where it is missing."""
    trial, what = reference(place, spare)
    measures: dict[str, Any] = {
        name: (lambda code=code: spend([sys.executable, "-c", code], place)) for name, code in BARE.items()
    }
    measures |= {
        f"mocap-id {word}": (lambda word=word: spend([*PROGRAM, word], place)) for word in ("--version", "--help")
    }
    run = [*PROGRAM, "run", "--quiet", str(trial)]

    def fresh() -> Spent:
        shutil.rmtree(trial.parent / "runs", ignore_errors=True)
        return spend(run, place)

    fresh()  # compiles
    measures |= {RUN: fresh, AGAIN: lambda: spend(run, place)}
    found = in_turns(measures, repeats)
    floor = told("scale_floor.py", str(trial.with_suffix(".c3d")), place=place)
    filters = told("scale_filters.py", str(filterpy_frames), place=place)
    return {
        "recording": what,
        "spent": {name: asdict(one) for name, one in found.items()},
        "floor": floor,
        "filters": filters,
        "repeats": repeats,
    }


def reference(place: Path, spare: Wanted) -> tuple[Path, str]:
    """A trial's file beside a copy of simulated/sts-normal's recording."""
    folder = os.environ.get("MOCAP_ID_RECORDINGS")
    if not folder:
        return make(spare, place), f"a simulated sit-to-stand of {spare.frames} frames at {spare.rate:g} Hz"
    shutil.copyfile(Path(folder) / "simulated" / "sts-normal" / "trial.c3d", place / "sts-normal.c3d")
    trial = place / "sts-normal.yaml"
    trial.write_text(_TRIAL, encoding="utf-8")
    return trial, "the reference recording simulated/sts-normal"
