"""Inertial sensors beside markers: clock, mounting, biases and noise of each sensor, from the motion of its segment.

The motion is estimated from the markers alone, in the plane or in space (docs/concepts/inertial-sensors.md).

A sensor at the position r has the mounting M, a rotation from sensor to segment. The skin under it lags: it does not
follow the fraction s of the segment's axial rotation τ about the long axis l. With E = exp(s τ l), the sensor measures

    gyroscope      A_g Mᵀ E (ω − s τ' l) + b_g
    accelerometer  A_a Mᵀ E (f + α × r + ω × (ω × r)) + b_a

at the times of its clock. The angular velocity ω, the angular acceleration α and the specific force f at the segment's
origin are in the segment's axes. The scales A_g and A_a are diagonal, and b_g and b_a are biases. Both residuals are
correlated over time, because errors of markers and skin persist over successive frames. Their weights are therefore
divided by the number of correlated samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline

from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.verdict import Reason

_GAP = 2.5  # times the usual time between samples; a longer time is a gap
_AVERAGED = 1.5  # samples in a frame; if there are more, they are averaged
_PINNED = 3  # number of successive samples at the largest value of a channel from which they are saturated


@dataclass(frozen=True)
class MotionFromMarkers:
    """Motion of a segment at F frames, in its own axes; NaN where unknown."""

    omega: FloatArray  # (F, 3) angular velocity, rad/s
    alpha: FloatArray  # (F, 3) angular acceleration, rad/s²
    force: FloatArray  # (F, 3) acceleration of the origin minus gravity, m/s²
    axial: FloatArray  # (F,) axial rotation relative to the parent, rad; zero for the base
    axial_rate: FloatArray  # (F,) its rate, rad/s
    long_axis: FloatArray  # (3,) unit vector of the axial rotation

    @property
    def known(self) -> BoolArray:
        """Whether (F,) the motion is known in a frame."""
        return np.asarray(np.isfinite(self.omega[:, 0] + self.alpha[:, 0] + self.force[:, 0] + self.axial_rate))

    def select(self, frames: IntArray) -> MotionFromMarkers:
        """Return the motion in the chosen frames."""
        names = ("omega", "alpha", "force", "axial", "axial_rate")
        return replace(self, **{name: getattr(self, name)[frames] for name in names})


@dataclass(frozen=True)
class SensorSignals:
    """K samples of a sensor on its own clock."""

    time: FloatArray  # (K,) increasing times, s
    gyro: FloatArray  # (K, 3) angular velocity in the sensor's axes, rad/s
    acc: FloatArray  # (K, 3) specific force in the sensor's axes, m/s²
    reasons: tuple[Reason, ...] = ()  # about samples that the reader left out

    @cached_property
    def rate(self) -> float:
        """Samples per second."""
        return float(1.0 / np.median(np.diff(self.time)))

    @cached_property
    def saturated(self) -> BoolArray:
        """Whether each sample (K,) is in a run of samples in which a channel stays at its largest or smallest value."""
        both = np.concatenate([self.gyro, self.acc], axis=1)
        found = np.zeros(len(both), dtype=np.bool_)
        for values in (both, -both):
            top = (values == values.max(axis=0)) & (values.max(axis=0) > 4 * np.std(values, axis=0))
            successive = np.stack([top[k : len(top) - _PINNED + 1 + k] for k in range(_PINNED)])
            run = np.asarray(np.any(np.all(successive, axis=0), axis=1))
            for k in range(_PINNED):
                found[k : len(run) + k] |= run
        return found

    @cached_property
    def noise(self) -> FloatArray:
        """Standard deviations (2,) of the white noise of one sample: gyroscope, rad/s, and accelerometer, m/s²."""
        found = []
        for values in (self.gyro, self.acc):
            bends = np.abs(np.diff(values, 3, axis=0))
            step = np.unique(np.abs(np.diff(values[:, 0])))
            least = float(step[step > 0].min(initial=np.inf)) / np.sqrt(12) if len(step) > 1 else 0.0
            quiet = np.quantile(bends, 0.5, axis=0) / (0.6745 * np.sqrt(20.0))
            found.append(max(float(np.sqrt(np.mean(quiet**2))), least if np.isfinite(least) else 0.0, 1e-9))
        return np.array(found)

    @cached_property
    def _splines(self) -> CubicSpline:
        return CubicSpline(self.time, np.concatenate([self.gyro, self.acc], axis=1))

    def at(self, time: FloatArray, frame: float, order: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return gyroscope (F, 3) and accelerometer (F, 3) at times (F,) of the sensor's clock, s.

        ``order`` is the order of the derivative that is returned. If a frame, which takes ``frame`` seconds, contains
        several samples, they are averaged. The result is NaN in gaps, at saturated samples, and beyond the ends.
        """
        if self.rate * frame > _AVERAGED:
            total = self._splines.antiderivative()
            both = (total(time + frame / 2, order) - total(time - frame / 2, order)) / frame
        else:
            both = self._splines(time, order)
        after = np.searchsorted(self.time, time).clip(1, len(self.time) - 1)
        covered = self.time[after] - self.time[after - 1] < _GAP / self.rate
        covered &= (time >= self.time[0]) & (time <= self.time[-1])
        covered &= ~self.saturated[after] & ~self.saturated[after - 1]
        both[~covered] = np.nan
        return both[:, :3], both[:, 3:]


