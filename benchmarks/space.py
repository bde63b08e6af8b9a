"""Chains in space: arms and plain chains with exact truth, run up to `report`.

Rows and limits are in docs/measured/space.md. It takes about five seconds per trial and core.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations
from typing import Any

import harness
import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import MocapIdError
from mocap_id.geometry import so3
from mocap_id.store import Table
from mocap_id_simulation import ArmOptions, ChainOptions, write_arm, write_chain

TO_TRIAL = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""From the lab's axes, Z up, to those of the trial."""
FALSE_SIDE = 0.1
"""Error of the shoulder, m, from which on a left arm was taken for a right one: it is on the other side."""
GATE = np.sin(np.radians(15))
ANGLES = {
    "shoulder_plane": ("isb_shoulder", 0, 1),
    "shoulder_elevation": ("isb_shoulder", 1, -1),
    "shoulder_axial": ("isb_shoulder", 2, 1),
    "elbow_flexion": ("isb_elbow", 0, 1),
}
ARM_KINDS = {"shoulder": {"ball"}, "elbow": {"two-axis"}, "wrist": {"two-axis", "ball"}}
CHAIN_KINDS = {"S": "ball", "H": "hinge", "T": "two-axis"}


@dataclass(frozen=True)
class Row:
    arm: Mapping[str, Any] | None = None
    chain: Mapping[str, Any] | None = None
    limits: Mapping[str, float] = field(default_factory=dict)


_DEFAULT = {
    **{"GH centre, mm": 5, "elbow centre, mm": 4, "elbow axis, °": 6},
    **{"shoulder_plane, °": 4.5, "shoulder_elevation, °": 2, "shoulder_axial, °": 5.5, "elbow_flexion, °": 1.5},
    "forearm acceleration, rad/s²": 0.6,
}
_HARD = {
    **{"GH centre, mm": 12, "elbow centre, mm": 8, "elbow axis, °": 8},
    **{"shoulder_plane, °": 6.5, "shoulder_elevation, °": 4, "shoulder_axial, °": 12, "elbow_flexion, °": 2},
    "forearm acceleration, rad/s²": 0.7,
}
ROWS: Mapping[str, Row] = {
    "arm, default": Row(arm={}, limits=_DEFAULT),
    "arm, hard": Row(arm={"preset": "hard", "cycles": 1, "severity": 0.5, "anonymous": True}, limits=_HARD),
    "left arm": Row(arm={"side": "left"}, limits=_DEFAULT),
    "two balls, 40°": Row(chain={"kinds": "SS", "arc_deg": 40}, limits={"centres, mm": 0.5}),
    "two balls, 15°": Row(chain={"kinds": "SS", "arc_deg": 15}, limits={"centres, mm": 0.8}),
    "two balls, 40°, hard": Row(chain={"kinds": "SS", "arc_deg": 40, "preset": "hard"}, limits={"centres, mm": 1.2}),
    "two balls, 15°, hard": Row(chain={"kinds": "SS", "arc_deg": 15, "preset": "hard"}, limits={"centres, mm": 2}),
    "ball and hinge, 40°": Row(chain={"kinds": "SH", "arc_deg": 40}, limits={"centres, mm": 0.5}),
    "ball, two-axis, hinge, base sways": Row(
        chain={"kinds": "STH", "arc_deg": 40, "sway_mm": 30}, limits={"centres, mm": 0.5}
    ),
}


@dataclass(frozen=True)
class Outcome(harness.Comparison):
    """Comparison of one trial, with its segments and joints."""

    right: bool = False  # number of segments and markers
    kinds: bool = False  # all kinds of joints are right
    confidence: float = 0.0


