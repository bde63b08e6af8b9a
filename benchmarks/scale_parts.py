"""Measurements of processes, stages, batches and long recordings: parts of benchmarks/scale.py."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from harness import ROOT, find_recordings, write_real_trial

from mocap_id.arrays import IntArray
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.recording.writer import write_c3d
from mocap_id_simulation.bodies import PLATE, Link, MarkerSet, SimulatedBody, add_plate_markers
from mocap_id_simulation.instruments import draw_plate
from mocap_id_simulation.options import Options
from mocap_id_simulation.scene import Scene, Streams, draw_scene, measure_scene, random_streams
from mocap_id_simulation.sit_to_stand import motion_through, smoothstep

SEED = 930_000
REPETITIONS = 4  # half a minute of sit-to-stands
LINK, WIDTH = 0.30, 0.06  # m, of a chain of many joints
STEP, PAD = 0.02, 2.0  # s
SCATTER = 0.03  # m, between a marker and an added one


@dataclass(frozen=True)
class Wanted:
    """Frames, rate and analog rate (Hz), markers, and joints (None for a sit-to-stand) of a recording to make."""

    frames: int
    rate: float = 100.0
    analog: float = 1000.0
    markers: int = 50
    joints: int | None = None

    @property
    def name(self) -> str:
        body = "sts" if self.joints is None else f"chain-{self.joints}"
        return f"{body}-{self.rate:g}-hz-{self.markers}-markers-{self.frames}-frames"


def make(wanted: Wanted, place: Path) -> Path:
    """Write the recording and return its configuration; if it exists, return it unchanged."""
    file = place / f"{wanted.name}.yaml"
    if file.exists():
        return file
    options = Options(seed=SEED, rate=wanted.rate, analog_rate=wanted.analog, repetitions=REPETITIONS)
    rng = random_streams(options.seed)
    scene = _make_chain(wanted, rng) if wanted.joints else _make_person(wanted, options, rng)
    made = measure_scene(scene, options, rng)
    per_frame = round(wanted.analog / wanted.rate)
    frames = len(made.points)
    points = made.points[count_to_and_fro(frames, wanted.frames)]  # played forwards and backwards
    samples = count_to_and_fro((frames - 1) * per_frame + 1, wanted.frames * per_frame)
    signals = replace(made.signals, channels=made.signals.channels[samples])
    write_c3d(place / f"{wanted.name}.c3d", scene.markers.labels, points, wanted.rate, plates=(signals,))
    subject = {"mass": round(scene.body.mass, 2)}
    if wanted.joints is None:
        subject["height"] = round(scene.body.description["subject"]["height_m"], 3)
    keys = {"trial": wanted.name, "recording": f"{wanted.name}.c3d", "subject": subject}
    keys["protocol"] = "free" if wanted.joints else "sit-to-stand"
    file.write_text(json.dumps(keys), encoding="utf-8")
    return file


def count_to_and_fro(own: int, count: int) -> IntArray:
    """Return ``count`` indices that go from 0 to own - 1, back to 0, and so on."""
    period = np.concatenate([np.arange(own), np.arange(own - 2, 0, -1)])
    return np.resize(period, count)


def _make_person(wanted: Wanted, options: Options, rng: Streams) -> Scene:
    """Return a sit-to-stand with the wanted number of markers.

    Fewer markers are chosen evenly; additional markers are beside the usual markers.
    """
    scene = draw_scene("sit-to-stand", options, rng)
    own = scene.markers
    if wanted.markers <= len(own.labels):
        return replace(scene, markers=_select(own, _choose_evenly(own, wanted.markers)))
    more = np.resize(np.flatnonzero(~own.on_plate), wanted.markers - len(own.labels))
    added = _select(own, more)
    rounds = np.arange(len(more)) // int((~own.on_plate).sum())
    labels = tuple(f"{label}X{k + 1}" for label, k in zip(added.labels, rounds, strict=True))
    moved = rng["markers"].normal(0, SCATTER, added.local.shape)
    added = replace(added, labels=labels, local=added.local + moved, at_joint=(None,) * len(more))
    return replace(scene, markers=_join(own, added))


def _choose_evenly(markers: MarkerSet, count: int) -> IntArray:
    """Return ``count`` chosen markers, in proportion to the markers of each link and at least three of each."""
    links = [np.flatnonzero(markers.link == link) for link in np.unique(markers.link)]
    share = [max(3, round(count * len(link) / len(markers.link))) for link in links]
    share[-1] += count - sum(share)
    chosen = [link[np.linspace(0, len(link) - 1, k).round().astype(int)] for link, k in zip(links, share, strict=True)]
    return np.sort(np.concatenate(chosen))


def _select(markers: MarkerSet, chosen: IntArray) -> MarkerSet:
    def pick(values: Any) -> Any:
        return tuple(values[k] for k in chosen) if isinstance(values, tuple) else values[chosen]

    return MarkerSet(**{field.name: pick(getattr(markers, field.name)) for field in fields(MarkerSet)})


def _join(one: MarkerSet, other: MarkerSet) -> MarkerSet:
    pairs = {field.name: (getattr(one, field.name), getattr(other, field.name)) for field in fields(MarkerSet)}
    return MarkerSet(**{k: a + b if isinstance(a, tuple) else np.concatenate([a, b]) for k, (a, b) in pairs.items()})


def _make_chain(wanted: Wanted, rng: Streams) -> Scene:
    """Return a chain of equal links on a plate, whose joints swing at 0.2 to 0.5 Hz by 17 to 29°, from rest to rest."""
    joints, seconds, of = wanted.joints, wanted.frames / wanted.rate, rng["motion"]
    assert joints
    base = Link("base", None, (0.0, 0.0), 0.1, 5.0, (0.0, 0.05), 0.02)
    links = [Link(f"l{k}", f"j{k}", (0.0, LINK if k > 1 else 0.1), LINK, 2.0, (0.01, LINK / 2), 0.02)
             for k in range(1, joints + 1)]  # fmt: skip
    plate = draw_plate(rng["plate"], "reaction", moved=False, flipped=False, noise=1.0, bias=0.0)
    time = np.arange(-PAD, seconds + PAD, STEP)
    frequency, size = of.uniform(0.2, 0.5, joints), of.uniform(0.3, 0.5, joints)
    moving = smoothstep((np.minimum(time, seconds - time) - 0.5) / 1.5)
    swing = np.sin(2 * np.pi * np.multiply.outer(time, frequency) + of.uniform(0, 2 * np.pi, joints))
    # the plate's markers are on the plate, and the others on the links in turn
    count = wanted.markers - len(PLATE)
    low, high = (-WIDTH, 0.1 * LINK, -WIDTH), (WIDTH, 0.9 * LINK, WIDTH)
    markers = add_plate_markers(
        rng["markers"],
        tuple(f"M{k:03}" for k in range(count)),
        1 + np.arange(count) % joints,
        rng["markers"].uniform(low, high, (count, 3)),
        softness=np.full(count, 0.001),
        hidden=np.ones(count, dtype=np.bool_),
        at_joint=(None,) * count,
    )
    return Scene(
        body=SimulatedBody((base, *links), (-0.2, 0.2), {}, {}),
        motion=motion_through(time, moving[:, None] * size * swing, seconds),
        chair=None,
        markers=markers,
        plate=plate,
        plane=PlaneFrame(float(rng["place"].uniform(-np.pi, np.pi)), plate.centre),
        offset=0.0,
        protocol={"reps": []},
    )


HERE = Path(__file__).parent
PROGRAM = (sys.executable, "-m", "mocap_id_cli")
ONE_CORE = {f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "MKL", "OMP", "NUMBA")}
STAGES = ("planarise", "segment", "fit-joints", "ukf-smooth", "identify-dim", "report")
WARM = Wanted(1_000)
REPEATED = 1_000_000  # marker-frames up to which a run is repeated
SAMPLE = ROOT / "sample_trials" / "sit-to-stand"
CLUSTER = "kind: local\nworkers: 2\n"
BARE = {
    "Python, nothing imported": "pass",
    "libraries only: numpy, pandas, pyarrow, h5py": "import numpy, pandas, pyarrow.parquet, h5py",
}
RUN, RUN_AGAIN = "mocap-id run", "mocap-id run again"
PERSON = "a run of STS1, a person, 14 s at 100 Hz"
EARLIER = "a run by an earlier commit"
ONE, TWO, APART, DASK, AGAIN = (
    "one process (`--jobs 1`)",
    "two processes (`--jobs 2`)",
    "two commands of one process each, half the trials each, started together",
    "Dask, two workers (`--cluster`)",
    "the same again, nothing to do (`--jobs 2`)",
)
Say = Callable[[str], object]


@dataclass(frozen=True)
class Spent:
    """Wall and processor time, s, and the largest resident memory of any one process, MB (1e6 bytes)."""

    wall: float
    cpu: float
    peak: float


def spend_together(commands: Sequence[Sequence[str]], place: Path) -> list[Spent]:
    """Measure commands that start at the same time; raise RuntimeError with the message of one that fails."""
    words: list[str] = []
    for command in commands:
        words += [*(["--and"] if words else []), *command]
    found = run_script("scale_measure.py", *words, place=place)
    for command, one in zip(commands, found, strict=True):
        if one["code"]:
            raise RuntimeError(f"{' '.join(command)} ended with {one['code']}: {one['said']}")
    return [Spent(one["wall"], one["cpu"], one["peak"]) for one in found]


def spend(command: Sequence[str], place: Path) -> Spent:
    return spend_together([command], place)[0]


def run_script(name: str, *words: str, place: Path) -> Any:
    """Return the JSON output of a script of this folder, which runs in a new process."""
    command = [sys.executable, str(HERE / name), *words]
    done = subprocess.run(command, cwd=place, env=os.environ | ONE_CORE, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{name} {' '.join(words)} ended with {done.returncode}: {done.stderr[-2000:]}")
    return json.loads(done.stdout)


def measure_in_turns(measures: Mapping[str, Callable[[], Spent]], repeats: int) -> dict[str, Spent]:
    """Return median times and largest memories of measurements that are made in turns.

    Other work then disturbs all of them alike.
    """
    found: dict[str, list[Spent]] = {name: [] for name in measures}
    for _ in range(repeats):
        for name, measure in measures.items():
            found[name].append(measure())
    return {
        name: Spent(median(one.wall for one in each), median(one.cpu for one in each), max(one.peak for one in each))
        for name, each in found.items()
    }


def run_anew(trial: Path, place: Path, before: Path | None = None) -> Spent:
    """Measure ``mocap-id run`` without earlier results; ``before`` is the source tree of another commit, or None."""
    shutil.rmtree(trial.parent / "runs", ignore_errors=True)
    other = [] if before is None else ["env", f"PYTHONPATH={before / 'pipeline'}:{before / 'cli'}"]
    return spend([*other, *PROGRAM, "run", "--quiet", str(trial)], place)


def measure_starts(
    place: Path, repeats: int, filterpy_frames: int, spare: Wanted, before: Path | None
) -> dict[str, Any]:
    """Measure whole processes in turns, and programs that do a part of the work.

    They use the reference recording, or without MOCAP_ID_RECORDINGS the simulated recording ``spare``. ``before`` is a
    source tree of an earlier commit, which is run in turns with this one, or None.
    """
    folder, person = find_recordings(), None
    if folder is None:
        trial, what = make(spare, place), f"a simulated sit-to-stand of {spare.frames} frames at {spare.rate:g} Hz"
    else:
        shutil.copyfile(folder / "simulated" / "sts-normal" / "trial.c3d", place / "sts-normal.c3d")
        trial, what = place / "sts-normal.yaml", "the reference recording simulated/sts-normal"
        trial.write_text("trial: sts-normal\nrecording: sts-normal.c3d\nprotocol: sit-to-stand\n", encoding="utf-8")
        person = write_real_trial(folder / "sit-to-stand" / "STS1", place / "sts1.yaml")
    measures: dict[str, Callable[[], Spent]] = {
        name: partial(spend, [sys.executable, "-c", code], place) for name, code in BARE.items()
    }
    measures |= {f"mocap-id {word}": partial(spend, [*PROGRAM, word], place) for word in ("--version", "--help")}
    measures[RUN] = partial(run_anew, trial, place)
    measures[RUN_AGAIN] = partial(spend, [*PROGRAM, "run", "--quiet", str(trial)], place)
    if person is not None:
        measures[PERSON] = partial(run_anew, person, place)
    if before is not None:
        measures[EARLIER] = partial(run_anew, trial, place, before)
    for name in {RUN, PERSON, EARLIER} & measures.keys():
        measures[name]()  # compiles
    found = measure_in_turns(measures, repeats)
    return {
        "recording": what,
        "spent": {name: asdict(one) for name, one in found.items()},
        "floor": run_script("scale_floor.py", str(trial.with_suffix(".c3d")), place=place),
        "filters": run_script("filter.py", f"--frames={filterpy_frames}", place=place),
        "repeats": repeats,
    }


def measure_lengths(wanted: Sequence[Wanted], place: Path, repeats: int, say: Say) -> list[dict[str, Any]]:
    """Measure recordings: their stages in a warm process, whole runs in new processes, and the floor."""
    found = []
    for one in wanted:
        times = repeats if one.frames * one.markers <= REPEATED else 1
        file, warm = make(one, place), make(WARM, place)
        runs = []
        for _ in range(times):
            shutil.rmtree(place / "runs", ignore_errors=True)
            runs.append(run_script("scale_trial.py", str(file), str(warm), place=place))
            names = [(stage["stage"], stage["action"]) for stage in runs[-1]["stages"]]
            if names != [(name, "computed") for name in STAGES]:
                raise RuntimeError(f"{file}: {names}, verdict {runs[-1]['verdict']} {runs[-1]['codes']}")
        whole = measure_in_turns({"run": partial(run_anew, file, place)}, times)["run"]
        shutil.rmtree(place / "runs", ignore_errors=True)
        floor = run_script("scale_floor.py", str(file.with_suffix(".c3d")), "--quick", place=place)
        say(f"{one.name}: {whole.wall:.1f} s, {whole.peak:.0f} MB")
        stages: dict[str, dict[str, float | None]] = {}
        for k, name in enumerate(STAGES):  # median times, the largest memory and its largest growth, None where unknown
            each = [run["stages"][k] for run in runs]
            known = [stage for stage in each if stage["peak"] is not None]
            stages[name] = {key: median(stage[key] for stage in each) for key in ("wall", "cpu", "computing")}
            stages[name]["peak"] = max((stage["peak"] for stage in known), default=None)
            stages[name]["growth"] = max((stage["peak"] - stage["first"] for stage in known), default=None)
        own = {key: runs[0][key] for key in ("verdict", "codes", "segments")}
        found.append({"wanted": asdict(one), "stages": stages, "whole": asdict(whole), "floor": floor, **own})
    return found


def measure_batches(place: Path, trials: int, rounds: int, say: Say) -> dict[str, Any]:
    """Measure each way to run the same trials, in turns, and return medians over the rounds."""
    # trials of the sample recording, half of them called a, half b
    folder = place / "batch"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copyfile(SAMPLE / "trial.c3d", folder / "trial.c3d")
    text = (SAMPLE / "trial.yaml").read_text("utf-8")
    for k in range(trials):
        name = f"{'ab'[k % 2]}-{k:05}"
        (folder / f"{name}.yaml").write_text(text.replace('trial: "sit-to-stand"', f"trial: {name}"), encoding="utf-8")
    (place / "cluster.yml").write_text(CLUSTER, encoding="utf-8")
    every, halves = [str(folder / "*.yaml")], [str(folder / f"{half}-*.yaml") for half in "ab"]
    ways: Mapping[str, tuple[list[str], list[str]]] = {
        ONE: (every, ["--jobs", "1"]),
        TWO: (every, ["--jobs", "2"]),
        AGAIN: (every, ["--jobs", "2"]),
        APART: (halves, ["--jobs", "1"]),
        DASK: (every, ["--cluster", str(place / "cluster.yml")]),
    }
    found: dict[str, list[dict[str, float]]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, (patterns, how) in ways.items():
            if name != AGAIN:  # which keeps earlier results
                shutil.rmtree(folder / "runs", ignore_errors=True)
            for old in place.glob("batch-*.parquet"):
                old.unlink()
            commands = [
                [*PROGRAM, "batch", pattern, *how, "--out", str(place / f"batch-{k}.parquet"), "--quiet"]
                for k, pattern in enumerate(patterns)
            ]
            each = spend_together(commands, place)  # one batch for each pattern
            tables = [pq.read_table(file).to_pydict() for file in sorted(place.glob("batch-*.parquet"))]
            if any(code != 0 for table in tables for code in table["exit_code"]):
                raise RuntimeError("a trial of the batch did not go through")
            wall, cpu, peak = max(one.wall for one in each), sum(one.cpu for one in each), max(one.peak for one in each)
            trial = median(seconds for table in tables for seconds in table["seconds"])
            found[name].append({"wall": wall, "cpu": cpu, "peak": peak, "trial": trial})
            say(f"{name}: {wall:.1f} s, {trial:.2f} s a trial")
    keys = ("wall", "cpu", "peak", "trial")
    medians = {name: {key: median(one[key] for one in each) for key in keys} for name, each in found.items()}
    return {"trials": trials, "rounds": rounds, "ways": medians}


def measure_tasks(place: Path, counts: Sequence[int], dask: Sequence[int], say: Say) -> dict[str, Any]:
    """Measure trials that take no time, and the work before and after them."""
    found: dict[str, Any] = {}
    for what, sizes in (("here", counts), ("dask", dask), ("table", counts), ("finding", counts), ("study", counts)):
        most = {"finding": 10_000, "study": 3_000}.get(what, max(sizes))
        found[what] = []
        for count in dict.fromkeys(min(size, most) for size in sizes):
            one = run_script("scale_tasks.py", what, str(count), place=place)
            say(f"{what}: {one['count']:,} in {one['seconds']:.1f} s, {one['peak']:.0f} MB")
            found[what].append(one)
    return found


def measure_storage(place: Path) -> dict[str, Any]:
    """Return the bytes of each file in a sample trial's run folder."""
    folder = place / "storage"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in ("trial.c3d", "trial.yaml"):
        shutil.copyfile(SAMPLE / name, folder / name)
    spend([*PROGRAM, "run", "--quiet", str(folder / "trial.yaml")], place)
    out = next((folder / "runs").iterdir())
    files = {file.relative_to(out).as_posix(): file.stat().st_size for file in out.rglob("*") if file.is_file()}
    return {"files": files, "recording": (folder / "trial.c3d").stat().st_size}
