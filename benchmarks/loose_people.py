"""Errors of the dynamics for simulated people whose joints move apart, with exact truth.

Every trial runs through the stages up to ``identify-dim`` twice: with the motion that the program chooses, and with the
pinned chain. It takes about ten seconds per trial and core.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import harness
import numpy as np
from dynamic_sweep import SCALE, UNITS, find_off_seat, stack_true_series
from dynamic_sweep import TITLES as NAMES

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.geometry import planar
from mocap_id.runner import run_stage
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial
from mocap_id_simulation import Options, PersonOptions

HIP = (6.0, 16.0)  # mm
ROWS: Mapping[str, PersonOptions] = {
    "hip": PersonOptions(),
    "hip, lumbar, heel, weight": PersonOptions(lumbar_deg=15, heel_lift_mm=10, held_mass_kg=2),
    "hip, lumbar, heel, weight, arms": PersonOptions(lumbar_deg=15, heel_lift_mm=10, held_mass_kg=2, arm_swing_deg=40),
}
MOTIONS = (f"identify-dim: {{{harness.EXACT}}}\n", f"identify-dim: {{{harness.EXACT}, motion: chain}}\n")
"""The program chooses the motion, or the chain is pinned."""


@dataclass(frozen=True)
class Result:
    rms: FloatArray  # (7,) of NAMES
    inside: FloatArray  # (7,) share of the samples inside the interval
    relative: FloatArray  # (7,) rms error in stated standard deviations
    moments: FloatArray  # (3,) relative errors of the first moments about the joints
    poses: bool  # measured poses were used


def measure(options: Options) -> tuple[Result, Result] | None:
    """Return the errors with the chosen motion and with the pinned chain; return None if the trial is refused."""
    with harness.open_simulated(options) as run:
        if run is None:
            return None
        plain, found = run.configuration.read_text(), []
        for motion in MOTIONS:
            run.configuration.write_text(f"{plain}\n{motion}")
            if run_stage(load(run.configuration), harness.DYNAMIC[-1]).refused is not None:
                return None
            found.append(compare(run, open_identified_trial(run.configuration)))
        return found[0], found[1]


def compare(run: harness.Run, done: IdentifiedTrial) -> Result:
    time, keys = done.dynamics["time"].to_numpy(), ("wrench", "tau", "body_pose", "joint_xy")
    true = dict(zip(keys, run.true(time, *keys), strict=True))
    off_seat = find_off_seat(time, run.truth)
    names = [f"{name}_model" for name in ("Fx", "Fy", "tauz", "cop_x")] + [f"tau_{j}" for j in (1, 2, 3)]
    off = (done.dynamics[names].to_numpy() - stack_true_series(true))[off_seat]
    sd = done.dynamics[[f"sd_{name}" for name in names]].to_numpy()[off_seat]
    # first moments (T, 3, 2) of all bodies beyond each joint about that joint, kg·m, in the plane's frame
    motion, bodies = done.bodies.motion, done.parameters.reshape(-1, 4)
    own = bodies[:, :1] * motion.origin + planar.rotate(motion.angle, bodies[:, 1:3])  # (T, K, 2) about the origin
    carried = motion.beyond.astype(np.float64)
    moments = np.einsum("jk,tkc->tjc", carried, own) - (carried @ bodies[:, 0])[:, None] * motion.joint
    found = moments[:, : len(harness.JOINTS)]
    # the true ones: foot, shank, thigh and all bodies beyond the hip
    parts = run.truth["people"]["bodies"]
    mass, first = np.array([body["m"] for body in parts]), np.array([[body["mx"], body["my"]] for body in parts])
    pose, joint = true["body_pose"], true["joint_xy"]
    own = mass[:, None] * pose[..., :2] + planar.rotate(pose[..., 2], first)
    exact = np.stack([own[:, k:].sum(axis=1) - mass[k:].sum() * joint[:, k - 1] for k in (1, 2, 3)], axis=1)
    known = done.dynamics["in_fit"].to_numpy() & np.isfinite(found).all(axis=(1, 2))
    size = np.linalg.norm(harness.rms(exact[known]), axis=1)
    return Result(
        rms=harness.rms(off) * SCALE,
        inside=np.nanmean(np.abs(off) <= harness.QUANTILE * sd, axis=0),
        relative=harness.rms(off / sd),
        moments=np.linalg.norm(harness.rms((found - exact)[known]), axis=1) / size,
        poses=done.facts["motion"]["source"] == "segments",
    )


def draw_person(row: str, seed: int) -> Options:
    """Return a person of a row; the gap of the hip depends on the seed."""
    low, high = HIP
    return Options(seed=seed, people=replace(ROWS[row], hip_gap_mm=low + (high - low) * (seed % 11) / 10))


def make_table(columns: Mapping[str, Sequence[tuple[Result, Result]]], quantity: str) -> str:
    """Return a table with cells for the chosen motion and for the pinned chain."""
    texts = []
    for pairs in columns.values():
        chosen, pinned = (FORMATS[quantity](results) for results in zip(*pairs, strict=True))
        texts.append([" / ".join(each) for each in zip(chosen, pinned, strict=True)])
    names = list(NAMES)
    if quantity == "errors":
        names = [f"{name}, {unit}" for name, unit in zip(NAMES, UNITS, strict=True)]
        names += [f"first moment about the {joint}, %" for joint in harness.JOINTS]
    return harness.format_table(["", *columns], zip(names, *texts, strict=True))


FORMATS: Mapping[str, Callable[[Sequence[Result]], list[str]]] = {
    "errors": lambda each: harness.format_numbers(
        np.median([np.append(r.rms, 100 * r.moments) for r in each], axis=0), ".2g"
    ),
    "inside": lambda each: harness.format_numbers(100 * np.mean([r.inside for r in each], axis=0), ".0f"),
    "relative": lambda each: harness.format_numbers(harness.rms(np.array([r.relative for r in each]))),
}


def make_first(first: int) -> str:
    """Return errors and shares inside the intervals in one trial per column, as a test measures them again."""
    found = {row: [pair] for row in ROWS if (pair := measure(draw_person(row, first))) is not None}
    tables = "\n\n".join(make_table(found, quantity) for quantity in ("errors", "inside"))
    return f"One trial per column, seed {first}; errors, then the shares inside the intervals, %:\n\n{tables}"


def main() -> None:
    given = harness.make_parser(__doc__, parallel=True, trials=20, first=991_000).parse_args()
    found: dict[str, list[tuple[Result, Result]]] = {}
    for row in ROWS:
        options = map(partial(draw_person, row), range(given.first, given.first + given.trials))
        found[row] = harness.measure_all(measure, options, given.jobs)
    every = [pair for pairs in found.values() for pair in pairs]
    with_all = found | {"all": every}
    chosen = sum(pair[0].poses for pair in every)
    source = f"{given.trials} simulated sit-to-stands per column, seeds from {given.first}, with 5 repetitions each"
    about = harness.describe_source(__file__, source)
    sections = {
        "loose-people": about,
        "loose-people-errors": make_table(found, "errors"),
        "loose-people-motion": f"The program chose measured poses in {chosen} of {len(every)} trials.",
        "loose-people-coverage": about,
        "loose-people-first": make_first(given.first),
        "loose-people-intervals": make_table(with_all, "inside"),
        "loose-people-relative": make_table(with_all, "relative"),
    }
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
