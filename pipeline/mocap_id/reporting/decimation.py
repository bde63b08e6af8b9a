"""Fewer points to draw, none of the peaks lost."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray

BINS = 450
"""Bins across a figure: finer than the eye tells apart on paper."""


def envelope(time: FloatArray, values: FloatArray, bins: int = BINS) -> tuple[FloatArray, FloatArray]:
    """A curve's lowest and highest sample in each bin, in the order of time.

    Parameters
    ----------
    time : (T,) array
    values : (T,) array
        NaN breaks the curve; a bin with any NaN keeps one.
    bins : int
        A curve of up to ``3 * bins`` samples is returned as it is.

    Returns
    -------
    time, values : (K,) arrays
        K ≤ 3 bins, a subset of the input's samples.
    """
    if len(time) <= 3 * bins:
        return time, values
    block = _blocks(np.arange(len(time), dtype=np.float64), bins).astype(np.int64)
    value = values[block]  # (bins, size)
    missing = np.isnan(value)
    rows = np.arange(len(block))
    low = block[rows, np.where(missing, np.inf, value).argmin(axis=1)]
    high = block[rows, np.where(missing, -np.inf, value).argmax(axis=1)]
    broken = block[rows, missing.argmax(axis=1)]  # the first sample where none is missing: harmless
    picked = np.unique(np.concatenate([low, high, broken]))
    return time[picked], values[picked]


def band(
    time: FloatArray, low: FloatArray, high: FloatArray, bins: int = BINS
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A band's lowest low and highest high in each bin.

    Parameters
    ----------
    time, low, high : (T,) arrays
        NaN where the band is unknown.
    bins : int
        A band of up to ``bins`` samples is returned as it is.

    Returns
    -------
    time, low, high : (K,) arrays
        K ≤ bins; NaN where a whole bin is unknown.
    """
    if len(time) <= bins:
        return time, low, high
    lowest = np.where(np.isnan(low), np.inf, low)
    highest = np.where(np.isnan(high), -np.inf, high)
    under, over = _blocks(lowest, bins).min(axis=1), _blocks(highest, bins).max(axis=1)
    known = np.isfinite(under) & np.isfinite(over)
    return _blocks(time, bins).mean(axis=1), np.where(known, under, np.nan), np.where(known, over, np.nan)


def runs(mask: BoolArray) -> IntArray:
    """First sample and one past the last of each run of true samples, (R, 2)."""
    steps = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return np.column_stack([np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)]).astype(np.int64)


def spans(time: FloatArray, mask: BoolArray, bins: int = BINS) -> list[tuple[float, float]]:
    """Start and width, s, of each stretch where ``mask`` (T,) holds; those nearer than a bin are drawn as one."""
    found = runs(mask)
    if not len(found):
        return []
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    start, end = time[found[:, 0]], time[found[:, 1] - 1] + step
    apart = start[1:] - end[:-1] > (time[-1] - time[0]) / bins
    first = np.concatenate([[True], apart])
    last = np.concatenate([apart, [True]])
    return [(float(a), float(b - a)) for a, b in zip(start[first], end[last], strict=True)]


def _blocks(values: FloatArray, bins: int) -> FloatArray:
    """(T,) as (bins', size), bins' ≤ bins, the last sample repeated to fill the last row."""
    size = -(-len(values) // bins)
    rows = -(-len(values) // size)
    return np.pad(values, (0, rows * size - len(values)), mode="edge").reshape(rows, size)
