"""Posture of a person on a fixed base: how upright the chain is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.geometry import planar

_LOW, _HIGH = 0.3, 0.7  # hysteresis of the upright state, as shares of the rise

STANDING = 0.9
"""Height above which the person stands, as a share of the rise."""

_HIP = 0.5
"""Share of the largest rise of any joint: the hip is the first joint from the ground that rises as much. The knee rises
less. The shoulder, or a joint within the trunk, also moves up and down when the trunk leans."""

_LEAST_RISE = 0.15  # share of the leg length; a smaller rise is not a sit-to-stand


@dataclass(frozen=True)
class Posture:
    """Height over time of the hip.

    Parameters
    ----------
    height : (T,) array
        0 at the trial's lowest (2 % quantile), 1 at its highest (98 %); NaN where unknown.
    rise : float
        Distance between these two heights, m.
    upright : (T,) bool array
        Upright state with hysteresis: entered above 0.7 of the rise, left below 0.3.
    moves : bool
        Whether the rise is at least 15 % of the chain length up to that joint, so that the person gets up.
    speed : (T,) array
        Norm of the velocities of the joints up to the hip, rad/s; NaN where unknown. Arms may swing during a pause.
    """

    height: FloatArray
    rise: float
    upright: BoolArray
    moves: bool
    speed: FloatArray


def posture(q: FloatArray, dq: FloatArray, centres: FloatArray) -> Posture:
    """Compute the posture of a chain whose base is on the ground.

    Parameters
    ----------
    q, dq : (T, n) arrays
        Joint angles, rad, and velocities; NaN where unknown.
    centres : (n, 2) array
        Joint centres in the frame of the previous segment, m.
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
    return Posture(height, rise, _with_hysteresis(height), rise > max(_LEAST_RISE * length, 1e-6), speed)


def standing_angles(q: FloatArray, posture: Posture) -> FloatArray | None:
    """Return the median angle of each segment frame in the plane frame while the person stands.

    Parameters
    ----------
    q : (T, n) array
        Joint angles, rad.
    posture : Posture
        If nobody rises, every sample counts as standing.

    Returns
    -------
    (n,) array or None
        rad; None if no angles are known.
    """
    high = posture.height > STANDING if posture.moves else np.ones(len(q), dtype=bool)
    known = high & np.isfinite(q).all(axis=1)
    return np.median(np.cumsum(q[known], axis=1), axis=0) if known.any() else None


def _with_hysteresis(height: FloatArray) -> BoolArray:
    """Return the upright state; unknown samples keep the previous state."""
    change = np.where(height > _HIGH, 1, np.where(height < _LOW, -1, 0))
    decided = np.flatnonzero(change)
    if len(decided) == 0:
        return np.zeros(len(height), dtype=bool)
    last = np.searchsorted(decided, np.arange(len(height)), side="right") - 1
    state: BoolArray = change[decided[np.maximum(last, 0)]] > 0
    return state