OBSERVABLE_SD = 2e-3  # largest standard deviation, s, of a clock that the motion determines

_LEAST_OVERLAP = 0.5  # of the shorter record


@dataclass(frozen=True)
class Clock:
    """Clock of a sensor: a sample stamped t was taken at the cameras' time ``offset + t (1 + drift)``."""

    offset: float  # s
    drift: float = 0.0  # s/s
    sd: float = np.inf  # standard deviation in the middle of the trial, s
    observable: bool = False  # the motion determines the clock; otherwise it is another sensor's clock, or zero

    def stamps(self, time: FloatArray) -> FloatArray:
        """Return the sensor's time stamps at times of the cameras, s."""
        return np.asarray((time - self.offset) / (1.0 + self.drift))


def find_clock(signals: SensorSignals, motion: MotionFromMarkers, time: FloatArray) -> tuple[float, float]:
    """Return the clock offset, s, at which angular speeds of sensor and segment correlate best, and the correlation.

    ``time`` (F,) are uniform times of the cameras, s. Both are zero if the motion is known in no frame.
    """
    step = float(time[1] - time[0])
    known = motion.known
    if not known.any():
        return 0.0, 0.0
    speed = np.linalg.norm(motion.omega, axis=1)
    first = np.where(known, speed - speed[known].mean(), 0.0)
    stamps = np.arange(signals.time[0], signals.time[-1], step)
    gyro = np.linalg.norm(signals.gyro - np.median(signals.gyro, axis=0), axis=1)
    second = np.interp(stamps, signals.time, gyro)
    second -= second.mean()
    size = 1 << int(np.ceil(np.log2(len(first) + len(second))))

    def shifted(a: FloatArray, b: FloatArray) -> FloatArray:
        """Return the sums over k of a[k + lag] b[k] for lags from 1 - len(b)."""
        product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        return np.concatenate([product[size - len(b) + 1 :], product[: len(a)]])

    there, all_there = known.astype(np.float64), np.ones(len(second))
    count = shifted(there, all_there)
    power = shifted(first**2, all_there) * shifted(there, second**2)
    enough = count > _LEAST_OVERLAP * min(known.sum(), len(second))
    correlation = np.where(enough & (power > 0), shifted(first, second) / np.sqrt(np.maximum(power, 1e-30)), -1.0)
    best = int(np.argmax(correlation))
    return float(time[0] - stamps[0] + (best + 1 - len(second)) * step), float(correlation[best])


