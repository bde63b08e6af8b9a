"""Compiled searches: the widest interval of a torque curve between two limits, and cells that can be held."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.compilation import compiled


@compiled
def find_widest_run(  # noqa: PLR0917
    curve: FloatArray, span: float, floor: float, ceiling: float, first: int, last: int
) -> tuple[int, int]:  # pragma: no cover
    """Return first and last sample of the longest run between ``floor`` and ``ceiling`` that varies by up to ``span``.

    The run must include the samples ``first`` to ``last``; if ``first > last``, no sample is required. Without such a
    run, the end is before the start. The method is one pass over the curve (M,) with two pointers and monotone queues.
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
def find_widest_runs(  # noqa: PLR0917
    gravity: FloatArray,
    angle: FloatArray,
    stiffness: FloatArray,
    half: float,
    limits: FloatArray,
    rest: FloatArray,
    first: int,
    last: int,
) -> FloatArray:  # pragma: no cover
    """Return the widest run of holdable angles for each of K stiffnesses, N·m/rad, as rows (K, 3).

    A row is the number of steps of the run (-1 for none), and the smallest and the largest g(θ) + k θ in it, N·m.
    ``gravity`` (M,) are moments, N·m, at evenly spaced angles (M,), rad. ``limits`` (2,) and ``rest`` (2,) limit the
    torque, N·m, and the rest angle, rad. ``first`` and ``last`` are as for :func:`find_widest_run`. With a distance
    ``half`` above 0, N·m/rad, the result is an upper bound for all stiffnesses within this distance.
    """
    runs = np.empty((stiffness.size, 3))
    span = limits[1] - limits[0] + half * (angle[-1] - angle[0])
    below, above = np.abs(angle - rest[0]).max(), np.abs(angle - rest[1]).max()
    for k in range(stiffness.size):
        curve = gravity + stiffness[k] * angle
        floor = limits[0] + stiffness[k] * rest[0] - half * below
        ceiling = limits[1] + stiffness[k] * rest[1] + half * above
        start, end = find_widest_run(curve, span, floor, ceiling, first, last)
        runs[k, 0] = -1.0 if end < start else end - start
        runs[k, 1] = curve[start : end + 1].min() if end >= start else np.nan
        runs[k, 2] = curve[start : end + 1].max() if end >= start else np.nan
    return runs


@compiled
def count_cells(  # noqa: PLR0917
    gravity: FloatArray,
    stretch: FloatArray,
    cell: IntArray,
    cells: int,
    required: int,
    across: BoolArray,
    torque: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> int:  # pragma: no cover
    """Return an upper bound of the number of cells with a posture that can be held, for all springs of a box.

    The number is exact if both corners of the box are the same. It is -1 if a required point cannot be held. The first
    parameters are fields of :class:`Postures`. ``across`` (S, n) is True if the spring spans the joint; ``torque`` (n,
    2) are the person's limits, N·m; ``low`` and ``high`` (S, 2) are the corners of the box: stiffness, N·m/rad, and
    rest angle, rad, of each spring.
    """
    held = np.zeros(cells + required, np.bool_)
    joints, springs = gravity.shape[1], stretch.shape[1]
    for i in range(gravity.shape[0]):
        if held[cell[i]]:
            continue
        fits = True
        for j in range(joints):
            least, most = gravity[i, j], gravity[i, j]
            for s in range(springs):
                if across[s, j]:
                    under, over = stretch[i, s] - high[s, 1], stretch[i, s] - low[s, 1]
                    least += min(low[s, 0] * under, high[s, 0] * under)
                    most += max(low[s, 0] * over, high[s, 0] * over)
            if most < torque[j, 0] or least > torque[j, 1]:
                fits = False
                break
        if fits:
            held[cell[i]] = True
    for r in range(required):
        if not held[cells + r]:
            return -1
    return int(held[:cells].sum())
