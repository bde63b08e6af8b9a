"""Simulated bodies that make a movement, receive advice and follow it, with their truth."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from dynamic_truth import last_frame_turn
from harness import read_truth

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.design.proposal import Proposal
from mocap_id.design.trajectory import Trajectory
from mocap_id.dynamics.base_parameters import structural_base
from mocap_id.errors import MocapIdError
from mocap_id.geometry import planar
from mocap_id.runner import run_to
from mocap_id.simulation import JointMotion, Kind, Options, motion_through, simulate
from mocap_id.simulation.body import draw_subject
from mocap_id.simulation.joint_motion import smoothstep
from mocap_id.store import Folder
from mocap_id.workflows.advice import Advice, AdviceOptions, advise

KINDS = ("robot", "stand", "rise")
NOISY: Mapping[str, tuple[float, float]] = {"robot": (0.002, 4.0)}  # m, and times the plate's usual noise
PAD, STEP, FADE = 2.0, 0.02, 2.0  # s: rest before and after, time step of a motion, fade before a cut
CUT = 0.05  # rad between samples: a larger step separates the trial's own movement from the next


@dataclass(frozen=True)
class Case:
    """A kind of body with its first movement."""

    kind: str
    seed: int
    objective: str = "intervals"


@dataclass(frozen=True)
class Recorded:
    """Result of a recording and its truth.

    ``value``, ``sd`` and ``true`` are the parameters (b,). ``turn`` the rotation of the last frame, rad; ``side``
    is -1 if x of the plane points opposite to the truth's. ``pressure`` is the range of the true centre of pressure, m.
    """

    value: FloatArray
    sd: FloatArray
    true: FloatArray
    condition: float
    turn: float
    side: int
    pressure: tuple[float, float]


@dataclass(frozen=True)
class Result:
    """A body before and after the advice; ``advised`` has each proposal with its result or failure."""

    case: Case
    names: tuple[str, ...]
    size: FloatArray
    before: Recorded
    advised: Mapping[str, tuple[Proposal, Recorded | str]]
    helps: bool
    support: tuple[float, float] | None


def swing(joints: int, rest: FloatArray, size: FloatArray, frequency: FloatArray, seconds: float) -> JointMotion:
    """Return a slow movement from a posture: (n,) amplitudes, rad, and frequencies, Hz."""
    time = np.arange(0.0, seconds, STEP)
    near = smoothstep((np.minimum(time, seconds - time) - 0.5) / 2.0)
    q = rest + near[:, None] * size * (1 - np.cos(2 * np.pi * np.multiply.outer(time, frequency))) / 2
    return smooth_motion(time, q)


def smooth_motion(time: FloatArray, q: FloatArray) -> JointMotion:
    """Return a motion through angles (T, n), with rest before and after it."""
    even = np.arange(-PAD, time[-1] - time[0] + PAD, STEP)
    columns = [np.interp(even, time - time[0], column) for column in q.T]
    return motion_through(even, np.column_stack(columns), float(time[-1] - time[0]))


def make_movement(course: Trajectory, rest: FloatArray, before: Recorded) -> JointMotion:
    """Return an advised movement without gaps and jumps, with angles in the frames of the truth."""
    q = np.column_stack([np.interp(course.time, course.time[np.isfinite(c)], c[np.isfinite(c)]) for c in course.q.T])
    for cut in np.flatnonzero(np.abs(np.diff(q, axis=0)).max(axis=1) > CUT):
        left = np.where(np.arange(len(q)) <= cut, course.time[cut] - course.time, np.inf)
        q = rest + smoothstep(left / FADE)[:, None] * (q - rest)
    q = before.side * q
    q[:, -1] -= before.turn
    return smooth_motion(course.time, q)


def record(place: Path, case: Case, options: Options, motion: JointMotion | None) -> Recorded:
    """Simulate a recording, run it, and read the result with its truth."""
    kind: Kind = "robot" if case.kind == "robot" else "sit-to-stand"
    configuration = simulate(kind, place, options, motion)
    trial = load(configuration)
    outcome = run_to(trial, "identify-dim")
    if outcome.refused is not None:
        raise outcome.refused
    return read(configuration, outcome.folder)


def read(configuration: Path, out: Path) -> Recorded:
    """Read an identified recording and its truth."""
    folder = Folder(out)
    dynamics, chain = folder.read("dynamics.h5"), folder.read("chain.h5")
    truth = read_truth(configuration)
    base: Any = dynamics.data["base"]
    joints: Any = chain.data["joints"]
    if len(joints["centre"]) + 1 != len(truth["segments"]):
        raise MocapIdError(f"found {len(joints['centre']) + 1} segments, expected {len(truth['segments'])}")
    if dynamics.facts["why"] is not None:
        raise MocapIdError(dynamics.facts["why"])
    turn, side = last_frame_turn(truth, chain), find_side(configuration, folder)
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


def find_side(configuration: Path, folder: Folder) -> int:
    """Return 1 if x of the plane is the truth's, -1 if it is opposite."""
    states: Any = folder.read("states.parquet")
    with np.load(configuration.with_name("truth.npz")) as arrays:
        at = np.searchsorted(arrays["t"], states.frame["time"].to_numpy() - 1e-6)
        true = arrays["qd"][at, 0]
    found = states.frame["dtheta_1"].to_numpy()
    return 1 if np.nansum(found * true) > 0 else -1


