"""Posture and facing direction of a body, from unlabelled markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

_RISES_M = 0.15  # a smaller change of the mean height of the body is not sitting down
_SHANKS, _THIGHS = (0.15, 0.33), (0.38, 0.56)
"""Height ranges of shanks and thighs of a standing person, as fractions of the height of the highest trunk marker."""

_KNEE = 0.26  # height of the knee, also as a fraction of that height; markers on the thigh stay above it
_TRUNK_M, _PELVIS_SHARE = 1.15, 0.6
"""If no marker is higher than the first value, m, the highest markers are on the pelvis. The second value is their
height as a fraction of that of the highest trunk marker."""

_LEGS, _LEGS_THIN = (0.2, 0.55), 0.16
"""Height range of the legs and largest accepted value of their least horizontal width, as fractions of the height of
all markers. The width is 0.02 to 0.11 for a standing person and 0.21 to 0.48 for a seated person, whose thighs are
level."""

_BODY_THIN = 0.3
"""The same limit for all markers above the feet. Their width is up to 0.28 for a standing person with the arms
forwards. The limit is needed if the highest markers are on the pelvis, since the thighs of a seated person are then
at the top."""

_FLAT = 0.005  # a smaller width means markers in a line or a vertical plane, from which the posture is unknown
_SWEEPS = 8  # number of alternating fits of heights with gaps; each removes most of the remaining bias
_SURE_M = 0.02  # smallest displacement that exceeds noise and soft-tissue motion


@dataclass(frozen=True)
class Facing:
    """Facing direction of a body along a horizontal line."""

    forwards: bool  # whether the body faces the positive direction of the line
    displacement: float  # displacement along the line on which the conclusion is based, m
    rule: str  # "knees", "reach" or "none", see :func:`find_body_facing`

    @property
    def sure(self) -> bool:
        """Whether the displacement is large enough for a conclusion."""
        return abs(self.displacement) >= _SURE_M


def measure_body_height(positions: FloatArray) -> FloatArray:
    """Return the mean height of the moving markers relative to their usual heights, (F,), m; NaN if none is visible.

    Only markers are used whose height varies at least half as much as that of the most variable marker. Their usual
    heights and the result are fitted together, so that markers with gaps do not shift the result.
    """
    height = positions[:, :, 2]
    spread = np.sqrt(_average((height - _average(height)) ** 2))
    with np.errstate(invalid="ignore"):
        height = height[:, spread >= 0.5 * np.nanmax(spread, initial=0.0)]
    common = np.zeros(len(height))
    for _ in range(_SWEEPS if np.isnan(height).any() else 1):
        usual = _average(height - common[:, None])
        common = _average((height - usual).T)
    return common


def find_upright(positions: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return for each frame whether the body is upright, (F,), and whether it is low, (F,).

    If the height of the body changes by less than 15 cm, it is upright in all frames with visible markers.
    """
    height = measure_body_height(positions)
    finite = np.isfinite(height)
    if not finite.any():
        return np.ones(len(height), bool), np.zeros(len(height), bool)
    low, high = np.percentile(height[finite], [2, 98])
    if high - low < _RISES_M:
        return finite, np.zeros(len(height), bool)
    with np.errstate(invalid="ignore"):
        return height > low + 0.85 * (high - low), height < low + 0.15 * (high - low)


def shows_standing(positions: FloatArray, samples: BoolArray) -> bool:
    """Return whether the arrangement of the markers is that of a standing person.

    The force on the plates cannot decide this, because the force under a seated person is equally steady. The upright
    legs of a standing person are thin in some horizontal direction. The level thighs of a person who sits, kneels or
    squats are broad in all directions. From markers in one plane neither can be seen. Then the person counts as
    standing only if the body rises or lowers within the recording.

    ``positions`` (F, M, 3) are in lab axes with Z up, m; NaN if not visible. ``samples`` (F,) marks frames of one
    posture.
    """
    visible = np.isfinite(positions[samples]).all(axis=2).any(axis=0)
    if not visible.any():
        return False
    middle = np.nanmedian(positions[samples][:, visible], axis=0)
    legs, body = _measure_thinness(middle, *_LEGS), _measure_thinness(middle, _LEGS[0], 1.0)
    if legs > _LEGS_THIN or body > _BODY_THIN:
        return False
    return legs > _FLAT or bool(find_upright(positions)[1].any())