def measure(task: tuple[str, int, int]) -> Outcome:
    name, first, k = task
    row = ROWS[name]
    with harness.temporary_folder() as place:
        folder = place / "trial"
        if row.arm is not None:
            configuration = write_arm(folder, ArmOptions(seed=first + k, **row.arm))
        else:
            configuration = write_chain(folder, ChainOptions(seed=first + k, **(row.chain or {})))
        try:
            return compare(harness.run_trial(configuration))
        except MocapIdError as error:
            return Outcome((type(error).__name__,))


def compare(done: harness.Run) -> Outcome:
    summary, truth = done.summary, done.truth
    confidence = summary["segments"]["confidence"] or 0.0
    found = summary["segments"]["assignment"]
    assigned = summary["segments"]["count"] == len(truth["segments"]) and all(
        found.get(label) == link
        for label, link in truth["assignment"].items()
        if label != "AC"  # it is on the shoulder girdle
    )
    if summary["verdict"]["level"] == "refused" or not assigned:
        return Outcome(done.codes, confidence=confidence)
    with np.load(done.configuration.with_name("truth.npz")) as arrays:
        true = {key: arrays[key].astype(np.float64) for key in arrays}
    poses, angles = done.read("poses.parquet", "angles.parquet")
    if truth["kind"] == "sphere":
        kinds = [joint["kind"] for joint in summary["joints"]] == [CHAIN_KINDS[each] for each in truth["types"]]
        errors, inside = _compare_chain(poses, truth, true)
    else:
        kinds = all(joint["kind"] in ARM_KINDS.get(joint["name"], ()) for joint in summary["joints"])
        errors, inside = _compare_arm(summary, poses, angles, truth, true)
    return Outcome(done.codes, errors, inside, right=True, kinds=kinds, confidence=confidence)


def stack_columns(table: Table, segment: str, names: Iterable[str]) -> FloatArray:
    return table.stack([f"{segment}_{name}" for name in names])


def compute_rms_length(error: FloatArray) -> float:
    """Return the rms length of the rows (F, 3); rows with NaN do not count."""
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=1))))


def _compare_motion(
    poses: Table, segment: str, k: int, truth: Mapping[str, Any], true: Mapping[str, FloatArray]
) -> tuple[float, dict[str, float]]:
    """Return the rms error of the angular acceleration, and the shares of samples inside their intervals."""
    moving = true["t"] > truth["static_s"] + 0.5
    off = {
        name: (stack_columns(poses, segment, [f"{name}_{axis}" for axis in "xyz"]) - true[name][:, k] @ TO_TRIAL.T)[
            moving
        ]
        for name in ("omega", "alpha")
    }
    sd = {name: np.repeat(poses[f"sd_{segment}_{name}"][moving, None], 3, axis=1) for name in off}
    return compute_rms_length(off["alpha"]), {
        "velocity": harness.compute_share_inside(off["omega"], sd["omega"]),
        "acceleration": harness.compute_share_inside(off["alpha"], sd["alpha"]),
    }


def _compare_arm(
    summary: Mapping[str, Any],
    poses: Table,
    angles: Table,
    truth: Mapping[str, Any],
    true: Mapping[str, FloatArray],
) -> tuple[dict[str, float], dict[str, float]]:
    origin = true["seg_origin"] @ TO_TRIAL.T
    shoulder = compute_rms_length(stack_columns(poses, "upper_arm", "xyz") - origin[:, 1])
    if truth.get("side") == "left" and shoulder > FALSE_SIDE:
        return {}, {}
    errors = {
        "GH centre, mm": 1e3 * shoulder,
        "elbow centre, mm": 1e3 * compute_rms_length(stack_columns(poses, "forearm", "xyz") - origin[:, 2]),
        "elbow axis, °": _compare_elbow_axis(summary, poses, truth, true),
    }
    errors["forearm acceleration, rad/s²"], inside = _compare_motion(poses, "forearm", 2, truth, true)
    sine = np.abs(np.sin(true["isb_shoulder"][:, 1]))
    covered = []
    for name, (key, column, sign) in ANGLES.items():
        keep = sine > GATE if name in ("shoulder_plane", "shoulder_axial") else np.isfinite(sine)
        error = (angles[name] - sign * true[key][:, column] + np.pi) % (2 * np.pi) - np.pi
        error = error[keep]
        errors[f"{name}, °"] = float(np.degrees(harness.rms(error)))
        covered.append(harness.compute_share_inside(error - np.nanmean(error), angles[f"sd_{name}"][keep]))
    return errors, {"angles": float(np.mean(covered)), **inside}


