"""Function of the stage planarise for a trial in space: expresses the recording in the lab's axes with y up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id import recording
from mocap_id.anatomy.names import find_landmarks
from mocap_id.arrays import find_runs
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.kinematics import fit_plane
from mocap_id.plates.placement import find_standing_feet
from mocap_id.recording.marker_posture import find_upright, shows_standing
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.planarise import PlanariseSettings
from mocap_id.stages.planarise.plate_registration import check_registration, describe_losses, describe_plates
from mocap_id.stages.planarise.skeleton import read_upright
from mocap_id.stages.planarise.used_part import (
    choose_on_one_clock,
    express_trajectories,
    list_bursts,
    read_recording,
    select_part,
)
from mocap_id.stages.planarise.wrenches import ExternalWrenches, compute_ground_wrench_in_space, find_plates_centre
from mocap_id.stages.trial_keys import get_landmark_labels, get_recording
from mocap_id.store import LongTable, Table
from mocap_id.store.schemas import PLANAR, WRENCH
from mocap_id.verdict import Reason

_PLANAR = 0.01  # fraction of the motion out of the best vertical plane up to which a trial in the plane is sufficient


def planarise_in_space(context: Context) -> Outputs:
    """Return planar.parquet and wrench.parquet of a trial in space.

    The trial's frame has the lab's axes with y up: x is the file's first horizontal axis, z = x × y. A left arm is
    mirrored (z → -z).
    """
    settings: PlanariseSettings = context.settings
    files, free = get_recording(context.trial), context.trial.protocol == "free"
    side, inferred = context.trial.side, None
    notes: tuple[Reason, ...] = ()
    if files.skeleton is None:
        source = read_recording(files, settings)
    else:
        source, side, inferred, notes = read_upright(context.trial, settings)
    part = select_part(source, context.trial.window or (float(source.time[0]), float(source.time[-1])), settings.ignore)
    named = None if context.trial.side else find_landmarks(part.labels, get_landmark_labels(context.trial)).side
    left = (side or named) == "left"
    frame = PlaneFrame(0.0)
    points = express_trajectories(part, frame)
    if left:
        points["z"] = -points["z"]
    visible = np.isfinite(points["x"])
    source, thinned, choice, clock = choose_on_one_clock(source, part, feet=context.trial.plates.feet)
    feet = [source.plates[index] for index in choice.indices("feet")]
    planarity = fit_plane(thinned.positions).planarity
    out = Findings(part.list_oddities(feet))
    out.fact(
        space="3d",
        side="left" if left else "right",
        bursts=list_bursts(part, points),
        plane={"yaw_deg": 0.0, "planarity": planarity, "lean_deg": 0.0, "origin_m": [0.0, 0.0, 0.0], "facing": None},
        **part.facts,
        missing_fraction=float(1.0 - visible.mean()),
    )
    if free and planarity <= _PLANAR:
        out.say(
            "planar-motion",
            f"all markers move in one vertical plane ({100 * (1 - planarity):.1f} % of the motion): a trial with "
            "`space: plane` is sufficient, and also gives the dynamics of a person.",
            planarity,
            _PLANAR,
            "ok",
        )
    if inferred is not None:  # first and last time of the intervals with inferred positions, by joint
        stretches = {}
        for number, label in enumerate(source.labels):
            runs = find_runs(inferred[part.first : part.stop, number])
            if label in part.labels and runs:
                stretches[label] = [part.time[[run.start, run.stop - 1]].tolist() for run in runs]
        out.fact(skeleton={"inferred": stretches})
    out.reasons += notes
    values = {**points, "visible": visible}
    planar = LongTable(PLANAR, part.frames, part.time, part.labels, values, out.facts, tuple(out.reasons))

    # wrench of the ground; no result of a reach or curl needs the plates
    samples = [recording.decimate(each, part.time, source.rate) for each in source.plates]
    ground, threshold = Findings(), settings.cop_threshold_N
    describe_plates(ground, source, thinned, choice, ExternalWrenches(), threshold=threshold)
    columns = compute_ground_wrench_in_space(part.time, samples, choice, frame, threshold, mirrored=left)
    upright = find_upright(thinned.positions)[0]
    person = (
        shows_standing(thinned.positions, upright) and len(find_standing_feet(thinned.positions, upright, None, 2)) == 2
    )
    check = check_registration(
        feet,
        [thinned.samples[index] for index in choice.indices("feet")],
        thinned.positions,
        thinned.rate,
        person=person,
        yaw=None,
        labels=part.labels,
        others=choice.list_unused(source.plates),
    )
    ground.fact(
        clock=clock.facts(),
        centre_m=find_plates_centre(source.plates, choice, frame, mirrored=left),
        registration=check.facts,
        unusable=check.unusable,
    )
    if check.unusable is not None:
        columns["plate_ok"] = np.zeros(len(part.time), np.bool_)
    describe_losses(ground, feet, part.time, np.zeros(len(part.time), np.bool_), clock.offset_s)
    ground.reasons += check.reasons
    if not free:  # but an assumed unit stays a caution
        ground.reasons = [
            each if each.code == "plate-unit-assumed" else replace(each, level="ok") for each in ground.reasons
        ]
        if feet and not person:
            ground.say(
                "plate-unchecked",
                "the plates were not compared with the markers, because nobody stands on two feet with markers. Joint "
                "angles do not need the plates; the mass and the forces in the exports are as in the file",
                level="ok",
            )
    return planar, Table(WRENCH, columns, ground.facts, tuple(ground.reasons))
