"""What a body does, told from its markers without their names: how tall it stands, which way it faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

_RISES_M = 0.15
"""Less change of the body's mean height than this is no sitting down."""

_SHANKS, _THIGHS = (0.15, 0.33), (0.38, 0.56)
"""Heights, as shares of the trunk's highest marker's, between which shanks and thighs of a standing person lie."""

_KNEE = 0.26
"""A marker on the thigh stays above this height, the knee's."""

_TRUNK_M, _PELVIS_SHARE = 1.15, 0.6
"""Where no marker stands higher than this, the set ends at the pelvis, at this share of the trunk's height."""

_LEGS, _LEGS_THIN = (0.2, 0.55), 0.16
"""Between these shares of the markers' height the legs of somebody who stands are thin in some horizontal direction:
0.02 … 0.11 of the height, and 0.21 … 0.48 of somebody who sits, whose thighs lie level there."""

_BODY_THIN = 0.3
"""All markers off the floor of somebody who stands: up to 0.28 with the arms forwards. It tells where the markers end
at the pelvis, so that the thighs of who sits are the top."""

_FLAT = 0.005
"""Thinner than this are markers in one line or projected into one plane, which show nothing."""

_SWEEPS = 8
"""Alternating fits of heights with gaps: each takes out most of what the gaps still bias."""

_SURE_M = 0.02
"""A displacement that markers show beyond noise and soft tissue."""


@dataclass(frozen=True)
class Facing:
    """Which way along a horizontal line a body faces.

    Parameters
    ----------
    forwards : bool
        It faces the line's positive direction.
    displacement : float
        What the rule saw, m along the line.
    rule : {"knees", "reach", "none"}
    """

    forwards: bool
    displacement: float
    rule: str

    @property
    def sure(self) -> bool:
        """Whether the rule had something to go by."""
        return abs(self.displacement) >= _SURE_M


def body_height(positions: FloatArray) -> FloatArray:
    """Height of the rising markers above their own usual heights, (F,) m; NaN where none of them is seen.

    Markers count whose height varies at least half as much as that of the one that varies most. Height and usual
    heights are fitted together to what is seen, so that markers which come and go do not move the sum.
    """
    height = positions[:, :, 2]
    spread = np.sqrt(_means((height - _means(height)) ** 2))
    with np.errstate(invalid="ignore"):
        height = height[:, spread >= 0.5 * np.nanmax(spread, initial=0.0)]
    common = np.zeros(len(height))
    for _ in range(_SWEEPS if np.isnan(height).any() else 1):
        usual = _means(height - common[:, None])
        common = _means((height - usual).T)
    return common


