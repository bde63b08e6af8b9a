"""Bodies that make a movement, are advised, and do what they were told: simulated, run, and held against the truth."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.dynamics.base import structural_base
from mocap_id.dynamics.course import Course
from mocap_id.dynamics.proposal import Proposal
from mocap_id.errors import MocapIdError
from mocap_id.geometry import planar
from mocap_id.runner import run_to
from mocap_id.simulation import Kind, Motion, Options, simulate, through
from mocap_id.simulation.motion import smoothstep
from mocap_id.simulation.subject import draw_subject
from mocap_id.store import Folder
from mocap_id.workflows.advice import Advised, Asked, advise

KINDS: Mapping[str, str] = {
    "robot": "a robot's joint that swings slowly by 7 to 11°, noisy cameras (2 mm) and plate (4 N)",
    "stand": "a person who stands and bends knees (by 35 to 45°) and hips (15 to 25°) slowly and in step; "
    "`advise` is told that the knees may go to 90° and the others 20° beyond what was seen",
    "rise": "a person who rises from a chair and sits down twice",
}
NOISY: Mapping[str, tuple[float, float]] = {"robot": (0.002, 4.0)}  # m, and times the plate's usual noise
PAD, STEP, FADE = 2.0, 0.02, 2.0  # s: rest before and after, between a given motion's samples, before a cut
CUT = 0.05  # rad from one sample to the next: where the trial's own movement ends and another begins


@dataclass(frozen=True)
class Case:
    """A body and the movement that it begins with."""

    kind: str
    seed: int
    objective: str = "intervals"


@dataclass(frozen=True)
class Recorded:
    """What a recording told: parameters, their sds and the truth (b,), condition number, the last frame's turn,
    and -1 where the plane's x points the other way than in the truth; reach of the true centre of pressure, m."""

    value: FloatArray
    sd: FloatArray
    true: FloatArray
    condition: float
    turn: float
    side: int
    pressure: tuple[float, float]


@dataclass(frozen=True)
class Result:
    """A body before and after the advice; ``told`` holds what was foreseen of a movement and what came of it."""

    case: Case
    names: tuple[str, ...]
    size: FloatArray
    before: Recorded
    told: Mapping[str, tuple[Proposal, Recorded | str]]
    helps: bool
    support: tuple[float, float] | None


def swing(joints: int, rest: FloatArray, size: FloatArray, frequency: FloatArray, seconds: float) -> Motion:
    """A slow movement to begin with: (n,) amplitudes, rad, and frequencies, Hz, about and beyond a posture."""
    time = np.arange(0.0, seconds, STEP)
    near = smoothstep((np.minimum(time, seconds - time) - 0.5) / 2.0)
    q = rest + near[:, None] * size * (1 - np.cos(2 * np.pi * np.multiply.outer(time, frequency))) / 2
    return given(time, q)


def given(time: FloatArray, q: FloatArray) -> Motion:
    """A motion through angles (T, n), at rest where it begins and ends for some time beyond."""
    even = np.arange(-PAD, time[-1] - time[0] + PAD, STEP)
    columns = [np.interp(even, time - time[0], column) for column in q.T]
    return through(even, np.column_stack(columns), float(time[-1] - time[0]))


def carried_out(course: Course, rest: FloatArray, before: Recorded) -> Motion:
    """An advised movement as the simulated body makes it: without gaps and jumps, angles in the truth's frames."""
    q = np.column_stack([np.interp(course.time, course.time[np.isfinite(c)], c[np.isfinite(c)]) for c in course.q.T])
    for cut in np.flatnonzero(np.abs(np.diff(q, axis=0)).max(axis=1) > CUT):
        left = np.where(np.arange(len(q)) <= cut, course.time[cut] - course.time, np.inf)
        q = rest + smoothstep(left / FADE)[:, None] * (q - rest)
    q = before.side * q
    q[:, -1] -= before.turn
    return given(course.time, q)


def record(place: Path, case: Case, options: Options, motion: Motion | None) -> Recorded:
    """Simulate a recording, run it, and hold it against the truth."""
    kind: Kind = "robot" if case.kind == "robot" else "sit-to-stand"
    configuration = simulate(kind, place, options, motion)
    trial = load(configuration)
    outcome = run_to(trial, "identify-dim")
    if outcome.refused is not None:
        raise outcome.refused
    return read(configuration, outcome.folder)


