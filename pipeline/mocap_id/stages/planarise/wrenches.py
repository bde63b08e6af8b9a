"""Wrenches on the body: of the ground (plates or a balance board), of a chair on its plate, and of force sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray, find_complete_rows
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.kinematics.base_motion import BaseMotion
from mocap_id.kinematics.plane import find_feet
from mocap_id.plates.choice import PlateChoice, ZeroRule, find_contradictions, measure_empty_chair
from mocap_id.recording import CELLS_BELOW_SURFACE_M, BoardLog, Plate, PlateSamples, Recording, ThinnedFrames
from mocap_id.recording.held_samples import describe_held
from mocap_id.stages.base import Findings
from mocap_id.stages.marker_names import find_markers
from mocap_id.stages.trial_keys import BalanceBoard, ExternalForce
from mocap_id.verdict import Reason

COMPONENTS = ("Fx", "Fy", "tauz")
"""Components of a wrench in the plane."""

_IN_SPACE = ("Fx", "Fy", "Fz", "taux", "tauy", "tauz")
_MIRROR = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])  # of a wrench, for z → -z: moments are axial vectors


@dataclass
class ExternalWrenches:
    """External wrenches at the F frames, for wrench.parquet; they are added one after another."""

    columns: dict[str, FloatArray] = field(default_factory=dict)  # (F,) by name
    facts: list[dict[str, Any]] = field(default_factory=list)  # fact ``external``
    reasons: list[Reason] = field(default_factory=list)
    vertical: FloatArray | float = 0.0  # upward force at the thinned frames, N

    def add(self, name: str, suffix: str, wrench: FloatArray, **fact: Any) -> None:
        """Add a wrench (F, 3) in the plane, the suffix of its columns, and the rest of its fact."""
        self.columns |= {f"{each}_{suffix}": column for each, column in zip(COMPONENTS, wrench.T.copy(), strict=True)}
        self.facts.append({"name": name, "columns": suffix, **fact})


@dataclass(frozen=True)
class UsedFrames:
    """Frames that are used, with the plane and the motion of the base."""

    labels: Sequence[str]  # M names
    positions: FloatArray  # (F, M, 3) in the lab, m
    time: FloatArray  # (F,) s
    thinned: ThinnedFrames
    frame: PlaneFrame
    base: BaseMotion | None = None  # None if the base is fixed


def add_wrenches(
    samples: Sequence[PlateSamples], plates: Sequence[int], frame: PlaneFrame
) -> tuple[FloatArray, BoolArray]:
    """Return the sum of the wrenches of ``plates`` in the plane (F, 3), and the samples (F,) in which all are valid."""
    each = [frame.wrench_to_plane(samples[index].force, samples[index].moment) for index in plates]
    return sum(each[1:], each[0]), np.logical_and.reduce([samples[index].ok for index in plates], axis=0)


def measure_seat(
    external: ExternalWrenches, used: UsedFrames, samples: Sequence[PlateSamples], choice: PlateChoice, zero: ZeroRule
) -> None:
    """Add the chair's wrench on the body, measured by the plates under the chair; no columns if there are none."""
    thinned = used.thinned
    doubts = find_contradictions(thinned.samples, choice, thinned.positions)
    for index, why in doubts.items():
        advice = "it looks like a chair's, but was added to the feet's; if a chair stands on it, name it under `seat:`"
        if choice.uses[index] == "seat":
            advice = (
                "a chair does not do this; its wrench was left out. Are they swapped in `plates: {feet: …, seat: …}`?"
            )
        text = f"plate {index + 1}, named under `{choice.uses[index]}:`, {why}: {advice}"
        external.reasons.append(Reason("plates-doubtful", text))
    plates = [index for index in choice.indices("seat") if index not in doubts]
    if not plates:
        return
    wrench, ok = add_wrenches(samples, plates, used.frame)
    reading, spread = measure_empty_chair(
        *add_wrenches(thinned.samples, plates, used.frame), thinned.positions, thinned.rate, zero
    )
    if reading is None:
        text = (
            "the person never stands in these frames, so the reading of the empty chair's plate is not known. It was "
            "not corrected, and the chair's weight counts as the person's. If the plate was zeroed with the chair on "
            "it, set `planarise: {seat_zero: none}`"
        )
        external.reasons.append(Reason("seat-zero-unknown", text))
    else:
        wrench = wrench - reading
    if used.base is not None:  # the base moves, and the chair does not
        chair = np.zeros(3) if reading is None else reading
        x, y, z = used.frame.axes
        weight = chair[0] * x + chair[1] * y
        force = sum((samples[index].force for index in plates), -weight)
        moment = sum((samples[index].moment for index in plates), -chair[2] * z - np.cross(used.frame.origin, weight))
        wrench = used.frame.wrench_to_plane(*used.base.undo_wrench(force, moment, used.time))
    wrench[~ok] = np.nan
    named = [None if each is None else dict(zip(COMPONENTS, each.tolist(), strict=True)) for each in (reading, spread)]
    numbers = [index + 1 for index in plates]
    external.add("seat", "seat", wrench, clock="plates", plates=numbers, zero=named[0], zero_sd=named[1])


