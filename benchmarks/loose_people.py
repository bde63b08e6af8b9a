"""Errors of the dynamics for simulated people whose joints give way, with exact truth.

Every trial runs through the stages up to ``identify-dim`` twice: with the motion that the program chooses, and with the
pinned chain. About ten seconds per trial and core.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import harness
import numpy as np
from dynamic_truth import UNITS

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.geometry import planar
from mocap_id.runner import run_stage
from mocap_id.simulation import Options, PersonOptions
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial

NAMES = ("Fx", "Fy", "tauz", "CoP", *(f"{joint} torque" for joint in harness.JOINTS))
SCALE = np.array([1, 1, 1, 1e3, 1, 1, 1])
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
    """Errors of one trial with one motion.

    Parameters
    ----------
    rms, inside, relative : (7,) arrays
        Errors of :data:`NAMES`, share of the samples inside the interval, and rms error in stated standard deviations.
    moments : (3,) array
        Relative errors of the first moments about :data:`JOINTS`.
    poses : bool
        Whether measured poses were used.
    """

    rms: FloatArray
    inside: FloatArray
    relative: FloatArray
    moments: FloatArray
    poses: bool


def measure(options: Options) -> tuple[Result, Result] | None:
    """Return the errors with the chosen motion and with the pinned chain; None if the trial is refused."""
    with tempfile.TemporaryDirectory() as place:
        run = harness.run_simulated(Path(place) / "trial", options)
        if run is None:
            return None
        configuration = run[1]
        plain, found = configuration.read_text(), []
        for motion in MOTIONS:
            configuration.write_text(f"{plain}\n{motion}")
            if run_stage(load(configuration), harness.DYNAMIC[-1]).refused is not None:
                return None
            found.append(compare(configuration, open_identified_trial(configuration)))
        return found[0], found[1]


def compare(configuration: Path, done: IdentifiedTrial) -> Result:
    """Return the errors of an identified trial."""
    time = done.dynamics["time"].to_numpy()
    truth = harness.read_truth(configuration)
    true = harness.read_true_arrays(configuration, time, ("wrench", "tau", "body_pose", "joint_xy"))
    off_seat = np.any([(time >= one["seat_off"]) & (time <= one["seat_on"]) for one in truth["reps"]], axis=0)
    names = [f"{name}_model" for name in ("Fx", "Fy", "tauz", "cop_x")] + [f"tau_{j}" for j in (1, 2, 3)]
    wrench = true["wrench"]
    wanted = np.column_stack([wrench, wrench[:, 2] / wrench[:, 1], true["tau"]])
    off = (done.dynamics[names].to_numpy() - wanted)[off_seat]
    sd = done.dynamics[[f"sd_{name}" for name in names]].to_numpy()[off_seat]
    used = done.dynamics["in_fit"].to_numpy()
    found, exact = first_moments(done), true_moments(truth, true["body_pose"], true["joint_xy"])
    known = used & np.isfinite(found).all(axis=(1, 2))
    size = np.linalg.norm(harness.rms(exact[known]), axis=1)
    return Result(
        rms=harness.rms(off) * SCALE,
        inside=np.nanmean(np.abs(off) <= harness.QUANTILE * sd, axis=0),
        relative=harness.rms(off / sd),
        moments=np.linalg.norm(harness.rms((found - exact)[known]), axis=1) / size,
        poses=done.facts["motion"]["source"] == "segments",
    )


def first_moments(done: IdentifiedTrial) -> FloatArray:
    """Return (T, 3, 2) first moments of all bodies beyond each joint about that joint, kg·m, plane frame."""
    motion, bodies = done.bodies.motion, done.parameters.reshape(-1, 4)
    own = bodies[:, :1] * motion.origin + planar.rotate(motion.angle, bodies[:, 1:3])  # (T, K, 2) about the origin
    carried = motion.beyond.astype(np.float64)
    moments = np.einsum("jk,tkc->tjc", carried, own) - (carried @ bodies[:, 0])[:, None] * motion.joint
    return np.asarray(moments[:, : len(harness.JOINTS)])


def true_moments(truth: Mapping[str, object], pose: FloatArray, joint: FloatArray) -> FloatArray:
    """Return the same of the true bodies: foot, shank, thigh and all bodies beyond the hip."""
    people = truth["people"]
    assert isinstance(people, dict)
    mass = np.array([body["m"] for body in people["bodies"]])
    first = np.array([[body["mx"], body["my"]] for body in people["bodies"]])
    own = mass[:, None] * pose[..., :2] + planar.rotate(pose[..., 2], first)
    return np.stack([own[:, k:].sum(axis=1) - mass[k:].sum() * joint[:, k - 1] for k in (1, 2, 3)], axis=1)


def people(row: str, seed: int) -> Options:
    """Return a person of a row; the gap of the hip depends on the seed."""
    low, high = HIP
    return Options(seed=seed, people=replace(ROWS[row], hip_gap_mm=low + (high - low) * (seed % 11) / 10))


def _names(cell: str) -> list[str]:
    if cell in {"inside", "relative"}:
        return list(NAMES)
    series = [f"{name}, {unit}" for name, unit in zip(NAMES, UNITS, strict=True)]
    return [*series, *(f"first moment about the {joint}, %" for joint in harness.JOINTS)]


def _cell(cell: str, k: int, pairs: Sequence[tuple[Result, Result]]) -> str:
    def values(which: int) -> str:
        if cell == "inside":
            return f"{100 * np.mean([pair[which].inside[k] for pair in pairs]):.0f}"
        if cell == "relative":
            return f"{harness.rms(np.array([pair[which].relative[k] for pair in pairs])):.2f}"
        every = [np.append(pair[which].rms, 100 * pair[which].moments)[k] for pair in pairs]
        return f"{np.median(every):.2g}"

    return f"{values(0)} / {values(1)}"


def main() -> None:
    """Measure all rows."""
    arguments = harness.command_line(__doc__, parallel=True, trials=20, first=991_000).parse_args()
    found: dict[str, list[tuple[Result, Result]]] = {}
    for row in ROWS:
        options = map(partial(people, row), range(arguments.first, arguments.first + arguments.trials))
        found[row] = [pair for pair in harness.run_all(measure, options, arguments.jobs) if pair is not None]

    every = [pair for pairs in found.values() for pair in pairs]

    def table(cell: str) -> str:
        columns = found if cell == "errors" else found | {"all": every}
        rows = [[name, *(_cell(cell, k, pairs) for pairs in columns.values())] for k, name in enumerate(_names(cell))]
        return harness.markdown(["", *columns], rows)

    chosen = sum(pair[0].poses for pair in every)
    own = (
        f"{arguments.trials} simulated sit-to-stands per column, seeds from {arguments.first}, with 5 repetitions each"
    )
    sections = {
        "loose-people": harness.measured_by(__file__, own),
        "loose-people-errors": table("errors"),
        "loose-people-motion": f"The program chose measured poses in {chosen} of {len(every)} trials.",
        "loose-people-coverage": harness.measured_by(__file__, own),
        "loose-people-intervals": table("inside"),
        "loose-people-relative": table("relative"),
    }
    harness.publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
