"""Smoothed states of a planar chain from its markers and inertial sensors.

The markers alone give a first motion. On it each sensor is calibrated as in space, and one that contradicts it is left
out. The filter then runs again with both: a gyroscope shows the sum of the joints' velocities up to its segment, an
accelerometer in the plane the acceleration of its place and gravity.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, as_complex, find_runs
from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_problem import InertialSignals
from mocap_id.estimation.inertial import (
    Calibrated,
    Prepared,
    SegmentMotion,
    SensorResult,
    SensorSignals,
    calibrate_all,
    calibrate_sensor,
    find_shown,
    prepare_sensor,
)
from mocap_id.estimation.inertial.signals import GRAVITY
from mocap_id.estimation.smoothing import FilterSettings, States, prepare_states
from mocap_id.geometry import so3

SHARES = (1.5, 1.5)  # of the residuals, which last: more than for balls, since a hinge can follow turning skin
_SHARE_SD = 0.05  # of a joint's turn, by which the skin under a sensor turns
_COVERED, _QUANTILE = 0.95, 1.645  # share of stretches, in movement and rest, whose drift is covered
_SOME = 500  # frames, for the residual
_WORSE = 1.5  # times the residual of the markers alone, at which the sensors contradict them


def smooth_with_sensors(
    observed: FloatArray,
    time: FloatArray,
    centres: FloatArray,
    segment: IntArray,
    local: FloatArray,
    *,
    sensors: Mapping[int, SensorSignals],
    settings: FilterSettings,
) -> tuple[States, dict[int, SensorResult]]:
    """Estimate the states of every joint at every frame from markers and inertial sensors.

    Parameters
    ----------
    observed : (F, M, 2) array
        Measured markers in the plane frame, m; NaN where missing. Changed as by ``overwrite`` of :func:`smooth`.
    time : (F,) array
        Uniform times of the cameras, s.
    centres, segment, local
        As for :func:`smooth`.
    sensors : mapping from int to SensorSignals
        Sensors by the number of their segment, 0 = base.
    settings : FilterSettings

    Returns
    -------
    States
        From the markers alone if no sensor is left.
    dict from int to SensorResult

    Raises
    ------
    NumericalError
        A covariance is not positive definite.
    """
    rate = (len(time) - 1) / float(time[-1] - time[0])
    times = time[0] + np.arange(len(time)) / rate
    prepared = prepare_states(observed, rate, centres, segment, local, settings=settings)
    alone = prepared.estimate()
    motions = segment_motions(alone, rate)
    results = calibrate_all(sensors, motions, times)
    kept = {s: each.found for s, each in results.items() if each.found is not None and each.why is None and s > 0}
    if not kept:
        return alone, results
    carried = {s: carry_sensor(sensors[s], s, found, motions[s], alone, times) for s, found in kept.items()}
    results |= {s: replace(results[s], found=each.found) for s, each in carried.items()}
    inertial = _as_arrays(alone, carried)
    try:
        both = prepared.estimate(inertial)
        if not _residual(both, observed) < _WORSE * _residual(alone, observed):
            raise NumericalError("the sensors pull the chain away from the markers")
    except NumericalError as error:
        return alone, {s: replace(each, why=each.why or str(error)) for s, each in results.items()}
    return replace(both, sd=_with_drift(both, carried, 1.0 / rate)), results


def segment_motions(states: States, rate: float) -> list[SegmentMotion]:
    """Return the motion of every segment in its own axes, where markers show it."""
    shown = find_shown(_seen(states), rate)
    still = np.zeros((len(states.mean), 1))
    angle, speed, turning = (np.concatenate([still, np.cumsum(states.mean[..., d], axis=1)], axis=1) for d in range(3))
    links = as_complex(states.chain.centres)[1:] * np.exp(1j * angle[:, 1:-1])
    carried = np.cumsum(links * (1j * turning[:, 1:-1] - speed[:, 1:-1] ** 2), axis=1)
    origins = np.concatenate([still, still, carried], axis=1) + 1j * GRAVITY
    force = origins * np.exp(-1j * angle)
    found, none = [], np.zeros(len(angle))
    for s in range(angle.shape[1]):
        given = np.where(shown[:, s, None], np.stack([speed[:, s], turning[:, s]], axis=1), np.nan)
        axis = np.array([0.0, 0.0, 1.0])
        own = np.stack([force[:, s].real, force[:, s].imag, none], axis=1)
        found.append(
            SegmentMotion(given[:, :1] * axis, given[:, 1:] * axis, own, none, none, np.array([0.0, 1.0, 0.0]))
        )
    return found


def _seen(states: States) -> BoolArray:
    """Return where (F, n + 1) markers of the same frame determine the pose of each segment; the base stands still."""
    known = np.logical_and.accumulate(states.observed & np.isfinite(states.mean[..., 0]), axis=1)
    return np.concatenate([np.ones((len(known), 1), dtype=np.bool_), known], axis=1)


@dataclass(frozen=True)
class CarriedSensor:
    """A sensor, the share (n,) of each joint's rotation that its skin follows, and the rest of the rate (F,)."""

    found: Calibrated
    ready: Prepared
    share: FloatArray
    left: FloatArray


