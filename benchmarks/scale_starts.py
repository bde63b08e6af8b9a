"""What a process costs before it does anything, and a warm run beside filterpy: a part of benchmarks/scale.py."""

from __future__ import annotations

import json
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
PERSON = "a run of STS1, a person, 14 s at 100 Hz"
EARLIER = "a run by an earlier commit"
_PERSON = {"markers": "STS1.trc", "forces": "STS1_grf.mot"}
_TRIAL = "trial: sts-normal\nrecording: sts-normal.c3d\nprotocol: sit-to-stand\n"


def measure(
    place: Path, repeats: int, filterpy_frames: int, spare: Wanted, before: Path | None = None
) -> dict[str, Any]:
    """Whole processes in turns, then the floors; of the reference recording, or of one as long where it is missing.

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
    floor = told("scale_floor.py", str(trial.with_suffix(".c3d")), place=place)
    filters = told("scale_filters.py", str(filterpy_frames), place=place)
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
    """The file of a trial of a person at 100 Hz; None without the shared recordings."""
    folder = os.environ.get("MOCAP_ID_RECORDINGS")
    if not folder:
        return None
    trial = place / "sts1.yaml"
    files = {key: str(Path(folder) / "sit-to-stand" / name) for key, name in _PERSON.items()}
    trial.write_text(json.dumps({"trial": "sts1", "recording": files, "protocol": "sit-to-stand"}), encoding="utf-8")
    return trial


def reference(place: Path, spare: Wanted) -> tuple[Path, str]:
    """A trial's file beside a copy of simulated/sts-normal's recording."""
    folder = os.environ.get("MOCAP_ID_RECORDINGS")
    if not folder:
        return make(spare, place), f"a simulated sit-to-stand of {spare.frames} frames at {spare.rate:g} Hz"
    shutil.copyfile(Path(folder) / "simulated" / "sts-normal" / "trial.c3d", place / "sts-normal.c3d")
    trial = place / "sts-normal.yaml"
    trial.write_text(_TRIAL, encoding="utf-8")
    return trial, "the reference recording simulated/sts-normal"
