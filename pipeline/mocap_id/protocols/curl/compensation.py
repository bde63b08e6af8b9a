"""Compensation: motion of shoulder and thorax during curls, which should only bend the elbow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import NORMAL_95, FloatArray, find_runs
from mocap_id.protocols.curl.repetitions import Curl
from mocap_id.protocols.curl.rules import CurlRules


@dataclass(frozen=True)
class Compensation:
    """Motion of one angle during one curl.

    Parameters
    ----------
    range : float
        Highest minus lowest value within the curl, rad.
    range_interval : (float, float)
        95 % interval of the range, rad; the lower end is not negative.
    offset : float
        Mean of the curl minus mean of the first complete curl, rad.
    offset_sd : float
        rad.
    floor : float
        95 % quantile of the range that errors of the angle alone cause, rad: a smaller range may be no motion at all.
    sustained : float
        Longest time in which the change of the angle since the start of the curls exceeds the limit, s; 0 if this time
        is shorter than the rule asks for.
    """

    range: float
    range_interval: tuple[float, float]
    offset: float
    offset_sd: float
    floor: float
    sustained: float


def compensation(
    time: FloatArray, angle: FloatArray, sd: FloatArray, curls: tuple[Curl, ...], rules: CurlRules
) -> tuple[Compensation | None, ...]:
    """Measure the motion of an angle during every complete curl; None for a curl in which the angle is unknown.

    Parameters
    ----------
    time, angle, sd : (T,) arrays
        s; the angle and the standard deviation of its changes, rad, NaN where unknown.
    curls : tuple of Curl
        Failed attempts are left out and get None.
    rules : CurlRules
    """
    spans = [slice(*np.searchsorted(time, [curl.start, curl.end])) if curl.complete else None for curl in curls]
    used = [span for span in spans if span is not None and np.isfinite(angle[span]).all() and span.stop > span.start]
    if not used:
        return tuple(None for _ in spans)
    first, start = float(angle[used[0]].mean()), float(angle[used[0].start])
    return tuple(
        None
        if span is None or span not in used
        else _of_curl(time[span], angle[span] - start, sd[span], first - start, rules)
        for span in spans
    )


def _of_curl(time: FloatArray, change: FloatArray, sd: FloatArray, first: float, rules: CurlRules) -> Compensation:
    """Return the compensation of one curl; ``first`` is the mean of the first curl."""
    error, size = float(np.sqrt(np.mean(sd**2))), float(np.ptp(change))
    half = NORMAL_95 * float(np.sqrt(2) * error)  # errors of both ends are independent at worst
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
