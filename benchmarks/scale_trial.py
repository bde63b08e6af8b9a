"""One trial run in this process, stage by stage, told as JSON: ``scale_trial.py TRIAL.yaml WARM.yaml``.

WARM is run first, so that libraries are imported, compiled code is loaded and figures have been drawn once. Of each
stage: wall seconds of the whole step (reading, computing, hashing, writing), processor seconds of it, and peak and
first resident memory, MB; the peak needs Linux, which can be told to forget the last one, and is null elsewhere.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

from mocap_id import runner
from mocap_id.config import load

STATUS, FORGET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
KILOBYTE = 1024


def memory(what: str) -> float | None:
    """``VmHWM``, the peak since it was forgotten, or ``VmRSS``, what there is now, MB."""
    if not STATUS.exists():
        return None
    found = re.search(rf"^{what}:\s*(\d+) kB", STATUS.read_text("ascii"), re.MULTILINE)
    return None if found is None else int(found[1]) * KILOBYTE / 1e6


class Stages:
    """Listens to a run."""

    def __init__(self) -> None:
        self.found: list[dict[str, Any]] = []
        self._begin()

    def __call__(self, step: runner.Step) -> None:
        if step.action == "begun":
            return
        wall, cpu = perf_counter() - self._wall, process_time() - self._cpu
        own = {"stage": step.stage, "action": step.action, "wall": wall, "cpu": cpu, "computing": step.seconds}
        self.found.append(own | {"peak": memory("VmHWM"), "first": self._first})
        self._begin()

    def _begin(self) -> None:
        if FORGET.exists():
            FORGET.write_text("5")
        self._wall, self._cpu, self._first = perf_counter(), process_time(), memory("VmRSS")


def main() -> None:
    """Run and tell."""
    trial, warm = (load(Path(word)) for word in sys.argv[1:])
    runner.run(warm)
    shutil.rmtree(trial.out, ignore_errors=True)
    listening = Stages()
    outcome = runner.run(trial, progress=listening)
    summary = outcome.summary()
    bytes_of = {file.relative_to(trial.out).as_posix(): file.stat().st_size for file in trial.out.rglob("*")}
    print(
        json.dumps(
            {
                "stages": listening.found,
                "verdict": summary["verdict"]["level"],
                "codes": [one["code"] for one in summary["verdict"]["reasons"]],
                "segments": (summary["segments"] or {}).get("count"),
                "files": {name: size for name, size in bytes_of.items() if (trial.out / name).is_file()},
            }
        )
    )


if __name__ == "__main__":
    main()
