"""Downsampling of curves, bands and intervals for drawing, without losing peaks."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs

BINS = 450
"""Number of bins across a figure; a finer resolution is not visible on paper."""


def thin_curve(time: FloatArray, values: FloatArray, bins: int = BINS) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest sample of a curve in each bin, in order of time; K ≤ 3 bins samples.

    NaN in ``values`` (T,) interrupts the curve; of a bin with NaN values, one NaN is also returned. A curve with at
    most ``3 * bins`` samples is returned unchanged.
    """
    if len(time) <= 3 * bins:
        return time, values
    block = _reshape(np.arange(len(time), dtype=np.float64), bins).astype(np.int64)
    value = values[block]  # (bins, size)
    missing = np.isnan(value)
    rows = np.arange(len(block))
    low = block[rows, np.where(missing, np.inf, value).argmin(axis=1)]
    high = block[rows, np.where(missing, -np.inf, value).argmax(axis=1)]
    broken = block[rows, missing.argmax(axis=1)]  # the first sample if none is missing, which is harmless
    picked = np.unique(np.concatenate([low, high, broken]))
    return time[picked], values[picked]


def thin_band(
    time: FloatArray, low: FloatArray, high: FloatArray, bins: int = BINS
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a band with the minimum of its lower edge and the maximum of its upper edge in each bin; K ≤ bins samples.

    The result has the mean time of each bin and the two edges, NaN if a whole bin is unknown. A band with at most
    ``bins`` samples is returned unchanged. ``time``, ``low`` and ``high`` are (T,) arrays, NaN where unknown.
    """
    if len(time) <= bins:
        return time, low, high
    lowest = np.where(np.isnan(low), np.inf, low)
    highest = np.where(np.isnan(high), -np.inf, high)
    under, over = _reshape(lowest, bins).min(axis=1), _reshape(highest, bins).max(axis=1)
    known = np.isfinite(under) & np.isfinite(over)
    return _reshape(time, bins).mean(axis=1), np.where(known, under, np.nan), np.where(known, over, np.nan)


def find_shaded_spans(time: FloatArray, mask: BoolArray, bins: int = BINS) -> list[tuple[float, float]]:
    """Return start and width, s, of each interval where ``mask`` (T,) is true; gaps shorter than a bin are closed."""
    runs = find_runs(mask)
    if not runs:
        return []
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    start = time[[run.start for run in runs]]
    end = time[[run.stop - 1 for run in runs]] + step
    apart = start[1:] - end[:-1] > (time[-1] - time[0]) / bins
    first = np.concatenate([[True], apart])
    last = np.concatenate([apart, [True]])
    return [(float(a), float(b - a)) for a, b in zip(start[first], end[last], strict=True)]


def _reshape(values: FloatArray, bins: int) -> FloatArray:
    """Reshape values (T,) to (K, size) with K ≤ ``bins``; the last value is repeated to fill the last row."""
    size = -(-len(values) // bins)
    rows = -(-len(values) // size)
    return np.pad(values, (0, rows * size - len(values)), mode="edge").reshape(rows, size)
