"""States of a planar chain from inertial sensors, beside markers, or alone on the chain of another trial.

Alone, the trial with markers calibrates the sensors on their segments. Dead reckoning then gives angles, biases and
clocks, and the filter smooths the corrected signals. The trial with markers is also tracked without its markers; the
differences give the persistent errors of mounting, chain and skin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from mocap_id.arrays import (
    GRAVITY,
    BoolArray,
    ComplexArray,
    FloatArray,
    as_complex,
    as_xy,
    find_runs,
    interpolate_gaps,
)
from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_kernels import Inertial
from mocap_id.estimation.filter_problem import (
    Anchors,
    FilterProblem,
    MarkerChain,
    filter_forwards,
    smooth_backwards,
)
from mocap_id.estimation.inertial import (
    WORSE,
    MotionFromMarkers,
    PreparedSensor,
    SensorCalibration,
    SensorResult,
    SensorSignals,
    calibrate_all,
    calibrate_sensor,
    find_observed_segments,
    measure_rms_distance,
    prepare_sensor,
)
from mocap_id.estimation.smoothing import FilterSettings, StateEstimator, States
from mocap_id.geometry import so3

SWITCHED_ON = 0.006  # standard deviation, rad/s, of the change of a gyroscope's bias from one recording to the next
FORCE_BIAS = 0.05  # standard deviation, m/s², of the change of an accelerometer's bias from one recording to the next

_KNOT = 10.0  # s between the values of a gyroscope's bias
_MOST_KNOTS = 12
_WALK = 2e-4  # rad/s/√s, random walk of a gyroscope's bias
_CLOCK = 0.1  # s, standard deviation between the clocks of two sensors
_SMOOTHED = 0.025  # s, standard deviation of the Gaussian window that smooths all signals of the fit
_ROUNDS = 8
_STEP = 1e-4  # of a parameter, for derivatives
_FAR = 4.0  # times the rms residual; farther samples count less
_MOST = 3000  # frames of the fit
_SD_FRAMES = 200  # frames in which the standard deviations of the angles are computed


@dataclass(frozen=True)
class KnownChain:
    """A chain of n joints and the sensors on it, from a trial with markers."""

    centres: FloatArray  # (n, 2) joint centres in the frame of the segment before, m
    calibrations: tuple[SensorCalibration, ...]  # of n sensors, one on each moving segment
    share: FloatArray  # (n, n) fraction of each joint's rotation (column) that the skin under each sensor follows
    rest: FloatArray  # (n,) joint angles at which the skin under the sensors is not rotated, rad
    density: FloatArray  # (n,) spectral density of each joint's snap, rad²/s⁷
    # (n, 3) rms errors of angle, rad, velocity, rad/s, and acceleration, rad/s², if they are estimated without markers
    errors: FloatArray | float = 0.0


@dataclass(frozen=True)
class Reckoning:
    """Motion of n segments at F times from their gyroscopes, with the parameters that the accelerometers determine.

    Biases are changes since the trial with markers.
    """

    angle: FloatArray  # (F, n) angles of the segments, rad
    angle_sd: FloatArray  # (F, n) standard deviations due to the parameters below, rad
    shift: FloatArray  # (n,) time on each sensor's clock minus the time on the first sensor's clock, s
    shift_sd: FloatArray  # (n,) standard deviations, s
    gyro_bias: FloatArray  # (F, n) bias of each gyroscope about the plane's normal, rad/s
    gyro_bias_sd: FloatArray  # (F, n) standard deviations, rad/s
    force_bias: FloatArray  # (n, 2) bias of each accelerometer, m/s²
    force_bias_sd: FloatArray  # (n, 2) standard deviations, m/s²
    residual: FloatArray  # (n,) rms residual of a component of each accelerometer, m/s²


class DeadReckoning:
    """Least-squares fit to the accelerometers of the motion from the gyroscopes.

    ``signals`` are those of the sensors on the moving segments 1 … n; ``time`` (F,) are uniform times on the first
    sensor's clock, s.
    """

    def __init__(self, signals: Sequence[SensorSignals], time: FloatArray, chain: KnownChain) -> None:
        self._signals, self.time, self.chain = tuple(signals), time, chain
        self._dt, n = float(time[1] - time[0]), len(signals)
        count = int(np.clip(1 + round((time[-1] - time[0]) / _KNOT), 2, _MOST_KNOTS))
        self._knots = np.linspace(time[0], time[-1], count)
        self._links = as_complex(chain.centres)
        self._place = np.array([complex(*each.place[:2]) for each in chain.calibrations])
        self._skin = chain.share @ (np.eye(n) - np.eye(n, k=-1))  # for the angles of the segments, not of the joints
        self._resting = chain.share @ chain.rest
        self._to_segments = np.linalg.inv(np.eye(n) + self._skin)
        self._half = int(np.ceil(3 * _SMOOTHED / self._dt))
        window = np.exp(-0.5 * (np.arange(-self._half, self._half + 1) * self._dt / _SMOOTHED) ** 2)
        self._window = window / window.sum()
        ends = np.cumsum([0, n, n * count, 2 * n, n - 1]).tolist()
        self._at = [slice(a, b) for a, b in pairwise(ends)]
        self._size = ends[-1]
        self._some = np.arange(0, len(time), max(1, -(-len(time) // _MOST)))
        self.sample = lru_cache(maxsize=2 * n)(self._sample)

    def _sample(self, shift: tuple[float, ...]) -> tuple[FloatArray, ComplexArray]:
        """Return angular velocities (F, n), rad/s, and specific forces (F, n), m/s², of the skin under each sensor.

        ``shift`` (n,) are the clocks, s. Forces are x + 1j y in the skin's axes. Missing values are NaN.
        """
        parts = [self.prepare(k, each) for k, each in enumerate(shift)]
        return np.stack([gyro[:, 2] for gyro, _ in parts], 1), np.stack([as_complex(f[:, :2]) for _, f in parts], 1)

    def prepare(self, k: int, shift: float) -> tuple[FloatArray, FloatArray]:
        """Return the angular velocity, rad/s, and specific force, m/s², (F, 3) of sensor k in the axes of its segment.

        They are corrected by the biases of the calibration. ``shift`` is the sensor's clock relative to the first, s.
        """
        still, none = np.zeros(len(self.time)), np.zeros((len(self.time), 3))
        motion = MotionFromMarkers(none, none, none, still, still, np.array([0.0, 1.0, 0.0]))
        found = self.chain.calibrations[k]
        found = replace(found, clock=replace(found.clock, offset=-shift, drift=0.0))
        prepared = prepare_sensor(self._signals[k], found, motion, self.time, still == 0.0, SHARES)
        return prepared.gyro, prepared.force

    def solve(self) -> Reckoning:
        """Return the motion and the parameters that fit best, by Gauss–Newton with weak priors."""
        # inverse covariance of the prior; the constants of the angles have none
        prior, free, count = np.zeros((self._size, self._size)), np.ones(self._size), len(self._knots)
        walk = np.diff(np.eye(count), axis=0) / (_WALK * np.sqrt(np.diff(self._knots)))[:, None]
        bias = walk.T @ walk
        bias[0, 0] += 1.0 / SWITCHED_ON**2
        prior[self._at[1], self._at[1]] = np.kron(np.eye(len(self._signals)), bias)
        for part, sd in ((self._at[2], FORCE_BIAS), (self._at[3], _CLOCK)):
            prior[part, part] = np.eye(part.stop - part.start) / sd**2
        free[self._at[0]] = 0.0

        # constants of the angles for which measured and expected forces agree in direction
        unknowns = np.zeros(self._size)
        _, _, _, shift = self._split(unknowns)
        angle, speed, acceleration = self._motion(unknowns)
        force, start = self.sample(tuple(shift))[1], np.zeros(len(self._signals))
        for _ in range(3):  # the rotation of the skin depends on the angle
            off = np.nansum(self._expect(start + angle, speed, acceleration) * np.conj(force), axis=0)
            start = start + self._to_segments @ np.angle(off)
        unknowns[self._at[0]] = start

        # Gauss–Newton
        spread = np.array([each.residual[1] * np.sqrt(each.correlated[1]) for each in self.chain.calibrations])
        spread *= len(self.time) ** -0.5 * len(self._some) ** 0.5  # thinned samples are less correlated
        for _ in range(_ROUNDS):
            off = self._residual(unknowns)
            rows = np.stack([(self._residual(unknowns + _STEP * e) - off) / _STEP for e in np.eye(self._size)], 2)
            there = np.isfinite(off) & np.isfinite(rows).all(axis=2)
            usual = np.sqrt(np.mean(np.abs(off[there]) ** 2))
            weight = 1.0 / (spread * np.sqrt(np.fmax(1.0, np.abs(off) / (_FAR * usual))))
            rows, off = (rows * weight[..., None])[there], (off * weight)[there]
            normal = np.real(rows.conj().T @ rows) + prior
            step = -np.linalg.solve(normal, np.real(rows.conj().T @ off) + prior @ (free * unknowns))
            unknowns = unknowns + step
            if np.max(np.abs(step) * np.sqrt(np.diagonal(normal))) < 1e-2:
                break

        # standard deviations
        covariance = np.linalg.inv(normal)
        sd = np.sqrt(np.diagonal(covariance))
        _, gyro_bias, force_bias, shift = self._split(unknowns)
        angle, off = self._motion(unknowns)[0], self._residual(unknowns)
        some = np.unique(np.linspace(0, len(angle) - 1, _SD_FRAMES).astype(np.int64))
        moved = [self._motion(unknowns + _STEP * e)[0][some] for e in np.eye(self._size)]
        slopes = (np.stack(moved, axis=2) - angle[some, :, None]) / _STEP
        variance = np.einsum("fkp,pq,fkq->kf", slopes, covariance, slopes)
        knots = sd[self._at[1]].reshape(len(self._signals), -1)
        return Reckoning(
            angle=angle,
            angle_sd=np.stack([np.interp(self.time, self.time[some], np.sqrt(each)) for each in variance], axis=1),
            shift=shift,
            shift_sd=np.concatenate([[0.0], sd[self._at[3]]]),
            gyro_bias=gyro_bias,
            gyro_bias_sd=np.stack([np.interp(self.time, self._knots, each) for each in knots], axis=1),
            force_bias=as_xy(force_bias),
            force_bias_sd=sd[self._at[2]].reshape(-1, 2),
            residual=np.sqrt(np.nanmean(np.abs(off) ** 2, axis=0) / 2),
        )

    def _split(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray, ComplexArray, FloatArray]:
        """Return the parameters of the fit.

        They are the constants (n,) of the angles, rad, the changes (F, n) of the gyroscopes' biases, rad/s, the changes
        (n,) of the accelerometers' biases, m/s², and the clocks (n,), s.
        """
        start, bias, force, shift = (unknowns[each] for each in self._at)
        knots = bias.reshape(len(self._signals), -1)
        every = np.stack([np.interp(self.time, self._knots, each) for each in knots], axis=1)
        return start, every, as_complex(force.reshape(-1, 2)), np.concatenate([[0.0], shift])

    def _smooth(self, values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        ends = [np.repeat(each, self._half, axis=0) for each in (values[:1], values[-1:])]
        padded = np.concatenate([ends[0], values, ends[1]])
        return np.stack([np.convolve(each, self._window, mode="valid") for each in padded.T], axis=1)

    def _motion(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return angles, angular velocities and angular accelerations (F, n) of the segments."""
        start, bias, _, shift = self._split(unknowns)
        speed = (interpolate_gaps(self.sample(tuple(shift))[0]) - bias) @ self._to_segments.T
        integral = np.cumsum((speed[1:] + speed[:-1]) / 2, axis=0) * self._dt
        smooth = self._smooth(speed)
        angle = start + np.concatenate([np.zeros((1, len(start))), integral])
        return angle, smooth, np.gradient(smooth, self._dt, axis=0)

    def _expect(self, angle: FloatArray, speed: FloatArray, acceleration: FloatArray) -> ComplexArray:
        """Return the specific forces (F, n), m/s², that the accelerometers should measure for a motion (F, n)."""
        rotation, weight = np.exp(1j * angle), 1j * acceleration - speed**2
        carried = np.cumsum(weight[:, :-1] * self._links[1:] * rotation[:, :-1], axis=1)
        carried = np.concatenate([np.zeros((len(angle), 1)), carried], axis=1)
        skin = angle @ self._skin.T - self._resting
        total = carried + weight * self._place * rotation + 1j * GRAVITY
        return np.asarray(total * np.exp(-1j * (angle + skin)))

    def _residual(self, unknowns: FloatArray) -> ComplexArray:
        """Return measured minus expected forces (f, n), m/s², at the frames of the fit; NaN where not measured."""
        _, _, bias, shift = self._split(unknowns)
        measured = self._smooth(self.sample(tuple(shift))[1]) - bias
        return np.asarray((measured - self._expect(*self._motion(unknowns)))[self._some])


