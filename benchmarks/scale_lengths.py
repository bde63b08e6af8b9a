"""Time and memory of every stage against frames, markers and joints: a part of benchmarks/scale.py."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scale_processes import PROGRAM, in_turns, read_script, spend
from scale_recordings import Wanted, make

STAGES = ("planarise", "segment", "fit-joints", "ukf-smooth", "identify-dim", "report")
WARM = Wanted(1_000)
SHORT = 1_000_000  # marker-frames up to which a run is repeated


def measure(wanted: Sequence[Wanted], place: Path, repeats: int, say: Any) -> list[dict[str, Any]]:
    """Measure each recording: its stages in a warm process, whole runs in new ones, and the floor."""
    return [_one(one, place, repeats if one.marker_frames <= SHORT else 1, say) for one in wanted]


def _one(wanted: Wanted, place: Path, repeats: int, say: Any) -> dict[str, Any]:
    file, warm = make(wanted, place), make(WARM, place)
    runs = [_stages(file, warm, place) for _ in range(repeats)]
    whole = in_turns({"run": lambda: _whole(file, place)}, repeats)["run"]
    shutil.rmtree(place / "runs", ignore_errors=True)
    floor = read_script("scale_floor.py", str(file.with_suffix(".c3d")), "--quick", place=place)
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
    found: dict[str, Any] = read_script("scale_trial.py", str(file), str(warm), place=place)
    names = [(one["stage"], one["action"]) for one in found["stages"]]
    if names != [(name, "computed") for name in STAGES]:
        raise RuntimeError(f"{file}: {names}, verdict {found['verdict']} {found['codes']}")
    return found


def _whole(file: Path, place: Path) -> Any:
    shutil.rmtree(place / "runs", ignore_errors=True)
    return spend([*PROGRAM, "run", "--quiet", str(file)], place)


def _middle(runs: Sequence[dict[str, Any]], k: int) -> dict[str, float | None]:
    """Return medians of a stage's times, and its largest memory."""
    each = [run["stages"][k] for run in runs]
    peaks = [one["peak"] for one in each if one["peak"] is not None]
    growth = [one["peak"] - one["first"] for one in each if one["peak"] is not None]
    return {
        **{key: median(one[key] for one in each) for key in ("wall", "cpu", "computing")},
        "peak": max(peaks, default=None),
        "growth": max(growth, default=None),
    }


@dataclass(frozen=True)
class Grown:
    """Processor seconds at every size, and their exponent: over all sizes and over the larger half."""

    seconds: tuple[float, ...]
    all: float | None
    larger: float | None


def fit_time(part: Sequence[Mapping[str, Any]], key: str, name: str) -> Grown:
    """Fit the time of a stage, or of a whole ``run``, against ``frames``, ``markers`` or ``joints``."""
    sizes = [float(one["wanted"][key]) for one in part]
    seconds = tuple(float((one["whole"] if name == "run" else one["stages"][name])["cpu"]) for one in part)
    half = len(sizes) // 2
    return Grown(seconds, exponent(sizes, seconds), exponent(sizes[half:], seconds[half:]))


def fit_memory(part: Sequence[Mapping[str, Any]]) -> tuple[float, float, float] | None:
    """Return MB per million marker-frames, MB without any, and the largest deviation of a length."""
    size = np.array([one["wanted"]["frames"] * one["wanted"]["markers"] / 1e6 for one in part])
    peak = np.array([one["whole"]["peak"] for one in part])
    if len(size) < 2:
        return None
    slope, intercept = np.polyfit(size, peak, 1)
    return float(slope), float(intercept), float(np.abs(peak - intercept - slope * size).max())


def exponent(size: Sequence[float], value: Sequence[float]) -> float | None:
    """Return p of value ∝ size^p, by least squares of the logarithms; None for fewer than two sizes."""
    return float(np.polyfit(np.log(size), np.log(value), 1)[0]) if len(size) > 1 else None
