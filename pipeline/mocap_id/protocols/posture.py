"""Posture of a person whose feet stay on the ground, described by the height of the hip over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.geometry import planar

_LOW, _HIGH = 0.3, 0.7  # hysteresis of the upright state, shares of the rise

STANDING = 0.9
"""Height above which the person stands, as a share of the rise."""

QUIET = 0.1
"""Share of the largest speed below which a person who is upright stands quietly."""

_HIP = 0.5
"""The hip is the first joint from the ground that rises by this share of the largest rise of any joint.

The knee rises less. The shoulder, or a joint within the trunk, also moves up and down when the trunk leans."""

_LEAST_RISE = 0.15  # share of the length of the leg; a smaller rise is not a sit-to-stand


@dataclass(frozen=True)
class Posture:
    """Height of the hip over time."""

    # (T,) relative height of the hip: 0 at its 2 % quantile, 1 at its 98 % quantile; NaN where unknown
    height: FloatArray
    rise: float  # distance between these two heights, m
    upright: BoolArray  # (T,) upright state with hysteresis: it begins above 0.7 of the rise and ends below 0.3
    moves: bool  # whether the person gets up: the rise is at least 15 % of the length of the chain up to the hip
    # (T,) norm of the velocities of the joints up to the hip, rad/s; NaN where unknown. The joints above it are left
    # out, because the arms may move during a pause.
    speed: FloatArray


def compute_posture(q: FloatArray, dq: FloatArray, centres: FloatArray) -> Posture:
    """Compute the height of the hip for a chain whose base is on the ground.

    Parameters
    ----------
    q, dq : (T, n) arrays
        Joint angles, rad, and their velocities, rad/s; NaN where unknown.
    centres : (n, 2) array
        Joint centres in the axes of the previous segment, m.
    """
    _, origin = planar.segment_poses(q, centres)
    heights = origin[:, 1:, 1]
    if not np.isfinite(heights).any():
        return Posture(heights[:, 0], 0.0, np.zeros(len(q), dtype=bool), False, np.linalg.norm(dq, axis=1))
    low, high = np.nanquantile(heights, [0.02, 0.98], axis=0)
    joint = int(np.argmax(high - low >= _HIP * np.nanmax(high - low)))
    rise = float(high[joint] - low[joint])
    length = float(np.linalg.norm(centres[1 : joint + 1], axis=1).sum())
    height = (heights[:, joint] - low[joint]) / rise if rise > 0.0 else np.zeros(len(q))
    speed = np.linalg.norm(dq[:, : joint + 1], axis=1)
    return Posture(height, rise, _apply_hysteresis(height), rise > max(_LEAST_RISE * length, 1e-6), speed)


def measure_standing_angles(q: FloatArray, posture: Posture) -> FloatArray | None:
    """Return the median angle of each segment in the plane while the person stands, (n,) rad; None if unknown.

    ``q`` (T, n) are the joint angles, rad. If nobody rises, every sample counts as standing.
    """
    high = posture.height > STANDING if posture.moves else np.ones(len(q), dtype=bool)
    known = high & np.isfinite(q).all(axis=1)
    return np.median(np.cumsum(q[known], axis=1), axis=0) if known.any() else None


def find_standing_phases(posture: Posture) -> list[slice]:
    """Return the part of each upright phase in which the person stands quietly; empty if nobody gets up.

    In a movement without a pause, it is the short time in which the hip is high and slow.
    """
    if not posture.moves:
        return []
    with np.errstate(invalid="ignore"):
        quiet = posture.upright & (posture.height > STANDING) & (posture.speed < QUIET * np.nanmax(posture.speed))
    phases = []
    for upright in find_runs(posture.upright):
        parts = [run for run in find_runs(quiet) if upright.start <= run.start < upright.stop]
        if parts:
            phases.append(max(parts, key=lambda part: part.stop - part.start))
    return phases


def _apply_hysteresis(height: FloatArray) -> BoolArray:
    """Return the upright state (T,), from above 0.7 until below 0.3 of the rise; unknown heights are skipped."""
    change = np.where(height > _HIGH, 1, np.where(height < _LOW, -1, 0))
    decided = np.flatnonzero(change)
    if len(decided) == 0:
        return np.zeros(len(height), dtype=bool)
    last = np.searchsorted(decided, np.arange(len(height)), side="right") - 1
    state: BoolArray = change[decided[np.maximum(last, 0)]] > 0
    return state
