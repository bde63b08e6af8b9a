"""Time and memory at every size: ``python benchmarks/scale.py --out docs/scale.md --quote docs/cluster.md``.

Prints the page, and with ``--out`` writes it; ``--quote`` renews the table of another page. What was measured is kept
in a folder (``--work``), part by part, so that an interrupted run goes on where it stopped, and ``--only frames,batch``
measures parts anew and leaves the others. The reference recording is taken from MOCAP_ID_RECORDINGS; without it a
simulated one stands in. Nothing else should run meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import scale_lengths
import scale_many
import scale_starts
from scale_page import machine, page
from scale_plan import plan, quote
from scale_recordings import Wanted

MINUTES = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
MARKERS = (20, 40, 80, 160)
JOINTS = (1, 2, 3, 5, 8)
DENSE = Wanted(14_400, rate=480.0, analog=2400.0)
TASKS = (1_000, 10_000, 100_000)
ON_DASK = (1_000, 10_000)
Say = Callable[[str], object]


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    minutes: tuple[float, ...] = MINUTES
    markers: tuple[int, ...] = MARKERS
    joints: tuple[int, ...] = JOINTS
    dense: Wanted = DENSE
    still: float = 60.0  # s of recording where markers or joints vary
    repeats: int = 5
    trials: int = 50
    rounds: int = 1
    tasks: tuple[int, ...] = TASKS
    dask: tuple[int, ...] = ON_DASK
    filterpy: int = 16_461  # frames: those of the reference recording
    before: Path | None = None


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
"""To see that it works."""

PARTS: Mapping[str, Callable[[Sizes, Path, Say], Any]] = {
    "starts": lambda s, place, say: scale_starts.measure(place, s.repeats, s.filterpy, s.dense, s.before),
    "dense": lambda s, place, say: scale_lengths.measure([s.dense], place, s.repeats, say),
    "frames": lambda s, place, say: scale_lengths.measure(
        [Wanted(round(6_000 * minutes)) for minutes in s.minutes], place, min(2, s.repeats), say
    ),
    "markers": lambda s, place, say: scale_lengths.measure(
        [Wanted(round(100 * s.still), markers=count) for count in s.markers], place, 1, say
    ),
    "joints": lambda s, place, say: scale_lengths.measure(
        [Wanted(round(100 * s.still), joints=count) for count in s.joints], place, 1, say
    ),
    "storage": lambda s, place, say: scale_many.storage(place),
    "tasks": lambda s, place, say: scale_many.handed_out(place, s.tasks, s.dask, say),
    "batch": lambda s, place, say: scale_many.batches(place, s.trials, s.rounds, say),
}


def main() -> None:
    """Measure what is asked for or missing, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, help="page to write")
    parser.add_argument("--quote", type=Path, help="page in which to write anew what 100,000 trials would take")
    parser.add_argument("--only", type=lambda words: words.split(","), help=f"parts to measure anew: {','.join(PARTS)}")
    parser.add_argument("--work", type=Path, help="folder of what was measured; default: one for this user and version")
    parser.add_argument("--repeats", type=int, default=Sizes.repeats, help="of whole processes and short trials")
    parser.add_argument("--trials", type=int, default=Sizes.trials, help="of a batch")
    parser.add_argument("--rounds", type=int, default=Sizes.rounds, help="of batches")
    parser.add_argument(
        "--before", type=Path, help="source tree of an earlier commit, to be run in turns with this one"
    )
    parser.add_argument("--afresh", action="store_true", help="measure every part anew")
    parser.add_argument("--small", action="store_true", help="tiny sizes, to see that it works")
    asked = parser.parse_args()
    unknown = set(asked.only or ()) - set(PARTS)
    if unknown:
        parser.error(f"no such part: {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    sizes = SMALL if asked.small else Sizes(repeats=asked.repeats, trials=asked.trials, rounds=asked.rounds)
    sizes = replace(sizes, before=asked.before and asked.before.resolve())
    work = asked.work or Path(tempfile.gettempdir()) / f"mocap-id-scale-{os.getuid()}{'-small' * asked.small}"
    work.mkdir(parents=True, exist_ok=True)
    for name in asked.only or PARTS:
        record = work / f"{name}.json"
        if asked.only or asked.afresh or not record.exists():
            record.write_text(json.dumps(measured(name, sizes, work), indent=1), encoding="utf-8")
    found = {
        name: json.loads((work / f"{name}.json").read_text("utf-8"))
        for name in PARTS
        if (work / f"{name}.json").exists()
    }
    text = page(found)
    sys.stdout.write(text)
    if asked.out:
        asked.out.write_text(text, encoding="utf-8")
    if asked.quote:
        quote(asked.quote, f"{machine(found)}\n\n{plan({name: one['found'] for name, one in found.items()})}")


def measured(name: str, sizes: Sizes, work: Path) -> dict[str, Any]:
    """One part, with how busy the machine was when it began and while it ran."""

    def say(words: str) -> None:
        sys.stderr.write(f"{time.strftime('%H:%M:%S')} {name}: {words}\n")

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