def measure_sensors(
    external: ExternalWrenches, used: UsedFrames, sensors: Sequence[ExternalForce], source: Recording
) -> None:
    """Add the wrenches of the sensors in the configuration.

    Raises ConfigError if the marker at which a force acts does not exist. Raises RecordingError if a sensor's file is
    unusable or shares no time with the recording.
    """
    for number, sensor in enumerate(sensors, start=1):
        log, offset = recording.read_force_log(sensor.file), sensor.clock_offset_s
        turn = recording.to_z_up(source.vertical) * (-1.0 if sensor.force == "on-sensor" else 1.0)
        ok = find_complete_rows(np.hstack([log.force, log.moment]))
        start = log.start + offset
        plate = Plate(0, "sensor", None, log.force @ turn.T, log.moment @ turn.T, ok, log.rate, start)
        sampled = recording.decimate(plate, used.time, source.rate)
        if not sampled.ok.any():
            raise RecordingError(
                f"{sensor.file}: it has no sample between {used.time[0]:g} and {used.time[-1]:g} s, the times of the "
                f"recording; it runs from {start:g} to {log.end + offset:g} s on the same clock (with "
                f"`clock_offset_s: {offset:g}`): check `time_s` and the offset"
            )
        if isinstance(sensor.at, str):
            found = find_markers(used.labels, (sensor.at,), f"external: {sensor.name}: at")
            if len(found) > 1:
                raise ConfigError(
                    f"external: {sensor.name}: at: {sensor.at} matches {len(found)} markers, expected one"
                )
            point = used.positions[:, found[0]]
        else:
            point = np.asarray(recording.to_z_up(source.vertical) @ np.array(sensor.at))
        acting = sampled.force, sampled.moment + np.cross(point, sampled.force)
        if used.base is not None:
            acting = used.base.undo_wrench(*acting, used.time)
        wrench = used.frame.wrench_to_plane(*acting)
        known = find_complete_rows(wrench)
        wrench[~known] = np.nan
        external.add(
            sensor.name,
            f"external_{number}",
            wrench,
            clock="cameras",
            segment=sensor.segment,
            file=sensor.file.name,
            rate_hz=log.rate,
            known_fraction=float(known.mean()),
            measures=sensor.measures,
        )
        external.reasons += describe_held(log.held, used.time[0] - offset, used.time[-1] - offset)
        if sensor.measures != "beyond":  # a force of the surroundings
            vertical = recording.decimate(plate, used.thinned.time, used.thinned.rate).force[:, 2]
            external.vertical = external.vertical + vertical


def compute_ground_wrench(
    time: FloatArray, samples: Sequence[PlateSamples], choice: PlateChoice, frame: PlaneFrame, threshold: float
) -> dict[str, np.ndarray[Any, Any]]:
    """Return columns of wrench.parquet: the sum of the feet's plates and, if several plates exist, each plate alone.

    ``samples`` are the wrenches of all plates at the marker times ``time`` (F,), s. The centre of pressure is NaN up to
    the vertical force ``threshold``, N.
    """
    feet, count = choice.indices("feet"), len(time)
    total, ok = add_wrenches(samples, feet, frame) if feet else (np.empty((count, 3)), np.zeros(count, np.bool_))
    columns = _build_columns(time, COMPONENTS, total, ok, threshold)
    if len(samples) > 1:
        for number, plate in enumerate(samples, start=1):
            alone = frame.wrench_to_plane(plate.force, plate.moment).T.copy()
            columns |= {f"{name}_p{number}": each for name, each in zip(COMPONENTS, alone, strict=True)}
    return columns


def compute_ground_wrench_in_space(
    time: FloatArray,
    samples: Sequence[PlateSamples],
    choice: PlateChoice,
    frame: PlaneFrame,
    threshold: float,
    *,
    mirrored: bool = False,
) -> dict[str, np.ndarray[Any, Any]]:
    """Return the same columns in space, with six components, about the origin of the trial's frame (y up).

    ``mirrored`` says whether the trial is mirrored, z → -z.
    """
    feet, count = choice.indices("feet"), len(time)
    ok = np.logical_and.reduce([samples[index].ok for index in feet]) if feet else np.zeros(count, np.bool_)
    force = sum((samples[index].force for index in feet), np.zeros((count, 3)))
    moment = sum((samples[index].moment for index in feet), np.zeros((count, 3))) - np.cross(frame.origin, force)
    total = np.concatenate([force @ frame.axes.T, moment @ frame.axes.T], axis=1)
    if mirrored:
        total *= _MIRROR
    return _build_columns(time, _IN_SPACE, total, ok, threshold)


