"""Time and memory of processes, stages, batches and long recordings.

The results of each part stay in a folder (``--work``), so that an interrupted run continues; ``--only frames batch``
measures parts anew. Without MOCAP_ID_RECORDINGS a simulated recording replaces the reference recording. Nothing else
should run at the same time.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from harness import make_parser, publish, report_progress
from scale_parts import Say, measure_batches, measure_lengths, measure_starts, measure_storage, measure_tasks
from scale_recordings import Wanted
from scale_tables import describe_machine, make_plan_table, make_sections

DENSE = Wanted(14_400, rate=480.0, analog=2400.0)


@dataclass(frozen=True)
class Sizes:
    """Sizes of all measurements."""

    minutes: tuple[float, ...] = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
    markers: tuple[int, ...] = (20, 40, 80, 160)
    joints: tuple[int, ...] = (1, 2, 3, 5, 8)
    dense: Wanted = DENSE
    still: float = 60.0  # s of recording for the markers and joints parts
    repeats: int = 5
    trials: int = 50
    rounds: int = 1
    tasks: tuple[int, ...] = (1_000, 10_000, 100_000)
    dask: tuple[int, ...] = (1_000, 10_000)
    filterpy: int = 16_461  # frames: those of the reference recording
    before: Path | None = None


PARTS: Mapping[str, Callable[[Sizes, Path, Say], Any]] = {
    "starts": lambda s, place, say: measure_starts(place, s.repeats, s.filterpy, s.dense, s.before),
    "dense": lambda s, place, say: measure_lengths([s.dense], place, s.repeats, say),
    "frames": lambda s, place, say: measure_lengths(
        [Wanted(round(6_000 * minutes)) for minutes in s.minutes], place, min(2, s.repeats), say
    ),
    "markers": lambda s, place, say: measure_lengths(
        [Wanted(round(100 * s.still), markers=count) for count in s.markers], place, 1, say
    ),
    "joints": lambda s, place, say: measure_lengths(
        [Wanted(round(100 * s.still), joints=count) for count in s.joints], place, 1, say
    ),
    "storage": lambda s, place, say: measure_storage(place),
    "tasks": lambda s, place, say: measure_tasks(place, s.tasks, s.dask, say),
    "batch": lambda s, place, say: measure_batches(place, s.trials, s.rounds, say),
}
SMALL = Sizes(
    minutes=(0.2,),
    markers=(20,),
    joints=(1,),
    dense=Wanted(2_000, rate=240.0, analog=480.0),
    still=12.0,
    repeats=1,
    trials=2,
    tasks=(20,),
    dask=(20,),
    filterpy=200,
)


def main() -> None:
    """Measure the parts without results, or the parts in ``--only``, and publish the sections."""
    parser = make_parser(__doc__, repeats=Sizes.repeats, trials=Sizes.trials, rounds=Sizes.rounds)
    parser.add_argument("--only", nargs="*", choices=list(PARTS), help="parts to measure anew")
    parser.add_argument("--work", type=Path, help="folder of the measured parts (default: one for this user)")
    parser.add_argument("--before", type=Path, help="source tree of an earlier commit, run in turns with this one")
    parser.add_argument("--small", action="store_true", help="tiny sizes, for tests")
    options = parser.parse_args()
    sizes = SMALL if options.small else Sizes(repeats=options.repeats, trials=options.trials, rounds=options.rounds)
    sizes = replace(sizes, before=options.before and options.before.resolve())
    work = options.work or Path(tempfile.gettempdir()) / f"mocap-id-scale-{os.getuid()}{'-small' * options.small}"
    work.mkdir(parents=True, exist_ok=True)
    for name in options.only or PARTS:
        record = work / f"{name}.json"
        if options.only or not record.exists():
            record.write_text(json.dumps(measure(name, sizes, work), indent=1), encoding="utf-8")
    records = {name: work / f"{name}.json" for name in PARTS}
    found = {name: json.loads(file.read_text("utf-8")) for name, file in records.items() if file.exists()}
    made = make_sections(found)
    if {"batch", "tasks", "storage"} <= found.keys():
        made["scale-plan"] = (
            f"{describe_machine(found)}\n\n{make_plan_table({name: one['found'] for name, one in found.items()})}"
        )
    publish(made, write=options.write)


def measure(name: str, sizes: Sizes, work: Path) -> dict[str, Any]:
    """Measure one part, and the load of the machine before and after it."""

    def say(words: str) -> None:
        report_progress(f"{time.strftime('%H:%M:%S')} {name}: {words}")

    say("begins")
    place = work / "place"
    place.mkdir(exist_ok=True)
    busy, start = os.getloadavg()[0], time.monotonic()
    found = PARTS[name](sizes, place, say)
    seconds = time.monotonic() - start
    say(f"done in {seconds:.0f} s")
    return {"found": found, "seconds": seconds, "load": [busy, os.getloadavg()[0]], "cores": os.cpu_count()}


if __name__ == "__main__":
    main()