def read(configuration: Path, out: Path) -> Recorded:
    """A finished recording beside its truth."""
    folder = Folder(out)
    dynamics, chain = folder.read("dynamics.h5"), folder.read("chain.h5")
    truth: dict[str, Any] = json.loads(configuration.with_name("truth.json").read_text())
    base: Any = dynamics.data["base"]
    joints: Any = chain.data["joints"]
    if len(joints["centre"]) + 1 != len(truth["segments"]):
        raise MocapIdError(f"{len(joints['centre']) + 1} segments were found, there are {len(truth['segments'])}")
    if dynamics.facts["why"] is not None:
        raise MocapIdError(dynamics.facts["why"])
    turn, side = last_turn(truth, chain), facing(configuration, folder)
    full = np.array([[s["m"], s["mx"], s["my"], s["Izz"]] for s in truth["segments"]])
    full[-1, 1:3] = planar.rotate(np.array(-turn), full[-1, 1:3])
    centres = np.array([s["p_in_parent_m"] for s in truth["segments"][1:]])
    full[:, 1] *= side
    centres[:, 0] *= side
    true = structural_base(centres).regrouping @ full.reshape(-1)
    condition = float(dynamics.facts["condition_number"])
    with np.load(configuration.with_name("truth.npz")) as arrays:
        pressure = side * arrays["cop_x"].astype(np.float64)
    reach = float(pressure.min()), float(pressure.max())
    return Recorded(np.asarray(base["value"]), np.asarray(base["sd"]), true, condition, turn, side, reach)


def last_turn(truth: Mapping[str, Any], chain: Any) -> float:
    """Angle, rad, from the truth's frame of the last segment to the one whose y points at its markers' middle."""
    markers = chain.data["markers"]
    last = len(truth["segments"]) - 1
    local = {marker["label"]: marker["local_xyz_m"][:2] for marker in truth["markers"]}
    pairs = zip(np.asarray(markers["name"]), np.asarray(markers["segment"]), strict=True)
    x, y = np.mean([local[str(name)] for name, segment in pairs if segment == last], axis=0)
    return float(np.arctan2(-x, y))


def facing(configuration: Path, folder: Folder) -> int:
    """1 where the plane's x is the truth's, -1 where it is opposite, and with it every angle."""
    states: Any = folder.read("states.parquet")
    with np.load(configuration.with_name("truth.npz")) as arrays:
        at = np.searchsorted(arrays["t"], states.frame["time"].to_numpy() - 1e-6)
        true = arrays["qd"][at, 0]
    found = states.frame["dtheta_1"].to_numpy()
    return 1 if np.nansum(found * true) > 0 else -1


def first_motion(case: Case) -> Motion | None:
    """What a body does before it is advised; None for sit-to-stands."""
    rng = np.random.default_rng(case.seed)
    if case.kind == "robot":
        start = rng.uniform(-0.5, 0.5, 1)
        return swing(1, start, rng.uniform(0.12, 0.2, 1), rng.uniform(0.07, 0.12, 1), 24.0)
    if case.kind == "stand":
        size = np.radians(rng.uniform([8, -45, 15], [12, -35, 25]))
        return swing(3, np.radians([2.0, -3.0, 5.0]), size, np.array([0.2, 0.2, 0.2]), 24.0)
    return None


def asked(case: Case) -> Asked:
    """What the lab asks for: a person may bend knees and hips further than shown."""
    if case.kind == "stand":
        return Asked(case.objective, angles={"joint 2": (-90.0, 0.0)}, widen=20.0)
    return Asked(case.objective)


def measure(case: Case) -> Result | str:
    """One body, before and after; why not, where it could not be advised."""
    subject = draw_subject(case.seed, 1)
    marker, plate = NOISY.get(case.kind, (Options.marker_noise, Options.plate_noise))
    options = [
        Options(seed=case.seed + k, subject=subject, repetitions=2, marker_noise=marker, plate_noise=plate)
        for k in range(3)
    ]
    with tempfile.TemporaryDirectory() as place:
        try:
            before = record(Path(place) / "before", case, options[0], first_motion(case))
            advised = advise(Path(place) / "before" / "trial.yaml", asked(case))
        except MocapIdError as error:
            return f"{case.kind} {case.seed}: {error}"
        told: dict[str, tuple[Proposal, Recorded | str]] = {}
        for k, (name, proposal) in enumerate(proposals(advised).items(), start=1):
            motion = carried_out(proposal.course, advised.design.rest, before)
            try:
                told[name] = proposal, record(Path(place) / name, case, options[k], motion)
            except MocapIdError as error:
                told[name] = proposal, str(error)
    found = advised.design
    return Result(case, advised.names, found.size, before, told, found.helps, advised.limits.support)


def proposals(advised: Advised) -> dict[str, Proposal]:
    """The designed movement and the best simple change; not what changes the trial's own, which may need a chair."""
    found = {} if advised.design.designed is None else {"designed": advised.design.designed}
    simple = [each for each in advised.design.simple if not each.own]
    return found | ({"simple": simple[0]} if simple else {})
