"""Function of the stage planarise: reads the recording, follows its base, and expresses it in the plane of motion."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, IntArray, chunks, find_runs
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.kinematics.base_motion import BaseMotion, find_base_motion, find_heel_lift, propose_window
from mocap_id.kinematics.marker_faults import find_bursts, find_lone_markers, find_swaps, undo_swaps
from mocap_id.kinematics.plane import find_feet, fit_plane
from mocap_id.plates.choice import PlateChoice, choose_plates, compare_courses, find_dropouts
from mocap_id.plates.clock import ClockSearch, find_clock_offset
from mocap_id.plates.placement import find_standing_feet
from mocap_id.recording import Plate, PlateSamples, Recording, ThinnedFrames
from mocap_id.recording.sample_checks import describe_held, find_body_facing, find_upright
from mocap_id.stages.base import Context, Findings, Outputs, find_markers
from mocap_id.stages.planarise import PlanariseSettings, wrenches
from mocap_id.stages.trial_keys import BalanceBoard, Files, get_recording
from mocap_id.store import LongTable, Table
from mocap_id.store.provenance import PLANAR, WRENCH
from mocap_id.verdict import Reason

_LISTED = 5  # largest number of swaps, or of displacements of the feet, in a message; the facts contain all


@dataclass(frozen=True)
class UsedPart:
    """Frames and markers of a recording that are used."""

    source: Recording
    first: int  # index of the first frame
    stop: int  # index after the last frame
    labels: tuple[str, ...]
    positions: FloatArray  # (F, M, 3) in the lab, m
    proposed: bool  # whether the program chose the window

    @property
    def time(self) -> FloatArray:
        """(F,) times on the recording's clock, s."""
        return self.source.time[self.first : self.stop]

    @property
    def frames(self) -> IntArray:
        """(F,) frame numbers of the recording."""
        return self.source.frames[self.first : self.stop]

    @property
    def facts(self) -> dict[str, Any]:
        """Facts of planar.parquet about the recording and its window."""
        source = self.source
        return {
            "window_s": [float(self.time[0]), float(self.time[-1])],
            "window_proposed": self.proposed,
            "rate_hz": source.rate,
            "vertical": source.vertical,
            "units": source.units,
            "format": source.format,
            "files": [file.name for file in source.files],
        }

    def list_oddities(self, feet: Sequence[Plate]) -> list[Reason]:
        """Return reasons about the file, without assumptions about the feet's plates, which are cautions already."""
        doubted = {text for plate in feet for text in plate.assumptions}
        oddities = [oddity for oddity in self.source.oddities if oddity not in doubted]
        notes = [Reason("recording-oddity", f"{oddity}.", level="ok") for oddity in oddities]
        return [*notes, *describe_held(self.source.held, float(self.time[0]), float(self.time[-1]))]


def read_recording(files: Files, settings: PlanariseSettings) -> Recording:
    """Return the recording of a trial, read with the units and axes of its settings."""
    return recording.read(
        files.motion,
        None if isinstance(files.forces, BalanceBoard) else files.forces,
        units=settings.units,
        vertical=settings.vertical,
        force_unit=settings.force_unit,
        moment_unit=settings.moment_unit,
    )


def select_part(source: Recording, window: tuple[float, float] | None, ignore: Sequence[str]) -> UsedPart:
    """Return the frames of the window and the markers visible in it; if ``window`` is None, the program chooses it.

    ``window`` is the first and the last time, s. Raises RecordingError if no marker is visible, and ConfigError if the
    window has fewer than two frames.
    """
    file = source.files[0]
    out = find_markers((*source.labels, *source.left_out), ignore, f"{file}: planarise: ignore")
    keep = [i for i in range(len(source.labels)) if i not in out]
    people = [each for each in source.people if any(source.labels[i].startswith(each) for i in keep)]
    if len(people) > 1:
        others = ", ".join(f"'{each}*'" for each in people[1:])
        raise RecordingError(
            f"{file}: the recording shows {len(people)} people, whose labels begin with {', '.join(people)}; a trial "
            f"has one person: leave out the others, such as `planarise: {{ignore: [{others}]}}`"
        )
    visible = _find_visible(source.positions)[:, keep]
    if not visible.any():
        raise RecordingError(
            f"{file}: no marker is visible in any of its {len(source.frames)} frames ({len(source.labels)} labels); "
            "track and export the trial again"
        )
    if window is None:
        thinned = ThinnedFrames.of(source.positions, source.time, source.rate)
        first, stop = (thinned.step * k for k in propose_window(thinned.positions[:, keep], thinned.rate))
        stop = min(stop, len(source.frames))
    else:
        inside = np.flatnonzero((source.time >= window[0] - 1e-9) & (source.time <= window[1] + 1e-9))
        if inside.size < 2:
            raise ConfigError(
                f"{file}: window: [{window[0]:g}, {window[1]:g}] s has fewer than two frames; "
                f"the recording runs from {source.time[0]:g} to {source.time[-1]:g} s"
            )
        first, stop = int(inside[0]), int(inside[-1]) + 1
    kept = [keep[k] for k in np.flatnonzero(visible[first:stop].any(axis=0))]
    if not kept:
        span = f"{source.time[first]:g} to {source.time[stop - 1]:g} s"
        raise RecordingError(f"{file}: no marker is visible from {span}; choose another `window:`")
    labels = tuple(source.labels[marker] for marker in kept)
    proposed = window is None and (first, stop) != (0, len(source.frames))
    positions = source.positions[first:stop]
    return UsedPart(source, first, stop, labels, positions if labels == source.labels else positions[:, kept], proposed)


