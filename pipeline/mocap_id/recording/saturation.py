"""Samples at which an analog channel sat at the end of its range."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

_RUN = 8
"""A noisy channel that repeats its extreme this often in a row is clipped."""

_QUANTISED = 0.2
"""Channels that repeat more than this share of their samples are coarse or at rest, and repetition means nothing."""


def saturated(counts: FloatArray, offset: FloatArray, bits: int | None) -> BoolArray:
    """Find saturated samples.

    Where the counts are whole numbers, the converter's limits are known from the resolution; elsewhere an extreme
    that is held exactly, in a channel that otherwise never stands still, gives clipping away.

    Parameters
    ----------
    counts : (K, C) array
        Samples in counts of the converter, as far as the file tells.
    offset : (C,) array
        Counts at zero input; about half the range for converters that count from 0.
    bits : int or None
        Resolution, ANALOG:BITS.

    Returns
    -------
    (K,) bool array
    """
    flags = np.zeros(len(counts), bool)
    for column, zero in zip(np.where(np.isfinite(counts), counts, np.nan).T, offset, strict=True):
        finite = column[np.isfinite(column)]
        if finite.size == 0 or np.ptp(finite) == 0:
            continue
        if np.abs(finite - np.round(finite)).max() < 1e-3:
            low, high = _limits(float(zero), bits)
            flags |= (column <= low + 0.5) | (column >= high - 0.5)
        else:
            flags |= _clipped(column)
    return flags


def _limits(offset: float, bits: int | None) -> tuple[float, float]:
    """Lowest and highest count of a converter, offset binary or two's complement."""
    resolution = bits if bits in (12, 14, 16) else (12 if 1900 < abs(offset) < 2200 else 16)
    span = 2.0**resolution
    return (0.0, span - 1) if abs(offset) > span / 4 else (-span / 2, span / 2 - 1)


def _clipped(column: FloatArray) -> BoolArray:
    flags = np.zeros(len(column), bool)
    if np.mean(np.diff(column) == 0) > _QUANTISED:
        return flags
    for extreme in (np.nanmin(column), np.nanmax(column)):
        held = column == extreme
        edges = np.flatnonzero(np.diff(np.concatenate(([0], held.astype(np.int8), [0]))))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - start >= _RUN:
                flags[start:stop] = True
    return flags
