"""Time and memory of each stage of one trial, in a warm process: ``scale_trial.py TRIAL.yaml WARM.yaml``.

WARM runs first; then libraries are imported, compiled code is loaded and figures have been drawn once. Prints JSON. For
each stage it has the wall seconds of the whole step (reading, computing, hashing, writing), its processor seconds, and
peak and initial resident memory, MB. The peak needs Linux; elsewhere it is null.
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

STATUS, RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
KILOBYTE = 1024


def read_memory(what: str) -> float | None:
    """Return the peak memory since its reset (``VmHWM``) or the present memory (``VmRSS``), MB; None if unknown."""
    if not STATUS.exists():
        return None
    found = re.search(rf"^{what}:\s*(\d+) kB", STATUS.read_text("ascii"), re.MULTILINE)
    return None if found is None else int(found[1]) * KILOBYTE / 1e6


class Stages:
    """Listener that records the stages of a run."""

    def __init__(self) -> None:
        self.found: list[dict[str, Any]] = []
        self._begin()

    def __call__(self, step: runner.Step) -> None:
        if step.action == "begun":
            return
        wall, cpu = perf_counter() - self._wall, process_time() - self._cpu
        own = {"stage": step.stage, "action": step.action, "wall": wall, "cpu": cpu, "computing": step.seconds}
        self.found.append(own | {"peak": read_memory("VmHWM"), "first": self._first})
        self._begin()

    def _begin(self) -> None:
        if RESET.exists():
            RESET.write_text("5")
        self._wall, self._cpu, self._first = perf_counter(), process_time(), read_memory("VmRSS")


def main() -> None:
    trial, warm = (load(Path(word)) for word in sys.argv[1:])
    runner.run(warm)
    shutil.rmtree(trial.out, ignore_errors=True)
    stages = Stages()
    outcome = runner.run(trial, progress=stages)
    summary = outcome.summary()
    print(
        json.dumps(
            {
                "stages": stages.found,
                "verdict": summary["verdict"]["level"],
                "codes": [one["code"] for one in summary["verdict"]["reasons"]],
                "segments": (summary["segments"] or {}).get("count"),
            }
        )
    )


if __name__ == "__main__":
    main()
