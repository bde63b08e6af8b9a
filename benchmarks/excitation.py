"""Advised movements compared with their prediction, on simulated bodies.

A body makes a movement that determines little. ``mocap-id advise`` suggests another movement. The same body makes it in
a new simulated recording, which goes through the whole pipeline. About fifteen seconds per body and core.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import harness
import numpy as np
from dynamic_sweep import find_last_frame_turn, regroup_truth

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.config import load
from mocap_id.design.proposal import Proposal, Trajectory
from mocap_id.dynamics.cautions import classify
from mocap_id.errors import MocapIdError
from mocap_id.runner import run_to
from mocap_id.workflows.advice import AdviceOptions, advise_movement
from mocap_id_simulation import JointMotion, Options, motion_through, simulate
from mocap_id_simulation.options import draw_subject
from mocap_id_simulation.sit_to_stand import smoothstep

KINDS, MOVEMENTS = ("robot", "stand", "rise"), ("designed", "simple")
NOISY: Mapping[str, tuple[float, float]] = {"robot": (0.002, 4.0)}  # m, and times the plate's usual noise
PAD, STEP, FADE = 2.0, 0.02, 2.0  # s: rest before and after, time step of a motion, fade before a cut
CUT = 0.05  # rad between samples: a larger step separates the trial's own movement from the next


@dataclass(frozen=True)
class Case:
    kind: str
    seed: int
    objective: str = "intervals"


@dataclass(frozen=True)
class Recorded:
    value: FloatArray  # (b,) parameters
    sd: FloatArray  # (b,)
    true: FloatArray  # (b,)
    condition: float
    turn: float  # rotation of the last frame, rad
    side: int  # -1 if x of the plane points opposite to x of the truth, else 1
    pressure: tuple[float, float]  # range of the true centre of pressure, m


@dataclass(frozen=True)
class Result:
    case: Case
    names: tuple[str, ...]
    size: FloatArray
    before: Recorded
    advised: Mapping[str, tuple[Proposal, Recorded | str]]  # each proposal with its result or failure
    helps: bool
    support: tuple[float, float] | None

    @property
    def improvable(self) -> BoolArray:
        """Which parameters (b,) a movement can improve: not the mass, nor mx1 of a robot."""
        return np.arange(len(self.names)) > (1 if self.case.kind == "robot" else 0)


def make_first_motion(case: Case) -> JointMotion | None:
    """Return the slow movement from a posture before the advice; return None for a sit-to-stand."""
    rng, seconds = np.random.default_rng(case.seed), 24.0
    if case.kind == "robot":
        rest = rng.uniform(-0.5, 0.5, 1)
        size, frequency = rng.uniform(0.12, 0.2, 1), rng.uniform(0.07, 0.12, 1)  # rad, Hz
    elif case.kind == "stand":
        rest, frequency = np.radians([2.0, -3.0, 5.0]), np.array([0.2, 0.2, 0.2])
        size = np.radians(rng.uniform([8, -45, 15], [12, -35, 25]))
    else:
        return None
    time = np.arange(0.0, seconds, STEP)
    near = smoothstep((np.minimum(time, seconds - time) - 0.5) / 2.0)
    q = rest + near[:, None] * size * (1 - np.cos(2 * np.pi * np.multiply.outer(time, frequency))) / 2
    return make_smooth_motion(time, q)


def make_smooth_motion(time: FloatArray, q: FloatArray) -> JointMotion:
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
    return make_smooth_motion(course.time, q)


def record(place: Path, case: Case, options: Options, motion: JointMotion | None) -> Recorded:
    """Simulate a recording, run it, and read the result with its truth."""
    configuration = simulate("robot" if case.kind == "robot" else "sit-to-stand", place, options, motion)
    trial = load(configuration)
    outcome = run_to(trial, "identify-dim")
    if outcome.refused is not None:
        raise outcome.refused
    done = harness.Run(configuration, trial)
    dynamics, chain, states = done.read("dynamics.h5", "chain.h5", "states.parquet")
    count, expected = len(chain.data["joints"]["centre"]) + 1, len(done.truth["segments"])
    if count != expected:
        raise MocapIdError(f"found {count} segments, expected {expected}")
    if dynamics.facts["why"] is not None:
        raise MocapIdError(dynamics.facts["why"])
    rate, base = done.true(states["time"], "qd")[0][:, 0], dynamics.data["base"]
    side = 1 if np.nansum(states["dtheta_1"] * rate) > 0 else -1
    turn = find_last_frame_turn(done.truth, chain)
    true = regroup_truth(done.truth, turn, side)
    with np.load(configuration.with_name("truth.npz")) as arrays:
        pressure = side * arrays["cop_x"].astype(np.float64)
    reach, condition = (float(pressure.min()), float(pressure.max())), float(dynamics.facts["condition_number"])
    return Recorded(np.asarray(base["value"]), np.asarray(base["sd"]), true, condition, turn, side, reach)


def measure(case: Case) -> Result | str:
    """Return one body before and after the advice, or the reason why there is no advice."""
    subject = draw_subject(case.seed, 1)
    marker, plate = NOISY.get(case.kind, (Options.marker_noise, Options.plate_noise))
    options = [
        Options(seed=case.seed + k, subject=subject, repetitions=2, marker_noise=marker, plate_noise=plate)
        for k in range(3)
    ]
    with harness.temporary_folder() as place:
        try:
            before = record(place / "before", case, options[0], make_first_motion(case))
            wishes = AdviceOptions(case.objective)
            if case.kind == "stand":  # a person may bend knees and hips further than before
                wishes = AdviceOptions(case.objective, angles={"joint 2": (-90.0, 0.0)}, widen=20.0)
            advised = advise_movement(place / "before" / "trial.yaml", wishes)
        except MocapIdError as error:
            return f"{case.kind} {case.seed}: {error}"
        simple = next((each for each in advised.design.simple if not each.own), None)
        done: dict[str, tuple[Proposal, Recorded | str]] = {}
        for name, proposal in zip(MOVEMENTS, (advised.design.designed, simple), strict=True):
            if proposal is None:
                continue
            motion = make_movement(proposal.trajectory, advised.design.rest, before)
            try:
                done[name] = proposal, record(place / name, case, options[len(done) + 1], motion)
            except MocapIdError as error:
                done[name] = proposal, str(error)
    found = advised.design
    return Result(case, advised.names, found.size, before, done, found.helps, advised.limits.support)


Achieved = tuple[Result, Proposal, Recorded]


def list_achieved(results: Sequence[Result]) -> Iterator[tuple[str, str, list[Achieved]]]:
    """Yield each kind of body and movement, with the movements that were carried out and identified."""
    for kind in KINDS:
        for name in MOVEMENTS:
            advised = [(r, *r.advised[name]) for r in results if r.case.kind == kind and name in r.advised]
            yield kind, name, [(r, p, c) for r, p, c in advised if isinstance(c, Recorded)]


def format_spread(values: FloatArray, form: str = "{:.2f}") -> str:
    if not len(values):
        return "–"
    return f"{form} ({form} to {form})".format(np.median(values), values.min(), values.max())


def make_prediction_table(results: Sequence[Result]) -> str:
    """Return predicted condition numbers and standard deviations, divided by the achieved values."""
    head = ["body", "movement", "recordings", "condition number", "standard deviations"]
    head.append("of them within a factor of 1.5")
    rows = []
    for kind, name, own in list_achieved(results):
        conditions = np.array([p.predicted.condition / c.condition for _, p, c in own])
        ratios = np.concatenate([np.zeros(0), *((p.predicted.sd / c.sd)[r.improvable] for r, p, c in own)])
        near = f"{100 * np.mean(np.abs(np.log(ratios)) <= np.log(1.5)):.0f} %" if len(ratios) else "–"
        rows.append([kind, name, str(len(own)), format_spread(conditions, "{:.3f}"), format_spread(ratios), near])
    return harness.format_table(head, rows)


def make_gain_table(results: Sequence[Result]) -> str:
    """Return condition number, standard deviations and errors before and after the advice."""
    head = ["body", "movement", "condition number", "sd by size, %", "error by size, %", "largest sd by size, %"]
    head.append("truth inside 95 %")
    after = {(kind, name): [(r, c) for r, _, c in own] for kind, name, own in list_achieved(results)}
    rows = []
    for kind in KINDS:
        groups = {"unchanged": [(r, r.before) for r in results if r.case.kind == kind]}
        groups |= {name: after[kind, name] for name in reversed(MOVEMENTS)}
        for name, pairs in groups.items():
            if pairs:
                sd = np.array([(c.sd / r.size)[r.improvable] for r, c in pairs])
                error = np.array([((c.value - c.true) / r.size)[r.improvable] for r, c in pairs])
                inside = np.abs(error) <= harness.QUANTILE * sd
                shares = np.median(sd), np.sqrt(np.mean(error**2)), np.median(sd.max(axis=1))
                texts = [f"{np.median([c.condition for _, c in pairs]):.3g}", *(f"{100 * one:.2g}" for one in shares)]
                rows.append([kind, name, *texts, f"{100 * inside.mean():.0f} %"])
    return harness.format_table(head, rows)


def make_promise_table(results: Sequence[Result]) -> str:
    """Return how many parameters were not known, were predicted to be known, and are known."""
    head = ["body", "movement", "not known before", "predicted to be known", "known", "predicted, but not known"]
    head.append("recordings without parameters")
    rows = []
    for kind, name, own in list_achieved(results):
        tried = sum(r.case.kind == kind and name in r.advised for r in results)
        weak = promised = kept = 0
        for r, proposal, came in own:
            doubtful = [i for i, sd in enumerate(r.before.sd / r.size) if classify(float(sd)) != "known"]
            sure = [i for i in doubtful if classify(float(proposal.predicted.sd[i] / r.size[i])) == "known"]
            weak, promised = weak + len(doubtful), promised + len(sure)
            kept += sum(classify(float(came.sd[i] / r.size[i])) == "known" for i in sure)
        counts = (weak, promised, kept, promised - kept, tried - len(own))
        rows.append([kind, name, *map(str, counts)])
    return harness.format_table(head, rows)


def main() -> None:
    given = harness.make_parser(__doc__, parallel=True, bodies=5, first=960_000).parse_args()
    cases = [Case(kind, given.first + 10 * k) for kind in KINDS for k in range(given.bodies)]
    found = harness.run_all(measure, cases, given.jobs)
    without = "; ".join(each for each in found if isinstance(each, str)) or "none"
    results = [each for each in found if isinstance(each, Result)]
    helped, examples = [], []  # the examples are the advice to the first body of each kind
    for kind in KINDS:
        own = [r for r in results if r.case.kind == kind]
        helped.append(f"{sum(r.helps for r in own)} of {len(own)} ({kind})")
        for first in own[:1]:
            for name, (proposal, came) in first.advised.items():
                after = f"{came.condition:.0f}" if isinstance(came, Recorded) else came
                examples.append(
                    f"- *{kind}*, {name}: {proposal.words}. Condition number {first.before.condition:.0f}, predicted "
                    f"{proposal.predicted.condition:.0f}, achieved {after}."
                )
    # how far the true centre of pressure leaves its limits in recordings of the advised movement alone, mm
    beyond = [
        1e3 * max(r.support[0] - c.pressure[0], c.pressure[1] - r.support[1], 0.0)
        for _, _, own in list_achieved(results)
        for r, p, c in own
        if r.support is not None and p.standalone
    ]
    outside = sum(value > 0 for value in beyond)
    source = f"{given.bodies} simulated bodies of each kind, seeds from {given.first}"
    sections = {
        "excitation": f"{harness.describe_source(__file__, source)} Recordings without advice: {without}.",
        "excitation-predictions": make_prediction_table(results),
        "excitation-gains": make_gain_table(results),
        "excitation-promises": make_promise_table(results),
        "excitation-helped": f"Something within the limits was predicted to help in {', '.join(helped)} trials. A "
        f"person's true centre of pressure left the limits in {outside} of {len(beyond)} recordings, by "
        f"{max(beyond, default=0.0):.0f} mm at most.",
        "excitation-examples": "\n".join(examples),
    }
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
