"""Ranges of the angles of an arm, robust against single samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.geometry.circle import on_shortest_arc
from mocap_id.store.spatial_views import GATED, SegmentPoses, SpatialAngles

HELD = 0.05
"""An end of a range counts if the angle is beyond it for this long in all, s. One wrong sample moves no end."""

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
        Its ends.
    low_sd, high_sd : float
        Standard deviation of each end without a constant error.
    constant_sd : float
        Standard deviation of a constant error by the landmarks, the same at both ends.
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
        """Standard deviation of the width; a constant error does not change it."""
        return float(np.hypot(self.low_sd, self.high_sd))


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
    return on_shortest_arc(found) if name in GATED and len(found) else found


def joint_ranges(angles: SpatialAngles, poses: SegmentPoses) -> dict[str, AngleRange]:
    """Return the range of every angle that is usable for long enough, by name."""
    rate = _rate(angles.time)
    found = {}
    for k, name in enumerate(angles.names):
        usable = usable_samples(angles, poses, name) & np.isfinite(angles.sd[:, k, 0])
        rank = max(round(HELD * rate), 1)
        if usable.sum() < 2 * rank:
            continue
        order = np.argsort(each := values(angles, name, usable))
        ends = order[rank - 1], order[-rank]
        sd = angles.sd[usable, k, 0]
        constant = float(np.sqrt(np.mean(np.square(np.nan_to_num(angles.constant_sd[usable, k])))))
        low, high = (float(each[end]) for end in ends)
        low_sd, high_sd = (float(np.median(sd[part])) for part in (order[:rank], order[-rank:]))
        found[name] = AngleRange(low, high, low_sd, high_sd, constant, float(usable.mean()))
    return found


def _rate(time: FloatArray) -> float:
    return float(1 / np.median(np.diff(time))) if len(time) > 1 else 1.0
