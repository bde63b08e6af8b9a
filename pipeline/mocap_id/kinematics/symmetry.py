"""Left-right asymmetry of the motion, which one sagittal segment for both sides assumes to be small."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.joint import unwrap_rotation
from mocap_id.kinematics.rigid_body import fit_body

_ASIDE = 0.03  # m; markers closer to the mid-plane belong to neither side


def measure_asymmetry(points: ComplexArray, lateral: FloatArray, segment: IntArray) -> FloatArray:
    """Return the difference between the rotations of the two sides of each segment.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where unseen.
    lateral : (M,) array
        Mean out-of-plane coordinate of every marker, m.
    segment : (M,) int array
        Segment of each marker, 0 = base, -1 = none.

    Returns
    -------
    (n,) array
        Standard deviation of the difference of the sides' angles for segments 1 … n, rad; NaN with fewer than two
        markers on a side.
    """
    middle = np.nanmean(lateral[segment > 0])
    return np.array(
        [_compare_sides(points, lateral - middle, np.flatnonzero(segment == k)) for k in range(1, segment.max() + 1)]
    )


def _compare_sides(points: ComplexArray, lateral: FloatArray, members: IntArray) -> float:
    sides = members[lateral[members] < -_ASIDE], members[lateral[members] > _ASIDE]
    if min(len(side) for side in sides) < 2:
        return np.nan
    left, right = (fit_body(points, side) for side in sides)
    difference = unwrap_rotation(left.rotation * np.conj(right.rotation))
    known = difference[np.isfinite(difference)]
    return float(np.std(known)) if len(known) else np.nan