def _build_columns(
    time: FloatArray, names: Sequence[str], total: FloatArray, ok: BoolArray, threshold: float
) -> dict[str, np.ndarray[Any, Any]]:
    """Return the columns of a wrench (F, len(names)) whose second component is Fy and whose last is tauz."""
    total[~ok] = np.nan
    with np.errstate(invalid="ignore"):
        vertical = np.where(total[:, 1] > threshold, total[:, 1], np.nan)
    components = dict(zip(names, total.T.copy(), strict=True))
    return {"time": time, **components, "cop_x": total[:, -1] / vertical, "plate_ok": ok}


def find_plates_centre(
    plates: Sequence[Plate], choice: PlateChoice, frame: PlaneFrame, *, mirrored: bool
) -> list[float] | None:
    """Return the centre (3,) of the feet's plates in the frame of a trial in space, m; None if it is not known."""
    centres = [plates[index].centre for index in choice.indices("feet")]
    known = [each for each in centres if each is not None]
    if not known or len(known) < len(centres):
        return None
    centre = frame.to_plane(np.mean(known, axis=0))
    return [float(x) for x in (centre * [1.0, 1.0, -1.0] if mirrored else centre)]


def measure_lateral_cop(samples: Sequence[PlateSamples], frame: PlaneFrame, threshold: float) -> list[float | None]:
    """Return the median centre of pressure of each plate along z, m; None if never loaded above ``threshold``, N."""
    medians: list[float | None] = []
    for plate in samples:
        force = plate.force @ frame.axes.T
        moment = (plate.moment - np.cross(frame.origin, plate.force)) @ frame.axes.T
        loaded = plate.ok & (np.nan_to_num(force[:, 1]) > threshold)
        medians.append(float(np.median(-moment[loaded, 0] / force[loaded, 1])) if loaded.any() else None)
    return medians


