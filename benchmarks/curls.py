"""Accuracy of curls on simulated trials: counts, times, compensation and torque, in all conditions of the device.

Rows and limits are in docs/measured/curls.md. Each trial has a calibration trial of the same person. It takes about ten
seconds per trial and core.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, get_args

import harness
import numpy as np
from harness import QUANTILE, Run, format_share, format_sizes, rms

from mocap_id.arrays import FloatArray
from mocap_id.errors import MocapIdError
from mocap_id.protocols.curl import Curl, fit_part_in_step
from mocap_id_simulation import ArmOptions, write_arm
from mocap_id_simulation.options import CurlCondition, Preset

PRESETS: tuple[Preset, ...] = ("default", "hard")
CONDITIONS: tuple[CurlCondition, ...] = get_args(CurlCondition)
ANGLES = ("plane", "elevation", "axial")
RANGE_LIMIT = {"default": 0.7, "hard": 1.2}  # °
TIME_LIMIT, TORQUE_LIMIT = 60.0, 0.4  # ms, N·m


def make_missing(*shape: int) -> FloatArray:
    return np.full(shape, np.nan)


@dataclass(frozen=True)
class Curls:
    """Comparison of one trial with its truth; arrays have a row for each curl."""

    level: str
    counted: bool  # the number of curls and of failed attempts is right
    times: FloatArray = field(default_factory=lambda: make_missing(0, 3))  # errors of start, top and end, ms
    ranges: FloatArray = field(default_factory=lambda: make_missing(0, 3))  # errors of the ranges of the shoulder, °
    inside: FloatArray = field(default_factory=lambda: make_missing(0, 3))  # 1 if the interval has the truth
    width: FloatArray = field(default_factory=lambda: make_missing(0, 3))  # width of the interval, °
    torque: FloatArray = field(default_factory=lambda: make_missing(2))  # rms errors: total, the person's, N·m
    within: FloatArray = field(default_factory=lambda: make_missing(2))  # share of the samples inside the intervals
    in_step: FloatArray = field(default_factory=lambda: make_missing(3))
    """Error of the axial rotation in step with the flexion, °; 1 if its interval has the truth; width."""
    flexion: FloatArray = field(default_factory=lambda: make_missing(3))
    """Rms error of the flexion's changes, °; share of the changes, and of the angles, inside the intervals."""


def compare(done: Run) -> Curls:
    summary, curls = done.summary, done.truth["repetitions"]
    events, dynamics = done.read("events.parquet", "dynamics.parquet")
    complete, found = events["complete"].astype(bool), summary["curls"]
    counted = [found[name] for name in ("count", "partial")]
    right = counted == [len(curls), len(done.truth["partials"])] and complete.sum() == len(curls)
    figures: dict[str, FloatArray] = {}
    if right:
        true = [[each["start"], (each["top"] + each["top_end"]) / 2, each["end"]] for each in curls]
        moved = [found["compensation"][f"shoulder_{name}"] for name in ANGLES]
        exact = np.degrees([[each["compensation_rad"][name] for name in ANGLES] for each in curls])
        ranges = np.array([one["range_deg"] for one in moved], dtype=float).T[complete]
        ends = np.array([[end or [np.nan] * 2 for end in one["interval_deg"]] for one in moved])
        low, high = ends[..., 0].T[complete], ends[..., 1].T[complete]
        figures["times"] = 1e3 * (events.stack(["start", "top", "end"])[complete] - np.array(true))
        figures["ranges"] = ranges - exact
        figures["inside"] = np.where(np.isfinite(ranges), (exact >= low) & (exact <= high), np.nan)
        figures["width"] = high - low
    if right and curls:
        figures["in_step"], figures["flexion"] = compare_angles(done, curls)
    if "elbow_torque" in dynamics.names and curls:
        taus = done.true(dynamics["time"], "tau_total", "tau_human")
        used = (dynamics["time"] >= curls[0]["start"]) & (dynamics["time"] <= curls[-1]["end"])
        torque, within = make_missing(2), make_missing(2)
        for k, (suffix, tau) in enumerate(zip(("", "_person"), taus, strict=True)):
            error = (dynamics[f"elbow_torque{suffix}"] - tau)[used]
            if np.isfinite(error).any():
                torque[k] = rms(error)
                within[k] = np.nanmean(np.abs(error) <= QUANTILE * dynamics[f"sd_elbow_torque{suffix}"][used])
        figures |= {"torque": torque, "within": within}
    return Curls(summary["verdict"]["level"], right, **figures)


def measure(task: tuple[Preset, int, int]) -> Curls:
    """Simulate and run a calibration and a trial of curls, and compare the trial with its truth."""
    preset, first, k = task
    seed = first + k
    condition = CONDITIONS[seed % len(CONDITIONS)]
    with harness.temporary_folder() as place:
        person = {"preset": preset, "subject": seed, "rate": 100.0}
        write_arm(place / "calibration", ArmOptions(seed=seed, severity=0.1, **person))
        options = ArmOptions(
            seed=seed + 500_000,
            movement="curl",
            repetitions=5 + seed % 3,
            failed=seed % 2,
            condition=condition,
            calibration="../calibration/trial.yaml",
            **person,
        )
        configuration = write_arm(place / "trial", options)
        try:
            return compare(harness.run_trial(configuration))
        except MocapIdError as error:
            return Curls(type(error).__name__, counted=False)


