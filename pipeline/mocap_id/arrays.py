"""Array types for annotations, helpers for arrays, Sobol' samples, and the half-width of 95 % intervals."""

import warnings
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
ComplexArray: TypeAlias = NDArray[np.complex128]

GRAVITY = 9.81
"""Acceleration of gravity, m/s²; a trial's setting `gravity` of identify-dim may give another."""

NORMAL_95 = 1.96
"""Half-width of a 95 % interval of a normal distribution, in standard deviations."""


def chunks(count: int, size: int = 1024) -> list[slice]:
    """Return consecutive slices of at most ``size`` items that cover ``count`` items, to process an array in parts.

    The list has at least one slice, so that results for an empty array also have the right shape.
    """
    return [slice(start, min(start + size, count)) for start in range(0, max(count, 1), size)]


def find_complete_rows(values: FloatArray) -> BoolArray:
    """Return a mask (T,) of the samples (T, ...) whose values are all finite."""
    return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1), dtype=np.bool_)


def find_runs(flags: BoolArray) -> list[slice]:
    """Return a slice for every run of consecutive True values in ``flags`` (K,).

    Examples
    --------
    >>> find_runs(np.array([True, True, False, True]))
    [slice(0, 2, None), slice(3, 4, None)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))).tolist()
    return [slice(start, stop) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def interpolate_gaps(series: FloatArray) -> FloatArray:
    """Return ``series`` (K, n) with missing samples (NaN) interpolated linearly in each column.

    The nearest sample is repeated before the first and after the last. A column without any sample becomes zero.
    """
    every, filled = np.arange(len(series)), np.zeros(series.shape)
    for k, values in enumerate(series.T):
        known = np.isfinite(values)
        if known.any():
            filled[:, k] = np.interp(every, every[known], values[known])
    return filled


def as_complex(points: FloatArray) -> ComplexArray:
    """Return points (x, y) of shape (..., 2) as complex numbers x + iy of shape (...)."""
    return np.ascontiguousarray(points, dtype=np.float64).view(np.complex128)[..., 0]


def as_xy(points: ComplexArray) -> FloatArray:
    """Return the coordinates (x, y), shape (..., 2), of points given as complex numbers x + iy of shape (...)."""
    return np.stack([points.real, points.imag], axis=-1)


def sobol(count: int, dimension: int, seed: int) -> FloatArray:
    """Return a scrambled Sobol' sequence (count, dimension) in [0, 1); its first half is also a Sobol' sequence."""
    from scipy.stats import qmc  # noqa: PLC0415  few commands need scipy.stats

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The balance properties", category=UserWarning)
        return np.asarray(qmc.Sobol(dimension, rng=seed).random(count))
