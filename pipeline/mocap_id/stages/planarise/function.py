"""planarise: the recording → marker trajectories and the ground's wrench in the plane of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from mocap_id import recording
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry.plane import PlaneFrame
from mocap_id.kinematics import fit_plane, propose_window
from mocap_id.recording import PlateChoice, PlateSamples, Recording
from mocap_id.recording.posture import Facing, facing
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.marker_names import columns
from mocap_id.stages.planarise import PlanariseSettings, plate_losses, plate_registration, swapped
from mocap_id.stages.planarise.external_wrenches import Measured, Seen, measure_seat, measure_sensors
from mocap_id.store import Table
from mocap_id.store.schemas import PLANAR, WRENCH
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class _Part:
    """The frames and markers that are used: positions (F, M, 3) in the lab, m."""

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
    """Read the recording and express it in the plane of motion."""
    settings: PlanariseSettings = context.settings
    files = context.trial.recording
    source = recording.read(
        files.markers,
        files.forces,
        units=settings.units,
        vertical=settings.vertical,
        force_unit=settings.force_unit,
        moment_unit=settings.moment_unit,
    )
    part = _part(source, context.trial.window, settings.ignore)
    frames = source.frames[part.first : part.stop]
    swaps = swapped.check(
        part.positions, part.labels, frames, part.time, rate=source.rate, repairing=settings.repair_swaps
    )
    part = replace(part, positions=swaps.positions)
    samples = [recording.decimate(plate, part.time, source.rate) for plate in source.plates]
    choice = recording.choose_plates(
        source.plates,
        samples,
        part.positions,
        feet=context.trial.plates.feet,
        seat=context.trial.plates.seat,
    )
    frame, faced, planarity = _plane(part, source, choice, settings)
    doubted = tuple(text for index in choice.indexes("feet") for text in source.plates[index].assumptions)
    notes = _notes(part, doubted, None if context.trial.protocol == "robot-joint" else faced, settings)
    found = {"swaps": swaps.facts, **_planar_facts(part, frame, planarity, faced)}
    planar = Table(PLANAR, _trajectories(part, frame), found, (*swaps.reasons, *notes))
    seen = Seen(part.labels, part.positions, part.time, frame)
    external = measure_seat(seen, samples, choice, source.rate, settings.seat_zero)
    external += measure_sensors(seen, context.trial.external, source)
    facts, reasons = _wrench_facts(part, samples, choice, external, settings.cop_threshold_N)
    samples, lost = _without_dropouts(part, samples, choice, facts["mass_kg"])
    wrench = _wrench(part, samples, choice, frame, settings.cop_threshold_N).assign(**external.columns)
    placed = _placed(part, samples, choice, person=context.trial.protocol != "robot-joint")
    facts["registration"] = placed.facts
    for plate, across in zip(facts["plates"], _across(samples, frame, settings.cop_threshold_N), strict=True):
        plate["across_m"] = across
    return planar, Table(
        WRENCH, wrench, facts, (*_doubts(doubted), *reasons, *lost, *placed.reasons, *external.reasons)
    )


def _part(source: Recording, window: tuple[float, float] | None, ignore: Sequence[str]) -> _Part:
    """Cut out the window, configured or proposed, and the markers that are seen in it."""
    file = source.files[0]
    out = columns(source.labels, ignore, f"{file}: planarise: ignore")
    keep = [i for i in range(len(source.labels)) if i not in out]
    positions = source.positions[:, keep]
    if not np.isfinite(positions).any():
        raise RecordingError(
            f"{file}: no marker is seen in any of its {len(source.frames)} frames ({len(source.labels)} are declared); "
            "track and export the trial again"
        )
    if window is None:
        first, stop = propose_window(positions, source.rate)
    else:
        inside = np.flatnonzero((source.time >= window[0] - 1e-9) & (source.time <= window[1] + 1e-9))
        if inside.size < 2:
            raise ConfigError(
                f"{file}: window: [{window[0]:g}, {window[1]:g}] s holds fewer than two frames; "
                f"the recording runs from {source.time[0]:g} to {source.time[-1]:g} s"
            )
        first, stop = int(inside[0]), int(inside[-1]) + 1
    seen = np.flatnonzero(np.isfinite(positions[first:stop]).all(axis=2).any(axis=0))
    if not seen.size:
        span = f"{source.time[first]:g} to {source.time[stop - 1]:g} s"
        raise RecordingError(f"{file}: no marker is seen from {span}; choose another `window:`")
    labels = tuple(source.labels[keep[i]] for i in seen)
    proposed = window is None and (first, stop) != (0, len(source.frames))
    return _Part(source, first, stop, labels, positions[first:stop][:, seen], proposed)


def _plane(
    part: _Part, source: Recording, choice: PlateChoice, settings: PlanariseSettings
) -> tuple[PlaneFrame, Facing | None, float]:
    """The frame of the plane, how its sense was found, and how planar the motion is."""
    fit = fit_plane(part.positions)
    faced, yaw = None, fit.yaw
    if settings.yaw_deg is not None:
        yaw = float(np.radians(settings.yaw_deg))
    else:
        faced = facing(part.positions, np.array([np.cos(yaw), np.sin(yaw)]))
        if faced.forwards != (settings.facing == "+x"):
            yaw += np.pi
    yaw = float(np.pi - (np.pi - yaw) % (2 * np.pi))  # in (-pi, pi]
    centres = [source.plates[index].centre for index in choice.indexes("feet")]
    origin = next((centre for centre in centres if centre is not None), np.zeros(3))
    return PlaneFrame(yaw, origin), faced, fit.planarity


def _trajectories(part: _Part, frame: PlaneFrame) -> pd.DataFrame:
    """The long table, by frame, then marker; unseen samples are NaN."""
    count, markers = part.positions.shape[:2]
    local = frame.to_plane(part.positions).reshape(-1, 3)
    visible = np.isfinite(local).all(axis=1)
    local[~visible] = np.nan
    codes: IntArray = np.tile(np.arange(markers), count)
    return pd.DataFrame(
        {
            "frame": np.repeat(part.source.frames[part.first : part.stop], markers),
            "time": np.repeat(part.time, markers),
            "marker": pd.Categorical.from_codes(codes, categories=pd.Index(part.labels)),
            "x": local[:, 0],
            "y": local[:, 1],
            "z": local[:, 2],
            "visible": visible,
        }
    )


def _wrench(
    part: _Part, samples: Sequence[PlateSamples], choice: PlateChoice, frame: PlaneFrame, threshold: float
) -> pd.DataFrame:
    """The sum of the feet's plates at marker times, and every plate alone where there are several."""
    each = [frame.wrench_to_plane(plate.force, plate.moment) for plate in samples]
    feet = choice.indexes("feet")
    total = sum((each[index] for index in feet), np.zeros((len(part.time), 3)))
    ok = (
        np.logical_and.reduce([samples[index].ok for index in feet], axis=0) if feet else np.zeros(len(part.time), bool)
    )
    total = np.where(ok[:, None], total, np.nan)
    with np.errstate(invalid="ignore"):
        vertical = np.where(total[:, 1] > threshold, total[:, 1], np.nan)
    columns: dict[str, FloatArray | np.ndarray[Any, Any]] = {
        "time": part.time,
        "Fx": total[:, 0],
        "Fy": total[:, 1],
        "tauz": total[:, 2],
        "cop_x": total[:, 2] / vertical,
        "plate_ok": ok,
    }
    if len(each) > 1:
        for number, wrench in enumerate(each, start=1):
            columns |= {f"{name}_p{number}": wrench[:, i] for i, name in enumerate(("Fx", "Fy", "tauz"))}
    return pd.DataFrame(columns)