_GATE = 8.0  # largest innovation in the filter, in standard deviations
_ACCELERATION_SHARE = 0.35  # factor on the filter's sd, from simulated people: it treats lasting errors as white noise
_LEAST = 1.0  # s, least time that the logs must have in common
_MARGIN = 0.3  # s left out at both ends, because the clocks of the sensors may differ


def calibrate_chain(
    states: States, time: FloatArray, sensors: Mapping[int, SensorSignals], density: FloatArray
) -> KnownChain:
    """Calibrate the sensors on a trial with markers, and track the same trial without the markers.

    ``states`` are those of the trial with markers; only ``mean``, ``observed`` and ``chain`` are used. ``time`` (F,)
    are uniform times of the cameras, s. ``sensors`` has one sensor for each moving segment 1 … n. ``density`` (n,) is
    the spectral density of each joint's snap, rad²/s⁷.

    NumericalError is raised if a sensor contradicts the markers, the logs have no time in common, or a covariance is
    not positive definite.
    """
    rate = (len(time) - 1) / float(time[-1] - time[0])
    motions = compute_segment_motions(states, rate)
    results = calibrate_all(sensors, motions, time)
    calibrations, shares = [], []
    for s in range(1, len(motions)):
        result = results[s]
        if result.used is None:
            raise NumericalError(f"segment {s}: {result.why}")
        found, share, _, _ = calibrate_worn_sensor(sensors[s], s, result.used, motions[s], states, time)
        calibrations.append(found)
        shares.append(share)
    rest = np.nanmean(states.mean[..., 0], axis=0)
    known = KnownChain(states.chain.centres, tuple(calibrations), np.array(shares), rest, density)
    signals = [sensors[s] for s in range(1, len(motions))]
    stamps = calibrations[0].clock.stamps(time)
    first, last = max(each.time[0] for each in signals), min(each.time[-1] for each in signals)
    inside = np.flatnonzero((stamps > first + _MARGIN) & (stamps < last - _MARGIN))
    if len(inside) < _LEAST * rate:
        raise NumericalError(
            f"by their times the logs have only {len(inside) / rate:.1f} s in common with each other and with the "
            "markers: use logs of one recording, of sensors whose clocks started together"
        )
    mean, _, _ = _track(DeadReckoning(signals, stamps[inside], known))
    off = mean[..., :3] - states.mean[inside][..., :3]
    return replace(known, errors=np.sqrt(np.nanmean(off**2, axis=0)))