def _compare_elbow_axis(
    summary: Mapping[str, Any],
    poses: Table,
    truth: Mapping[str, Any],
    true: Mapping[str, FloatArray],
) -> float:
    """Return the angle between the elbow's first axis and the true one in the still pose, °."""
    joint = next((each for each in summary["joints"] if each["name"] == "elbow"), None)
    if joint is None or not joint.get("axis"):
        return float("nan")
    axis = np.atleast_2d(np.array(joint["axis"], dtype=np.float64))[0]
    still = true["t"] < truth["static_s"]
    vector, scalar = (stack_columns(poses, "upper_arm", names)[still] for names in (("qx", "qy", "qz"), ("qw",)))
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    rotation = so3.exp(2 * np.arctan2(length, scalar) * (vector / np.maximum(length, 1e-300)))
    there = true["seg_R"][still, 1] @ np.array(truth["subject"]["elbow_axis_in_upper_arm"]) @ TO_TRIAL.T
    cosine = np.abs(np.sum((rotation @ axis) * there, axis=1))
    return float(np.degrees(np.arccos(np.clip(np.median(cosine), 0, 1))))


def _compare_chain(
    poses: Table, truth: Mapping[str, Any], true: Mapping[str, FloatArray]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the largest error of a centre, mm, and the shares inside intervals.

    The error along the axis of a hinge does not count.
    """
    names = [name.removesuffix("_qw") for name in poses.names if name.endswith("_qw")]
    centres = true["joint_lab"]
    found = [stack_columns(poses, name, "xyz") @ TO_TRIAL for name in names]
    best = np.inf
    for order in permutations(range(len(found)), centres.shape[1]):
        errors = []
        for j, k in enumerate(order):
            error = found[k] - centres[:, j]
            if truth["types"][j] == "H":
                axis = true["seg_R"][:, j] @ np.array(truth["joint_axes"][j])[:, 0]
                error = error - np.sum(error * axis, axis=1, keepdims=True) * axis
            errors.append(1e3 * compute_rms_length(error))
        best = min(best, max(errors))
    _, inside = _compare_motion(poses, names[-1], len(truth["segments"]) - 1, truth, true)
    return {"centres, mm": best}, inside


def make_table(name: str, outcomes: Sequence[Outcome], first: int) -> str:
    """Return the table of a row: quantity, limit, share within it, median and 80 % quantile."""
    right = [each for each in outcomes if each.right]
    flagged = sum(not each.right and (each.confidence < 0.5 or bool(each.codes)) for each in outcomes)
    about = (
        f"**{name}**, {len(outcomes)} trials, seeds from {first}: chain right {len(right)}, else "
        f"flagged {flagged}, kinds right {sum(each.kinds for each in outcomes)}. Cautions: "
        f"{harness.count_codes(code for each in outcomes for code in each.codes)}."
    )
    return f"{about}\n\n{harness.make_limit_table(ROWS[name].limits, right)}"


def make_first(first: int) -> str:
    """Return the tables of an arm and a chain, as a test measures them again."""
    return "\n\n".join(make_table(row, [measure((row, first, 0))], first) for row in ("arm, default", "two balls, 40°"))


def main() -> None:
    given = harness.make_parser(__doc__, parallel=True, only=ROWS, trials=30, first=210_000).parse_args()
    sections = {"space": harness.measure_rows("space", ROWS, given, measure, make_table)}
    sections["space-first"] = make_first(given.first)
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