_ROUNDS, _SETTLED = 12, 0.05  # iterations of the search, and the change, in standard deviations, at which it ends
_MOST, _FEW, _ENOUGH = 3000, 500, 25.0  # frames, and frames per second: residuals are correlated over 0.5 s or more
_FAR = 5.0  # times the rms residual; samples with a larger residual do not count
_GYRO_SD, _FORCE_SD = 0.05, 0.5  # rad/s and m/s², for the first weights
_PRIOR = {
    **{"turn": 10.0, "gyro_scale": 5e-3, "lag": 0.15, "gyro_bias": 0.2},
    **{"shift": 0.05, "drift": 1e-4, "place": 0.3, "acc_scale": 5e-3, "acc_bias": 0.5},
}
"""Prior standard deviations of the parameters: rad, –, –, rad/s, s, –, m, –, m/s²."""
_USUAL_LAG = 0.1
_IN_PHASE = 0.12  # fraction of the residual that skin may make proportional to the acceleration, like a late clock
_SIZES = (
    *(("turn", 3), ("gyro_scale", 3), ("lag", 1), ("gyro_bias", 3), ("shift", 1), ("drift", 1)),
    *(("place", 3), ("acc_scale", 3), ("acc_bias", 3)),
)
_ENDS = np.cumsum([size for _, size in _SIZES]).tolist()
_AT = {name: slice(end - size, end) for (name, size), end in zip(_SIZES, _ENDS, strict=True)}
_COUNT = _ENDS[-1]
_VECTORS = ("gyro_scale", "gyro_bias", "place", "acc_scale", "acc_bias")


@dataclass(frozen=True)
class SensorCalibration:
    """Parameters of a sensor on its segment."""

    clock: Clock
    mount: FloatArray  # (3, 3) rotation from the sensor to its segment
    place: FloatArray  # (3,) position in the segment's frame, m
    lag: float  # fraction of the segment's axial rotation that the skin under the sensor does not follow
    gyro_scale: FloatArray  # (3,) relative error of the gyroscope's scale
    gyro_bias: FloatArray  # (3,) rad/s
    acc_scale: FloatArray  # (3,) relative error of the accelerometer's scale
    acc_bias: FloatArray  # (3,) m/s²
    sd: dict[str, FloatArray]  # standard deviations by these names; mounting: ``turn`` (3,), rad; clock: ``shift``, s
    residual: FloatArray  # (2,) rms residual of a component: gyroscope, rad/s, and accelerometer, m/s²
    correlated: FloatArray  # (2,) number of successive frames with correlated residuals: gyroscope, accelerometer
    segment_rate: float  # rms of the segment's angular velocity, rad/s


