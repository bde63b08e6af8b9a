"""Function of the stage planarise: reads the recording and expresses it in the plane of motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray, chunks, find_runs
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry.plane_frame import PlaneFrame
from mocap_id.kinematics import PlaneFit, find_bursts, fit_plane, propose_window
from mocap_id.kinematics.base_motion import find_base_motion
from mocap_id.kinematics.lone_markers import find_lone_markers
from mocap_id.kinematics.plane import find_feet
from mocap_id.plates import GRAVITY, PlateChoice, choose_plates, standing_mass
from mocap_id.plates.dropout import find_dropouts
from mocap_id.recording import PlateSamples, Recording, ThinnedFrames
from mocap_id.recording.marker_posture import Facing, facing, upright
from mocap_id.stages.base import Context, Files, Outputs
from mocap_id.stages.marker_names import marker_columns
from mocap_id.stages.planarise import (
    PlanariseSettings,
    label_swaps,
    moved_base,
    plate_losses,
    plate_registration,
)
from mocap_id.stages.planarise.external_wrenches import ExternalWrenches, UsedFrames, measure_seat, measure_sensors
from mocap_id.stages.planarise.ground_wrench import ground_wrench, lateral_pressure
from mocap_id.store import LongTable, Table
from mocap_id.store.schemas import PLANAR, WRENCH
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class _Part:
    """The frames and markers used: positions (F, M, 3) in the lab, m."""

    source: Recording
    first: int
    stop: int
    labels: tuple[str, ...]
    positions: FloatArray
    proposed: bool

    @property
    def time(self) -> FloatArray:
        return self.source.time[self.first : self.stop]


def planarise(context: Context) -> Outputs:
    """Return planar.parquet and wrench.parquet."""
    settings: PlanariseSettings = context.settings
    source = _read(context.trial.recording, settings)
    part = _part(source, context.trial.window, settings.ignore)
    frames = source.frames[part.first : part.stop]
    swaps = label_swaps.check(
        part.positions, part.labels, frames, part.time, rate=source.rate, repairing=settings.repair_swaps
    )
    part = replace(part, positions=swaps.positions)
    thinned = ThinnedFrames.of(part.positions, part.time, source.rate, source.plates)
    samples = [recording.decimate(plate, part.time, source.rate) for plate in source.plates]
    choice = choose_plates(
        source.plates,
        thinned.samples,
        thinned.positions,
        feet=context.trial.plates.feet,
        seat=context.trial.plates.seat,
    )
    base = find_base_motion(thinned.positions, thinned.time, thinned.rate)
    still = moved_base.undo_in_frames(base, thinned)
    frame, faced, plane = _plane(still, source, choice, settings)
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
    points = _trajectories(part, frame)
    visible = np.isfinite(points["x"])
    moved = moved_base.describe(base, thinned, part.labels, frame, plane)
    found = {
        "swaps": swaps.facts,
        "bursts": _bursts(part, points),
        **_planar_facts(part, frame, plane, faced),
        "missing_fraction": float(1.0 - visible.mean()),
        **moved.facts,
    }
    values = {**points, "visible": visible}
    planar = LongTable(PLANAR, frames, part.time, part.labels, values, found, (*swaps.reasons, *moved.reasons, *notes))
    facts, reasons = _wrench_facts(source, thinned, choice, external, settings.cop_threshold_N)
    lost = _dropouts(part, samples, thinned, choice, facts["mass_kg"])
    thinned = replace(thinned, samples=_without(thinned.samples, choice, lost[:: thinned.step]))
    kept = _without(samples, choice, lost)
    wrench = ground_wrench(part.time, kept, choice, frame, settings.cop_threshold_N) | external.columns
    placed = _placed(source, thinned, choice, person=context.trial.protocol != "robot-joint")
    facts["registration"] = placed.facts
    for plate, across in zip(
        facts["plates"], lateral_pressure(thinned.samples, frame, settings.cop_threshold_N), strict=True
    ):
        plate["across_m"] = across
    losses = plate_losses.losses([source.plates[index] for index in choice.indices("feet")], part.time, lost)
    registered = moved_base.without_lean(placed.reasons, plane)
    reasons = (*_doubts(doubted), *reasons, *losses, *registered, *external.reasons)
    return planar, Table(WRENCH, wrench, facts, reasons)


def _read(files: Files, settings: PlanariseSettings) -> Recording:
    return recording.read(
        files.markers,
        files.forces,
        units=settings.units,
        vertical=settings.vertical,
        force_unit=settings.force_unit,
        moment_unit=settings.moment_unit,
    )


def _part(source: Recording, window: tuple[float, float] | None, ignore: Sequence[str]) -> _Part:
    """Return the frames of the window, configured or proposed, and the markers visible in it."""
    file = source.files[0]
    out = marker_columns(source.labels, ignore, f"{file}: planarise: ignore")
    keep = [i for i in range(len(source.labels)) if i not in out]
    visible = _visible(source.positions)[:, keep]
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
    return _Part(source, first, stop, labels, positions if labels == source.labels else positions[:, kept], proposed)


def _visible(positions: FloatArray) -> BoolArray:
    """Return whether each marker is visible in each frame, (F, M)."""
    return np.isfinite(positions[..., 0] + positions[..., 1] + positions[..., 2])


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
        faced = facing(thinned.positions, np.array([np.cos(yaw), np.sin(yaw)]))
        if faced.forwards != (settings.facing == "+x"):
            yaw += np.pi
    yaw = float(np.pi - (np.pi - yaw) % (2 * np.pi))  # in (-pi, pi]
    centres = [source.plates[index].centre for index in choice.indices("feet")]
    origin = next((centre for centre in centres if centre is not None), np.zeros(3))
    return PlaneFrame(yaw, origin), faced, fit


def _trajectories(part: _Part, frame: PlaneFrame) -> dict[str, FloatArray]:
    """Return coordinates (F, M) in the plane, m; NaN where not visible."""
    x, y, z = (np.empty(part.positions.shape[:2]) for _ in range(3))
    for some in chunks(len(part.time)):
        local = frame.to_plane(part.positions[some])
        local[~_visible(local)] = np.nan
        x[some], y[some], z[some] = np.moveaxis(local, 2, 0)
    return {"x": x, "y": y, "z": z}


def _bursts(part: _Part, points: Mapping[str, FloatArray]) -> dict[str, list[list[float]]]:
    """Return first and last time, s, of every burst (a jump away and back), for the markers that have any."""
    found = {}
    for marker, label in enumerate(part.labels):
        track = np.stack([values[:, marker] for values in points.values()], axis=1)
        out = find_bursts(track[:, None], part.source.rate)[:, 0]
        if out.any():
            found[label] = [part.time[[run.start, run.stop - 1]].tolist() for run in find_runs(out)]
    return found


def _planar_facts(part: _Part, frame: PlaneFrame, fit: PlaneFit, faced: Facing | None) -> dict[str, Any]:
    source = part.source
    return {
        "plane": {
            "yaw_deg": float(np.degrees(frame.yaw)),
            "planarity": fit.planarity,
            "lean_deg": float(np.degrees(fit.lean)),
            "origin_m": [float(value) for value in frame.origin],
            "facing": None if faced is None else {"rule": faced.rule, "displacement_m": abs(faced.displacement)},
        },
        "window_s": [float(part.time[0]), float(part.time[-1])],
        "window_proposed": part.proposed,
        "rate_hz": source.rate,
        "vertical": source.vertical,
        "units": source.units,
        "format": source.format,
        "files": [file.name for file in source.files],
    }


def _wrench_facts(
    source: Recording, thinned: ThinnedFrames, choice: PlateChoice, external: ExternalWrenches, threshold: float
) -> tuple[dict[str, Any], tuple[Reason, ...]]:
    """Return the facts of wrench.parquet (use of the plates, standing mass) and a reason if no plate is usable."""
    plates = source.plates
    feet = choice.indices("feet")
    mass: float | None = None
    why: str | None = "the recording has no force plates"
    reasons: tuple[Reason, ...] = ()
    if feet:
        vertical = sum((thinned.samples[index].force[:, 2] for index in feet), np.zeros(len(thinned.time)))
        mass, why = standing_mass(thinned.positions, thinned.rate, vertical + external.vertical)
    else:
        if plates:
            found = "; ".join(f"plate {plate.index}: {text}" for plate, text in zip(plates, choice.why, strict=True))
            why = f"none of the force plates is under the feet ({found})"
        advice = " If there is a MOT file, name it: `recording: {markers: …, forces: …}`."
        message = f"{why}: only the kinematics can be identified."
        reasons = (Reason("no-plate", message + (advice if source.format == "TRC" and not plates else "")),)
    facts = {
        "plates": choice.facts(plates),
        "external": list(external.facts),
        "mass_kg": mass,
        "why": why,
        "analog_rate_hz": source.analog_rate,
        "cop_threshold_N": threshold,
    }
    return facts, reasons


def _dropouts(
    part: _Part, samples: Sequence[PlateSamples], thinned: ThinnedFrames, choice: PlateChoice, mass: float | None
) -> BoolArray:
    """Return frames (F,) in which the feet's plates show no load under a standing person; none without a known mass."""
    if mass is None:
        return np.zeros(len(part.time), np.bool_)
    vertical = sum((samples[index].force[:, 2] for index in choice.indices("feet")), np.zeros(len(part.time)))
    tall = np.repeat(upright(thinned.positions)[0], thinned.step)[: len(part.time)]
    return find_dropouts(vertical, tall, part.source.rate, mass * GRAVITY)