def upright(positions: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Frames (F,) in which the body stands tall, and those in which it is low: all and none if it keeps its height."""
    height = body_height(positions)
    finite = np.isfinite(height)
    if not finite.any():
        return np.ones(len(height), bool), np.zeros(len(height), bool)
    low, high = np.percentile(height[finite], [2, 98])
    if high - low < _RISES_M:
        return finite, np.zeros(len(height), bool)
    with np.errstate(invalid="ignore"):
        return height > low + 0.85 * (high - low), height < low + 0.15 * (high - low)


def shows_standing(positions: FloatArray, samples: BoolArray) -> bool:
    """Whether the markers are arranged as those of somebody who stands.

    The weight on the plates does not tell: a seated person's is as steady. Who stands has upright legs, which some
    horizontal direction sees thin against the height; the level thighs of who sits, kneels or squats are broad in
    every direction. Markers that are flat show neither; they are taken as standing only where the body rises and
    falls within the recording.

    Parameters
    ----------
    positions : (F, M, 3) array
        m, lab axes with Z up; NaN where unseen.
    samples : (F,) bool array
        Frames in question, one posture.
    """
    seen = np.isfinite(positions[samples]).all(axis=2).any(axis=0)
    if not seen.any():
        return False
    middle = np.nanmedian(positions[samples][:, seen], axis=0)
    legs, body = _thinness(middle, *_LEGS), _thinness(middle, _LEGS[0], 1.0)
    if legs > _LEGS_THIN or body > _BODY_THIN:
        return False
    return legs > _FLAT or bool(upright(positions)[1].any())


def facing(positions: FloatArray, direction: FloatArray) -> Facing:
    """Tell front from back along a horizontal line.

    A person who sits down or squats moves the hips backwards of the knees: where the body changes its height, the
    shanks' markers show the front by their displacement, from upright to low, relative to the thighs'; both are told
    by their height above the floor. Where it does not, but limbs move about a resting trunk, the limbs work in front:
    the moving markers show it by their mean offset from the resting ones.

    Parameters
    ----------
    positions : (F, M, 3) array
        m, lab axes with Z up; NaN where unseen.
    direction : (2,) array
        Horizontal unit vector of the line.

    Returns
    -------
    Facing
        ``forwards`` False, ``displacement`` 0 and the rule "none" where neither applies.
    """
    along = positions[:, :, :2] @ direction
    tall, low = upright(positions)
    moves = _range(positions) > max(0.25 * float(np.nanmax(_range(positions), initial=0.0)), _SURE_M)
    heights = _means(positions[:, :, 2])
    if _above(heights, moves, ~moves) and low.any():
        found, rule = _knees(positions, along, tall, low), "knees"
    elif moves.any() and not moves.all():
        found, rule = _difference(_means(along), moves, ~moves), "reach"
    else:
        found, rule = 0.0, "none"
    return Facing(found > 0, found, rule)


def _knees(positions: FloatArray, along: FloatArray, tall: BoolArray, low: BoolArray) -> float:
    """Displacement of the shanks relative to the thighs from upright to low, m."""
    heights = _means(positions[tall][:, :, 2])
    floor, top = float(np.nanmin(heights)), float(np.nanmax(heights))
    trunk = top - floor if top - floor > _TRUNK_M else (top - floor) / _PELVIS_SHARE
    share = (heights - floor) / trunk
    shift = _means(along[low]) - _means(along[tall])
    drop = heights - _means(positions[low][:, :, 2])
    with np.errstate(invalid="ignore"):
        shanks = (share > _SHANKS[0]) & (share < _SHANKS[1]) & np.isfinite(shift)
        thighs = (share > _THIGHS[0]) & (share < _THIGHS[1]) & np.isfinite(shift)
        if not (shanks.any() and thighs.any()):
            return 0.0
        sinks = max(float(np.median(drop[shanks] / share[shanks])) * _KNEE, 0.0)  # the knee, as the shank leans
        thighs &= (drop > 0) & (
            drop < sinks + (share - _KNEE) * trunk
        )  # hands hang there too, but fall or rise farther
    return float(np.median(shift[shanks]) - np.median(shift[thighs])) if thighs.any() else 0.0


def _thinness(points: FloatArray, low: float, high: float) -> float:
    """Least horizontal width of points (M, 3) between two shares of their height, by that height; 0 of fewer than 2."""
    height = float(np.ptp(points[:, 2]))
    share = (points[:, 2] - points[:, 2].min()) / max(height, 1e-9)
    inside = points[(share >= low) & (share <= high), :2]
    if len(inside) < 2:
        return 0.0
    angles = np.radians(np.arange(0.0, 180.0, 3.0))
    return float(np.ptp(inside @ np.stack([np.cos(angles), np.sin(angles)]), axis=0).min()) / height


def _means(values: FloatArray) -> FloatArray:
    """Mean of each column (F, M) → (M,) over its finite values; NaN where there are none."""
    finite = np.isfinite(values)
    counts = finite.sum(axis=0)
    return np.asarray(np.where(counts > 0, np.where(finite, values, 0.0).sum(axis=0), np.nan) / np.maximum(counts, 1))


def _range(positions: FloatArray) -> FloatArray:
    """(M,) rms distance of each marker from its own mean, m; 0 where it is never seen."""
    away = positions - np.stack([_means(positions[:, :, axis]) for axis in range(3)], axis=1)
    return np.sqrt(np.nan_to_num(_means(np.sum(away**2, axis=2))))


def _difference(values: FloatArray, these: BoolArray, others: BoolArray) -> float:
    both = [values[group & np.isfinite(values)] for group in (these, others)]
    return float(both[0].mean() - both[1].mean()) if all(group.size for group in both) else 0.0


def _above(heights: FloatArray, these: BoolArray, others: BoolArray) -> bool:
    return not others.any() or _difference(heights, these, others) > 0