def calibrate_sensor(
    signals: SensorSignals,
    motion: MotionFromMarkers,
    time: FloatArray,
    clock: Clock,
    *,
    follows: bool = True,
    start: SensorCalibration | None = None,
) -> SensorCalibration | None:
    """Return the parameters of a sensor on a segment; None if sensor and motion have too few samples in common.

    ``motion`` comes from markers alone at ``time`` (F,), uniform times of the cameras, s. The search starts from
    ``clock`` and, if given, from ``start``, for example the result for almost the same motion. The standard deviation
    of ``clock``, if finite, is that of its prior. If ``follows``, the lag of the skin is estimated; otherwise it is
    zero.
    """
    frame = float(time[1] - time[0])
    thin = max(1, -(-len(time) // _MOST), min(int(1.0 / (_ENOUGH * frame)), len(time) // _FEW))  # every thin-th frame
    some = np.arange(0, len(time), thin)
    seen = motion.known[some]
    some = some[seen & np.isfinite(signals.at(clock.stamps(time[some]), frame)[0][:, 0])]
    if len(some) < 50:
        return None
    given = motion.select(some)
    follows = follows and bool(np.std(given.axial) > 0)
    prior = np.concatenate([np.full(size, _PRIOR[name]) for name, size in _SIZES])
    prior[_AT["shift"]] = min(clock.sd, 0.5) if np.isfinite(clock.sd) else _PRIOR["shift"]
    if not follows:
        prior[_AT["lag"]] = 1e-9
    found = start
    if found is None:  # the mounting that fits both signals best, the gyroscope's bias, other errors zero
        gyro, acc = signals.at(clock.stamps(time[some]), frame)
        there = np.isfinite(gyro[:, 0])
        bias = np.median(gyro[there], axis=0)
        product = (given.omega[there] - given.omega[there].mean(axis=0)).T @ (gyro[there] - bias) / _GYRO_SD**2
        product += given.force[there].T @ acc[there] / _FORCE_SD**2
        u, _, v = np.linalg.svd(product)
        mount = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
        zero, none = np.zeros(3), np.zeros(2)
        found = SensorCalibration(clock, mount, zero, 0.0, zero, bias, zero, zero, {}, none, none, 0.0)
    middle = float(time[len(time) // 2])  # the time at which the clock is shifted
    at_middle = float(clock.stamps(np.array(middle)))
    for _ in range(_ROUNDS):
        rows, off, kept = _residuals(signals, given, time[some], frame, found, middle)
        residual, correlated = _measure_residuals(off, kept)
        weight = np.fmin(residual, 4 * np.array([_GYRO_SD, _FORCE_SD])) * np.sqrt(correlated)
        by = np.repeat(kept / weight, 3, axis=1).reshape(-1)
        rows, off = rows.reshape(-1, rows.shape[2]) * by[:, None], off.reshape(-1) * by
        normal = rows.T @ rows + np.diag(1.0 / prior**2)
        # the parameters minus their prior values; zero for the mounting, which has no prior value
        stamp, away = float(found.clock.stamps(np.array(middle))), np.zeros(_COUNT)
        for name in _VECTORS:
            away[_AT[name]] = getattr(found, name)
        away[_AT["lag"]] = found.lag - _USUAL_LAG * follows
        away[_AT["drift"]] = found.clock.drift - clock.drift
        away[_AT["shift"]] = at_middle - stamp
        step = np.linalg.solve(normal, rows.T @ off - away / prior**2)
        stamp -= float(step[_AT["shift"]][0])
        drift = found.clock.drift + float(step[_AT["drift"]][0])
        found = replace(
            found,
            clock=replace(found.clock, offset=middle - stamp * (1 + drift), drift=drift),
            mount=found.mount @ so3.exp(step[_AT["turn"]]),
            lag=found.lag + float(step[_AT["lag"]][0]),
            **{name: getattr(found, name) + step[_AT[name]] for name in _VECTORS},
        )
        if np.max(np.abs(step) * np.sqrt(np.diagonal(normal))) < _SETTLED:
            break
    sd = np.sqrt(np.diagonal(np.linalg.inv(normal)))
    spread = {name: sd[at] for name, at in _AT.items()}
    slope = float(np.sqrt(np.sum(motion.alpha[some] ** 2) / len(some)))
    clock_sd = float(np.hypot(spread["shift"][0], _IN_PHASE * np.sqrt(3.0) * residual[0] / max(slope, 1e-9)))
    rate = float(np.sqrt(np.mean(np.sum(given.omega**2, axis=1))))
    settled = replace(found.clock, sd=clock_sd, observable=clock_sd <= OBSERVABLE_SD)
    return replace(found, clock=settled, sd=spread, residual=residual, correlated=correlated * thin, segment_rate=rate)


def _residuals(  # noqa: PLR0917
    signals: SensorSignals,
    motion: MotionFromMarkers,
    time: FloatArray,
    frame: float,
    at: SensorCalibration,
    middle: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return derivatives (F, 6, p) of the expected signals by p parameters, residuals (F, 6), and weights (F, 2).

    ``at`` are the parameters. A weight is 0 for a missing or distant sample of gyroscope or accelerometer, otherwise 1.
    """
    stamps = at.clock.stamps(time)
    measured = np.concatenate(signals.at(stamps, frame), axis=1)
    slope = np.concatenate(signals.at(stamps, frame, 1), axis=1)
    along = motion.long_axis
    skin = so3.exp(at.lag * motion.axial[:, None] * along)
    back = at.mount.T @ skin
    lever = so3.hat(motion.alpha) + so3.hat(motion.omega) @ so3.hat(motion.omega)
    seen = np.einsum("fij,fj->fi", back, motion.omega - at.lag * motion.axial_rate[:, None] * along)
    felt = np.einsum("fij,fj->fi", back, motion.force + lever @ at.place)
    expected = np.concatenate([(1 + at.gyro_scale) * seen + at.gyro_bias, (1 + at.acc_scale) * felt + at.acc_bias], 1)
    rows = np.zeros((len(time), 6, _COUNT))
    turned = at.mount.T @ along
    swing = motion.axial[:, None] * turned
    for part, vector, name in ((slice(0, 3), seen, "gyro"), (slice(3, 6), felt, "acc")):
        rows[:, part, _AT["turn"]] = so3.hat(vector)
        rows[:, part, _AT[f"{name}_scale"]] = vector[:, :, None] * np.eye(3)
        rows[:, part, _AT[f"{name}_bias"]] = np.eye(3)
        rows[:, part, _AT["lag"].start] = np.cross(swing, vector)
    rows[:, :3, _AT["lag"].start] -= motion.axial_rate[:, None] * turned
    rows[:, 3:, _AT["place"]] = back @ lever
    rows[:, :, _AT["shift"].start] = slope
    rows[:, :, _AT["drift"].start] = slope * (time - middle)[:, None]
    off = measured - expected
    there = np.isfinite(off).all(axis=1) & np.isfinite(slope).all(axis=1)
    size = np.stack([np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)], axis=1)
    usual = np.sqrt(np.mean(size[there] ** 2, axis=0))
    off[~there], rows[~there] = 0.0, 0.0
    return rows, off, (there[:, None] & (size < _FAR * usual)).astype(np.float64)


def _measure_residuals(off: FloatArray, kept: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rms residual (2,) of a component, and the number (2,) of successive samples that are correlated."""
    rms, correlated = np.empty(2), np.empty(2)
    padded = next_fast_len(2 * len(off), real=True)
    for k in range(2):
        own = off[:, 3 * k : 3 * k + 3] * kept[:, k : k + 1]
        rms[k] = np.sqrt(np.sum(own**2) / max(3 * kept[:, k].sum(), 1.0))
        power = np.abs(rfft(own - own.mean(axis=0), padded, axis=0)) ** 2
        lags = irfft(power.sum(axis=1), padded)[: len(own)]
        ends = np.flatnonzero(lags <= 0)
        last = int(ends[0]) if len(ends) else len(lags)
        correlated[k] = 1.0 + 2.0 * float(np.sum(lags[1:last])) / max(float(lags[0]), 1e-30)
    return np.maximum(rms, 1e-9), correlated


SHARES = (0.5, 1.0)
"""Standard deviations of gyroscope and accelerometer in the filter, relative to the rms residuals of the calibration.

The skin rotates a sensor on its segment, and the chain cannot follow this rotation. With smaller values, the joints
would follow the skin.
"""

_MOST_OFF = 0.35  # largest rms difference of a gyroscope, relative to the segment's rms angular velocity
_LEAST_RATE = 0.15  # rad/s
_MOST_FORCE, _MOST_BIAS = 2.0, 3.0  # m/s²
_LAG_SD = 0.08  # standard deviation of the lag, because the skin under markers and sensor lags by changing fractions
_UNKNOWN_AXIAL, _BRIDGED_AXIAL = 0.3, 0.1  # rad, sd of the axial rotation in gaps: interpolated, and from sensors


@dataclass(frozen=True)
class PreparedSensor:
    """Signals and noise of a sensor for a filter, at F frames, in the segment's axes."""

    gyro: FloatArray  # (F, 3) angular velocity of the skin under the sensor, rad/s; NaN where missing
    force: FloatArray  # (F, 3) specific force at the sensor, m/s²; NaN where missing
    variance: FloatArray  # (F, 2) variance of a component of the angular velocity, and of the force
    lasting: FloatArray  # (F,) variance of a gyroscope component from slow errors: scale, mounting, bias and skin
    spread: FloatArray  # (2,) mean square difference of a component between sensor and markers


def prepare_sensor(  # noqa: PLR0917
    signals: SensorSignals,
    found: SensorCalibration,
    motion: MotionFromMarkers,
    time: FloatArray,
    seen: BoolArray,
    shares: tuple[float, float] = SHARES,
    *,
    axial: FloatArray | None = None,
) -> PreparedSensor:
    """Return the signals of a sensor at uniform times of the cameras, corrected by its calibration, with their noise.

    ``time`` (F,) is in s. ``motion`` comes from markers alone; its axial rotation converts the signals from the skin's
    axes to the segment's. ``seen`` (F,) is true where the frame's own markers determine the segment's pose. ``shares``
    are as :data:`SHARES`. ``axial`` (F,), rad, is the axial rotation in all frames; if omitted, it is interpolated
    where the markers do not determine it.
    """
    frame = float(time[1] - time[0])
    gyro, force = signals.at(found.clock.stamps(time), frame)
    given = np.where(seen, motion.axial, np.nan) if axial is None else axial
    known = np.flatnonzero(np.isfinite(given))
    angle = np.interp(np.arange(len(time)), known, given[known])
    back = so3.exp(-found.lag * angle[:, None] * motion.long_axis) @ found.mount
    gyro = np.einsum("fij,fj->fi", back, (gyro - found.gyro_bias) / (1 + found.gyro_scale))
    force = np.einsum("fij,fj->fi", back, (force - found.acc_bias) / (1 + found.acc_scale))
    lag = np.hypot(float(found.sd["lag"][0]), _LAG_SD if found.lag else 0.0)
    speed = np.nan_to_num(np.sum(gyro**2, axis=1))
    tilt = float(np.mean(found.sd["turn"] ** 2))
    spin = np.nan_to_num(gyro @ motion.long_axis) ** 2
    lasting = speed * (tilt + np.mean(found.sd["gyro_scale"] ** 2)) + spin * lag**2
    lasting += float(np.mean(found.sd["gyro_bias"] ** 2))
    unknown = (found.lag * (_UNKNOWN_AXIAL if axial is None else _BRIDGED_AXIAL)) ** 2 * ~seen
    white = signals.noise**2 / (frame * signals.rate)
    variance = np.empty((len(time), 2))
    variance[:, 0] = white[0] + (shares[0] * found.residual[0]) ** 2
    variance[:, 1] = white[1] + (shares[1] * found.residual[1]) ** 2 + unknown * GRAVITY**2
    return PreparedSensor(gyro, force, variance, lasting + unknown * speed, found.residual**2)


def _explain_disagreement(found: SensorCalibration) -> str | None:
    """Return a text that says how a sensor contradicts the motion of its segment; None if it agrees."""
    off = float(found.residual[0]) * np.sqrt(3.0)
    limit = _MOST_OFF * max(found.segment_rate, _LEAST_RATE)
    if off > limit:
        return f"its gyroscope differs from the markers by {off:.2g} rad/s rms; expected at most {limit:.2g}"
    if found.residual[1] > _MOST_FORCE:
        off = found.residual[1]
        return f"its accelerometer differs from the markers by {off:.2g} m/s² rms; expected at most {_MOST_FORCE:g}"
    bias = float(np.linalg.norm(found.acc_bias))
    if bias > _MOST_BIAS:
        return (
            f"its accelerometer has a bias of {bias:.2g} m/s², expected at most {_MOST_BIAS:g}: gravity was probably "
            "removed from its signal, or the file names a wrong unit"
        )
    return None


_BORROWED_SD = 0.1  # s, least standard deviation of a clock taken from other sensors
_CLEAR = 0.5  # least correlation of the rotation speeds that determines a clock
_MARGIN = 0.2  # s before and after a gap in which the motion is also partly bridged
WORSE = 1.5  # times the residual of the markers alone, at which sensors contradict the markers


@dataclass(frozen=True)
class SensorResult:
    """Calibration of the sensor on one segment, and whether it can be used."""

    calibration: SensorCalibration | None  # None if sensor and markers have too little time in common
    saturated: float  # fraction of its samples that are saturated
    why: str | None = None  # reason for which the sensor is left out; None if it is used
    better_segment: int | None = None  # another segment, whose motion the sensor fits better; None if there is none

    @property
    def used(self) -> SensorCalibration | None:
        """Calibration of a sensor that can be used; None if the sensor is left out."""
        return self.calibration if self.why is None else None


def calibrate_all(
    sensors: Mapping[int, SensorSignals], motions: Sequence[MotionFromMarkers], time: FloatArray
) -> dict[int, SensorResult]:
    """Calibrate all sensors; return the results by segment, like ``sensors``.

    A sensor whose motion does not determine its clock takes the clock of the others. ``motions`` are the motions of all
    segments from markers alone, and ``time`` (F,) are uniform times of the cameras, s.
    """
    coarse = {s: find_clock(each, motions[s], time) for s, each in sensors.items()}
    clocks: list[Clock] = []
    results = {}
    for s in sorted(sensors, key=lambda s: -coarse[s][1]):
        signals, (offset, correlation) = sensors[s], coarse[s]
        clock = Clock(offset)
        if not correlation > _CLEAR:  # the median of the other clocks; without others, zero with infinite deviation
            offsets = np.array([each.offset for each in clocks])
            spread = float(np.std(offsets, ddof=1)) if len(offsets) > 1 else 0.0
            clock = Clock(float(np.median(offsets)), 0.0, max(spread, _BORROWED_SD)) if clocks else Clock(0.0)
        found = calibrate_sensor(signals, motions[s], time, clock, follows=s > 0)
        saturated = float(np.mean(signals.saturated))
        if found is None:
            results[s] = SensorResult(None, saturated, "too few samples in the time of the recording")
            continue
        why, better = _explain_disagreement(found), None
        if why is not None:  # another segment, whose motion the sensor fits much better
            least = 0.5 * float(found.residual[0])
            for k, motion in enumerate(motions):
                if k == s:
                    continue
                offset, correlation = find_clock(signals, motion, time)
                other = calibrate_sensor(signals, motion, time, Clock(offset)) if correlation > _CLEAR else None
                if other is not None and _explain_disagreement(other) is None and other.residual[0] < least:
                    better, least = k, float(other.residual[0])
        elif found.clock.observable:
            clocks.append(found.clock)
        results[s] = SensorResult(found, saturated, why, better)
    return {s: results[s] for s in sensors}


def measure_rms_distance(points: FloatArray, predicted: FloatArray, used: BoolArray) -> float:
    """Return the rms distance, m, of the ``used`` points from predicted positions; infinite if none is used."""
    squares = np.sum((points - predicted) ** 2, axis=2)[used]
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else np.inf


def find_observed_segments(observed: BoolArray, rate: float) -> BoolArray:
    """Return where (F, n) a segment is observed in a frame and in all frames near it.

    ``observed`` (F, n) is false in bridged frames; ``rate`` is in frames per second.
    """
    width = 2 * round(_MARGIN * rate) + 1
    hidden = np.stack([np.convolve(~each, np.ones(width), mode="same") for each in observed.T], axis=1) > 0.5
    return np.asarray(~hidden)
