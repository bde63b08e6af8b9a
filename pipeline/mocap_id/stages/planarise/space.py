"""Function of the stage planarise for a trial in space: expresses the recording in the lab's axes with y up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id import recording
from mocap_id.anatomy.names import find_landmarks
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.kinematics import fit_plane
from mocap_id.plates import choose_plates, find_clock_offset
from mocap_id.plates.placement import find_standing_feet
from mocap_id.recording import ThinnedFrames
from mocap_id.recording.marker_posture import find_upright, shows_standing
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.planarise import PlanariseSettings
from mocap_id.stages.planarise.plate_registration import (
    check_registration,
    describe_losses,
    describe_plates,
    doubt_units,
)
from mocap_id.stages.planarise.skeleton import read_upright
from mocap_id.stages.planarise.used_part import express_trajectories, list_bursts, read_recording, select_part
from mocap_id.stages.planarise.wrenches import ExternalWrenches, compute_ground_wrench_in_space, find_plates_centre
from mocap_id.stages.trial_keys import get_landmark_labels, get_recording
from mocap_id.store import LongTable, Table
from mocap_id.store.schemas import PLANAR, WRENCH
from mocap_id.verdict import Reason

_UNCHECKED = Reason(
    "plate-unchecked",
    "the plates were not compared with the markers, because nobody stands on two feet with markers. Joint angles do "
    "not need the plates; the mass and the forces in the exports are as in the file",
    level="ok",
)

_PLANAR = 0.01  # fraction of the motion out of the best vertical plane up to which a trial in the plane is sufficient


def planarise_in_space(context: Context) -> Outputs:
    """Return planar.parquet and wrench.parquet of a trial in space.

    The trial's frame has the lab's axes with y up: x is the file's first horizontal axis, z = x × y. A left arm is
    mirrored (z → -z).
    """
    settings: PlanariseSettings = context.settings
    files = get_recording(context.trial)
    skeleton = None if files.skeleton is None else read_upright(context.trial, settings)
    source = read_recording(files, settings) if skeleton is None else skeleton.recording
    window = context.trial.window or (float(source.time[0]), float(source.time[-1]))
    part = select_part(source, window, settings.ignore)
    free = context.trial.protocol == "free"
    side = context.trial.side or find_landmarks(part.labels, get_landmark_labels(context.trial)).side
    if skeleton is not None:
        side = skeleton.side
    left = side == "left"
    frame = PlaneFrame(0.0)
    points = express_trajectories(part, frame)
    if left:
        points["z"] = -points["z"]
    visible = np.isfinite(points["x"])
    thinned = ThinnedFrames.of(part.positions, part.time, source.rate, source.plates)
    planarity = fit_plane(thinned.positions).planarity
    planar_facts = {
        "space": "3d",
        "side": "left" if left else "right",
        "bursts": list_bursts(part, points),
        "plane": {"yaw_deg": 0.0, "planarity": planarity, "lean_deg": 0.0, "origin_m": [0.0, 0.0, 0.0], "facing": None},
        **part.facts,
        "missing_fraction": float(1.0 - visible.mean()),
        **({} if skeleton is None else {"skeleton": skeleton.facts(part.labels, part.first, part.stop)}),
    }
    named = context.trial.plates.feet
    choice = choose_plates(source.plates, thinned.samples, thinned.positions, feet=named, seat=())
    loaded = [source.plates[index] for index in (*choice.indices("feet"), *choice.indices("seat"))]
    clock = find_clock_offset(loaded, thinned.positions, thinned.time, thinned.rate, frame_s=1.0 / source.rate)
    if clock.offset_s:
        source = replace(source, plates=clock.correct(source.plates))
        thinned = ThinnedFrames.of(part.positions, part.time, source.rate, source.plates)
        choice = choose_plates(source.plates, thinned.samples, thinned.positions, feet=named, seat=())
    assumptions = tuple(text for index in choice.indices("feet") for text in source.plates[index].assumptions)
    notes = (*part.list_oddities(assumptions), *(_describe_planar_motion(planarity) if free else ()))
    notes += () if skeleton is None else skeleton.reasons
    planar = LongTable(PLANAR, part.frames, part.time, part.labels, {**points, "visible": visible}, planar_facts, notes)
    samples = [recording.decimate(plate, part.time, source.rate) for plate in source.plates]
    facts, reasons = describe_plates(source, thinned, choice, ExternalWrenches(), settings.cop_threshold_N)
    threshold = settings.cop_threshold_N
    columns = compute_ground_wrench_in_space(part.time, samples, choice, frame, threshold, mirrored=left)
    facts["clock"] = clock.facts()
    facts["centre_m"] = find_plates_centre(source.plates, choice, frame, mirrored=left)
    feet = [source.plates[index] for index in choice.indices("feet")]
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
        others=[
            f"plate {plate.index} ({why})"
            for plate, use, why in zip(source.plates, choice.uses, choice.why, strict=True)
            if use not in ("feet", "seat")
        ],
    )
    facts |= {"registration": check.facts, "unusable": check.unusable}
    if check.unusable is not None:
        columns["plate_ok"] = np.zeros(len(part.time), np.bool_)
    losses = describe_losses(feet, part.time, np.zeros(len(part.time), np.bool_), clock.offset_s)
    reasons = (*reasons, *losses, *check.reasons)
    if not free:  # no result of a reach or curl needs the plates
        reasons = tuple(replace(each, level="ok") for each in reasons)
        reasons += () if person or not feet else (_UNCHECKED,)
    return planar, Table(WRENCH, columns, facts, (*doubt_units(assumptions), *reasons))


def _describe_planar_motion(planarity: float) -> tuple[Reason, ...]:
    """Return a note if all markers move in one vertical plane, or else an empty tuple."""
    if planarity > _PLANAR:
        return ()
    return (
        Reason(
            "planar-motion",
            f"all markers move in one vertical plane ({100 * (1 - planarity):.1f} % of the motion): a trial with "
            "`space: plane` is sufficient, and also gives the dynamics of a person.",
            planarity,
            _PLANAR,
            level="ok",
        ),
    )