def first_motion(case: Case) -> JointMotion | None:
    """Return the movement before the advice; None for sit-to-stands."""
    rng = np.random.default_rng(case.seed)
    if case.kind == "robot":
        start = rng.uniform(-0.5, 0.5, 1)
        return swing(1, start, rng.uniform(0.12, 0.2, 1), rng.uniform(0.07, 0.12, 1), 24.0)
    if case.kind == "stand":
        size = np.radians(rng.uniform([8, -45, 15], [12, -35, 25]))
        return swing(3, np.radians([2.0, -3.0, 5.0]), size, np.array([0.2, 0.2, 0.2]), 24.0)
    return None


def advice_options(case: Case) -> AdviceOptions:
    """Return the options of the advice: a person may bend knees and hips further than before."""
    if case.kind == "stand":
        return AdviceOptions(case.objective, angles={"joint 2": (-90.0, 0.0)}, widen=20.0)
    return AdviceOptions(case.objective)


def measure(case: Case) -> Result | str:
    """Return one body before and after the advice, or why there is no advice."""
    subject = draw_subject(case.seed, 1)
    marker, plate = NOISY.get(case.kind, (Options.marker_noise, Options.plate_noise))
    options = [
        Options(seed=case.seed + k, subject=subject, repetitions=2, marker_noise=marker, plate_noise=plate)
        for k in range(3)
    ]
    with tempfile.TemporaryDirectory() as place:
        try:
            before = record(Path(place) / "before", case, options[0], first_motion(case))
            advised = advise(Path(place) / "before" / "trial.yaml", advice_options(case))
        except MocapIdError as error:
            return f"{case.kind} {case.seed}: {error}"
        done: dict[str, tuple[Proposal, Recorded | str]] = {}
        for k, (name, proposal) in enumerate(proposals(advised).items(), start=1):
            motion = make_movement(proposal.trajectory, advised.design.rest, before)
            try:
                done[name] = proposal, record(Path(place) / name, case, options[k], motion)
            except MocapIdError as error:
                done[name] = proposal, str(error)
    found = advised.design
    return Result(case, advised.names, found.size, before, done, found.helps, advised.limits.support)


def proposals(advised: Advice) -> dict[str, Proposal]:
    """Return the designed movement and the best simple change that is not the trial's own, which may need a chair."""
    found = {} if advised.design.designed is None else {"designed": advised.design.designed}
    simple = [each for each in advised.design.simple if not each.own]
    return found | ({"simple": simple[0]} if simple else {})