def compare_angles(done: Run, curls: Sequence[dict[str, float]]) -> tuple[FloatArray, FloatArray]:
    """Return the errors of the axial rotation in step with the flexion, and of the flexion."""
    angles, events = done.read("angles.parquet", "events.parquet")
    time, found = angles["time"], events.facts["curl"]["in_step"].get("shoulder_axial")
    shoulder, elbow = done.true(time, "isb_shoulder", "isb_elbow")
    bent, axial, in_step, flexion = elbow[:, 0], shoulder[:, 2], make_missing(3), make_missing(3)
    if found is not None:
        first = [Curl(curls[0]["start"], curls[0]["top"], curls[0]["end"], 1.0, complete=True)]
        _, _, exact, _ = fit_part_in_step(time, axial, np.zeros(len(time)), bent, None, first)
        low, high = found["interval_rad"]
        covered = low <= exact <= high
        in_step[:] = np.degrees(found["range_rad"] - exact), covered, np.degrees(high - low)
    if "elbow_flexion" in angles.names:
        used = (time >= curls[0]["start"]) & (time <= curls[-1]["end"])
        error, sd = (angles["elbow_flexion"] - bent)[used], angles["sd_elbow_flexion"][used]
        change, whole = error - np.nanmean(error), np.hypot(sd, angles["constant_sd_elbow_flexion"][used])
        flexion[0] = np.degrees(rms(change))
        flexion[1:] = [np.nanmean(np.abs(off) <= QUANTILE * each) for off, each in ((change, sd), (error, whole))]
    return in_step, flexion


def make_table(preset: str, own: Sequence[Curls], _first: int) -> str:
    def stack(name: str) -> Any:
        return np.concatenate([np.atleast_2d(getattr(each, name)) for each in own]).T

    def held(name: str, kept: Any, required: str = "88–99 %") -> list[str]:
        return [f"… {name}", required, format_share(kept), "", ""]

    counted = format_share([each.counted for each in own])
    rows = [["trials with exact counts of curls and failed attempts", "100 %", counted, "", ""]]
    for name, errors in zip(("start", "top", "end"), stack("times"), strict=True):
        rows.append([f"{name}, ms", f"{TIME_LIMIT:g}", *format_sizes(errors, TIME_LIMIT, ".0f")])
    limit = RANGE_LIMIT[preset]
    for name, errors, inside, width in zip(ANGLES, *map(stack, ("ranges", "inside", "width")), strict=True):
        rows.append([f"range of {name}, °", f"{limit:g}", *format_sizes(errors, limit, ".2f")])
        rows.append(held(f"inside its interval, {np.nanmedian(width):.1f}° wide", inside))
    errors, inside, width = stack("in_step")
    rows.append(["axial in step with the flexion, first curl, °", "", "", *format_sizes(errors, np.inf, ".2f")[1:]])
    rows.append(held(f"inside its interval, {np.nanmedian(width):.1f}° wide", inside))
    errors, change, whole = stack("flexion")
    rows.append(["change of the flexion, rms, °", "", "", *format_sizes(errors, np.inf, ".2f")[1:]])
    rows.append(held("samples inside 1.96 standard deviations", change))
    rows.append(held("of the flexion itself", whole))
    for name, errors, inside in zip(("total", "person's"), stack("torque"), stack("within"), strict=True):
        rows.append([f"{name} torque, rms, N·m", f"{TORQUE_LIMIT:g}", *format_sizes(errors, TORQUE_LIMIT, ".2f")])
        rows.append(held("samples inside 1.96 standard deviations", inside, ""))
    levels = ", ".join(f"{level} {count}" for level, count in Counter(each.level for each in own).items())
    head = f"**{preset}**, {len(own)} trials, {sum(len(each.times) for each in own)} curls. Verdicts: {levels}."
    return f"{head}\n\n" + harness.format_table(
        ["quantity", "limit", "within it", "median", "80 %"], rows, numbers_from=1
    )


def make_first(seed: int) -> str:
    """Return the table of one trial, as a test measures it again."""
    return f"One trial, seed {seed}:\n\n{make_table(PRESETS[0], [measure((PRESETS[0], seed, 0))], seed)}"


def main() -> None:
    given = harness.make_parser(__doc__, parallel=True, only=PRESETS, trials=24, first=420_000).parse_args()
    about = harness.describe_source(__file__, f"{given.trials} trials a preset, seeds from {given.first}")
    tables = harness.measure_rows("curls", PRESETS, given, measure, make_table)
    sections = {"curls": f"{about}\n\n{tables}", "curls-first": make_first(given.first + 1)}
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
