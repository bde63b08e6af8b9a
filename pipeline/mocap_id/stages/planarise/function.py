"""Function of the stage planarise: reads the recording and expresses it in the plane of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray
from mocap_id.geometry.plane_frame import PlaneFrame
from mocap_id.kinematics import PlaneFit, fit_plane
from mocap_id.kinematics.base_motion import find_base_motion
from mocap_id.kinematics.lone_markers import find_lone_markers
from mocap_id.kinematics.plane import find_feet
from mocap_id.plates import GRAVITY, PlateChoice, choose_plates, find_dropouts
from mocap_id.recording import BoardLog, PlateSamples, Recording, ThinnedFrames
from mocap_id.recording.marker_posture import Facing, find_facing, find_upright
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.planarise import (
    PlanariseSettings,
    label_swaps,
    moved_base,
    plate_losses,
    plate_registration,
)
from mocap_id.stages.planarise.balance_board import PlacedBoard, place_board, read_board_plate
from mocap_id.stages.planarise.external_wrenches import UsedFrames, measure_seat, measure_sensors
from mocap_id.stages.planarise.ground_wrench import ground_wrench, lateral_pressure
from mocap_id.stages.planarise.plate_facts import unit_doubts, wrench_facts
from mocap_id.stages.planarise.used_part import UsedPart, bursts, read_recording, trajectories, used_part
from mocap_id.stages.trial_keys import BalanceBoard, get_recording
from mocap_id.store import LongTable, Table
from mocap_id.store.schemas import PLANAR, WRENCH
from mocap_id.verdict import Reason


def planarise(context: Context) -> Outputs:
    """Return planar.parquet and wrench.parquet."""
    settings: PlanariseSettings = context.settings
    log, source = _read(context)
    part = used_part(source, context.trial.window, settings.ignore)
    frames = source.frames[part.first : part.stop]
    swaps = label_swaps.check(
        part.positions, part.labels, frames, part.time, rate=source.rate, repairing=settings.repair_swaps
    )
    part = replace(part, positions=swaps.positions)
    thinned = ThinnedFrames.of(part.positions, part.time, source.rate, source.plates)
    samples = [recording.decimate(plate, part.time, source.rate) for plate in source.plates]
    choice = _choice(context, source, thinned)
    base = find_base_motion(thinned.positions, thinned.time, thinned.rate)
    still = moved_base.undo_in_frames(base, thinned)
    frame, faced, plane = _plane(still, source, choice, settings)
    board = None
    if log is not None:
        board, source, frame = _on_board(context, log, source, still, frame)
        samples = [recording.decimate(board.plate, part.time, source.rate)]
        thinned = replace(thinned, samples=(recording.decimate(board.plate, thinned.time, thinned.rate),))
        still = moved_base.undo_in_frames(base, thinned)
    used = UsedFrames(part.labels, part.positions, part.time, thinned, frame, base)
    external = measure_seat(used, samples, choice, settings.seat_zero)
    external += measure_sensors(used, context.trial.external, source)
    if base is not None:
        part = replace(part, positions=base.undo_positions(part.positions, part.time))
    if plane.lean:
        part = replace(part, positions=plane.straighten(part.positions, find_feet(still.positions)))
    thinned, samples = still, moved_base.undo_in_samples(base, samples, part.time)
    doubted = tuple(text for index in choice.indices("feet") for text in source.plates[index].assumptions)
    notes = _notes(part, doubted, None if context.trial.protocol == "robot-joint" else faced, settings)
    points = trajectories(part, frame)
    visible = np.isfinite(points["x"])
    moved = moved_base.describe(base, thinned, part.labels, frame, plane)
    found = {
        "swaps": swaps.facts,
        "bursts": bursts(part, points),
        **_planar_facts(part, frame, plane, faced),
        "missing_fraction": float(1.0 - visible.mean()),
        **moved.facts,
    }
    values = {**points, "visible": visible}
    planar = LongTable(PLANAR, frames, part.time, part.labels, values, found, (*swaps.reasons, *moved.reasons, *notes))
    facts, reasons = wrench_facts(source, thinned, choice, external, settings.cop_threshold_N)
    lost = _dropouts(part, samples, thinned, choice, facts["mass_kg"])
    thinned = replace(thinned, samples=_without(thinned.samples, choice, lost[:: thinned.step]))
    kept = _without(samples, choice, lost)
    wrench = ground_wrench(part.time, kept, choice, frame, settings.cop_threshold_N) | external.columns
    if board is not None:
        wrench["Fx"] = np.full(len(part.time), np.nan)
        facts, reasons = facts | {"board": board.facts}, (*reasons, *board.reasons)
    placed = _placed(source, thinned, choice, board, person=context.trial.protocol != "robot-joint")
    facts["registration"] = placed.facts
    across = lateral_pressure(thinned.samples, frame, settings.cop_threshold_N)
    facts["plates"] = [plate | {"across_m": each} for plate, each in zip(facts["plates"], across, strict=True)]
    losses = plate_losses.losses([source.plates[index] for index in choice.indices("feet")], part.time, lost)
    registered = moved_base.without_lean(placed.reasons, plane)
    reasons = (*unit_doubts(doubted), *reasons, *losses, *registered, *external.reasons)
    return planar, Table(WRENCH, wrench, facts, reasons)


def _read(context: Context) -> tuple[BoardLog | None, Recording]:
    """Return the log of a balance board, if any, and the recording."""
    files = get_recording(context.trial)
    return read_board_plate(files.forces, read_recording(files, context.settings))


def _choice(context: Context, source: Recording, thinned: ThinnedFrames) -> PlateChoice:
    """Return the use of every plate."""
    plates = context.trial.plates
    return choose_plates(source.plates, thinned.samples, thinned.positions, feet=plates.feet, seat=plates.seat)


def _on_board(
    context: Context, log: BoardLog, source: Recording, thinned: ThinnedFrames, frame: PlaneFrame
) -> tuple[PlacedBoard, Recording, PlaneFrame]:
    """Return the balance board in the laboratory, the recording with it, and the plane with its origin at its cells."""
    forces = get_recording(context.trial).forces
    assert isinstance(forces, BalanceBoard)
    faces = 1.0 if context.settings.facing == "+x" else -1.0
    board = place_board(forces, log, source, thinned, frame, faces=faces)
    return board, replace(source, plates=(board.plate,)), replace(frame, origin=board.origin)


def _plane(
    thinned: ThinnedFrames, source: Recording, choice: PlateChoice, settings: PlanariseSettings
) -> tuple[PlaneFrame, Facing | None, PlaneFit]:
    """Return the plane's frame, the facing that determined the direction of its x, and the fit of the motion."""
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