def find_body_facing(positions: FloatArray, direction: FloatArray) -> Facing:
    """Determine in which direction a body faces along a horizontal line with the unit vector ``direction`` (2,).

    ``positions`` (F, M, 3) are in lab axes with Z up, m; NaN if not visible. Rule "knees": if the body changes its
    height, the hips move backwards relative to the knees. From upright to low, the markers of the shanks therefore move
    forwards relative to the markers of the thighs. Both are recognised by their height above the floor. Rule "reach":
    if limbs move and the trunk rests, the moving markers are in front of the resting markers. If no rule applies,
    ``forwards`` is False and ``displacement`` 0.
    """
    along = positions[:, :, :2] @ direction
    tall, low = find_upright(positions)
    moves = _measure_spread(positions) > max(0.25 * float(np.nanmax(_measure_spread(positions), initial=0.0)), _SURE_M)
    heights = _average(positions[:, :, 2])
    if low.any() and (moves.all() or _compare_means(heights, moves, ~moves) > 0):
        displacement, rule = _compare_legs(positions, along, tall, low), "knees"
    elif moves.any() and not moves.all():
        displacement, rule = _compare_means(_average(along), moves, ~moves), "reach"
    else:
        displacement, rule = 0.0, "none"
    return Facing(displacement > 0, displacement, rule)


def _compare_legs(positions: FloatArray, along: FloatArray, tall: BoolArray, low: BoolArray) -> float:
    """Return the displacement of the shanks relative to the thighs from upright to low, m; 0 without such markers."""
    heights = _average(positions[tall][:, :, 2])
    floor, top = float(np.nanmin(heights)), float(np.nanmax(heights))
    trunk = top - floor if top - floor > _TRUNK_M else (top - floor) / _PELVIS_SHARE
    share = (heights - floor) / trunk
    shift = _average(along[low]) - _average(along[tall])
    drop = heights - _average(positions[low][:, :, 2])
    with np.errstate(invalid="ignore"):
        shanks = (share > _SHANKS[0]) & (share < _SHANKS[1]) & np.isfinite(shift)
        thighs = (share > _THIGHS[0]) & (share < _THIGHS[1]) & np.isfinite(shift)
        if not (shanks.any() and thighs.any()):
            return 0.0
        knee_drop = max(float(np.median(drop[shanks] / share[shanks])) * _KNEE, 0.0)  # the shank leans
        thighs &= (drop > 0) & (drop < knee_drop + (share - _KNEE) * trunk)  # without the hands, which move farther
    return float(np.median(shift[shanks]) - np.median(shift[thighs])) if thighs.any() else 0.0


def _measure_thinness(points: FloatArray, low: float, high: float) -> float:
    """Return the least horizontal width of the points (M, 3) between two heights, all relative to the total height."""
    height = float(np.ptp(points[:, 2]))
    share = (points[:, 2] - points[:, 2].min()) / max(height, 1e-9)
    inside = points[(share >= low) & (share <= high), :2]
    if len(inside) < 2:
        return 0.0
    angles = np.radians(np.arange(0.0, 180.0, 3.0))
    return float(np.ptp(inside @ np.stack([np.cos(angles), np.sin(angles)]), axis=0).min()) / height


def _average(values: FloatArray) -> FloatArray:
    """Return the mean (M,) of the finite values in each column (F, M); NaN if there are none."""
    finite = np.isfinite(values)
    counts = finite.sum(axis=0)
    return np.asarray(np.where(counts > 0, np.where(finite, values, 0.0).sum(axis=0), np.nan) / np.maximum(counts, 1))


def _measure_spread(positions: FloatArray) -> FloatArray:
    """Return the rms distance (M,) of each marker from its mean position, m; 0 if it is never visible."""
    away = positions - np.stack([_average(positions[:, :, axis]) for axis in range(3)], axis=1)
    return np.sqrt(np.nan_to_num(_average(np.sum(away**2, axis=2))))


def _compare_means(values: FloatArray, these: BoolArray, others: BoolArray) -> float:
    """Return the mean of the values ``these`` minus the mean of the values ``others``; 0 if one has no finite value."""
    both = [values[group & np.isfinite(values)] for group in (these, others)]
    return float(both[0].mean() - both[1].mean()) if all(group.size for group in both) else 0.0
