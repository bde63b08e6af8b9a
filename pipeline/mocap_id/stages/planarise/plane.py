"""Function of the stage planarise: reads the recording, follows its base, and expresses it in the plane of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.kinematics import PlaneFit, fit_plane
from mocap_id.kinematics.base_motion import BaseMotion, find_base_motion, find_heel_lift
from mocap_id.kinematics.marker_faults import find_lone_markers
from mocap_id.kinematics.plane import find_feet
from mocap_id.plates import GRAVITY, PlateChoice, choose_plates, find_clock_offset, find_dropouts
from mocap_id.plates.direction import compare_courses
from mocap_id.plates.placement import find_standing_feet
from mocap_id.recording import PlateSamples, Recording, ThinnedFrames
from mocap_id.recording.marker_posture import Facing, find_facing, find_upright
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.planarise import PlanariseSettings
from mocap_id.stages.planarise.plate_registration import (
    FOLLOWS,
    PlateCheck,
    check_registration,
    describe_losses,
    describe_plates,
    doubt_units,
    judge_course,
)
from mocap_id.stages.planarise.used_part import (
    check_swaps,
    express_trajectories,
    list_bursts,
    read_recording,
    select_part,
)
from mocap_id.stages.planarise.wrenches import (
    UsedFrames,
    compute_ground_wrench,
    measure_lateral_cop,
    measure_seat,
    measure_sensors,
    place_board,
    read_board_plate,
)
from mocap_id.stages.trial_keys import BalanceBoard, get_recording
from mocap_id.store import LongTable, Table
from mocap_id.store.schemas import PLANAR, WRENCH


def planarise(context: Context) -> Outputs:
    """Return planar.parquet and wrench.parquet of a trial in the plane."""
    settings: PlanariseSettings = context.settings
    threshold, person = settings.cop_threshold_N, context.trial.protocol != "robot-joint"
    files, plates = get_recording(context.trial), context.trial.plates
    log, source = read_board_plate(files.forces, read_recording(files, settings))
    part = select_part(source, context.trial.window, settings.ignore)
    positions, swaps, swap_reasons = check_swaps(part, repair=settings.repair_swaps)
    part = replace(part, positions=positions)
    thinned = ThinnedFrames.of(part.positions, part.time, source.rate, source.plates)
    choice = choose_plates(source.plates, thinned.samples, thinned.positions, feet=plates.feet, seat=plates.seat)
    loaded = [source.plates[index] for index in (*choice.indices("feet"), *choice.indices("seat"))]
    clock = find_clock_offset(loaded, thinned.positions, thinned.time, thinned.rate, frame_s=1.0 / source.rate)
    if clock.offset_s:  # everything below, and every later stage, uses the corrected clock
        source = replace(source, plates=clock.correct(source.plates))
        thinned = ThinnedFrames.of(part.positions, part.time, source.rate, source.plates)
        choice = choose_plates(source.plates, thinned.samples, thinned.positions, feet=plates.feet, seat=plates.seat)
    samples = [recording.decimate(plate, part.time, source.rate) for plate in source.plates]
    base = find_base_motion(thinned.positions, thinned.time, thinned.rate)
    still = undo_in_frames(base, thinned)
    frame, faced, plane = _fit_frame(still, source, choice, settings)
    board = None
    if log is not None and not log.problem and isinstance(files.forces, BalanceBoard):
        board = place_board(files.forces, log, source, still, frame, faces=1.0 if settings.facing == "+x" else -1.0)
        source, frame = replace(source, plates=(board.plate,)), replace(frame, origin=board.origin)
        samples = [recording.decimate(board.plate, part.time, source.rate)]
        thinned = replace(thinned, samples=(recording.decimate(board.plate, thinned.time, thinned.rate),))
        still = undo_in_frames(base, thinned)
    used = UsedFrames(part.labels, part.positions, part.time, thinned, frame, base)
    external = measure_seat(used, samples, choice, settings.seat_zero)
    external += measure_sensors(used, context.trial.external, source)
    if base is not None:
        part = replace(part, positions=base.undo_positions(part.positions, part.time))
    if plane.lean:
        part = replace(part, positions=plane.straighten(part.positions, find_feet(still.positions)))
    thinned, samples = still, undo_in_samples(base, samples, part.time)
    feet = [source.plates[index] for index in choice.indices("feet")]
    assumptions = tuple(text for plate in feet for text in plate.assumptions)
    out = Findings(swap_reasons)
    points = express_trajectories(part, frame)
    visible = np.isfinite(points["x"])
    out.facts |= part.facts
    out.fact(
        plane={
            "yaw_deg": float(np.degrees(frame.yaw)),
            "planarity": plane.planarity,
            "lean_deg": float(np.degrees(plane.lean)),
            "origin_m": [float(value) for value in frame.origin],
            "facing": None if faced is None else {"rule": faced.rule, "displacement_m": abs(faced.displacement)},
        },
        bursts=list_bursts(part, points),
        missing_fraction=float(1.0 - visible.mean()),
        swaps=swaps,
    )
    describe_base(out, base, part.labels, frame)
    lift = find_heel_lift(thinned.positions, thinned.time, thinned.rate)
    out.fact(
        heel_lift=None
        if lift is None
        else {
            "marker": part.labels[lift.marker],
            "about": part.labels[lift.about],
            "height_m": lift.height,
            "turn_deg": float(np.degrees(lift.turn)),
            "time_s": lift.time,
        }
    )
    if plane.lean:
        lean = abs(float(np.degrees(plane.lean)))
        out.say(
            "plane-leans",
            f"the plane of motion leans sideways by {lean:.1f}°: the person moves at an angle to the vertical, or "
            "the cameras' vertical is wrong. Angles and lengths are measured in this plane, forces and moments in the "
            "vertical plane along it",
            lean,
            level="ok",
        )
    # notes about how the recording was read; they cast no doubt on the results
    out.reasons += part.list_oddities(assumptions)
    if part.proposed:
        out.say(
            "window-proposed",
            f"only {part.time[0]:g} to {part.time[-1]:g} s is used, the longest part in which some markers stay still "
            f"and others move (the recording runs from {part.source.time[0]:g} to {part.source.time[-1]:g} s); give "
            "`window:` to choose another part.",
            level="ok",
        )
    if person and faced is not None and not faced.sure:
        out.say(
            "facing-unsure",
            "the direction in which the subject faces does not follow from the motion, so x may point forwards instead "
            f"of backwards; if so, set `planarise: {{facing: {'+x' if settings.facing == '-x' else '-x'}}}`.",
            level="ok",
        )
    values = {**points, "visible": visible}
    planar = LongTable(PLANAR, part.frames, part.time, part.labels, values, out.facts, tuple(out.reasons))

    # wrench of the ground; frames with no load under a standing person do not count
    facts, reasons = describe_plates(source, thinned, choice, external, threshold)
    missing = np.zeros(len(part.time), np.bool_)
    if facts["mass_kg"] is not None:
        load = sum((samples[index].force[:, 2] for index in choice.indices("feet")), np.zeros(len(part.time)))
        tall = np.repeat(find_upright(thinned.positions)[0], thinned.step)[: len(part.time)]
        missing = find_dropouts(load, tall, part.source.rate, facts["mass_kg"] * GRAVITY)

    def mark_missing(each: Sequence[PlateSamples], dropped: BoolArray) -> tuple[PlateSamples, ...]:
        on_feet = choice.indices("feet")
        return tuple(replace(s, ok=s.ok & ~dropped) if k in on_feet else s for k, s in enumerate(each))

    thinned = replace(thinned, samples=mark_missing(thinned.samples, missing[:: thinned.step]))
    kept = mark_missing(samples, missing)
    wrench = compute_ground_wrench(part.time, kept, choice, frame, threshold) | external.columns
    course = None
    if person and feet and find_standing_feet(thinned.positions, find_upright(thinned.positions)[0], None, 2):
        vertical = sum((thinned.samples[index].force[:, 2] for index in choice.indices("feet")), external.vertical)
        course = compare_courses(np.asarray(vertical), thinned.positions, thinned.rate)
    check = PlateCheck({}, ())  # a balance board has no position in the file
    if board is None:
        loads = [thinned.samples[index] for index in choice.indices("feet")]
        others = [
            f"plate {plate.index} ({why})"
            for plate, use, why in zip(source.plates, choice.uses, choice.why, strict=True)
            if use not in ("feet", "seat")
        ]
        check = check_registration(
            feet,
            loads,
            thinned.positions,
            thinned.rate,
            person=person,
            yaw=frame.yaw,
            labels=part.labels,
            others=others,
            follows=course is not None and course.correlation >= FOLLOWS,
        )
        if not check.horizontal:
            wrench["Fx"] = np.full(len(part.time), np.nan)
        if check.unusable is not None:
            wrench["plate_ok"] = np.zeros(len(part.time), np.bool_)
    else:
        wrench["Fx"] = np.full(len(part.time), np.nan)
        facts, reasons = facts | {"board": board.facts}, (*reasons, *board.reasons)
    facts |= {"registration": check.facts, "clock": clock.facts()}
    facts["unusable"], facts["horizontal_measured"] = check.unusable, check.horizontal
    belonging = judge_course(course, source.files, files.forces)
    across = measure_lateral_cop(thinned.samples, frame, threshold)
    facts["plates"] = [plate | {"across_m": each} for plate, each in zip(facts["plates"], across, strict=True)]
    losses = describe_losses(feet, part.time, missing, clock.offset_s)
    # the lean of the plane may explain a force beside the feet
    beside = _HIGH_M * abs(np.sin(plane.lean))
    registered = [
        each
        for each in check.reasons
        if each.code != "plate-misplaced" or (each.value or 0.0) - beside > (each.limit or 0.0)
    ]
    reasons = (*doubt_units(assumptions), *reasons, *losses, *registered, *belonging, *external.reasons)
    return planar, Table(WRENCH, wrench, facts, reasons)


def _fit_frame(
    thinned: ThinnedFrames, source: Recording, choice: PlateChoice, settings: PlanariseSettings
) -> tuple[PlaneFrame, Facing | None, PlaneFit]:
    """Return the plane's frame, the facing that determined the direction of its x, and the fit of the plane.

    The facing is None if the configuration gives ``yaw_deg``.
    """
    lone = find_lone_markers(thinned.positions)
    fit = fit_plane(thinned.positions[:, ~lone] if lone.any() else thinned.positions)
    faced, yaw = None, fit.yaw
    if settings.yaw_deg is not None:
        yaw, fit = float(np.radians(settings.yaw_deg)), replace(fit, lean=0.0)
    else:
        faced = find_facing(thinned.positions, np.array([np.cos(yaw), np.sin(yaw)]))
        if faced.forwards != (settings.facing == "+x"):
            yaw += np.pi
    yaw = float(np.pi - (np.pi - yaw) % (2 * np.pi))  # in (-pi, pi]
    centres = [source.plates[index].centre for index in choice.indices("feet")]
    origin = next((centre for centre in centres if centre is not None), np.zeros(3))
    return PlaneFrame(yaw, origin), faced, fit


_LISTED = 5  # largest number of changes in the message; the facts contain all
_HIGH_M = 1.1  # largest height of the centre of mass


def undo_in_samples(base: BaseMotion | None, samples: Sequence[PlateSamples], time: FloatArray) -> list[PlateSamples]:
    """Return the plates' wrenches at ``time`` (F,), s, relative to a base that stands still.

    They are unchanged if ``base`` is None.
    """
    if base is None:
        return list(samples)
    moved = [base.undo_wrench(each.force, each.moment, time) for each in samples]
    return [replace(each, force=force, moment=moment) for each, (force, moment) in zip(samples, moved, strict=True)]


def undo_in_frames(base: BaseMotion | None, thinned: ThinnedFrames) -> ThinnedFrames:
    """Return thinned frames, expressed relative to a base that stands still; unchanged if ``base`` is None."""
    if base is None:
        return thinned
    positions = base.undo_positions(thinned.positions, thinned.time)
    return replace(thinned, positions=positions, samples=tuple(undo_in_samples(base, thinned.samples, thinned.time)))


def describe_base(out: Findings, base: BaseMotion | None, labels: Sequence[str], frame: PlaneFrame) -> None:
    """Add the fact ``base_motion`` and a reason if the base moved; ``base`` is the removed motion, None if it is fixed.

    ``frame`` is the plane's frame before the base moved.
    """
    if base is None:
        out.fact(base_motion=None)
        return
    axes = frame.axes[[0, 2], :2]
    stretches = [
        {
            "from_s": each.start,
            "to_s": each.end,
            "along_m": float(axes[0] @ each.shift),
            "across_m": float(axes[1] @ each.shift),
            "turn_deg": float(np.degrees(each.turn)),
            "misfit_m": each.misfit,
        }
        for each in base.stretches
    ]
    path = [
        {"time_s": float(time), "shift_m": pose[:2].tolist(), "turn_deg": float(np.degrees(pose[2]))}
        for time, pose in zip(base.knots, base.poses, strict=True)
    ]
    out.fact(
        base_motion={
            "stretches": stretches,
            "markers": [labels[marker] for marker in base.feet],
            "fixed_markers": [label for label, fixed in zip(labels, base.fixed, strict=True) if fixed],
            "centre_m": base.centre.tolist(),
            "path": path,
        }
    )
    changes = []
    for before, after in pairwise(base.stretches):
        shift = 1e2 * float(np.linalg.norm(after.shift - before.shift))
        turn = abs(float(np.degrees(after.turn - before.turn)))
        rotation = f" and rotated by {turn:.0f}°" if turn >= 1.0 else ""
        changes.append(f"by {shift:.1f} cm{rotation} between {before.end:.1f} and {after.start:.1f} s")
    rest = f"; and {len(changes) - _LISTED} more changes" if len(changes) > _LISTED else ""
    moved = f"the feet moved to another position: {'; '.join(changes[:_LISTED])}{rest}. "
    farthest, first = max(float(np.linalg.norm(each.shift)) for each in base.stretches), base.stretches[0]
    if base.rigid:
        out.say(
            "base-moved",
            f"{moved}This was corrected: markers, forces and moments are expressed relative to the feet. x, tauz and "
            f"the centre of pressure refer to the position of the feet from {first.start:.1f} to {first.end:.1f} s.",
            farthest,
            level="ok",
        )
        return
    out.say(
        "base-moved",
        f"{moved}They did not move together: their markers differ by "
        f"{1e3 * max(each.misfit for each in base.stretches):.0f} mm rms from a common motion. Only their mean "
        "displacement was corrected, so the joints are less exact: analyse each part alone with `window:`",
        farthest,
    )
