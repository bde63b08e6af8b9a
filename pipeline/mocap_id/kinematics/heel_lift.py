"""Lift of the heels: feet that turn about the toes while the person rises, so that the base of the chain moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, as_complex
from mocap_id.kinematics.base_motion import block_means, find_standing
from mocap_id.kinematics.rigid_body import count_positions

_BLOCK_S = 0.1
_LASTING_S = 0.3  # a lift lasts at least as long
_LIFT_M = 0.012  # least lift; markers on heels that stay on the ground rise by up to 9 mm
_FLAT = 0.4  # share of the body's motion in which feet are flat at least; shanks move in most of it
_FOOT_M = (0.1, 0.35)  # distance of two markers on one foot that show its turn
_RIGID_M = 0.003  # markers on one foot keep their distance
_STILL_M = 0.001  # markers that move less are on the ground, not on a foot that turns
_MOSTLY = 0.98  # quantile of a marker's distance from its usual place
_LEAST_PLACES = 2  # of markers that show the pose of a foot
_FEWEST = 10  # frames
_INDEPENDENT = 3.0  # observations of the ankle that one trial counts as: gaps recur with the movement
_LEAST_GAP = 1e-5  # m, of recordings without noise: an ankle that does not turn at all stays where it is
_ANKLE_SD = 0.01  # m, of an ankle that the joint fit places in a foot that moves

LEAST_TURN = float(np.radians(3.0))
"""Least turn of a foot that is found, rad."""


@dataclass(frozen=True)
class HeelLift:
    """Lift of one end of a foot.

    Parameters
    ----------
    marker, about : int
        The marker that rises, and the one on the same foot that rises less.
    height : float
        Rise that lasts 0.3 s, m.
    turn : float
        Turn of the foot, rad.
    time : float
        When the marker first rises that far, s.
    """

    marker: int
    about: int
    height: float
    turn: float
    time: float


@dataclass(frozen=True)
class AnklePosition:
    """Place of the ankle in the frames of foot and shank, m, and its standard deviation in one direction, m."""

    foot: complex
    shank: complex
    sd: float


def find_heel_lift(positions: FloatArray, time: FloatArray, rate: float) -> HeelLift | None:
    """Find the largest turn of a foot, from pairs of low markers that keep their distance while one of them rises.

    Parameters
    ----------
    positions : (F, M, 3) array
        Lab axes with Z up, m; NaN where not visible.
    time : (F,) array
        s.
    rate : float
        Frames per second.

    Returns
    -------
    HeelLift or None
        None if all feet stay flat, or if their markers do not show a turn.
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
    found: HeelLift | None = None
    for up in np.flatnonzero(height > _LIFT_M):
        for down in np.flatnonzero((away > _STILL_M) & (height < height[up])):
            between = blocks[:, up] - blocks[:, down]
            turn = _measure_rotation(between[np.isfinite(between[:, 0])], lasting)
            if turn > LEAST_TURN and (found is None or turn > found.turn):
                first = int(np.argmax(blocks[:, up, 2] - usual[up, 2] > _LIFT_M))
                found = HeelLift(int(low[up]), int(low[down]), float(height[up]), turn, float(time[size * first]))
    return found


def find_moving_markers(points: FloatArray, rate: float) -> BoolArray:
    """Return which markers (m,) of the base are on feet that move; none if they show no pose.

    Parameters
    ----------
    points : (F, m, 2) array
        Markers of the base in the plane frame, m; NaN where not visible.
    rate : float
        Frames per second.
    """
    blocks = block_means(points, max(1, round(_BLOCK_S * rate)))
    moving: BoolArray = np.asarray(np.isfinite(blocks).any(axis=(0, 2)))  # seen at all
    if not moving.any():
        return moving
    usual = np.nanmedian(blocks[:, moving], axis=0)
    away = np.linalg.norm(blocks[:, moving] - usual, axis=2)
    moves = np.nanquantile(away, _MOSTLY, axis=0) > _STILL_M
    moving[moving] = moves & (count_positions(as_complex(usual[moves])) >= _LEAST_PLACES)
    return moving


def locate_ankle(
    foot: tuple[ComplexArray, FloatArray], shank: tuple[ComplexArray, FloatArray], ankle: complex
) -> AnklePosition | None:
    """Return the place of the ankle between a foot that moves and the shank; None if unknown.

    A joint fit holds the base still, and takes a part of the foot's motion for another place of the ankle. The measured
    poses of foot (f) and shank (s), with origin p and angle a, show the ankle h in the foot and c in the shank:

        p_f + e^{i a_f} h = p_s + e^{i a_s} c,

    by least squares. A normal prior of h is around the place of the joint fit, so that an ankle that hardly turns stays
    there.

    Parameters
    ----------
    foot, shank : ((F,) complex array, (F,) array)
        Origin in the plane frame, m, and angle, rad, of each body's frame; NaN where unknown.
    ankle : complex
        Place of the ankle in the foot's frame by the joint fit, m.
    """
    below, above = np.exp(1j * foot[1]), np.exp(1j * shank[1])
    apart = shank[0] - foot[0] - below * ankle
    known = np.isfinite(apart) & np.isfinite(above)
    if np.count_nonzero(known) < _FEWEST:
        return None
    columns, apart = np.column_stack([below, -above])[known], apart[known]
    normal, target = columns.conj().T @ columns / len(columns), columns.conj().T @ apart / len(columns)
    gap = float(np.mean(np.abs(apart - columns @ np.linalg.lstsq(columns, apart)[0]) ** 2)) / 2
    gap = max(gap, _LEAST_GAP**2)
    normal[0, 0] += gap / (_INDEPENDENT * _ANKLE_SD**2)
    shift, beyond = np.linalg.solve(normal, target)
    variance = gap / _INDEPENDENT * float(np.linalg.inv(normal)[0, 0].real)
    return AnklePosition(ankle + complex(shift), complex(beyond), float(np.sqrt(variance)))


def _measure_rotation(between: FloatArray, lasting: int) -> float:
    """Return the turn from its usual direction of the line (K, 3) between two markers, rad; 0 if not on one foot."""
    if len(between) <= lasting:
        return 0.0
    lengths = np.linalg.norm(between, axis=1)
    length, usual = float(np.median(lengths)), np.median(between, axis=0)
    level = abs(usual[2]) < np.hypot(usual[0], usual[1])
    if not (level and _FOOT_M[0] < length < _FOOT_M[1]) or np.quantile(np.abs(lengths - length), 0.98) > _RIGID_M:
        return 0.0
    slope = np.arcsin(np.clip(between[:, 2] / length, -1, 1))
    return float(np.sort(slope - np.median(slope))[-lasting])