def _across(samples: Sequence[PlateSamples], frame: PlaneFrame, threshold: float) -> list[float | None]:
    """Where each plate is loaded along z, m: median centre of pressure; None where it hardly is."""
    found: list[float | None] = []
    for plate in samples:
        force = plate.force @ frame.axes.T
        moment = (plate.moment - np.cross(frame.origin, plate.force)) @ frame.axes.T
        loaded = plate.ok & (np.nan_to_num(force[:, 1]) > threshold)
        found.append(float(np.median(-moment[loaded, 0] / force[loaded, 1])) if loaded.any() else None)
    return found


def _planar_facts(part: _Part, frame: PlaneFrame, planarity: float, faced: Facing | None) -> dict[str, Any]:
    source = part.source
    return {
        "plane": {
            "yaw_deg": float(np.degrees(frame.yaw)),
            "planarity": planarity,
            "origin_m": [float(value) for value in frame.origin],
            "facing": None if faced is None else {"rule": faced.rule, "displacement_m": abs(faced.displacement)},
        },
        "window_s": [float(part.time[0]), float(part.time[-1])],
        "window_proposed": part.proposed,
        "rate_hz": source.rate,
        "missing_fraction": float(1.0 - np.isfinite(part.positions).all(axis=2).mean()),
        "vertical": source.vertical,
        "units": source.units,
        "format": source.format,
        "files": [file.name for file in source.files],
    }