def _find_visible(positions: FloatArray) -> BoolArray:
    """Return whether each marker is visible in each frame, (F, M)."""
    return np.isfinite(positions[..., 0] + positions[..., 1] + positions[..., 2])


def express_trajectories(part: UsedPart, frame: PlaneFrame) -> dict[str, FloatArray]:
    """Return the coordinates x, y and z in the axes of the plane, by name, each (F, M), m; NaN if not visible."""
    x, y, z = (np.empty(part.positions.shape[:2]) for _ in range(3))
    for some in chunks(len(part.time)):
        local = frame.to_plane(part.positions[some])
        local[~_find_visible(local)] = np.nan
        x[some], y[some], z[some] = np.moveaxis(local, 2, 0)
    return {"x": x, "y": y, "z": z}


def list_bursts(part: UsedPart, points: Mapping[str, FloatArray]) -> dict[str, list[list[float]]]:
    """Return first and last time of every burst (a jump away and back), s, by the label of each marker that has one."""
    found = {}
    for marker, label in enumerate(part.labels):
        track = np.stack([values[:, marker] for values in points.values()], axis=1)
        out = find_bursts(track[:, None], part.source.rate)[:, 0]
        if out.any():
            found[label] = [part.time[[run.start, run.stop - 1]].tolist() for run in find_runs(out)]
    return found


def choose_on_one_clock(
    source: Recording, part: UsedPart, *, feet: Collection[int], seat: Collection[int] = ()
) -> tuple[Recording, ThinnedFrames, PlateChoice, ClockSearch]:
    """Return the use of every plate after the plates' clock is corrected, which everything later uses.

    ``feet`` and ``seat`` are as in :func:`mocap_id.plates.choice.choose_plates`.
    """

    def choose(plates: tuple[Plate, ...]) -> tuple[ThinnedFrames, PlateChoice]:
        thinned = ThinnedFrames.of(part.positions, part.time, source.rate, plates)
        return thinned, choose_plates(plates, thinned.samples, thinned.positions, feet=feet, seat=seat)

    thinned, choice = choose(source.plates)
    loaded = [source.plates[index] for index in (*choice.indices("feet"), *choice.indices("seat"))]
    clock = find_clock_offset(loaded, thinned.positions, thinned.time, thinned.rate, frame_s=1.0 / source.rate)
    if clock.offset_s:
        source = replace(
            source, plates=tuple(replace(plate, start=plate.start + clock.offset_s) for plate in source.plates)
        )
        thinned, choice = choose(source.plates)
    return source, thinned, choice, clock


_HIGH_M = 1.1  # largest height of the centre of mass


