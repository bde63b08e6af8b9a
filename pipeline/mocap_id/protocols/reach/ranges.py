"""Ranges of the angles of an arm, which single wrong samples do not change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.geometry.so3 import shift_to_shortest_arc
from mocap_id.store.spatial_views import MEANINGLESS_AT_POLE, SegmentPoses, SpatialAngles

HELD = 0.05
"""Total time for which the angle is beyond each end of its range, s, so that one wrong sample does not move an end."""
_EXCESS = 0.56
"""Expected value of the larger of two independent errors, in standard deviations: noise moves each end outwards."""
_RAISED_SD = float(np.radians(7.0))
"""Standard deviation of each end of the elevation from the skeleton of a camera, rad.

This error depends on the posture: the ranges of five recorded arms were up to 20° too large (docs/recordings.md).
"""

BETWEEN = {"shoulder": ("thorax", "upper_arm"), "elbow": ("upper_arm", "forearm"), "wrist": ("forearm", "hand")}
"""Segments before and after each joint of the arm."""


@dataclass(frozen=True)
class AngleRange:
    """Range of one angle in a recording."""

    # low, high: ends of the range, rad
    low: float
    high: float
    # low_sd, high_sd: standard deviation of each end without the constant error, rad
    low_sd: float
    high_sd: float
    # standard deviation of the constant error, which is the same at both ends and comes from the landmarks, rad
    constant_sd: float
    # share of the samples that are used: observed and, for plane and axial rotation, more than 15° from the poles
    used_share: float

    @property
    def width_sd(self) -> float:
        """Standard deviation of the width of the range, rad.

        The errors of both ends are added, because a tilt of the thorax or sliding skin often moves the ends in
        opposite directions.
        """
        return self.low_sd + self.high_sd


def find_usable_samples(angles: SpatialAngles, poses: SegmentPoses, name: str) -> BoolArray:
    """Return True (T,) for the samples in which the angle ``name`` is defined, known, and measured by markers."""
    usable = angles.find_usable(name)
    pair = BETWEEN.get(name.split("_", maxsplit=1)[0], ())
    for segment in pair:
        if segment in poses.segments and len(poses.time) == len(angles.time):
            usable = usable & poses.observed[:, poses.segments.index(segment)]
    return usable


def get_angle(angles: SpatialAngles, name: str, usable: BoolArray) -> FloatArray:
    """Return the angle ``name`` (K,) in the K usable samples, rad, without jumps by full rotations."""
    values = angles.mean[usable, angles.names.index(name), 0]
    return shift_to_shortest_arc(values) if name in MEANINGLESS_AT_POLE and len(values) else values


def measure_ranges(angles: SpatialAngles, poses: SegmentPoses, *, skeleton: bool = False) -> dict[str, AngleRange]:
    """Return the range of every angle that is usable for long enough, by name.

    ``skeleton`` is True if the angles come from the skeleton of a camera. Its noise is slow and makes every range too
    large, so each end is then moved inwards by the expected excess.
    """
    rate = float(1 / np.median(np.diff(angles.time))) if len(angles.time) > 1 else 1.0
    ranges = {}
    for k, name in enumerate(angles.names):
        usable = find_usable_samples(angles, poses, name) & np.isfinite(angles.sd[:, k, 0])
        rank = max(round(HELD * rate), 1)
        if usable.sum() < 2 * rank:
            continue
        values, sd = get_angle(angles, name, usable), angles.sd[usable, k, 0]
        excess = _EXCESS * sd if skeleton else np.zeros(len(sd))
        low, low_sd = _find_low_end(values + excess, sd, rank)
        high, high_sd = _find_low_end(excess - values, sd, rank)
        high = -high
        if low > high:  # the noise is larger than the range
            low = high = 0.5 * (low + high)
        if skeleton and name == "shoulder_elevation":
            low_sd, high_sd = (float(np.hypot(one, _RAISED_SD)) for one in (low_sd, high_sd))
        constant = float(np.sqrt(np.mean(np.square(np.nan_to_num(angles.constant_sd[usable, k])))))
        ranges[name] = AngleRange(low, high, low_sd, high_sd, constant, float(usable.mean()))
    return ranges


def _find_low_end(values: FloatArray, sd: FloatArray, rank: int) -> tuple[float, float]:
    """Return the ``rank``-th lowest of ``values`` (K,), and the median of ``sd`` over the values up to this one."""
    lowest = np.argsort(values)[:rank]
    return float(values[lowest[-1]]), float(np.median(sd[lowest]))