def track_without_markers(
    signals: Sequence[SensorSignals], time: FloatArray, chain: KnownChain
) -> tuple[FloatArray, FloatArray, Reckoning, FloatArray]:
    """Return the states of the joints from ``signals``, those of the sensors on the moving segments 1 … n.

    They are the states (F, n, 4), the standard deviations (F, n, 3) of angle, velocity and acceleration, and the motion
    before the filter, with biases and clocks. The last result (3, n) shows whether the sensors left the plane: mean
    specific force out of it, m/s², not zero if a sensor was rotated; rotation of each sensor about the vertical between
    start and end, rad, and its standard deviation. ``time`` (F,) are uniform times on the first sensor's clock, s.

    Raise NumericalError if a covariance is not positive definite.
    """
    problem = DeadReckoning(signals, time, chain)
    mean, sd, reckoning = _track(problem)
    variance = sd[..., :3] ** 2
    variance[..., 2] *= _ACCELERATION_SHARE**2
    lasting = np.broadcast_to(chain.errors**2, variance.shape).copy()
    before = np.concatenate([np.zeros((len(sd), 1)), reckoning.angle_sd[:, :-1]], axis=1)
    lasting[..., 0] += np.hypot(reckoning.angle_sd, before) ** 2
    # out of the plane: mean force, and rotation about the vertical
    beyond = np.empty((3, len(signals)))
    duration = float(time[-1] - time[0])
    for k, found in enumerate(chain.calibrations):
        gyro, force = problem.prepare(k, float(reckoning.shift[k]))
        upwards = as_xy(1j * np.exp(-1j * reckoning.angle[:, k]))
        beyond[0, k] = np.nanmean(force[:, 2])
        beyond[1, k] = np.nanmean(np.sum(gyro[:, :2] * upwards, axis=1)) * duration
        beyond[2, k] = np.hypot(SWITCHED_ON, np.mean(found.sd["gyro_bias"])) * duration
    return mean, np.sqrt(variance + lasting), reckoning, beyond