_LOADED = 0.9  # fraction of the usual largest load above which the person is off the chair
_SMOOTH_S = 0.15
_ALONG = 2.0  # smallest ratio of the movements of the centre of pressure along and across the motion
_EXPLAINED = 0.5  # smallest fraction of the variance of the centre of pressure that the movement of the body explains
_DIRECTIONS = {"forwards": (1.0, 0.0), "backwards": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
_FEW = 0.02
_STANDS_N = 50.0


def read_board_plate(board: Path | BalanceBoard | None, source: Recording) -> tuple[BoardLog | None, Recording]:
    """Return the log, and the recording with the board as its only plate, whose moments are still zero.

    Without a board, the log is None and the recording does not change. Raises RecordingError if the log is unusable or
    shares no time with the recording.
    """
    if not isinstance(board, BalanceBoard):
        return None, source
    log = recording.read_board(board.balance_board, board.loads)
    start, end = log.start + board.clock_offset_s, log.start + board.clock_offset_s + (len(log.ok) - 1) / log.rate
    if start > source.time[-1] or end < source.time[0]:
        raise RecordingError(
            f"{board.balance_board}: the log shares no time with the recording: with `clock_offset_s: "
            f"{board.clock_offset_s:g}` it runs from {start:g} to {end:g} s, but the recording from "
            f"{source.time[0]:g} to {source.time[-1]:g} s. Correct `clock_offset_s:` to about 0.1 s; it is the "
            "recording's time minus `time_s`"
        )
    force = np.column_stack([np.zeros((len(log.force), 2)), log.force])
    ok = log.ok if not log.problem else np.zeros_like(log.ok)
    force[~ok] = np.nan
    plate = Plate(1, "balance board", None, force, np.zeros_like(force), ok, log.rate, start, log.problem)
    return log, replace(source, plates=(plate,), analog_rate=log.rate, held=source.held + log.held)


def place_board(
    board: BalanceBoard, log: BoardLog, source: Recording, thinned: ThinnedFrames, frame: PlaneFrame, *, faces: float
) -> tuple[Plate, FloatArray, dict[str, Any], tuple[Reason, ...]]:
    """Determine the board's position from the configuration, or else from the movement of the body and the feet.

    The position along the motion is only a first estimate; identify-dim improves it with the model. ``source`` contains
    the board's plate. ``faces`` is 1 if the person faces the plane's x, and -1 if the person faces the opposite
    direction.

    Return the plate, whose horizontal force is 0 because it is not measured; the origin (3,) of the plane frame at the
    height of the cells, so that tauz needs no horizontal force, m; the fact ``board`` of wrench.parquet; and reasons.
    """
    plate, load = source.plates[0], thinned.samples[0].force[:, 2]
    forwards = faces * frame.axes[0, :2]
    basis = np.stack([forwards, [-forwards[1], forwards[0]]])
    on_board = replace(plate, force=np.pad(log.moment, ((0, 0), (0, 1))))
    sampled = recording.decimate(on_board, thinned.time, thinned.rate).force[:, :2]
    pressure = sampled / np.where(load > _STANDS_N, load, np.nan)[:, None]
    top, sure = _find_direction(pressure, load, thinned.positions @ np.append(forwards, 0.0), thinned.rate)
    if board.top is not None:
        top, sure = board.top, True
    up = np.array(_DIRECTIONS[top]) @ basis
    axes = np.stack([[up[1], -up[0]], up])  # to the right, towards the top
    usual = np.nan_to_num(np.nanmedian(pressure @ axes, axis=0))
    if board.centre_m is not None:
        centre = np.asarray(recording.to_z_up(source.vertical) @ np.array(board.centre_m))
    else:
        feet = find_feet(thinned.positions)
        lowest = float(np.nanmin(np.nanmedian(thinned.positions[:, :, 2], axis=0)))
        height = CELLS_BELOW_SURFACE_M if lowest >= CELLS_BELOW_SURFACE_M else 0.0  # on the floor, or sunk into it
        centre = np.array([*(feet[:2] - usual), height])
    lever = log.force[:, None] * centre[:2] + log.moment @ axes
    moment = np.column_stack([lever[:, 1], -lever[:, 0], np.zeros(len(lever))])
    facts = {
        "file": board.balance_board.name,
        "top": top,
        "top_sure": sure,
        "centre_m": centre.tolist(),
        "centre_given": board.centre_m is not None,
        "cells_below_surface_m": CELLS_BELOW_SURFACE_M,
        "averaged_s": log.averaged,
        "interval_s": log.interval,
    }
    out = Findings()
    out.say(
        "board-vertical-only",
        "the ground's force comes from a balance board, which measures the vertical force and the centre of pressure "
        "at its cells. The parameters are fitted to Fy and tauz; Fx is computed by the model, and no measurement "
        "checks it",
        level="ok",
    )
    if log.gaps:
        share = float(1.0 - log.ok.mean())
        out.say(
            "board-gaps",
            f"the balance board sent no data {log.gaps} times for more than 0.15 s ({100 * share:.1f} % of its time): "
            "these samples are left out. Bring the receiver closer, and close other programs",
            share,
            _FEW,
            "caution" if share > _FEW else "ok",
        )
    origin = np.array([0.0, 0.0, centre[2] - CELLS_BELOW_SURFACE_M])
    return replace(plate, moment=moment), origin, facts, tuple(out.reasons)


def _find_direction(pressure: FloatArray, load: FloatArray, along: FloatArray, rate: float) -> tuple[str, bool]:
    """Return the direction from the board's centre to its top as seen by the person, and whether it is certain.

    The centre of pressure moves mostly along the motion. While the person is off the chair, it follows the body, minus
    a part that is proportional to the body's acceleration. ``pressure`` (F, 2) is its position to the right of the
    board's centre and towards the top, m; ``load`` (F,) is in N; ``along`` (F, M) are the coordinates of the markers in
    the direction in which the person faces, m; ``rate`` is in Hz.
    """
    body = np.nanmean(along - np.nanmean(along, axis=0), axis=1)
    width = max(1, round(_SMOOTH_S * rate))
    kernel = np.convolve(np.ones(width) / width, np.ones(width) / width)
    body = np.convolve(np.nan_to_num(body), kernel, mode="same")
    with np.errstate(invalid="ignore"):
        chosen = (load > _LOADED * np.nanpercentile(load, 95)) & np.isfinite(pressure).all(axis=1)
    chosen[:width] = chosen[-width:] = False
    if chosen.sum() < rate or np.ptp(body[chosen]) == 0.0:
        return "forwards", False
    series = pressure[chosen] - pressure[chosen].mean(axis=0)
    spread = series.std(axis=0)
    axis = int(np.argmax(spread))
    rows = np.column_stack([np.ones(len(series)), body[chosen], np.gradient(np.gradient(body))[chosen]])
    slope, *_ = np.linalg.lstsq(rows, series[:, axis], rcond=None)
    explained = 1.0 - float(np.var(series[:, axis] - rows @ slope)) / float(spread[axis] ** 2)
    name = (("left", "forwards") if slope[1] > 0.0 else ("right", "backwards"))[axis]
    return name, bool(spread[axis] > _ALONG * spread[1 - axis] and explained > _EXPLAINED)