def carry_sensor(  # noqa: PLR0917
    signals: SensorSignals, s: int, found: Calibrated, motion: SegmentMotion, states: States, time: FloatArray
) -> CarriedSensor:
    """Estimate the turn of the skin under a sensor with the joints beside it, and calibrate the sensor again."""
    seen, rest = _seen(states)[:, s], np.nanmean(states.mean[..., 0], axis=0)
    first = prepare_sensor(signals, found, motion, time, seen, SHARES)
    beside = [j for j in (s - 1, s) if j < len(rest)]
    share = np.zeros(len(rest))
    share[beside] = _fit_share(first.gyro[:, 2] - motion.omega[:, 2], states.mean[:, beside, 1], found)
    turn, rate, change = ((states.mean[..., d] - rest * (d == 0)) @ share for d in range(3))
    axis = np.array([0.0, 0.0, 1.0])
    skin = replace(
        motion,
        omega=motion.omega + rate[:, None] * axis,
        alpha=motion.alpha + change[:, None] * axis,
        force=np.einsum("fij,fj->fi", so3.exp(-turn[:, None] * axis), motion.force),
    )
    clock = replace(found.clock, sd=np.inf) if found.clock.observable else found.clock
    again = calibrate_sensor(signals, skin, time, clock, follows=False, start=replace(found, lag=0.0)) or found
    ready = prepare_sensor(signals, again, skin, time, seen, SHARES)
    return CarriedSensor(again, ready, share, ready.gyro[:, 2] - skin.omega[:, 2])


def _fit_share(off: FloatArray, rates: FloatArray, found: Calibrated) -> FloatArray:
    """Return the shares of the rates (F, k) of joints in a difference of angular velocities (F,)."""
    known = np.isfinite(off + rates.sum(axis=1))
    weight = 1.0 / (found.left[0] ** 2 * found.together[0])
    normal = weight * rates[known].T @ rates[known] + np.eye(rates.shape[1]) / _SHARE_SD**2
    return np.asarray(np.linalg.solve(normal, weight * rates[known].T @ off[known]))


def _as_arrays(states: States, carried: Mapping[int, CarriedSensor]) -> InertialSignals:
    every = list(carried.values())
    signal = [np.column_stack([each.ready.gyro[:, 2], each.ready.force[:, :2]]) for each in every]
    return InertialSignals(
        segment=np.array(list(carried), dtype=np.int64),
        place=np.array([each.found.place[:2] for each in every]),
        share=np.array([each.share for each in every]),
        rest=np.nanmean(states.mean[..., 0], axis=0),
        signal=np.stack(signal, axis=1),
        variance=np.stack([each.ready.variance for each in every], axis=1),
        gravity=GRAVITY,
    )


def _with_drift(states: States, carried: Mapping[int, CarriedSensor], dt: float) -> FloatArray:
    """Return the standard deviations, increased in gaps by the integrated differences between sensors and markers."""
    sd = states.sd.copy()
    gaps = [find_runs(~states.observed[:, j]) for j in range(sd.shape[1])]
    longest = max((run.stop - run.start for runs in gaps for run in runs), default=0)
    drifts = {s: _drift(each.left, longest, dt) ** 2 for s, each in carried.items()} if longest else {}
    for j, runs in enumerate(gaps):
        own = [drifts[s] for s in (j, j + 1) if s in drifts]
        for run in runs:
            variance = np.sum(own, axis=0)[: run.stop - run.start + 1] if own else np.zeros(run.stop - run.start + 1)
            ends = [variance[1:]] * (run.start > 0) + [variance[:0:-1]] * (run.stop < len(sd))
            if ends:
                sd[run, j, 0] = np.hypot(sd[run, j, 0], np.sum([1.0 / np.maximum(v, 1e-12) for v in ends], 0) ** -0.5)
    return sd


def _drift(left: FloatArray, count: int, dt: float) -> FloatArray:
    """Return the usual size (count + 1,), rad, of a difference of angular velocities (F,) integrated over frames."""
    known = np.isfinite(left)
    total, missing = (
        np.concatenate([[0.0], np.cumsum(each)]) for each in (np.where(known, left, 0.0) * dt, (~known).astype(float))
    )
    lags, sizes = [0], [0.0]
    for lag in np.unique(np.geomspace(1, max(count, 2), 30).astype(np.int64)).tolist():
        whole = missing[lag:] == missing[:-lag] if lag < len(total) else np.zeros(0, dtype=np.bool_)
        if np.count_nonzero(whole) < lag:
            break
        lags.append(lag)
        sizes.append(float(np.quantile(np.abs(total[lag:] - total[:-lag])[whole], _COVERED)) / _QUANTILE)
    every = np.arange(count + 1)
    return np.asarray(np.interp(every, lags, np.maximum.accumulate(sizes)) * np.maximum(every / max(lags[-1], 1), 1.0))


def _residual(states: States, observed: FloatArray) -> float:
    some = slice(None, None, max(1, len(observed) // _SOME))
    squares = np.sum((observed[some] - states.predicted_in(some)) ** 2, axis=2)[states.used[some]]
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else np.inf