def _without(samples: Sequence[PlateSamples], choice: PlateChoice, lost: BoolArray) -> tuple[PlateSamples, ...]:
    """Return the plates' samples, with the lost samples of the feet's plates marked as unknown."""
    feet = choice.indices("feet")
    return tuple(replace(each, ok=each.ok & ~lost) if index in feet else each for index, each in enumerate(samples))


def _placed(
    source: Recording, thinned: ThinnedFrames, choice: PlateChoice, *, person: bool
) -> plate_registration.PlateCheck:
    """Check the positions of the feet's plates in the file."""
    feet = choice.indices("feet")
    plates, loads = [source.plates[index] for index in feet], [thinned.samples[index] for index in feet]
    return plate_registration.check(plates, loads, thinned.positions, thinned.rate, person=person)


def _doubts(assumptions: Sequence[str]) -> tuple[Reason, ...]:
    """Return a caution for each assumed unit of the feet's plates; all forces and masses depend on it."""
    return tuple(
        Reason(
            "plate-unit-assumed",
            f"{assumption}; if the unit is another, give `planarise: {{force_unit: …, moment_unit: …}}`.",
        )
        for assumption in assumptions
    )


def _notes(
    part: _Part, doubted: Sequence[str], faced: Facing | None, settings: PlanariseSettings
) -> tuple[Reason, ...]:
    """Return notes about reading the recording that cast no doubt on the results."""
    oddities = [oddity for oddity in part.source.oddities if oddity not in doubted]
    notes = [Reason("recording-oddity", f"{oddity}.", level="ok") for oddity in oddities]
    if part.proposed:
        notes.append(
            Reason(
                "window-proposed",
                f"only {part.time[0]:g} to {part.time[-1]:g} s is used, the longest part in which markers stay still "
                f"(the recording runs from {part.source.time[0]:g} to {part.source.time[-1]:g} s); give `window:` to "
                "choose another.",
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
