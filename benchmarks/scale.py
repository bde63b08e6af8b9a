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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from harness import format_table, make_parser, publish, report_progress
from scale_parts import (
    AGAIN,
    APART,
    BARE,
    DASK,
    EARLIER,
    ONE,
    PERSON,
    RUN,
    RUN_AGAIN,
    STAGES,
    TWO,
    Say,
    Wanted,
    measure_batches,
    measure_lengths,
    measure_starts,
    measure_storage,
    measure_tasks,
)

Part = Mapping[str, Any]
POWER, MEMORY, LONG, SHARE, OVERHEAD = 1.05, 400.0, 1000.0, 0.9, 1.1
WHOLE, OF_EARLIER, SHORT, NOTHING, EACH = 3.5, 0.42, 2.2, 0.3, 1.2
TRIALS, CORES = 100_000, (16, 64, 256)
NOT_MEASURED = "Not measured in this run."
FLOORS = {
    "numpy": "reading with numpy",
    "ezc3d": "reading with ezc3d",
    "c3d": "reading with the c3d package",
    "parquet": "writing Parquet",
    "hdf5": "writing HDF5",
}
TASKS = {
    "here": "two processes (`--jobs 2`)",
    "dask": "Dask, two workers of this machine",
    "table": "the table's rows and its Parquet file",
    "finding": "finding: a folder of trials' files",
    "study": "finding: one study's file",
}


def make_sections(found: Mapping[str, Any]) -> dict[str, str]:
    """Return the sections of all parts; the section of a part without results says so."""
    parts = {name: one["found"] for name, one in found.items()}
    rows = [row for name, requirements in _REQUIREMENTS.items() if name in parts for row in requirements(parts[name])]
    return {
        "scale": describe_machine(found),
        "scale-requirements": format_table(["quantity", "required", "measured"], rows),
        **{f"scale-{name}": make(parts[name]) if name in parts else NOT_MEASURED for name, make in _SECTIONS.items()},
    }


def describe_machine(found: Mapping[str, Any]) -> str:
    if not found:
        return "Nothing was measured."
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text("utf-8").splitlines() if cpu.exists() else []
    processor = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown")
    most = max(load for one in found.values() for load in one["load"][:1])
    cores = next(iter(found.values()))["cores"]
    minutes = sum(one["seconds"] for one in found.values()) / 60
    busy = "**other work ran at the same time; no time here is reliable**"
    return (
        f"Measured by `benchmarks/scale.py` on {cores} cores (processor: {processor}) in {minutes:.0f} minutes. When "
        f"the parts began, up to {most:.1f} processes were waiting for a core: "
        f"{'nothing else ran' if most < 0.5 * cores else busy}."
    )


def compute_floor(one: Part) -> float:
    """Return the time to read with numpy and to write once as a long table and once as an array, s."""
    return float(sum(one["floor"][name] for name in ("numpy", "parquet", "hdf5")))


def format_megabytes(value: float | None) -> str:
    return "–" if value is None else f"{value:.0f} MB"


class Grown(NamedTuple):
    """Processor time at every size, and its exponent."""

    seconds: tuple[float, ...]
    all: float | None  # exponent over all sizes
    larger: float | None  # over the larger half of the sizes


def fit_time(part: Sequence[Mapping[str, Any]], key: str, name: str) -> Grown:
    sizes = [float(one["wanted"][key]) for one in part]
    seconds = tuple(float((one["whole"] if name == "run" else one["stages"][name])["cpu"]) for one in part)
    half = len(sizes) // 2
    return Grown(seconds, fit_exponent(sizes, seconds), fit_exponent(sizes[half:], seconds[half:]))


def fit_memory(part: Sequence[Mapping[str, Any]]) -> tuple[float, float, float] | None:
    """Return MB per million marker-frames, MB without any, and the largest deviation from this line, MB."""
    size = np.array([one["wanted"]["frames"] * one["wanted"]["markers"] / 1e6 for one in part])
    peak = np.array([one["whole"]["peak"] for one in part])
    if len(size) < 2:
        return None
    slope, intercept = np.polyfit(size, peak, 1)
    return float(slope), float(intercept), float(np.abs(peak - intercept - slope * size).max())


def fit_exponent(size: Sequence[float], value: Sequence[float]) -> float | None:
    """Return p of value ∝ size^p, by least squares of the logarithms; return None for fewer than two sizes."""
    return float(np.polyfit(np.log(size), np.log(value), 1)[0]) if len(size) > 1 else None


