"""Lift of the heels: feet that rotate about the toes while the person rises, so that the base of the chain moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, as_complex
from mocap_id.kinematics.base_motion import LOW_M, block_means, find_standing
from mocap_id.kinematics.rigid_body import count_positions

_BLOCK_S = 0.1
_LASTING_S = 0.3  # shortest lift
_LIFT_M = 0.012  # least lift; markers on heels that stay on the ground rise by up to 9 mm
_FLAT = 0.4  # least fraction of the body's moving time in which feet are flat; shanks move in most of it
_FOOT_M = (0.1, 0.35)  # range of distances of two markers on one foot
_RIGID_M = 0.003  # largest change of distance of two markers on one foot
_STILL_M = 0.001  # markers that move less are on the ground, not on a rotating foot
_MOSTLY = 0.98  # quantile of a marker's distance from its usual position
_LEAST_POSITIONS = 2  # fewest distinct marker positions that determine the pose of a foot

LEAST_TURN = float(np.radians(3.0))
"""Least rotation of a foot that is reported, rad."""


@dataclass(frozen=True)
class HeelLift:
    """Lift of one end of a foot."""

    marker: int  # column of the marker that rises
    about: int  # column of a marker on the same foot that rises less
    height: float  # rise that lasts 0.3 s, m
    turn: float  # rotation of the foot, rad
    time: float  # time when the marker first rises, s


def find_heel_lift(positions: FloatArray, time: FloatArray, rate: float) -> HeelLift | None:
    """Return the largest rotation of a foot; None if all feet stay flat, or if no two markers of a foot rotate.

    A rotation is visible in two low markers that keep their distance while one of them rises. Positions (F, M, 3) are
    in lab axes with Z up, m, NaN where missing; ``rate`` is in frames per second.
    """
    size = max(1, round(_BLOCK_S * rate))
    blocks = block_means(positions, size)
    low = np.flatnonzero(find_standing(blocks, size / rate, _FLAT))
    blocks, lasting = blocks[:, low], max(1, round(_LASTING_S * rate / size))
    if len(low) < 2:
        return None
    usual = np.nanmedian(blocks, axis=0)
    away = np.sort(np.nan_to_num(np.linalg.norm(blocks - usual, axis=2)), axis=0)[-lasting]
    height = np.sort(np.nan_to_num(blocks[..., 2] - usual[:, 2]), axis=0)[-lasting]
    largest: HeelLift | None = None
    for up in np.flatnonzero(height > _LIFT_M):
        for down in np.flatnonzero((away > _STILL_M) & (height < height[up])):
            between = blocks[:, up] - blocks[:, down]
            turn = _measure_rotation(between[np.isfinite(between[:, 0])], lasting)
            if turn > LEAST_TURN and (largest is None or turn > largest.turn):
                first = int(np.argmax(blocks[:, up, 2] - usual[up, 2] > _LIFT_M))
                largest = HeelLift(int(low[up]), int(low[down]), float(height[up]), turn, float(time[size * first]))
    return largest


def find_moving_markers(points: FloatArray, rate: float) -> BoolArray:
    """Return which base markers (m,) are on feet that move; none if the moving markers do not determine a pose.

    Marker positions (F, m, 2) are in the plane frame, m, NaN where missing; the rate is in frames per second.
    """
    blocks = block_means(points, max(1, round(_BLOCK_S * rate)))
    moving: BoolArray = np.asarray(np.isfinite(blocks).any(axis=(0, 2)))
    if not moving.any():
        return moving
    usual = np.nanmedian(blocks[:, moving], axis=0)
    low = usual[:, 1] < usual[:, 1].min() + LOW_M  # a table or a chair that is touched is not a foot
    moving[moving], usual = low, usual[low]
    away = np.linalg.norm(blocks[:, moving] - usual, axis=2)
    moves = np.nanquantile(away, _MOSTLY, axis=0) > _STILL_M
    moving[moving] = moves & (count_positions(as_complex(usual[moves])) >= _LEAST_POSITIONS)
    return moving


def _measure_rotation(between: FloatArray, lasting: int) -> float:
    """Return the rotation for ``lasting`` blocks of the line (K, 3) between two markers, rad; 0 if not on a foot."""
    if len(between) <= lasting:
        return 0.0
    lengths = np.linalg.norm(between, axis=1)
    length, usual = float(np.median(lengths)), np.median(between, axis=0)
    level = abs(usual[2]) < np.hypot(usual[0], usual[1])
    if not (level and _FOOT_M[0] < length < _FOOT_M[1]) or np.quantile(np.abs(lengths - length), 0.98) > _RIGID_M:
        return 0.0
    slope = np.arcsin(np.clip(between[:, 2] / length, -1, 1))
    return float(np.sort(slope - np.median(slope))[-lasting])
