"""Smoothed states of a planar chain from its markers and inertial sensors.

The markers alone give a first motion. Each sensor is calibrated with this motion, and a sensor that contradicts it is
left out. The filter then runs again with markers and sensors. A gyroscope measures the sum of the joints' velocities up
to its segment. An accelerometer measures gravity and the acceleration of its position, both in the plane.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, as_complex, find_runs
from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_kernels import Inertial
from mocap_id.estimation.inertial import (
    GRAVITY,
    MotionFromMarkers,
    PreparedSensor,
    SensorCalibration,
    SensorResult,
    SensorSignals,
    calibrate_all,
    calibrate_sensor,
    find_observed_segments,
    prepare_sensor,
)
from mocap_id.estimation.inverse_kinematics import MarkerChain
from mocap_id.estimation.smoothing import FilterSettings, StateEstimator, States
from mocap_id.geometry import so3

SHARES = (1.5, 1.5)
"""As :data:`mocap_id.estimation.inertial.SHARES`, but larger, because hinges can follow rotating skin."""

_SHARE_SD = 0.05  # standard deviation of the fraction of a joint's rotation that the skin under a sensor follows
_COVERED, _QUANTILE = 0.95, 1.645  # fraction of intervals whose drift is covered; this quantile in standard deviations
_SOME = 500  # frames, for the residual
_NORMAL, _UP = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
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
    """Return the states of every joint from markers and inertial sensors, and the result of each sensor by segment.

    If all sensors are left out, the states come from the markers alone. Markers and chain are as for
    :func:`mocap_id.estimation.smooth`; ``observed`` is changed in place as with its ``overwrite``. ``time`` (F,) are
    uniform times of the cameras, s. ``sensors`` are numbered by their segment, 0 = base.

    Raise NumericalError if a covariance is not positive definite.
    """
    rate = (len(time) - 1) / float(time[-1] - time[0])
    times = time[0] + np.arange(len(time)) / rate
    trial = StateEstimator(observed, rate, MarkerChain(centres, segment, local), settings)
    alone = trial.estimate()
    motions = compute_segment_motions(alone, rate)
    results = calibrate_all(sensors, motions, times)
    worn = {
        s: calibrate_worn_sensor(sensors[s], s, each.used, motions[s], alone, times)
        for s, each in results.items()
        if each.used is not None and s > 0
    }
    if not worn:
        return alone, results
    results |= {s: replace(results[s], calibration=each.calibration) for s, each in worn.items()}
    try:
        ready = [each.prepared for each in worn.values()]
        both = trial.estimate(
            Inertial(
                segment=np.array(list(worn), dtype=np.int64),
                place=np.array([each.calibration.place[:2] for each in worn.values()]),
                share=np.array([each.share for each in worn.values()]),
                rest=np.nanmean(alone.mean[..., 0], axis=0),
                signal=np.stack([np.column_stack([each.gyro[:, 2], each.force[:, :2]]) for each in ready], axis=1),
                variance=np.stack([each.variance for each in ready], axis=1),
                gravity=GRAVITY,
            )
        )
        if not _measure_residual(both, observed) < _WORSE * _measure_residual(alone, observed):
            raise NumericalError("the sensors pull the chain away from the markers")
    except NumericalError as error:
        return alone, {s: replace(each, why=each.why or str(error)) for s, each in results.items()}
    # in gaps, the standard deviations increase by the drift of the angles from the sensors
    sd, gaps = both.sd.copy(), [find_runs(~each) for each in both.observed.T]
    longest = max((run.stop - run.start for runs in gaps for run in runs), default=0)
    drifts = {s: _measure_drift(each.left, longest, 1.0 / rate) ** 2 for s, each in worn.items()} if longest else {}
    for j, runs in enumerate(gaps):
        own = [drifts[s] for s in (j, j + 1) if s in drifts]
        for run in runs:
            variance = np.sum(own, axis=0)[: run.stop - run.start + 1] if own else np.zeros(run.stop - run.start + 1)
            ends = [variance[1:]] * (run.start > 0) + [variance[:0:-1]] * (run.stop < len(sd))
            if ends:
                sd[run, j, 0] = np.hypot(sd[run, j, 0], np.sum([1.0 / np.maximum(v, 1e-12) for v in ends], 0) ** -0.5)
    return replace(both, sd=sd), results


def compute_segment_motions(states: States, rate: float) -> list[MotionFromMarkers]:
    """Return the motion of every segment, base first, in its own axes; NaN where markers do not determine it."""
    known = find_observed_segments(_find_determined(states), rate)
    still = np.zeros((len(states.mean), 1))
    angle, speed, acceleration = (
        np.concatenate([still, np.cumsum(states.mean[..., d], axis=1)], axis=1) for d in range(3)
    )
    links = as_complex(states.chain.centres)[1:] * np.exp(1j * angle[:, 1:-1])
    carried = np.cumsum(links * (1j * acceleration[:, 1:-1] - speed[:, 1:-1] ** 2), axis=1)
    origins = np.concatenate([still, still, carried], axis=1) + 1j * GRAVITY
    force = origins * np.exp(-1j * angle)
    motions, none = [], np.zeros(len(angle))
    for s in range(angle.shape[1]):
        rates = np.where(known[:, s, None], np.stack([speed[:, s], acceleration[:, s]], axis=1), np.nan)
        own = np.stack([force[:, s].real, force[:, s].imag, none], axis=1)
        motions.append(MotionFromMarkers(rates[:, :1] * _NORMAL, rates[:, 1:] * _NORMAL, own, none, none, _UP))
    return motions


def _find_determined(states: States) -> BoolArray:
    """Return where (F, n + 1) markers of the same frame determine the pose of each segment; always for the base."""
    known = np.logical_and.accumulate(states.observed & np.isfinite(states.mean[..., 0]), axis=1)
    return np.concatenate([np.ones((len(known), 1), dtype=np.bool_), known], axis=1)


@dataclass(frozen=True)
class WornSensor:
    """A sensor on skin that follows the rotations of the joints beside it in part."""

    calibration: SensorCalibration
    prepared: PreparedSensor
    share: FloatArray  # (n,) fraction of each joint's rotation that the skin follows
    left: FloatArray  # (F,) angular velocity of the sensor minus that of the skin from the markers, rad/s


def calibrate_worn_sensor(  # noqa: PLR0917
    signals: SensorSignals,
    s: int,
    found: SensorCalibration,
    motion: MotionFromMarkers,
    states: States,
    time: FloatArray,
) -> WornSensor:
    """Estimate how far the skin under a sensor follows the joints beside it, and calibrate the sensor again with this.

    ``s`` is the segment, ``found`` the first calibration, and ``motion`` the motion of the segment from markers.
    """
    seen, rest = _find_determined(states)[:, s], np.nanmean(states.mean[..., 0], axis=0)
    first = prepare_sensor(signals, found, motion, time, seen, SHARES)
    beside = [j for j in (s - 1, s) if j < len(rest)]
    # the fractions of the joints' rates that add up best to the rate of the sensor relative to the segment
    off, rates = first.gyro[:, 2] - motion.omega[:, 2], states.mean[:, beside, 1]
    known = np.isfinite(off + rates.sum(axis=1))
    weight = 1.0 / (found.residual[0] ** 2 * found.correlated[0])
    normal = weight * rates[known].T @ rates[known] + np.eye(rates.shape[1]) / _SHARE_SD**2
    share = np.zeros(len(rest))
    share[beside] = np.linalg.solve(normal, weight * rates[known].T @ off[known])
    angle, rate, acceleration = ((states.mean[..., d] - rest * (d == 0)) @ share for d in range(3))
    skin = replace(
        motion,
        omega=motion.omega + rate[:, None] * _NORMAL,
        alpha=motion.alpha + acceleration[:, None] * _NORMAL,
        force=np.einsum("fij,fj->fi", so3.exp(-angle[:, None] * _NORMAL), motion.force),
    )
    clock = replace(found.clock, sd=np.inf) if found.clock.observable else found.clock
    again = calibrate_sensor(signals, skin, time, clock, follows=False, start=replace(found, lag=0.0)) or found
    prepared = prepare_sensor(signals, again, skin, time, seen, SHARES)
    return WornSensor(again, prepared, share, prepared.gyro[:, 2] - skin.omega[:, 2])


def _measure_drift(left: FloatArray, count: int, dt: float) -> FloatArray:
    """Return the standard deviations, rad, of an angular velocity (F,), rad/s, integrated over 0 … ``count`` frames."""
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


def _measure_residual(states: States, observed: FloatArray) -> float:
    """Return the rms distance, m, of the used markers from their predicted positions; infinite if none is used."""
    some = slice(None, None, max(1, len(observed) // _SOME))
    squares = np.sum((observed[some] - states.predicted_in(some)) ** 2, axis=2)[states.used[some]]
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else np.inf
