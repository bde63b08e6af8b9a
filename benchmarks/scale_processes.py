"""Time and memory of processes, measured from outside: a part of benchmarks/scale.py."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

HERE = Path(__file__).parent
PROGRAM = (sys.executable, "-m", "mocap_id_cli")
ONE_CORE = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "MKL", "OMP", "NUMBA")}


@dataclass(frozen=True)
class Spent:
    """Wall and processor time, s, and the largest resident memory of any one process, MB (1e6 bytes)."""

    wall: float
    cpu: float
    peak: float


def together(commands: Sequence[Sequence[str]], place: Path, fine: Sequence[int] = (0,)) -> list[Spent]:
    """Start commands at the same time; raise RuntimeError with the message of one that fails."""
    words: list[str] = []
    for command in commands:
        words += [*(["--and"] if words else []), *command]
    found = json.loads(run_script("scale_measure.py", *words, place=place))
    for command, one in zip(commands, found, strict=True):
        if one["code"] not in fine:
            raise RuntimeError(f"{' '.join(command)} ended with {one['code']}: {one['said']}")
    return [Spent(one["wall"], one["cpu"], one["peak"]) for one in found]


def spend(command: Sequence[str], place: Path, fine: Sequence[int] = (0,)) -> Spent:
    """Measure one command."""
    return together([command], place, fine)[0]


def run_script(name: str, *words: str, place: Path) -> str:
    """Return the standard output of a script of this folder, in a process of its own."""
    command = [sys.executable, str(HERE / name), *words]
    done = subprocess.run(command, cwd=place, env=os.environ | ONE_CORE, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{name} {' '.join(words)} ended with {done.returncode}: {done.stderr[-2000:]}")
    return done.stdout


def in_turns(measures: Mapping[str, Callable[[], Spent]], repeats: int) -> dict[str, Spent]:
    """Return medians of measurements that are made in turns, so that other work disturbs all of them alike."""
    found: dict[str, list[Spent]] = {name: [] for name in measures}
    for _ in range(repeats):
        for name, measure in measures.items():
            found[name].append(measure())
    return {name: middle(each) for name, each in found.items()}


def middle(each: Sequence[Spent]) -> Spent:
    """Return medians of time, and the largest memory."""
    return Spent(median(one.wall for one in each), median(one.cpu for one in each), max(one.peak for one in each))


def read_script(name: str, *words: str, place: Path) -> Any:
    """Return the JSON output of a script of this folder."""
    return json.loads(run_script(name, *words, place=place))
