"""Errors of the joint states when markers jump, on simulated sit-to-stands.

Each trial is written as a C3D file twice, without and with jumps, and runs through the stages up to ``ukf-smooth``.
About six seconds per trial and core.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
class Result:
    jumped: FloatArray  # (3,) error of the worst joint with jumps, relative to the run without jumps
    missing: FloatArray  # (3,) the same where the samples that jump are missing
    moved: bool  # a marker is on another segment than without jumps
    wrong: list[bool]  # a marker is on a wrong segment, without and with jumps; a marker on no segment is not wrong
    let_in: tuple[int, int]  # displaced samples that were used, and all displaced samples
    lost: tuple[int, int]  # other samples that were not used, and all other samples
    share: float  # of the samples that jump


def measure(seed: int) -> Result | None:
    """Simulate and run a trial without and with jumps, and return its comparison; return None if a run fails."""
    contexts = []
    with harness.temporary_folder() as place:
        for jumps in (0, JUMPS):
            configuration = simulate("sit-to-stand", place / str(jumps), replace(USUAL, seed=seed, jumps=jumps))
            trial = load(configuration)
            if (refused := run_stage(trial, "planarise").refused) is not None:
                raise refused
            planar = Folder(trial.out).read("planar.parquet")
            contexts.append(Context(trial.keys, None, {"planar.parquet": planar}))
        document = harness.read_truth(configuration)
        with np.load(configuration.with_name("truth.npz")) as arrays:
            truth = np.stack([arrays[name].astype(np.float64) for name in ("q", "qd", "qdd")], axis=2)
    labels = list(document["assignment"])
    hit: BoolArray = np.zeros((len(truth), len(labels)), dtype=np.bool_)  # samples that jump
    for jump in document["jumps"]:
        hit[jump["first_frame"] : jump["first_frame"] + jump["n_frames"], labels.index(jump["label"])] = True
    tables = [context.long("planar.parquet") for context in contexts]
    plain, jumped = (np.stack([table.values[axis] for axis in "xy"], axis=2) for table in tables)
    off = np.linalg.norm(jumped - plain, axis=2)  # (F, M) distance of each jump in the plane, m
    contexts.append(replace(contexts[0], inputs={"planar.parquet": harness.hide_samples(tables[0], hit)}))
    try:
        runs = [run(context, truth, labels) for context in contexts]
    except Refused:
        return None
    if any(each is None for each in runs):
        return None
    errors, segments, used = zip(*runs, strict=True)
    true = np.array([document["assignment"][label] for label in labels])
    moving, seen = true > 0, np.isfinite(jumped[..., 0])
    bad, good = hit & seen & moving & (off > LEAST), seen & moving & ~hit & used[0]
    return Result(
        (errors[1] / errors[0]).max(axis=0),
        (errors[2] / errors[0]).max(axis=0),
        bool((segments[1] != segments[0]).any()),
        [bool(((each >= 0) & (each != true)).any()) for each in segments[:2]],
        (int((bad & used[1]).sum()), int(bad.sum())),
        (int((good & ~used[1]).sum()), int(good.sum())),
        float(hit.mean()),
    )


def run(context: Context, truth: FloatArray, labels: Sequence[str]) -> tuple[FloatArray, IntArray, BoolArray] | None:
    """Run the stages after planarise; return None if the number of segments is wrong.

    Otherwise return rms errors (n, 3) of the states, the segment (M,) of every marker, and which samples (F, M) were
    used.
    """
    for stage in (SEGMENT, FIT_JOINTS, UKF_SMOOTH):
        outputs = stage.function(replace(context, settings=stage.settings()))
        made = {name: each for name, each in zip(stage.outputs, outputs, strict=True) if not isinstance(each, Document)}
        context = replace(context, inputs={**context.inputs, **made})
    states, markers = context.table("states.parquet"), context.long("markers.parquet")
    if not harness.has_true_segments(states):
        return None
    error = harness.stack_states(states) - truth
    error[..., 0] -= np.nanmedian(error[..., 0], axis=0)
    segments = context.table("segments.parquet")
    known = dict(zip(segments["marker"], segments["segment"], strict=True))
    used = np.zeros((len(markers.frames), len(labels)), dtype=np.bool_)
    used[:, [labels.index(label) for label in markers.labels]] = markers.values["used"]
    return harness.rms(error[MARGIN:-MARGIN]), np.array([int(known[label]) for label in labels]), used


def make_ratio_table(ratios: FloatArray) -> str:
    rows = []
    for name, own in zip(NAMES, ratios.T, strict=True):
        rows.append([name, *harness.format_quantiles(own, ".3f"), f"{np.sum(own <= LIMIT)} of {len(own)}"])
    return harness.format_table(["", "median", "90th percentile", "largest", f"trials within {LIMIT:g}"], rows)


def main() -> None:
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