def _wrench_facts(
    part: _Part, samples: Sequence[PlateSamples], choice: PlateChoice, external: Measured, threshold: float
) -> tuple[dict[str, Any], tuple[Reason, ...]]:
    """What the plates are used for, the mass that they show, and what is missing."""
    plates = part.source.plates
    feet = choice.indexes("feet")
    mass: float | None = None
    why: str | None = "the recording has no force plates"
    reasons: tuple[Reason, ...] = ()
    if feet:
        vertical = sum((samples[index].force[:, 2] for index in feet), np.zeros(len(part.time)))
        mass, why = recording.standing_mass(part.positions, part.source.rate, vertical + external.vertical)
    else:
        if plates:
            found = "; ".join(f"plate {plate.index}: {text}" for plate, text in zip(plates, choice.why, strict=True))
            why = f"none of the force plates carries the feet ({found})"
        advice = " If there is a MOT file, name it: `recording: {markers: …, forces: …}`."
        told = f"{why}: kinematics only, nothing dynamic can be identified."
        reasons = (Reason("no-plate", told + (advice if part.source.format == "TRC" and not plates else "")),)
    facts = {
        "plates": choice.facts(plates),
        "external": list(external.facts),
        "mass_kg": mass,
        "why": why,
        "analog_rate_hz": part.source.analog_rate,
        "cop_threshold_N": threshold,
    }
    return facts, reasons


def _without_dropouts(
    part: _Part, samples: Sequence[PlateSamples], choice: PlateChoice, mass: float | None
) -> tuple[list[PlateSamples], tuple[Reason, ...]]:
    """The feet's plates less the stretches in which they say nothing of who stands on them; what is lost."""
    feet = choice.indexes("feet")
    vertical = sum((samples[index].force[:, 2] for index in feet), np.zeros(len(part.time)))
    lost = plate_losses.without_signal(vertical, part.positions, part.source.rate, mass, recording.GRAVITY)
    kept = [replace(each, ok=each.ok & ~lost) if index in feet else each for index, each in enumerate(samples)]
    return kept, plate_losses.losses([part.source.plates[index] for index in feet], part.time, lost)


def _placed(
    part: _Part, samples: Sequence[PlateSamples], choice: PlateChoice, *, person: bool
) -> plate_registration.Checked:
    """Whether the feet's plates are where the file has them."""
    feet = choice.indexes("feet")
    plates, loads = [part.source.plates[index] for index in feet], [samples[index] for index in feet]
    return plate_registration.check(plates, loads, part.positions, part.source.rate, person=person)


def _doubts(assumptions: Sequence[str]) -> tuple[Reason, ...]:
    """Units that were assumed for the feet's plates: forces, mass and inertial parameters rest on them."""
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
    """What a reader should know about the reading, none of it a doubt about the results."""
    oddities = [oddity for oddity in part.source.oddities if oddity not in doubted]
    notes = [Reason("recording-oddity", f"{oddity}.", level="ok") for oddity in oddities]
    if part.proposed:
        notes.append(
            Reason(
                "window-proposed",
                f"only {part.time[0]:g} to {part.time[-1]:g} s is used, the longest part in which markers stay put "
                f"(the recording runs from {part.source.time[0]:g} to {part.source.time[-1]:g} s); give `window:` to "
                "choose another.",
                level="ok",
            )
        )
    if faced is not None and not faced.sure:
        notes.append(
            Reason(
                "facing-unsure",
                "the motion does not show which way the subject faces: x may point forwards instead of backwards; if "
                f"so, give `planarise: {{facing: {'+x' if settings.facing == '-x' else '-x'}}}`.",
                level="ok",
            )
        )
    return tuple(notes)
