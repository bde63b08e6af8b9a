"""Calibration of an inertial sensor on a moving segment, by maximum likelihood with weak priors.

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

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from mocap_id.arrays import FloatArray
from mocap_id.estimation.inertial.clock import OBSERVABLE_SD, Clock
from mocap_id.estimation.inertial.signals import SegmentMotion, SensorSignals
from mocap_id.geometry import so3

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
    motion: SegmentMotion,
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
    thin = _thin_frames(len(time), frame)
    some = np.arange(0, len(time), thin)
    seen = motion.known[some]
    some = some[seen & np.isfinite(signals.at(clock.stamps(time[some]), frame)[0][:, 0])]
    if len(some) < 50:
        return None
    given = motion.select(some)
    follows = follows and bool(np.std(given.axial) > 0)
    prior, found = _prior(clock, follows), start or _guess_mounting(signals, given, time[some], clock, frame)
    middle = float(time[len(time) // 2])
    for _ in range(_ROUNDS):
        rows, off, kept = _residuals(signals, given, time[some], frame, found, middle)
        residual, correlated = _measure_residuals(off, kept)
        weight = np.fmin(residual, 4 * np.array([_GYRO_SD, _FORCE_SD])) * np.sqrt(correlated)
        by = np.repeat(kept / weight, 3, axis=1).reshape(-1)
        rows, off = rows.reshape(-1, rows.shape[2]) * by[:, None], off.reshape(-1) * by
        normal = rows.T @ rows + np.diag(1.0 / prior**2)
        pull = rows.T @ off - _differ_from_prior(found, clock, middle, _USUAL_LAG * follows) / prior**2
        step = np.linalg.solve(normal, pull)
        found = _add_step(found, step, middle)
        if np.max(np.abs(step) * np.sqrt(np.diagonal(normal))) < _SETTLED:
            break
    sd = np.sqrt(np.diagonal(np.linalg.inv(normal)))
    spread = {name: sd[at] for name, at in _AT.items()}
    slope = float(np.sqrt(np.sum(motion.alpha[some] ** 2) / len(some)))
    clock_sd = float(np.hypot(spread["shift"][0], _IN_PHASE * np.sqrt(3.0) * residual[0] / max(slope, 1e-9)))
    rate = float(np.sqrt(np.mean(np.sum(given.omega**2, axis=1))))
    settled = replace(found.clock, sd=clock_sd, observable=clock_sd <= OBSERVABLE_SD)
    return replace(found, clock=settled, sd=spread, residual=residual, correlated=correlated * thin, segment_rate=rate)


def _thin_frames(frames: int, frame: float) -> int:
    """Return k if every k-th frame is used; ``frames`` is the number of frames, ``frame`` the time between them, s."""
    return max(1, -(-frames // _MOST), min(int(1.0 / (_ENOUGH * frame)), frames // _FEW))


def _prior(clock: Clock, follows: bool) -> FloatArray:
    sd = np.concatenate([np.full(size, _PRIOR[name]) for name, size in _SIZES])
    sd[_AT["shift"]] = min(clock.sd, 0.5) if np.isfinite(clock.sd) else _PRIOR["shift"]
    if not follows:
        sd[_AT["lag"]] = 1e-9
    return sd


def _guess_mounting(
    signals: SensorSignals, motion: SegmentMotion, time: FloatArray, clock: Clock, frame: float
) -> SensorCalibration:
    """Return start values: the mounting that fits both signals best, the gyroscope's bias, other errors zero."""
    gyro, acc = signals.at(clock.stamps(time), frame)
    there = np.isfinite(gyro[:, 0])
    bias = np.median(gyro[there], axis=0)
    product = (motion.omega[there] - motion.omega[there].mean(axis=0)).T @ (gyro[there] - bias) / _GYRO_SD**2
    product += motion.force[there].T @ acc[there] / _FORCE_SD**2
    u, _, v = np.linalg.svd(product)
    mount = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    zero, none = np.zeros(3), np.zeros(2)
    return SensorCalibration(clock, mount, zero, 0.0, zero, bias, zero, zero, {}, none, none, 0.0)


def _residuals(  # noqa: PLR0917
    signals: SensorSignals, motion: SegmentMotion, time: FloatArray, frame: float, at: SensorCalibration, middle: float
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


def _differ_from_prior(found: SensorCalibration, clock: Clock, middle: float, lag: float) -> FloatArray:
    """Return the parameters (p,) minus their prior values; zero for the mounting, which has no prior value."""
    out = np.zeros(_COUNT)
    for name in _VECTORS:
        out[_AT[name]] = getattr(found, name)
    out[_AT["lag"]] = found.lag - lag
    out[_AT["drift"]] = found.clock.drift - clock.drift
    out[_AT["shift"]] = float(clock.stamps(np.array(middle)) - found.clock.stamps(np.array(middle)))
    return out


def _add_step(found: SensorCalibration, step: FloatArray, middle: float) -> SensorCalibration:
    """Return the parameters changed by ``step`` (p,); ``middle`` is the time, s, at which the clock is shifted."""
    stamp = float(found.clock.stamps(np.array(middle))) - float(step[_AT["shift"]][0])
    drift = found.clock.drift + float(step[_AT["drift"]][0])
    offset = middle - stamp * (1 + drift)
    return replace(
        found,
        clock=replace(found.clock, offset=offset, drift=drift),
        mount=found.mount @ so3.exp(step[_AT["turn"]]),
        lag=found.lag + float(step[_AT["lag"]][0]),
        **{name: getattr(found, name) + step[_AT[name]] for name in _VECTORS},
    )
