"""Compensation: motion of shoulder and thorax during curls, which should only bend the elbow.

One part of an angle of the shoulder depends on the flexion of the elbow and is the same in every curl. An error
(d_x, d_y) of the elbow's axis causes such a part: it rotates the upper arm about its y axis by d_y Δsin(flexion) + d_x
Δcos(flexion) from one flexion to another. Skin that slides with the flexion has nearly the same effect, and so has a
person who rotates the upper arm in every curl. No motion separates these causes. Therefore, the part in the first curl
is reported separately, and the compensation is the motion beyond this part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import NORMAL_95, FloatArray, find_runs
from mocap_id.protocols.curl.repetitions import Curl, CurlRules

_VARIES = 0.25  # share of the error of the angle's changes that differs from curl to curl


@dataclass(frozen=True)
class Compensation:
    """Motion of one angle of shoulder or thorax during one curl."""

    range: float  # highest minus lowest value within the curl, rad
    range_interval: tuple[float, float]  # 95 % interval of the range, rad; the lower end is not negative
    # offset, offset_sd: mean of the angle in this curl minus its mean in the first complete curl, and its standard
    # deviation, rad
    offset: float
    offset_sd: float
    # 95 % quantile of the range that errors of the angle alone cause, rad. A smaller range may be no motion at all.
    floor: float
    # longest time in which the angle differs from its value at the start of the curls by more than
    # ``rules.compensation``, s; 0 if this time is shorter than ``rules.sustained``
    sustained: float


def measure_compensation(
    time: FloatArray, angle: FloatArray, sd: FloatArray, curls: tuple[Curl, ...], rules: CurlRules
) -> tuple[Compensation | None, ...]:
    """Measure the motion of an angle of shoulder or thorax during every curl.

    The entry of a curl is None if it is a failed attempt or if the angle is unknown in it.

    Parameters
    ----------
    time : (T,) array
        Sample times, s.
    angle, sd : (T,) arrays
        Angle and standard deviation of its changes, rad; NaN where unknown.
    """
    spans = [slice(*np.searchsorted(time, [curl.start, curl.end])) if curl.timed else None for curl in curls]
    used = [span for span in spans if span is not None and np.isfinite(angle[span]).all() and span.stop > span.start]
    if not used:
        return tuple(None for _ in spans)
    first, start = float(angle[used[0]].mean()), float(angle[used[0].start])
    return tuple(
        None
        if span is None or span not in used
        else _measure_in_curl(time[span], angle[span] - start, sd[span], first - start, rules)
        for span in spans
    )


def _measure_in_curl(
    time: FloatArray, change: FloatArray, sd: FloatArray, first: float, rules: CurlRules
) -> Compensation:
    """Return the compensation in one curl; ``first`` is the mean change of the angle in the first curl, rad."""
    error, size = float(np.sqrt(np.mean(sd**2))), float(np.ptp(change))
    half = NORMAL_95 * float(np.sqrt(2) * error)  # at worst, the errors of both ends are independent
    away = find_runs(np.abs(change) > rules.compensation)
    longest = max((float(time[run.stop - 1] - time[run.start]) for run in away), default=0.0)
    return Compensation(
        range=size,
        range_interval=(max(size - half, 0.0), size + half),
        offset=float(change.mean()) - first,
        offset_sd=np.sqrt(2) * error,
        floor=half,
        sustained=longest if longest >= rules.sustained else 0.0,
    )


@dataclass(frozen=True)
class InStep:
    """Part of an angle that depends on the flexion alone, fitted to the first complete curl with a known angle."""

    curve: FloatArray  # (T,) this part at all times, up to a constant, rad
    range: float  # highest minus lowest value of the curve within this curl, rad
    # 95 % interval of the person's motion in ``range``, rad; the lower end is not negative
    interval: tuple[float, float]
    rest_sd: FloatArray  # (T,) standard deviation of the changes of the angle minus the curve, rad


def fit_part_in_step(  # noqa: PLR0917
    time: FloatArray,
    angle: FloatArray,
    sd: FloatArray,
    flexion: FloatArray,
    axis: FloatArray | None,
    curls: Sequence[Curl],
) -> InStep | None:
    """Fit the part of an angle that depends on the flexion alone; None if the angle is known in no complete curl.

    Parameters
    ----------
    time : (T,) array
        Sample times, s.
    angle, sd, flexion : (T,) arrays
        Angle, standard deviation of its changes, and flexion of the elbow, rad; NaN where unknown.
    axis : (2, 2) array or None
        Covariance of the elbow's axis along x and y of the upper arm, rad²; None if unknown.
    """
    spans = (slice(*np.searchsorted(time, [curl.start, curl.end])) for curl in curls if curl.timed)
    basis = np.stack([np.cos(flexion), np.sin(flexion)], axis=1)
    known = np.isfinite(angle) & np.isfinite(flexion)
    first = next((span for span in spans if span.stop - span.start > basis.shape[1] and known[span].all()), None)
    if first is None:
        return None
    middle = basis[first].mean(axis=0)
    shape, *_ = np.linalg.lstsq(basis[first] - middle, angle[first] - angle[first].mean(), rcond=None)
    curve = basis @ shape
    left = float(np.std(angle[first] - curve[first]))
    size = float(np.ptp(curve[first]))
    half = NORMAL_95 * (np.sqrt(2 * np.mean(sd[first] ** 2)) if axis is None else _find_largest_sd(basis[first], axis))
    rest = np.sqrt(left**2 + (_VARIES * sd) ** 2 / 2)
    return InStep(curve, size, (max(size - float(half), 0.0), size + float(half)), rest)


def _find_largest_sd(basis: FloatArray, axis: FloatArray) -> float:
    """Return the largest standard deviation, rad, of a rotation in a curl that an error of the elbow's axis causes."""
    extended = int(np.argmax(basis[:, 0]))
    change = basis - basis[extended]
    return float(np.sqrt(np.einsum("ti,ij,tj->t", change, axis, change).max()))