def describe_starts(part: Part) -> str:
    spent, floor, filters = part["spent"], part["floor"], part["filters"]
    bare, run = spent[next(iter(BARE))]["wall"], spent[RUN]["wall"]
    rows = []
    for name, one in spent.items():
        times = [
            f"{one['wall']:.2f} s",
            f"{one['cpu']:.2f} s",
            format_megabytes(one["peak"]),
            f"{one['wall'] / bare:.1f}",
        ]
        rows.append([f"`{name}`" if name.startswith("mocap-id") else name, *times])
    beside = [[name, f"{floor[key]:.3f} s", f"{run / floor[key]:.1f}"] for key, name in FLOORS.items() if key in floor]
    title = f"filterpy, {filters['frames']:,} frames, 39 markers, three joints"
    beside += [
        [title, f"{filters['filterpy']:.2f} s", f"{run / filters['filterpy']:.2f}"],
        ["our filter and smoother on the same", f"{filters['ours']:.3f} s", f"{run / filters['ours']:.1f}"],
        ["the same, noise estimated", f"{filters['noise too']:.2f} s", f"{run / filters['noise too']:.1f}"],
    ]
    base = compute_floor(part)
    return (
        f"Medians of {part['repeats']}, measured alternately; runs of {part['recording']}, compiled code available.\n\n"
        + format_table(["process", "wall", "processor", "memory", "relative to bare Python"], rows)
        + f"\n\n`run` takes {run / base:.1f} times the floor, and a second run with nothing to do "
        f"{spent[RUN_AGAIN]['wall'] / base:.1f} times. `run` relative to other programs, which do a part of "
        "its work:\n\n" + format_table(["", "time", "`run` relative to it"], beside)
    )


def describe_dense(part: Sequence[Part]) -> str:
    one, base, whole = part[0], compute_floor(part[0]), part[0]["whole"]
    rows = []
    for name in STAGES:
        stage = one["stages"][name]
        times = [f"{stage[key]:.2f} s" for key in ("wall", "cpu", "computing")]
        memory = [format_megabytes(stage["peak"]), format_megabytes(stage["growth"])]
        rows.append([name, *times, f"{stage['wall'] / base:.1f}", *memory])
    total = sum(one["stages"][name]["wall"] for name in STAGES)
    rows.append(["all six, warm", f"{total:.2f} s", "", "", f"{total / base:.1f}", "", ""])
    times = [f"{whole['wall']:.2f} s", f"{whole['cpu']:.2f} s", "", f"{whole['wall'] / base:.1f}"]
    rows.append(["`mocap-id run`, a new process", *times, format_megabytes(whole["peak"]), ""])
    head = ["stage", "wall", "processor", "computing", "relative to the floor", "peak", "above the memory before"]
    wanted = one["wanted"]
    body = "A sit-to-stand" if wanted["joints"] is None else f"A chain of {wanted['joints']} joints"
    return (
        f"{body}: {wanted['frames']:,} frames at {wanted['rate']:g} Hz, {wanted['markers']} markers. The floor takes "
        f"{base:.2f} s. The warm process has loaded all libraries before the first stage.\n\n{format_table(head, rows)}"
    )


def describe_frames(part: Sequence[Part]) -> str:
    rows = []
    for one in part:
        wanted, whole, base = one["wanted"], one["whole"], compute_floor(one)
        each = f"{1e6 * whole['cpu'] / (wanted['frames'] * wanted['markers']):.1f}"
        times = [f"{whole['wall']:.1f} s", f"{whole['cpu']:.1f} s", each]
        times += [f"{base:.2f} s", f"{whole['wall'] / base:.1f}"]
        length = f"{wanted['frames'] / wanted['rate'] / 60:g} min"
        rows.append([length, f"{wanted['frames']:,}", *times, format_megabytes(whole["peak"])])
    head = ["length", "frames", "`run`", "processor", "µs per marker and frame", "floor", "`run` / floor", "memory"]
    text = (
        "Sit-to-stands at 100 Hz with 50 markers and a plate at 1000 Hz: half a minute, played forwards and backwards "
        f"to the required length.\n\n{format_table(head, rows)}\n\n{make_stage_table(part, 'frames')}"
    )
    line = fit_memory(part)
    if line is None:
        return text
    slope, intercept, worst = line
    return text + (
        f"\n\nMemory of a whole run: {intercept:.0f} MB + {slope:.1f} MB per million marker-frames (frames times "
        f"markers); no length deviates from this line by more than {worst:.0f} MB."
    )


def make_stage_table(part: Sequence[Part], key: str) -> str:
    rows = []
    for name in (*STAGES, "run"):
        taken = fit_time(part, key, name)
        powers = ["–" if value is None else f"{value:.2f}" for value in (taken.all, taken.larger)]
        rows.append([f"`{name}`" if name == "run" else name, *(f"{value:.2f}" for value in taken.seconds), *powers])
    sizes = [f"{one['wanted'][key]:,}" for one in part]
    return format_table(["processor, s", *sizes, "exponent", "larger half"], rows)