def _planar_facts(part: UsedPart, frame: PlaneFrame, fit: PlaneFit, faced: Facing | None) -> dict[str, Any]:
    return {
        "plane": {
            "yaw_deg": float(np.degrees(frame.yaw)),
            "planarity": fit.planarity,
            "lean_deg": float(np.degrees(fit.lean)),
            "origin_m": [float(value) for value in frame.origin],
            "facing": None if faced is None else {"rule": faced.rule, "displacement_m": abs(faced.displacement)},
        },
        **part.facts,
    }


def _dropouts(
    part: UsedPart, samples: Sequence[PlateSamples], thinned: ThinnedFrames, choice: PlateChoice, mass: float | None
) -> BoolArray:
    """Return frames (F,) in which the feet's plates show no load under a standing person; none without a known mass."""
    if mass is None:
        return np.zeros(len(part.time), np.bool_)
    vertical = sum((samples[index].force[:, 2] for index in choice.indices("feet")), np.zeros(len(part.time)))
    tall = np.repeat(find_upright(thinned.positions)[0], thinned.step)[: len(part.time)]
    return find_dropouts(vertical, tall, part.source.rate, mass * GRAVITY)


def _without(samples: Sequence[PlateSamples], choice: PlateChoice, lost: BoolArray) -> tuple[PlateSamples, ...]:
    """Return the plates' samples, with the lost samples of the feet's plates marked as unknown."""
    feet = choice.indices("feet")
    return tuple(replace(each, ok=each.ok & ~lost) if index in feet else each for index, each in enumerate(samples))


def _placed(
    source: Recording, thinned: ThinnedFrames, choice: PlateChoice, board: PlacedBoard | None, *, person: bool
) -> plate_registration.PlateCheck:
    """Check the positions of the feet's plates in the file; a board has none."""
    if board is not None:
        return plate_registration.PlateCheck({}, ())
    feet = choice.indices("feet")
    plates, loads = [source.plates[index] for index in feet], [thinned.samples[index] for index in feet]
    return plate_registration.check(plates, loads, thinned.positions, thinned.rate, person=person)


def _notes(
    part: UsedPart, doubted: Sequence[str], faced: Facing | None, settings: PlanariseSettings
) -> tuple[Reason, ...]:
    """Return notes about reading the recording that cast no doubt on the results."""
    notes = part.oddities(doubted)
    if part.proposed:
        notes.append(
            Reason(
                "window-proposed",
                f"only {part.time[0]:g} to {part.time[-1]:g} s is used, the longest part in which some markers stay "
                f"still and others move (the recording runs from {part.source.time[0]:g} to {part.source.time[-1]:g} "
                "s); give `window:` to choose another.",
                level="ok",
            )
        )
    if faced is not None and not faced.sure:
        notes.append(
            Reason(
                "facing-unsure",
                "the motion does not show which way the subject faces, so x may point forwards instead of backwards; "
                f"in that case set `planarise: {{facing: {'+x' if settings.facing == '-x' else '-x'}}}`.",
                level="ok",
            )
        )
    return tuple(notes)
