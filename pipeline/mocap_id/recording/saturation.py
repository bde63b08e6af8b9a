"""Detection of samples at which an analog channel is saturated."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs

_RUN = 8  # a noisy channel that repeats its extreme this many times in a row is clipped
_QUANTISED = 0.2  # channels that repeat a larger fraction of their samples are coarse or at rest and are not checked
_REST = 0.1  # fraction of the larger extreme; an extreme closer to zero belongs to a channel at rest


def find_saturated(counts: FloatArray, offset: FloatArray, bits: int | None) -> BoolArray:
    """Return for each of K samples whether any of the C channels is saturated.

    ``counts`` (K, C) are the samples as stored, in most files counts of the converter. ``offset`` (C,) are the counts
    at zero input, about half the range for unsigned converters. ``bits`` is the resolution (ANALOG:BITS), None if not
    declared. If the counts are integers, the limits of the converter follow from its resolution. If they are not,
    :func:`find_clipped` judges each channel.
    """
    flags = np.zeros(len(counts), bool)
    for stored, zero in zip(counts.T, offset, strict=True):
        column = np.where(np.isfinite(stored), stored, np.nan)
        finite = column[np.isfinite(column)]
        if finite.size == 0 or np.ptp(finite) == 0:
            continue
        if np.abs(finite - np.round(finite)).max() < 1e-3:
            low, high = _find_limits(float(zero), bits)
            flags |= (column <= low + 0.5) | (column >= high - 0.5)
        else:
            flags |= find_clipped(column - zero)
    return flags


def _find_limits(offset: float, bits: int | None) -> tuple[float, float]:
    """Return the lowest and the highest count of a converter that uses offset binary or two's complement."""
    resolution = bits if bits in (12, 14, 16) else (12 if 1900 < abs(offset) < 2200 else 16)
    span = 2.0**resolution
    return (0.0, span - 1) if abs(offset) > span / 4 else (-span / 2, span / 2 - 1)


def find_clipped(column: FloatArray) -> BoolArray:
    """Return for each sample (K,) whether it is clipped: it equals an extreme that occurs at least 8 times in a row.

    Extremes near zero are not judged, nor is a channel that often repeats other values, because it is coarse or at
    rest.

    ``column`` (K,) is the signal minus its zero level; NaN if missing.
    """
    flags = np.zeros(len(column), bool)
    low, high = float(np.nanmin(column)), float(np.nanmax(column))
    between = column[(column > low) & (column < high)]
    if not between.size or np.mean(np.diff(between) == 0) > _QUANTISED:
        return flags
    for extreme in (low, high):
        if abs(extreme) < _REST * max(abs(low), abs(high)):
            continue
        at_extreme = column == extreme
        if max(run.stop - run.start for run in find_runs(at_extreme)) >= _RUN:
            flags |= at_extreme
    return flags