def describe_sweep(part: Sequence[Part], key: str) -> str:
    wanted = part[0]["wanted"]
    rows = []
    for each in part:
        whole = each["whole"]
        cells = [
            f"{whole['wall']:.1f} s",
            f"{whole['wall'] / compute_floor(each):.1f}",
            format_megabytes(whole["peak"]),
        ]
        rows.append([f"{each['wanted'][key]}", *cells, f"{each['segments'] - 1}", each["verdict"]])
    fixed = f", {wanted['markers']} markers in all" if key == "joints" else ""
    head = [key, "`run`", "`run` / floor", "memory", "joints found", "verdict"]
    text = f"{wanted['frames']:,} frames at {wanted['rate']:g} Hz{fixed}."
    return f"{text}\n\n{format_table(head, rows)}\n\n{make_stage_table(part, key)}"


def describe_batch(part: Part) -> str:
    ways, one = part["ways"], part["ways"][ONE]["wall"]
    rows = []
    for name in (ONE, TWO, APART, DASK, AGAIN):
        way = ways[name]
        speed = f"{one / (2 * way['wall']):.2f}" if name in (TWO, APART, DASK) else "–"
        times = [f"{way['wall']:.1f} s", f"{way['cpu']:.1f} s", f"{way['trial']:.2f} s"]
        rows.append([name, *times, speed, format_megabytes(way["peak"])])
    head = ["", "wall", "processor", "per trial", "relative to twice the speed of one", "memory per process"]
    return (
        f"{part['trials']} copies of the sample trial `sample_trials/sit-to-stand`, median of {part['rounds']} "
        f"round(s). Two independent commands show the best that this machine can do with two processes.\n\n"
        + format_table(head, rows)
    )


def make_task_table(part: Part) -> str:
    rows = []
    for key, name in TASKS.items():
        for one in part.get(key, ()):
            begun = one.get("first", 0.0)
            each = f"{1e3 * (one['seconds'] - begun) / one['count']:.2f} ms"
            times = [f"{one['seconds']:.1f} s", f"{begun:.1f} s" if begun else "–", each]
            rows.append([name, f"{one['count']:,}", *times, format_megabytes(one["peak"] - one["before"])])
    return format_table(["", "trials", "all", "until the first", "per trial after it", "memory for it"], rows)


def describe_storage(part: Part) -> str:
    files: Mapping[str, int] = part["files"]
    groups: dict[str, list[int]] = {}
    for name, size in files.items():
        folder = next((f"{one}/" for one in ("figures", ".mocap-id") if name.startswith(one)), name)
        groups.setdefault(folder, []).append(size)
    ordered = sorted(groups.items(), key=lambda item: -sum(item[1]))
    rows = [[f"`{name}`", f"{len(sizes)}", f"{sum(sizes) / 1e6:.2f}"] for name, sizes in ordered]
    total, recording = sum(files.values()) / 1e6, part["recording"] / 1e6
    rows.append(["all", f"{len(files)}", f"{total:.2f}"])
    return (
        f"The run folder of `sample_trials/sit-to-stand` ({recording:.2f} MB of recording; the folder is "
        f"{total / recording:.1f} times as large).\n\n{format_table(['file', 'files', 'MB'], rows)}"
    )


_SECTIONS: Mapping[str, Callable[[Any], str]] = {
    "starts": describe_starts,
    "dense": describe_dense,
    "frames": describe_frames,
    "markers": lambda part: describe_sweep(part, "markers"),
    "joints": lambda part: describe_sweep(part, "joints"),
    "batch": describe_batch,
    "tasks": make_task_table,
    "storage": describe_storage,
}


def _require_at_most(name: str, value: float, limit: float, unit: str = "", digits: int = 2) -> list[str]:
    return [name, f"≤ {limit:g}{unit}", f"{value:.{digits}f}{unit}" + _mark_unmet(value <= limit)]


def _mark_unmet(met: bool) -> str:
    return "" if met else ", **not met**"


def _require_frames(part: Any) -> Iterator[list[str]]:
    found = {name: fit_time(part, "frames", name) for name in (*STAGES, "run")}
    for what, which in (("exponent of frames, all lengths", "all"), ("the same, larger half", "larger")):
        powers = {name: getattr(one, which) for name, one in found.items()}
        known = {name: value for name, value in powers.items() if value is not None}
        if known:
            worst = max(known, key=lambda name: known[name])
            text = f"{known[worst]:.2f} ({worst})" + (f"; `run` {known['run']:.2f}" if worst != "run" else "")
            yield [what, f"≤ {POWER}", text + _mark_unmet(known[worst] <= POWER)]
    longest = max(part, key=lambda one: one["wanted"]["frames"])
    yield _require_at_most(f"memory, {longest['wanted']['frames']:,} frames", longest["whole"]["peak"], LONG, " MB", 0)


