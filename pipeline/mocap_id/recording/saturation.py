"""Samples at which an analog channel sat at the end of its range."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

_RUN = 8
"""A noisy channel that repeats its extreme this often in a row is clipped."""

_QUANTISED = 0.2
"""Channels that repeat more than this share of their samples are coarse or at rest, and repetition means nothing."""

_REST = 0.1
"""Of the range from zero to the other extreme: an extreme this near to zero is a channel at rest."""


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
    for stored, zero in zip(counts.T, offset, strict=True):
        column = np.where(np.isfinite(stored), stored, np.nan)
        finite = column[np.isfinite(column)]
        if finite.size == 0 or np.ptp(finite) == 0:
            continue
        if np.abs(finite - np.round(finite)).max() < 1e-3:
            low, high = _limits(float(zero), bits)
            flags |= (column <= low + 0.5) | (column >= high - 0.5)
        else:
            flags |= clipped(column - zero)
    return flags


def _limits(offset: float, bits: int | None) -> tuple[float, float]:
    """Lowest and highest count of a converter, offset binary or two's complement."""
    resolution = bits if bits in (12, 14, 16) else (12 if 1900 < abs(offset) < 2200 else 16)
    span = 2.0**resolution
    return (0.0, span - 1) if abs(offset) > span / 4 else (-span / 2, span / 2 - 1)


def clipped(column: FloatArray) -> BoolArray:
    """Samples of one channel that are held at an extreme, far from zero, while it never stands still elsewhere.

    Parameters
    ----------
    column : (K,) array
        Less its zero; NaN where unknown.

    Returns
    -------
    (K,) bool array
    """
    flags = np.zeros(len(column), bool)
    low, high = float(np.nanmin(column)), float(np.nanmax(column))
    between = column[(column > low) & (column < high)]
    if not between.size or np.mean(np.diff(between) == 0) > _QUANTISED:
        return flags
    for extreme in (low, high):
        if abs(extreme) < _REST * max(abs(low), abs(high)):
            continue
        held = column == extreme
        edges = np.flatnonzero(np.diff(np.concatenate(([0], held.astype(np.int8), [0]))))
        if np.max(edges[1::2] - edges[::2]) >= _RUN:
            flags |= held
    return flags
