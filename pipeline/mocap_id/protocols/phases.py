"""Signals resampled at 0 to 100 % of each repetition and averaged over the repetitions (figures 6.5 and 6.7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray

GRID = np.linspace(0.0, 1.0, 101)


@dataclass(frozen=True)
class Averaged:
    """Mean, standard deviation and number of known repetitions at each point of the cycle, (P,) arrays.

    The standard deviation is NaN for fewer than two repetitions.
    """

    mean: FloatArray
    sd: FloatArray
    count: FloatArray


@dataclass(frozen=True)
class Agreement:
    """Agreement of an angle with the same angle from another system, over the samples where both are known."""

    r: float  # correlation; negative if the two angles have opposite signs
    offset: float  # mean difference, other system minus this program, rad
    rmse: float  # rms difference after removing the offset, rad
    samples: int  # number of samples where both are known


def resample_repetitions(time: FloatArray, values: FloatArray, bounds: FloatArray) -> FloatArray:
    """Return a signal at 0, 1 … 100 % of each repetition, (R, 101); NaN next to missing samples.

    Parameters
    ----------
    time : (T,) array
        Sample times, s.
    values : (T,) array
        Signal; NaN where missing.
    bounds : (R, 2) array
        Start and end of each repetition, s.
    """
    return interpolate_at(time, values, bounds[:, :1] + (bounds[:, 1:] - bounds[:, :1]) * GRID)


def interpolate_at(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return a signal ``values`` (K,) interpolated at the times ``at``; NaN outside ``time`` (K,) and next to a gap."""
    gap = np.interp(at, time, np.isnan(values).astype(np.float64)) > 0
    return np.where(gap, np.nan, np.interp(at, time, values, np.nan, np.nan))


def average_repetitions(curves: FloatArray) -> Averaged:
    """Average curves (R, P) over the R repetitions; NaN counts as missing."""
    known = np.isfinite(curves)
    count = known.sum(axis=0).astype(np.float64)
    mean = np.where(known, curves, 0.0).sum(axis=0) / np.where(count > 0, count, np.nan)
    square = np.where(known, (curves - mean) ** 2, 0.0).sum(axis=0)
    return Averaged(mean, np.sqrt(square / np.where(count > 1, count - 1, np.nan)), count)


def compare_angles(ours: FloatArray, other: FloatArray) -> Agreement:
    """Compare an angle (T,), rad, with the same angle (T,) from another system; NaN where unknown.

    All numbers except ``samples`` are NaN if fewer than three samples have both angles, or if an angle is constant.
    """
    both = np.isfinite(ours) & np.isfinite(other)
    count = int(both.sum())
    if count < 3 or np.ptp(ours[both]) == 0.0 or np.ptp(other[both]) == 0.0:
        return Agreement(np.nan, np.nan, np.nan, count)
    difference = other[both] - ours[both]
    r = float(np.corrcoef(ours[both], other[both])[0, 1])
    return Agreement(r, float(difference.mean()), float(difference.std()), count)
