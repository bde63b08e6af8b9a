"""Time and memory against frames, markers and joints, stage by stage: a part of benchmarks/scale.py."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scale_processes import PROGRAM, in_turns, spend, told
from scale_recordings import Wanted, make

STAGES = ("planarise", "segment", "fit-joints", "ukf-smooth", "identify-dim", "report")
WARM = Wanted(1_000)
SHORT = 1_000_000  # marker-frames up to which a run is repeated
LARGER = 500_000  # marker-frames from which fixed costs are small


def measure(wanted: Sequence[Wanted], place: Path, repeats: int, say: Any) -> list[dict[str, Any]]:
    """Each recording: its stages in a warm process, whole runs in fresh ones, and the floor."""
    return [_one(one, place, repeats if one.marker_frames <= SHORT else 1, say) for one in wanted]


def _one(wanted: Wanted, place: Path, repeats: int, say: Any) -> dict[str, Any]:
    file, warm = make(wanted, place), make(WARM, place)
    runs = [_stages(file, warm, place) for _ in range(repeats)]
    whole = in_turns({"run": lambda: _whole(file, place)}, repeats)["run"]
    shutil.rmtree(place / "runs", ignore_errors=True)
    floor = told("scale_floor.py", str(file.with_suffix(".c3d")), "--quick", place=place)
    say(f"{wanted.name}: {whole.wall:.1f} s, {whole.peak:.0f} MB")
    first = runs[0]
    return {
        "wanted": asdict(wanted),
        "stages": {name: _middle(runs, k) for k, name in enumerate(STAGES)},
        "whole": asdict(whole),
        "floor": floor,
        **{key: first[key] for key in ("verdict", "codes", "segments", "files")},
    }


def _stages(file: Path, warm: Path, place: Path) -> dict[str, Any]:
    shutil.rmtree(place / "runs", ignore_errors=True)
    found: dict[str, Any] = told("scale_trial.py", str(file), str(warm), place=place)
    names = [(one["stage"], one["action"]) for one in found["stages"]]
    if names != [(name, "computed") for name in STAGES]:
        raise RuntimeError(f"{file}: {names}, verdict {found['verdict']} {found['codes']}")
    return found


def _whole(file: Path, place: Path) -> Any:
    shutil.rmtree(place / "runs", ignore_errors=True)
    return spend([*PROGRAM, "run", "--quiet", str(file)], place)


def _middle(runs: Sequence[dict[str, Any]], k: int) -> dict[str, float | None]:
    """Medians of a stage's times, its largest memory."""
    each = [run["stages"][k] for run in runs]
    peaks = [one["peak"] for one in each if one["peak"] is not None]
    growth = [one["peak"] - one["first"] for one in each if one["peak"] is not None]
    return {
        **{key: median(one[key] for one in each) for key in ("wall", "cpu", "computing")},
        "peak": max(peaks, default=None),
        "growth": max(growth, default=None),
    }


def exponent(size: Sequence[float], value: Sequence[float]) -> float | None:
    """p of value ∝ size^p, by least squares of the logarithms; None for fewer than two sizes."""
    if len(size) < 2:
        return None
    return float(np.polyfit(np.log(size), np.log(value), 1)[0])


def line(size: Sequence[float], value: Sequence[float]) -> tuple[float, float] | None:
    """Slope and intercept of a straight line; None for fewer than two sizes."""
    if len(size) < 2:
        return None
    slope, intercept = np.polyfit(size, value, 1)
    return float(slope), float(intercept)
