"""Errors of the joint states when markers jump, on simulated sit-to-stands.

Each trial is written as a C3D file twice, without and with jumps, and runs through the stages up to ``ukf-smooth``.
About six seconds per trial and core.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import harness
import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.config import load
from mocap_id.errors import Refused
from mocap_id.runner import run_stage
from mocap_id.stages.base import Context
from mocap_id.stages.fit_joints import STAGE as FIT_JOINTS
from mocap_id.stages.segment import STAGE as SEGMENT
from mocap_id.stages.ukf_smooth import STAGE as UKF_SMOOTH
from mocap_id.store import Document, Folder
from mocap_id_simulation import Options, simulate

JUMPS = 60
USUAL = Options(analog_rate=100)
NAMES = ("angle", "velocity", "acceleration")
LEAST = 0.02  # m
MARGIN = 20  # frames at either end, where a smoother has one side only
LIMIT = 1.1


@dataclass(frozen=True)
class Run:
    """Errors of one run of a trial."""

    rms: FloatArray  # (n, 3) rms errors of the states
    segment: IntArray  # (M,) segment of every marker
    used: BoolArray  # (F, M) samples that were used


@dataclass(frozen=True)
class Result:
    """Comparison of the runs of one trial."""

    jumped: FloatArray  # (3,) error of the worst joint with jumps, relative to the run without jumps
    missing: FloatArray  # (3,) the same where the samples that jump are missing
    moved: bool  # a marker is on another segment than without jumps
    wrong: tuple[bool, bool]  # a marker is on a wrong segment, without and with jumps
    let_in: tuple[int, int]  # displaced samples that were used, and all displaced samples
    lost: tuple[int, int]  # other samples that were not used, and all other samples
    share: float  # of the samples that jump


def measure(seed: int) -> Result | None:
    """Simulate and run a trial without and with jumps, and return its comparison; return None if a run fails."""
    with harness.temporary_folder() as place:
        plain, jumped = (
            simulate("sit-to-stand", place / str(jumps), replace(USUAL, seed=seed, jumps=jumps)) for jumps in (0, JUMPS)
        )
        document = harness.read_truth(jumped)
        with np.load(jumped.with_name("truth.npz")) as arrays:
            truth = np.stack([arrays[name].astype(np.float64) for name in ("q", "qd", "qdd")], axis=2)
        contexts = [planarise(configuration) for configuration in (plain, jumped)]
    labels = list(document["assignment"])
    hit, off = find_jumps(document["jumps"], labels, len(truth), contexts)
    planar = harness.hide_samples(contexts[0].long("planar.parquet"), hit)
    contexts.append(replace(contexts[0], inputs={"planar.parquet": planar}))
    try:
        runs = [run(context, truth, labels) for context in contexts]
    except (Refused, WrongSegments):
        return None
    worst = [each.rms / runs[0].rms for each in runs[1:]]
    true = np.array([document["assignment"][label] for label in labels])
    moving, seen = true > 0, np.isfinite(read_coordinates(contexts[1])[..., 0])
    bad, good = hit & seen & moving & (off > LEAST), seen & moving & ~hit & runs[0].used
    return Result(
        worst[0].max(axis=0),
        worst[1].max(axis=0),
        bool((runs[1].segment != runs[0].segment).any()),
        (has_wrong_marker(runs[0].segment, true), has_wrong_marker(runs[1].segment, true)),
        (int((bad & runs[1].used).sum()), int(bad.sum())),
        (int((good & ~runs[1].used).sum()), int(good.sum())),
        float(hit.mean()),
    )


class WrongSegments(Exception):
    """The stages found a wrong number of segments."""


def has_wrong_marker(segment: IntArray, true: IntArray) -> bool:
    """Return whether a marker is on a wrong segment; a marker on no segment is not wrong."""
    return bool(((segment >= 0) & (segment != true) & ~((segment == 0) & (true == 0))).any())


def planarise(configuration: Path) -> Context:
    """Run the first stage of a trial."""
    trial = load(configuration)
    if (refused := run_stage(trial, "planarise").refused) is not None:
        raise refused
    planar = Folder(trial.out).read("planar.parquet")
    return Context(trial.keys, None, {"planar.parquet": planar})


def read_coordinates(context: Context) -> FloatArray:
    """Return (F, M, 3) coordinates of the planar table, m."""
    values = context.long("planar.parquet").values
    return np.stack([values[axis] for axis in "xyz"], axis=2)


def find_jumps(
    found: Sequence[Mapping[str, Any]], labels: Sequence[str], frames: int, contexts: Sequence[Context]
) -> tuple[BoolArray, FloatArray]:
    """Return which samples (F, M) jump, and the distance of each jump in the plane, m."""
    hit: BoolArray = np.zeros((frames, len(labels)), dtype=np.bool_)
    for jump in found:
        hit[jump["first_frame"] : jump["first_frame"] + jump["n_frames"], labels.index(jump["label"])] = True
    plain, jumped = (read_coordinates(context)[..., :2] for context in contexts)
    return hit, np.asarray(np.linalg.norm(jumped - plain, axis=2))


def run(context: Context, truth: FloatArray, labels: Sequence[str]) -> Run:
    """Run the stages after planarise and return the errors."""
    for stage in (SEGMENT, FIT_JOINTS, UKF_SMOOTH):
        outputs = stage.function(replace(context, settings=stage.settings()))
        made = {name: each for name, each in zip(stage.outputs, outputs, strict=True) if not isinstance(each, Document)}
        context = replace(context, inputs={**context.inputs, **made})
    states, markers = context.table("states.parquet"), context.long("markers.parquet")
    if not harness.has_true_segments(states):
        raise WrongSegments
    error = harness.stack_states(states) - truth
    error[..., 0] -= np.nanmedian(error[..., 0], axis=0)
    segments = context.table("segments.parquet")
    known = dict(zip(segments["marker"], segments["segment"], strict=True))
    used = np.zeros((len(markers.frames), len(labels)), dtype=np.bool_)
    used[:, [labels.index(label) for label in markers.labels]] = markers.values["used"]
    return Run(harness.rms(error[MARGIN:-MARGIN]), np.array([int(known[label]) for label in labels]), used)


def make_ratio_table(ratios: FloatArray) -> str:
    """Return quantiles of the ratios (trials, 3) of the errors."""
    rows = []
    for name, own in zip(NAMES, ratios.T, strict=True):
        rows.append([name, *harness.format_quantiles(own, ".3f"), f"{np.sum(own <= LIMIT)} of {len(own)}"])
    return harness.format_table(["", "median", "90th percentile", "largest", f"trials within {LIMIT:g}"], rows)


def main() -> None:
    """Measure all trials and publish the sections."""
    arguments = harness.make_parser(__doc__, parallel=True, trials=30, first=960_000).parse_args()
    every = harness.run_all(measure, range(arguments.first, arguments.first + arguments.trials), arguments.jobs)
    found: list[Result] = [each for each in every if each is not None]
    let_in, lost = (np.sum([getattr(each, name) for each in found], axis=0) for name in ("let_in", "lost"))
    share, trials = 100 * np.mean([each.share for each in found]), len(found)
    source = (
        f"{trials} trials of five repetitions, seeds from {arguments.first}, each run without and with {JUMPS} bursts "
        f"({share:.1f} % of all samples)"
    )
    samples = (
        "Trials in which some marker is assigned to another segment than without bursts: "
        f"{sum(each.moved for each in found)} of {trials}; to a wrong segment: {sum(each.wrong[1] for each in found)} "
        f"of {trials} with bursts, {sum(each.wrong[0] for each in found)} without. Of the samples on moving segments "
        f"that a burst displaces by more than 20 mm in the plane, {100 * let_in[0] / let_in[1]:.2f} % were used. Of "
        f"the other samples that are used without bursts, {100 * lost[0] / lost[1]:.2f} % were not used. Refused, or a "
        f"wrong number of segments: {len(every) - trials}."
    )
    sections = {
        "bursts": harness.describe_source(__file__, source),
        "bursts-ratios": make_ratio_table(np.array([each.jumped for each in found])),
        "bursts-missing": make_ratio_table(np.array([each.missing for each in found])),
        "bursts-samples": samples,
    }
    harness.publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