def planarise(context: Context) -> Outputs:
    """Return planar.parquet and wrench.parquet of a trial in the plane."""
    settings: PlanariseSettings = context.settings
    threshold, person = settings.cop_threshold_N, context.trial.protocol != "robot-joint"
    files, named = get_recording(context.trial), context.trial.plates
    out = Findings()
    log, source = wrenches.read_board_plate(files.forces, read_recording(files, settings))
    part = select_part(source, context.trial.window, settings.ignore)

    # markers that have each other's label for a while
    repair, swaps = settings.repair_swaps, find_swaps(part.positions, part.source.rate)
    swap_facts = [
        {
            "labels": [part.labels[swap.first], part.labels[swap.second]],
            "first_frame": int(part.frames[swap.start]),
            "last_frame": int(part.frames[swap.stop - 1]),
            "first_s": float(part.time[swap.start]),
            "last_s": float(part.time[swap.stop - 1]),
            "repaired": repair,
        }
        for swap in swaps
    ]
    if swaps:
        listed = "; ".join(
            f"{part.labels[swap.first]} and {part.labels[swap.second]} in frames {part.frames[swap.start]} to "
            f"{part.frames[swap.stop - 1]} ({part.time[swap.start]:.2f} to {part.time[swap.stop - 1]:.2f} s)"
            for swap in swaps[:_LISTED]
        )
        rest = f"; and {len(swaps) - _LISTED} more" if len(swaps) > _LISTED else ""
        times = "once" if len(swaps) == 1 else f"{len(swaps)} times"
        outcome = (
            "These frames were corrected in the results; the file was not changed."
            if repair
            else "Both markers are left out of the skeleton in these frames. To use them there, set "
            "`planarise: {repair_swaps: true}`, or relabel them and export the trial again."
        )
        message = f"two markers have each other's label {times}: {listed}{rest}. {outcome}"
        out.say("marker-swap", message, float(len(swaps)), level="ok" if repair else "caution")
        if repair:
            part = replace(part, positions=undo_swaps(part.positions, swaps))

    # use of the plates, and motion of the base, which everything later is relative to
    source, thinned, choice, clock = choose_on_one_clock(source, part, feet=named.feet, seat=named.seat)
    on_feet = choice.indices("feet")
    samples = [recording.decimate(plate, part.time, source.rate) for plate in source.plates]
    base = find_base_motion(thinned.positions, thinned.time, thinned.rate)
    still = undo_in_frames(base, thinned)

    # the plane's frame; the person faces the direction of its x that the settings give
    lone = find_lone_markers(still.positions)
    plane = fit_plane(still.positions[:, ~lone] if lone.any() else still.positions)
    faced, yaw = None, plane.yaw
    if settings.yaw_deg is not None:
        yaw, plane = float(np.radians(settings.yaw_deg)), replace(plane, lean=0.0)
    else:
        faced = find_body_facing(still.positions, np.array([np.cos(yaw), np.sin(yaw)]))
        if faced.forwards != (settings.facing == "+x"):
            yaw += np.pi
    yaw = float(np.pi - (np.pi - yaw) % (2 * np.pi))  # in (-pi, pi]
    centres = [source.plates[index].centre for index in on_feet]
    frame = PlaneFrame(yaw, next((centre for centre in centres if centre is not None), np.zeros(3)))

    board: dict[str, Any] | None = None
    board_reasons: tuple[Reason, ...] = ()
    if log is not None and not log.problem and isinstance(files.forces, BalanceBoard):
        faces = 1.0 if settings.facing == "+x" else -1.0
        plate, origin, board, board_reasons = wrenches.place_board(files.forces, log, source, still, frame, faces=faces)
        source, frame = replace(source, plates=(plate,)), replace(frame, origin=origin)
        samples = [recording.decimate(plate, part.time, source.rate)]
        thinned = replace(thinned, samples=(recording.decimate(plate, thinned.time, thinned.rate),))
        still = undo_in_frames(base, thinned)
    external = wrenches.ExternalWrenches()
    wrenches.measure_seat(external, choice, samples, thinned, frame, zero=settings.seat_zero, time=part.time, base=base)
    wrenches.measure_sensors(external, context.trial.external, part, thinned, frame, base)
    if base is not None:
        part = replace(part, positions=base.undo_positions(part.positions, part.time))
    if plane.lean:
        part = replace(part, positions=plane.straighten(part.positions, find_feet(still.positions)))
    thinned, samples = still, undo_in_samples(base, samples, part.time)
    feet = [source.plates[index] for index in on_feet]
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
        swaps=swap_facts,
        base_motion=None,
    )
    if base is not None:
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
                "markers": [part.labels[marker] for marker in base.feet],
                "fixed_markers": [label for label, fixed in zip(part.labels, base.fixed, strict=True) if fixed],
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
        outcome = (
            "This was corrected: markers, forces and moments are expressed relative to the feet. x, tauz and "
            f"the centre of pressure refer to the position of the feet from {first.start:.1f} to {first.end:.1f} s."
            if base.rigid
            else "They did not move together: their markers differ by "
            f"{1e3 * max(each.misfit for each in base.stretches):.0f} mm rms from a common motion. Only their mean "
            "displacement was corrected, so the joints are less exact: analyse each part alone with `window:`"
        )
        out.say("base-moved", moved + outcome, farthest, level="ok" if base.rigid else "caution")
    lift = find_heel_lift(thinned.positions, thinned.time, thinned.rate)
    out.fact(
        heel_lift=None
        if lift is None
        else {
            "marker": part.labels[lift[0]],
            "about": part.labels[lift[1]],
            "height_m": lift[2],
            "turn_deg": float(np.degrees(lift[3])),
            "time_s": lift[4],
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
    out.reasons += part.list_oddities(feet)
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
    ground = Findings()
    wrenches.describe_plates(ground, source, thinned, choice, external, threshold=threshold)
    missing, mass = np.zeros(len(part.time), np.bool_), ground.facts["mass_kg"]
    if mass is not None:
        load = sum((samples[index].force[:, 2] for index in on_feet), np.zeros(len(part.time)))
        tall = np.repeat(find_upright(thinned.positions)[0], thinned.step)[: len(part.time)]
        missing = find_dropouts(load, tall, part.source.rate, mass * GRAVITY)

    def mark_missing(each: Iterable[PlateSamples], dropped: BoolArray) -> tuple[PlateSamples, ...]:
        return tuple(replace(s, ok=s.ok & ~dropped) if k in on_feet else s for k, s in enumerate(each))

    thinned = replace(thinned, samples=mark_missing(thinned.samples, missing[:: thinned.step]))
    kept = mark_missing(samples, missing)
    wrench = wrenches.compute_ground_wrench(part.time, kept, choice, frame, threshold) | external.columns
    course = None
    if person and feet and find_standing_feet(thinned.positions, find_upright(thinned.positions)[0], None, 2):
        vertical = sum((thinned.samples[index].force[:, 2] for index in on_feet), external.vertical)
        course = compare_courses(np.asarray(vertical), thinned.positions, thinned.rate)
    check, unusable, horizontal = Findings(), None, True  # a balance board has no position in the file
    if board is None:
        check, unusable, horizontal = wrenches.check_registration(
            feet,
            [thinned.samples[index] for index in on_feet],
            thinned.positions,
            thinned.rate,
            person=person,
            yaw=frame.yaw,
            labels=part.labels,
            others=choice.list_unused(source.plates),
            follows=course is not None and course[0] >= wrenches.FOLLOWS,
        )
        if unusable is not None:
            wrench["plate_ok"] = np.zeros(len(part.time), np.bool_)
    else:
        ground.fact(board=board)
        ground.reasons += board_reasons
    if board is not None or not horizontal:
        wrench["Fx"] = np.full(len(part.time), np.nan)
    across: list[float | None] = []  # median centre of pressure of each plate along z, m; None if never loaded
    for each in thinned.samples:
        force = each.force @ frame.axes.T
        moment = (each.moment - np.cross(frame.origin, each.force)) @ frame.axes.T
        loaded = each.ok & (np.nan_to_num(force[:, 1]) > threshold)
        across.append(float(np.median(-moment[loaded, 0] / force[loaded, 1])) if loaded.any() else None)
    ground.fact(
        registration=check.facts,
        clock=clock.facts(),
        unusable=unusable,
        horizontal_measured=horizontal,
        plates=[plate | {"across_m": z} for plate, z in zip(ground.facts["plates"], across, strict=True)],
    )
    wrenches.describe_losses(ground, feet, part.time, missing, clock.offset_s)
    # the lean of the plane may explain a force beside the feet
    beside = _HIGH_M * abs(np.sin(plane.lean))
    ground.reasons += (
        each
        for each in check.reasons
        if each.code != "plate-misplaced" or (each.value or 0.0) - beside > (each.limit or 0.0)
    )
    ground.reasons += wrenches.judge_course(course, source.files, files.forces)
    return planar, Table(WRENCH, wrench, ground.facts, (*ground.reasons, *external.reasons))


def undo_in_samples(base: BaseMotion | None, samples: Sequence[PlateSamples], time: FloatArray) -> list[PlateSamples]:
    """Return the plates' wrenches at ``time`` (F,), s, relative to a base that stands still; None if it never moved."""
    if base is None:
        return list(samples)
    moved = [base.undo_wrench(each.force, each.moment, time) for each in samples]
    return [replace(each, force=force, moment=moment) for each, (force, moment) in zip(samples, moved, strict=True)]


def undo_in_frames(base: BaseMotion | None, thinned: ThinnedFrames) -> ThinnedFrames:
    """Return thinned frames, expressed relative to a base that stands still; None if it never moved."""
    if base is None:
        return thinned
    positions = base.undo_positions(thinned.positions, thinned.time)
    return replace(thinned, positions=positions, samples=tuple(undo_in_samples(base, thinned.samples, thinned.time)))