def _track(reckoned: DeadReckoning) -> tuple[FloatArray, FloatArray, Reckoning]:
    """Return the filter's states (F, n, 4), their standard deviations (F, n, 4), and the motion before the filter."""
    reckoning, known = reckoned.solve(), reckoned.chain
    gyro, force = reckoned.sample(tuple(reckoning.shift))
    residual = np.array([each.residual for each in known.calibrations])
    residual[:, 1] = np.fmax(residual[:, 1], reckoning.residual)
    joints = np.diff(reckoning.angle, axis=1, prepend=0.0)
    frames, n = joints.shape
    none = np.zeros(0)
    problem = FilterProblem(
        observed=np.zeros((frames, 0, 2)),
        dt=float(reckoned.time[1] - reckoned.time[0]),
        chain=MarkerChain(known.centres.copy(), none.astype(np.int64), np.zeros((0, 2))),
        variance=none,
        gate_variance=none,
        gate=_GATE,
        density=known.density,
        anchors=Anchors(  # only the first frame counts: the filter starts there
            joints,
            np.tile(np.eye(n), (frames, 1, 1)),
            np.zeros(joints.shape, np.bool_),
            np.zeros((frames, 0), np.bool_),
        ),
        inertial=Inertial(
            segment=np.arange(1, n + 1),
            place=np.array([each.place[:2] for each in known.calibrations]),
            share=known.share,
            rest=known.rest,
            signal=np.concatenate(
                [(gyro - reckoning.gyro_bias)[..., None], as_xy(force) - reckoning.force_bias], axis=2
            ),
            variance=np.tile((np.array(SHARES) * residual) ** 2, (frames, 1, 1)),
            gravity=GRAVITY,
        ),
    )
    mean, sd = smooth_backwards(problem, filter_forwards(problem)).by_joint()
    return mean, sd, reckoning


