"""Curls: counts, times, compensation and torque against exact truth, over all conditions of the device.

Rows and limits are those of docs/measured/curls.md. Each trial has a calibration trial of the same person. About ten
seconds per trial and core.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import harness
import numpy as np
from harness import share, sizes

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.errors import MocapIdError
from mocap_id.protocols.curl.compensation import fit_part_in_step
from mocap_id.protocols.curl.repetitions import Curl
from mocap_id.runner import run
from mocap_id.simulation.arm import ArmOptions, write_arm
from mocap_id.simulation.arm.options import CurlCondition, Preset
from mocap_id.store import Folder

PRESETS: tuple[Preset, ...] = ("default", "hard")
CONDITIONS: tuple[CurlCondition, ...] = get_args(CurlCondition)
ANGLES = ("plane", "elevation", "axial")
RANGE_LIMIT = {"default": 0.7, "hard": 1.2}  # °
TIME_LIMIT, TORQUE_LIMIT = 60.0, 0.4  # ms, N·m


@dataclass(frozen=True)
class Curls:
    """What came of one trial; arrays have a row for each curl."""

    preset: str
    level: str
    counted: bool  # the number of curls and of failed attempts is right
    times: FloatArray  # (n, 3) errors of start, top and end, ms
    ranges: FloatArray  # (n, 3) errors of the ranges of the shoulder's angles, °
    inside: FloatArray  # (n, 3) 1 if the interval of the range holds the truth
    width: FloatArray  # (n, 3) width of the interval, °
    torque: FloatArray  # (2,) rms errors of the total torque and of the person's, N·m; NaN if unknown
    within: FloatArray  # (2,) share of the samples within 1.96 standard deviations
    in_step: FloatArray  # (3,) error of the axial rotation in step with the flexion, °, 1 if its interval holds, width
    flexion: FloatArray  # (3,) rms error of the flexion's changes, °; share of the changes, and of the angles, within


def measure(task: tuple[Preset, int]) -> Curls:
    """Simulate and run a calibration and a trial of curls, and compare the latter with its truth."""
    preset, seed = task
    condition = CONDITIONS[seed % len(CONDITIONS)]
    with tempfile.TemporaryDirectory() as place:
        person = {"preset": preset, "subject": seed, "rate": 100.0}
        write_arm(Path(place) / "calibration", ArmOptions(seed=seed, severity=0.1, **person))
        options = ArmOptions(
            seed=seed + 500_000,
            movement="curl",
            repetitions=5 + seed % 3,
            failed=seed % 2,
            condition=condition,
            calibration="../calibration/trial.yaml",
            **person,
        )
        configuration = write_arm(Path(place) / "trial", options)
        nothing = np.full((0, 3), np.nan)
        try:
            outcome = run(load(configuration))
        except MocapIdError as error:
            return Curls(preset, type(error).__name__, False, *[nothing] * 4, *_unknown())
        return compare(preset, outcome.folder, configuration)


def _unknown() -> list[FloatArray]:
    return [np.full(size, np.nan) for size in (2, 2, 3, 3)]


def compare(preset: str, folder: Path, configuration: Path) -> Curls:
    """Compare the results of a trial with its truth."""
    summary, truth, artefacts = harness.read_summary(folder), harness.read_truth(configuration), Folder(folder)
    events, dynamics = (artefacts.read(name) for name in ("events.parquet", "dynamics.parquet"))
    done, curls = events["complete"].astype(bool), truth["repetitions"]
    counted = [summary["curls"][name] for name in ("count", "partial")]
    right = counted == [len(curls), len(truth["partials"])] and done.sum() == len(curls)
    times = ranges = inside = width = np.full((0, 3), np.nan)
    if right:
        true = [[each["start"], (each["top"] + each["top_end"]) / 2, each["end"]] for each in curls]
        times = 1e3 * (events.stack(["start", "top", "end"])[done] - np.array(true))
        moved = [summary["curls"]["compensation"][f"shoulder_{name}"] for name in ANGLES]
        exact = np.degrees([[each["compensation_rad"][name] for name in ANGLES] for each in curls])
        found = np.array([one["range_deg"] for one in moved], dtype=float).T[done]
        ends = np.array([[end or [np.nan] * 2 for end in one["interval_deg"]] for one in moved])
        low, high = ends[..., 0].T[done], ends[..., 1].T[done]
        ranges, width = found - exact, high - low
        inside = np.where(np.isfinite(found), (exact >= low) & (exact <= high), np.nan)
    torque, within, in_step, flexion = _unknown()
    if right and curls:
        in_step, flexion = compare_angles(artefacts, configuration, curls)
    if "elbow_torque" in dynamics.names and curls:
        taus = harness.read_true_arrays(configuration, dynamics["time"], ["tau_total", "tau_human"])
        used = (dynamics["time"] >= curls[0]["start"]) & (dynamics["time"] <= curls[-1]["end"])
        for k, (suffix, name) in enumerate((("", "tau_total"), ("_person", "tau_human"))):
            error = (dynamics[f"elbow_torque{suffix}"] - taus[name])[used]
            if np.isfinite(error).any():
                torque[k] = np.sqrt(np.nanmean(error**2))
                within[k] = np.nanmean(np.abs(error) <= 1.96 * dynamics[f"sd_elbow_torque{suffix}"][used])
    level = summary["verdict"]["level"]
    return Curls(preset, level, right, times, ranges, inside, width, torque, within, in_step, flexion)


def compare_angles(
    artefacts: Folder, configuration: Path, curls: Sequence[dict[str, float]]
) -> tuple[FloatArray, FloatArray]:
    """Compare the axial rotation in step with the flexion, and the flexion."""
    angles, facts = artefacts.read("angles.parquet"), artefacts.read("events.parquet").facts["curl"]
    time, found = angles["time"], facts["in_step"].get("shoulder_axial")
    true = harness.read_true_arrays(configuration, time, ["isb_shoulder", "isb_elbow"])
    bent, axial = true["isb_elbow"][:, 0], true["isb_shoulder"][:, 2]
    in_step, flexion = np.full(3, np.nan), np.full(3, np.nan)
    if found is not None:
        first = [Curl(curls[0]["start"], curls[0]["top"], curls[0]["end"], 1.0, complete=True)]
        exact = fit_part_in_step(time, axial, np.zeros(len(time)), bent, None, first)
        low, high = found["interval_rad"]
        held = low <= exact.range <= high
        in_step[:] = np.degrees(found["range_rad"] - exact.range), held, np.degrees(high - low)
    if "elbow_flexion" in angles.names:
        used = (time >= curls[0]["start"]) & (time <= curls[-1]["end"])
        error, sd = (angles["elbow_flexion"] - bent)[used], angles["sd_elbow_flexion"][used]
        change, whole = error - np.nanmean(error), np.hypot(sd, angles["constant_sd_elbow_flexion"][used])
        flexion[0] = np.degrees(np.sqrt(np.nanmean(change**2)))
        flexion[1:] = [np.nanmean(np.abs(off) <= 1.96 * each) for off, each in ((change, sd), (error, whole))]
    return in_step, flexion


def table(preset: str, outcomes: Sequence[Curls]) -> str:
    """Return the table of a preset."""
    own = [each for each in outcomes if each.preset == preset]

    def stack(name: str) -> Any:
        return np.concatenate([np.atleast_2d(getattr(each, name)) for each in own]).T

    def held(name: str, kept: Any, required: str = "88–99 %") -> list[str]:
        return [f"… {name}", required, share(kept), "", ""]

    counted = share([each.counted for each in own])
    rows = [["trials with exact counts of curls and failed attempts", "100 %", counted, "", ""]]
    for name, errors in zip(("start", "top", "end"), stack("times"), strict=True):
        rows.append([f"{name}, ms", f"{TIME_LIMIT:g}", *sizes(errors, TIME_LIMIT, ".0f")])
    limit = RANGE_LIMIT[preset]
    for name, errors, inside, width in zip(ANGLES, *map(stack, ("ranges", "inside", "width")), strict=True):
        rows.append([f"range of {name}, °", f"{limit:g}", *sizes(errors, limit, ".2f")])
        rows.append(held(f"inside its interval, {np.nanmedian(width):.1f}° wide", inside))
    errors, inside, width = stack("in_step")
    rows.append(["axial in step with the flexion, first curl, °", "", "", *sizes(errors, np.inf, ".2f")[1:]])
    rows.append(held(f"inside its interval, {np.nanmedian(width):.1f}° wide", inside))
    errors, change, whole = stack("flexion")
    rows.append(["change of the flexion, rms, °", "", "", *sizes(errors, np.inf, ".2f")[1:]])
    rows.append(held("samples inside 1.96 standard deviations", change))
    rows.append(held("of the flexion itself", whole))
    for name, errors, inside in zip(("total", "person's"), stack("torque"), stack("within"), strict=True):
        rows.append([f"{name} torque, rms, N·m", f"{TORQUE_LIMIT:g}", *sizes(errors, TORQUE_LIMIT, ".2f")])
        rows.append(held("samples inside 1.96 standard deviations", inside, ""))
    levels = ", ".join(f"{level} {sum(e.level == level for e in own)}" for level in dict.fromkeys(e.level for e in own))
    head = f"**{preset}**, {len(own)} trials, {sum(len(each.times) for each in own)} curls. Verdicts: {levels}."
    return f"{head}\n\n" + harness.markdown(["quantity", "limit", "within it", "median", "80 %"], rows, numbers_from=1)


def main() -> None:
    """Measure trials of both presets, or those given by ``--only``."""
    parser = harness.command_line(__doc__, parallel=True, trials=24, first=420_000)
    parser.add_argument("--only", nargs="*", default=PRESETS, choices=PRESETS, help="presets to measure")
    given = parser.parse_args()
    tasks = [(preset, given.first + k) for preset in given.only for k in range(given.trials)]
    outcomes = harness.run_all(measure, tasks, given.jobs)
    about = harness.measured_by(__file__, f"{given.trials} trials a preset, seeds from {given.first}")
    sections = {"curls": "\n\n".join([about, *(table(preset, outcomes) for preset in given.only)])}
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