def _require_dense(part: Any) -> Iterator[list[str]]:
    yield _require_at_most("memory, 30 s at 480 Hz of 50 markers", part[0]["whole"]["peak"], MEMORY, " MB", 0)


def _require_batch(part: Any) -> Iterator[list[str]]:
    wall = {name: way["wall"] for name, way in part["ways"].items()}
    two, best = (wall[ONE] / (2 * wall[name]) for name in (TWO, APART))
    share = two / best
    yield ["two workers, relative to twice the speed of one", f"≥ {SHARE}", f"{two:.2f}" + _mark_unmet(two >= SHARE)]
    text = f"{share:.2f} (the machine: {best:.2f})"
    yield ["the same, relative to what the machine can do", f"≥ {SHARE}", text + _mark_unmet(share >= SHARE)]
    yield _require_at_most("a trial of a batch, two workers", wall[TWO] / part["trials"], EACH, " s")
    yield _require_at_most("Dask by processes", wall[DASK] / wall[TWO], OVERHEAD)


def _require_starts(part: Any) -> Iterator[list[str]]:
    spent = part["spent"]
    for name, most in ((RUN, WHOLE), (PERSON, SHORT), (RUN_AGAIN, NOTHING)):
        if name in spent:
            yield _require_at_most(f"{name}, a whole process", spent[name]["wall"], most, " s")
    if EARLIER in spent:
        name = "processor time of `run`, relative to an earlier commit"
        yield _require_at_most(name, spent[RUN]["cpu"] / spent[EARLIER]["cpu"], OF_EARLIER)


_REQUIREMENTS = {"frames": _require_frames, "dense": _require_dense, "batch": _require_batch, "starts": _require_starts}


def make_plan_table(parts: Mapping[str, Any]) -> str:
    """Return a table of what 100,000 trials need, with formulas."""
    batch, tasks, storage = (parts[name] for name in ("batch", "tasks", "storage"))
    trial, memory = batch["ways"][TWO]["trial"], batch["ways"][TWO]["peak"]
    files, size = len(storage["files"]), sum(storage["files"].values()) / 1e6
    dask, finding, table = (tasks[name][-1] for name in ("dask", "finding", "table"))
    out = 1e3 * (dask["seconds"] - dask["first"]) / dask["count"]
    found, rows = (1e3 * one["seconds"] / one["count"] for one in (finding, table))
    kept = table["peak"] - table["before"] + tasks["here"][-1]["peak"] - tasks["here"][-1]["before"]
    kept *= 1e3 / table["count"]
    most = f"at most {1e3 / out:.0f} trials/s"
    row, hours = table["bytes"] / table["count"], TRIALS * trial / 3600
    lines = [
        ["a trial on one core", "t", f"{trial:.1f} s", f"{hours:.0f} core hours"],
        *([f"the whole on {cores} cores", f"N t / {cores}", "", f"{hours / cores:.1f} h"] for cores in CORES),
        ["memory of a worker", "m", f"{memory:.0f} MB", f"{memory * CORES[1] / 1e3:.0f} GB for {CORES[1]} workers"],
        ["a run folder", "b", f"{size:.1f} MB", f"{TRIALS * size / 1e6:.2f} TB"],
        ["files in it", "f", f"{files}", f"{TRIALS * files / 1e6:.1f} million"],
        ["handing a trial out, by Dask", "d", f"{out:.1f} ms", f"{TRIALS * out / 6e4:.0f} min, {most}"],
        ["finding a trial, in folders", "s", f"{found:.1f} ms", f"{TRIALS * found / 6e4:.0f} min before the first"],
        ["a row of the table", "r", f"{rows:.2f} ms", f"{TRIALS * rows / 6e4:.1f} min after the last"],
        ["memory for a trial where `batch` runs", "k", f"{kept:.1f} kB", f"{TRIALS * kept / 1e6:.1f} GB"],
        ["batch.parquet", "p", f"{row:.0f} bytes a row", f"{TRIALS * row / 1e6:.1f} MB"],
    ]
    return format_table(["what", "formula", "measured", "for 100,000 trials"], lines)


DENSE = Wanted(14_400, rate=480.0, analog=2400.0)


@dataclass(frozen=True)
class Sizes:
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
