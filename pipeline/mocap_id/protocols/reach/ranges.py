"""Ranges of the angles of an arm, robust against single samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.geometry.circle import shift_to_shortest_arc
from mocap_id.store.spatial_views import GATED, SegmentPoses, SpatialAngles

HELD = 0.05
"""An end of a range counts if the angle is beyond it for this long in all, s. One wrong sample moves no end."""
_EXCESS = 0.56
"""Expected larger one of two independent errors, in standard deviations: noise moves the end of a range outwards."""
_RAISED_SD = float(np.radians(7.0))
"""Error of an end of the elevation from a skeleton that depends on the posture, rad.

Five recorded arms had ranges that were up to 20° too large (docs/recordings.md).
"""

BETWEEN = {
    "shoulder": ("thorax", "upper_arm"),
    "elbow": ("upper_arm", "forearm"),
    "wrist": ("forearm", "hand"),
}
"""The two segments of each joint, whose relative rotation its angles describe."""


@dataclass(frozen=True)
class AngleRange:
    """Range of one angle, rad.

    Parameters
    ----------
    low, high : float
        Its ends; ``low <= high``.
    low_sd, high_sd : float
        Standard deviation of each end without a constant error.
    constant_sd : float
        Standard deviation of a constant error caused by the landmarks, the same at both ends.
    used_share : float
        Share of the samples that count: observed and, for plane and axial rotation, more than 15° from the poles.
    """

    low: float
    high: float
    low_sd: float
    high_sd: float
    constant_sd: float
    used_share: float

    @property
    def width_sd(self) -> float:
        """Standard deviation of the width; a constant error does not change it.

        The others add up: a tilt of the thorax or sliding skin often moves the ends in opposite directions.
        """
        return self.low_sd + self.high_sd


def usable_samples(angles: SpatialAngles, poses: SegmentPoses, name: str) -> BoolArray:
    """Return the samples (T,) in which an angle is known, has a meaning, and is observed by markers."""
    usable = angles.usable(name)
    pair = BETWEEN.get(name.split("_", maxsplit=1)[0], ())
    for segment in pair:
        if segment in poses.segments and len(poses.time) == len(angles.time):
            usable = usable & poses.observed[:, poses.segments.index(segment)]
    return usable


def values(angles: SpatialAngles, name: str, usable: BoolArray) -> FloatArray:
    """Return an angle (K,) in the usable samples, rad; plane and axial rotation without jumps by whole turns."""
    found = angles.mean[usable, angles.names.index(name), 0]
    return shift_to_shortest_arc(found) if name in GATED and len(found) else found


def joint_ranges(angles: SpatialAngles, poses: SegmentPoses, *, skeleton: bool = False) -> dict[str, AngleRange]:
    """Return the range of every angle that is usable for long enough, by name.

    Parameters
    ----------
    angles : SpatialAngles
    poses : SegmentPoses
    skeleton : bool
        The angles come from the skeleton of a camera. Its noise lasts as long as a held posture and makes every range
        too large, so that each end is moved inwards by the expected excess.
    """
    rate = _rate(angles.time)
    found = {}
    for k, name in enumerate(angles.names):
        usable = usable_samples(angles, poses, name) & np.isfinite(angles.sd[:, k, 0])
        rank = max(round(HELD * rate), 1)
        if usable.sum() < 2 * rank:
            continue
        each, sd = values(angles, name, usable), angles.sd[usable, k, 0]
        excess = _EXCESS * sd if skeleton else np.zeros(len(sd))
        low, low_sd = _end(each + excess, sd, rank)
        high, high_sd = _end(excess - each, sd, rank)
        high = -high
        if low > high:  # the noise is larger than the range
            low = high = 0.5 * (low + high)
        if skeleton and name == "shoulder_elevation":
            low_sd, high_sd = (float(np.hypot(one, _RAISED_SD)) for one in (low_sd, high_sd))
        constant = float(np.sqrt(np.mean(np.square(np.nan_to_num(angles.constant_sd[usable, k])))))
        found[name] = AngleRange(low, high, low_sd, high_sd, constant, float(usable.mean()))
    return found


def _end(values: FloatArray, sd: FloatArray, rank: int) -> tuple[float, float]:
    """Return the rank-th lowest of values (K,), and the median standard deviation of the values up to it."""
    lowest = np.argsort(values)[:rank]
    return float(values[lowest[-1]]), float(np.median(sd[lowest]))


def _rate(time: FloatArray) -> float:
    return float(1 / np.median(np.diff(time))) if len(time) > 1 else 1.0
