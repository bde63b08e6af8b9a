"""A balance board in place of a force plate: vertical force and centre of pressure, in the lab."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.geometry.plane_frame import PlaneFrame
from mocap_id.kinematics.plane import find_feet
from mocap_id.recording import CELLS_BELOW_SURFACE_M, BoardLog, Plate, Recording, ThinnedFrames
from mocap_id.stages.trial_keys import BalanceBoard
from mocap_id.verdict import Reason

_LOADED = 0.9  # fraction of the usual largest load above which the person is off the chair
_SMOOTH_S = 0.15
_ALONG = 2.0  # smallest ratio of the movements of the centre of pressure along and across the motion
_EXPLAINED = 0.5  # smallest fraction of the variance of the centre of pressure that the movement of the body explains
_DIRECTIONS = {"forwards": (1.0, 0.0), "backwards": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
_FEW = 0.02
_STANDS_N = 50.0


_VERTICAL_ONLY = Reason(
    "board-vertical-only",
    "the ground's force comes from a balance board, which measures the vertical force and the centre of pressure at "
    "its cells. The parameters are fitted to Fy and tauz; Fx is computed by the model, and no measurement checks it",
    level="ok",
)


@dataclass(frozen=True)
class PlacedBoard:
    """A balance board in the lab."""

    plate: Plate  # vertical force and its moments; the horizontal force is 0 because it is not measured
    # (3,) origin of the plane frame at the height of the cells, so that tauz needs no horizontal force, m
    origin: FloatArray
    facts: dict[str, Any]  # fact ``board`` of wrench.parquet
    reasons: tuple[Reason, ...]


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
    board: BalanceBoard,
    log: BoardLog,
    source: Recording,
    thinned: ThinnedFrames,
    frame: PlaneFrame,
    *,
    faces: float,
) -> PlacedBoard:
    """Determine the board's position from the configuration, or else from the movement of the body and the feet.

    The position along the motion is only a first estimate; identify-dim improves it with the model. ``source`` contains
    the board's plate. ``faces`` is 1 if the person faces the plane's x, and -1 if the person faces the opposite
    direction.
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
    centre = _find_centre(board, source, thinned.positions, usual)
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
    placed = replace(plate, moment=moment)
    share = float(1.0 - log.ok.mean())
    reasons = (_VERTICAL_ONLY, _describe_gaps(log.gaps, share)) if log.gaps else (_VERTICAL_ONLY,)
    origin = np.array([0.0, 0.0, centre[2] - CELLS_BELOW_SURFACE_M])
    return PlacedBoard(placed, origin, facts, reasons)


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


def _find_centre(board: BalanceBoard, source: Recording, positions: FloatArray, pressure: FloatArray) -> FloatArray:
    """Return the centre (3,) of the board's surface in the lab, m."""
    if board.centre_m is not None:
        return np.asarray(recording.to_z_up(source.vertical) @ np.array(board.centre_m))
    feet = find_feet(positions)
    lowest = float(np.nanmin(np.nanmedian(positions[:, :, 2], axis=0)))
    height = CELLS_BELOW_SURFACE_M if lowest >= CELLS_BELOW_SURFACE_M else 0.0  # on the floor, or sunk into it
    return np.array([*(feet[:2] - pressure), height])


def _describe_gaps(gaps: int, share: float) -> Reason:
    return Reason(
        "board-gaps",
        f"the balance board sent no data {gaps} times for more than 0.15 s ({100 * share:.1f} % of its time): these "
        "samples are left out. Bring the receiver closer, and close other programs",
        value=share,
        limit=_FEW,
        level="caution" if share > _FEW else "ok",
    )