SHARES = (1.5, 1.5)
"""As :data:`mocap_id.estimation.inertial.SHARES`, but larger, because hinges can follow rotating skin."""

_SHARE_SD = 0.05  # standard deviation of the fraction of a joint's rotation that the skin under a sensor follows
_COVERED, _QUANTILE = 0.95, 1.645  # fraction of intervals whose drift is covered; this quantile in standard deviations
_SOME = 500  # frames, for the residual
_NORMAL, _UP = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])


def smooth_with_sensors(
    observed: FloatArray,
    time: FloatArray,
    chain: MarkerChain,
    *,
    sensors: Mapping[int, SensorSignals],
    settings: FilterSettings,
) -> tuple[States, dict[int, SensorResult]]:
    """Return the states of every joint from markers and inertial sensors, and the result of each sensor by segment.

    If all sensors are left out, the states come from the markers alone. The markers are as for
    :func:`mocap_id.estimation.smooth`; ``observed`` is changed in place as with its ``overwrite``. ``time`` (F,) are
    uniform times of the cameras, s. ``sensors`` are numbered by their segment, 0 = base.

    Raise NumericalError if a covariance is not positive definite.
    """
    rate = (len(time) - 1) / float(time[-1] - time[0])
    times = time[0] + np.arange(len(time)) / rate
    trial = StateEstimator(observed, rate, chain, settings)
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
    results |= {s: replace(results[s], calibration=found) for s, (found, *_) in worn.items()}
    try:
        calibrations, shares, ready, _ = zip(*worn.values(), strict=True)
        both = trial.estimate(
            Inertial(
                segment=np.array(list(worn), dtype=np.int64),
                place=np.array([each.place[:2] for each in calibrations]),
                share=np.array(shares),
                rest=np.nanmean(alone.mean[..., 0], axis=0),
                signal=np.stack([np.column_stack([each.gyro[:, 2], each.force[:, :2]]) for each in ready], axis=1),
                variance=np.stack([each.variance for each in ready], axis=1),
                gravity=GRAVITY,
            )
        )
        some = slice(None, None, max(1, len(observed) // _SOME))
        off, usual = (
            measure_rms_distance(observed[some], each.predicted_in(some), each.used[some]) for each in (both, alone)
        )
        if not off < WORSE * usual:
            raise NumericalError("the sensors pull the chain away from the markers")
    except NumericalError as error:
        return alone, {s: replace(each, why=each.why or str(error)) for s, each in results.items()}
    # in gaps, the standard deviations increase by the drift of the angles from the sensors
    sd, gaps = both.sd.copy(), [find_runs(~each) for each in both.observed.T]
    longest = max((run.stop - run.start for runs in gaps for run in runs), default=0)
    drifts = {s: _measure_drift(left, longest, 1.0 / rate) ** 2 for s, (*_, left) in worn.items()} if longest else {}
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


def calibrate_worn_sensor(  # noqa: PLR0917
    signals: SensorSignals,
    s: int,
    found: SensorCalibration,
    motion: MotionFromMarkers,
    states: States,
    time: FloatArray,
) -> tuple[SensorCalibration, FloatArray, PreparedSensor, FloatArray]:
    """Estimate how far the skin under a sensor follows the joints beside it, and calibrate the sensor again with this.

    ``s`` is the segment, ``found`` the first calibration, and ``motion`` the motion of the segment from markers. Return
    the new calibration, the fraction (n,) of each joint's rotation that the skin follows, the signals of the sensor,
    and its angular velocity (F,) minus that of the skin from the markers, rad/s.
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
    return again, share, prepared, prepared.gyro[:, 2] - skin.omega[:, 2]


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
