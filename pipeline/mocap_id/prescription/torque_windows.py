"""Widest window of a sampled torque curve that fits between two limits with a common shift."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.compilation import compiled


@compiled
def widest_window(  # noqa: PLR0917
    curve: FloatArray, span: float, floor: float, ceiling: float, first: int, last: int
) -> tuple[int, int]:  # pragma: no cover
    """Find the widest run of samples within floor and ceiling whose range is at most ``span``.

    It takes one pass with two pointers and monotone queues.

    Parameters
    ----------
    curve : (M,) array
    span, floor, ceiling : float
        In the curve's unit.
    first, last : int
        First and last sample that the run must include; ``first > last`` for none.

    Returns
    -------
    start, end : int
        First and last sample of the run; end < start if there is none.
    """
    size = curve.size
    largest, smallest = np.empty(size, np.int64), np.empty(size, np.int64)
    large_head, large_tail, small_head, small_tail = 0, 0, 0, 0
    start, best_start, best_end = 0, 0, -1
    for end in range(size):
        value = curve[end]
        if value < floor or value > ceiling:
            start = end + 1
            large_head, large_tail, small_head, small_tail = 0, 0, 0, 0
            continue
        while large_tail > large_head and curve[largest[large_tail - 1]] <= value:
            large_tail -= 1
        largest[large_tail] = end
        large_tail += 1
        while small_tail > small_head and curve[smallest[small_tail - 1]] >= value:
            small_tail -= 1
        smallest[small_tail] = end
        small_tail += 1
        while curve[largest[large_head]] - curve[smallest[small_head]] > span:
            start += 1
            if largest[large_head] < start:
                large_head += 1
            if smallest[small_head] < start:
                small_head += 1
        if first <= last and (start > first or end < last):
            continue
        if end - start > best_end - best_start:
            best_start, best_end = start, end
    return best_start, best_end


@compiled
def widest_by_stiffness(  # noqa: PLR0917
    gravity: FloatArray,
    angle: FloatArray,
    stiffness: FloatArray,
    half: float,
    limits: FloatArray,
    rest: FloatArray,
    first: int,
    last: int,
) -> FloatArray:  # pragma: no cover
    """Find the widest runs for several stiffnesses.

    Parameters
    ----------
    gravity, angle : (M,) arrays
        N·m at rad, evenly spaced.
    stiffness : (K,) array
        N·m/rad.
    half : float
        With a value above 0, N·m/rad, the limits are widened so that the result is an upper bound for all stiffnesses
        within this distance.
    limits : (2,) array
        Limits of the torque, N·m.
    rest : (2,) array
        Smallest and largest rest angle, rad.
    first, last : int
        As for :func:`widest_window`.

    Returns
    -------
    (K, 3) array
        Number of steps of the widest run (-1 for none), and the smallest and the largest g(θ) + k θ in it.
    """
    found = np.empty((stiffness.size, 3))
    span = limits[1] - limits[0] + half * (angle[-1] - angle[0])
    below, above = np.abs(angle - rest[0]).max(), np.abs(angle - rest[1]).max()
    for k in range(stiffness.size):
        curve = gravity + stiffness[k] * angle
        floor = limits[0] + stiffness[k] * rest[0] - half * below
        ceiling = limits[1] + stiffness[k] * rest[1] + half * above
        start, end = widest_window(curve, span, floor, ceiling, first, last)
        found[k, 0] = -1.0 if end < start else end - start
        found[k, 1] = curve[start : end + 1].min() if end >= start else np.nan
        found[k, 2] = curve[start : end + 1].max() if end >= start else np.nan
    return found
