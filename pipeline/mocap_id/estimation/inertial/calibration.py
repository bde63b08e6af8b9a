"""Calibration of an inertial sensor on a moving segment, by maximum likelihood with weak priors.

A sensor at the place r, mounted with the rotation M (sensor to segment) on skin that does not follow the share s of the
twist τ about the long axis l, measures

    gyroscope      A_g Mᵀ E (ω − s τ' l) + b_g
    accelerometer  A_a Mᵀ E (f + α × r + ω × (ω × r)) + b_a       with E = exp(s τ l)

at its own times; ω, α and the specific force f at the segment's origin are in the segment's axes, and A_g, A_a are
diagonal. Both residuals are correlated over time, since errors of markers and skin persist over successive frames;
their weights are divided by the number of correlated samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.estimation.inertial.clock import OBSERVABLE_SD, Clock
from mocap_id.estimation.inertial.signals import SegmentMotion, SensorSignals
from mocap_id.geometry import so3

_ROUNDS, _SETTLED = 12, 0.05  # largest step at which the search ends, in standard deviations
_MOST, _FEW, _ENOUGH = 3000, 500, 25.0  # frames, and frames a second: residuals are correlated over 0.5 s or more
_FAR = 5.0  # times the rms residual; farther samples do not count
_GYRO_SD, _FORCE_SD = 0.05, 0.5  # rad/s and m/s², first weights
_PRIOR = {
    **{"turn": 10.0, "gyro_scale": 5e-3, "lag": 0.15, "gyro_bias": 0.2},
    **{"shift": 0.05, "drift": 1e-4, "place": 0.3, "acc_scale": 5e-3, "acc_bias": 0.5},
}
"""Standard deviations of the parameters before the trial: rad, –, –, rad/s, s, –, m, –, m/s²."""
_USUAL_LAG = 0.1
_IN_PHASE = 0.12  # of the residual may follow the acceleration, because skin lags: this looks like a late clock
_SIZES = (
    *(("turn", 3), ("gyro_scale", 3), ("lag", 1), ("gyro_bias", 3), ("shift", 1), ("drift", 1)),
    *(("place", 3), ("acc_scale", 3), ("acc_bias", 3)),
)


def _slices() -> dict[str, slice]:
    starts = np.concatenate([[0], np.cumsum([size for _, size in _SIZES])]).tolist()
    return {name: slice(at, at + size) for (name, size), at in zip(_SIZES, starts, strict=False)}


_AT = _slices()


@dataclass(frozen=True)
class Calibrated:
    """Parameters of a sensor.

    Parameters
    ----------
    clock : Clock
    mount : (3, 3) array
        Rotation from the sensor to its segment.
    place : (3,) array
        Position in the segment's frame, m.
    lag : float
        Share of the segment's twist that the skin under the sensor does not follow.
    gyro_scale, gyro_bias : (3,) arrays
        Relative error of the scale, and bias, rad/s.
    acc_scale, acc_bias : (3,) arrays
        The same of the accelerometer; bias in m/s².
    sd : mapping of str to array
        Standard deviations by the names above, and ``turn`` of the mounting (3,), rad, ``shift`` of the clock, s.
    left : (2,) array
        Root mean squares of a component's residual: gyroscope, rad/s, and accelerometer, m/s².
    together : (2,) array
        Numbers of successive frames with correlated residuals.
    moved : float
        Root mean square of the segment's angular velocity, rad/s.
    """

    clock: Clock
    mount: FloatArray
    place: FloatArray
    lag: float
    gyro_scale: FloatArray
    gyro_bias: FloatArray
    acc_scale: FloatArray
    acc_bias: FloatArray
    sd: dict[str, FloatArray]
    left: FloatArray
    together: FloatArray
    moved: float


def calibrate_sensor(
    signals: SensorSignals,
    motion: SegmentMotion,
    time: FloatArray,
    clock: Clock,
    *,
    follows: bool = True,
    start: Calibrated | None = None,
) -> Calibrated | None:
    """Estimate the parameters of a sensor on a segment.

    Parameters
    ----------
    signals : SensorSignals
    motion : SegmentMotion
        From markers alone, F frames.
    time : (F,) array
        Uniform times of the cameras, s.
    clock : Clock
        Start of the search; its ``sd`` limits it if finite.
    follows : bool
        Whether the skin under the sensor may follow the twist only in part; if false, it follows fully.
    start : Calibrated, optional
        Start of the search with this clock, such as the result for almost the same motion.

    Returns
    -------
    Calibrated or None
        None if sensor and segment have too few samples in common.
    """
    frame = float(time[1] - time[0])
    thin = _step(len(time), frame)
    some = np.arange(0, len(time), thin)
    seen = motion.known[some]
    some = some[seen & np.isfinite(signals.at(clock.stamps(time[some]), frame)[0][:, 0])]
    if len(some) < 50:
        return None
    given = _at_frames(motion, some)
    follows = follows and bool(np.std(given.twist) > 0)
    prior, found = _prior(clock, follows), start or _start(signals, given, time[some], clock, frame)
    middle = float(time[len(time) // 2])
    for _ in range(_ROUNDS):
        rows, off, kept = _residuals(signals, given, time[some], frame, found, middle)
        left, together = _sizes(off, kept, thin)
        weight = np.fmin(left, 4 * np.array([_GYRO_SD, _FORCE_SD])) * np.sqrt(together)
        by = np.repeat(kept / weight, 3, axis=1).reshape(-1)
        rows, off = rows.reshape(-1, rows.shape[2]) * by[:, None], off.reshape(-1) * by
        normal = rows.T @ rows + np.diag(1.0 / prior**2)
        pull = rows.T @ off - _departure(found, clock, middle, _USUAL_LAG * follows) / prior**2
        step = np.linalg.solve(normal, pull)
        found = _moved(found, step, middle)
        if np.max(np.abs(step) * np.sqrt(np.diagonal(normal))) < _SETTLED:
            break
    sd = np.sqrt(np.diagonal(np.linalg.inv(normal)))
    spread = {name: sd[at] for name, at in _AT.items()}
    slope = float(np.sqrt(np.sum(motion.alpha[some] ** 2) / len(some)))
    of_clock = float(np.hypot(spread["shift"][0], _IN_PHASE * np.sqrt(3.0) * left[0] / max(slope, 1e-9)))
    moved = float(np.sqrt(np.mean(np.sum(given.omega**2, axis=1))))
    settled = replace(found.clock, sd=of_clock, observable=of_clock <= OBSERVABLE_SD)
    return replace(found, clock=settled, sd=spread, left=left, together=together * thin, moved=moved)


def _step(frames: int, frame: float) -> int:
    """Return the step between the frames that are used."""
    return max(1, -(-frames // _MOST), min(int(1.0 / (_ENOUGH * frame)), frames // _FEW))


def _at_frames(motion: SegmentMotion, some: IntArray) -> SegmentMotion:
    return SegmentMotion(
        motion.omega[some],
        motion.alpha[some],
        motion.force[some],
        motion.twist[some],
        motion.twist_rate[some],
        motion.long_axis,
    )


def _prior(clock: Clock, follows: bool) -> FloatArray:
    sd = np.concatenate([np.full(size, _PRIOR[name]) for name, size in _SIZES])
    sd[_AT["shift"]] = min(clock.sd, 0.5) if np.isfinite(clock.sd) else _PRIOR["shift"]
    if not follows:
        sd[_AT["lag"]] = 1e-9
    return sd


def _start(signals: SensorSignals, motion: SegmentMotion, time: FloatArray, clock: Clock, frame: float) -> Calibrated:
    """Return the rotation that fits both sensors best, without their other errors."""
    gyro, acc = signals.at(clock.stamps(time), frame)
    there = np.isfinite(gyro[:, 0])
    bias = np.median(gyro[there], axis=0)
    product = (motion.omega[there] - motion.omega[there].mean(axis=0)).T @ (gyro[there] - bias) / _GYRO_SD**2
    product += motion.force[there].T @ acc[there] / _FORCE_SD**2
    u, _, v = np.linalg.svd(product)
    mount = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    zero, none = np.zeros(3), np.zeros(2)
    return Calibrated(clock, mount, zero, 0.0, zero, bias, zero, zero, {}, none, none, 0.0)


def _residuals(  # noqa: PLR0917
    signals: SensorSignals, motion: SegmentMotion, time: FloatArray, frame: float, at: Calibrated, middle: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return derivatives (F, 6, p) of what is expected, residuals (F, 6), and where (F, 2) samples count."""
    stamps = at.clock.stamps(time)
    measured = np.concatenate(signals.at(stamps, frame), axis=1)
    slope = np.concatenate(signals.at(stamps, frame, 1), axis=1)
    along = motion.long_axis
    skin = so3.exp(at.lag * motion.twist[:, None] * along)
    back = at.mount.T @ skin
    lever = so3.hat(motion.alpha) + so3.hat(motion.omega) @ so3.hat(motion.omega)
    seen = np.einsum("fij,fj->fi", back, motion.omega - at.lag * motion.twist_rate[:, None] * along)
    felt = np.einsum("fij,fj->fi", back, motion.force + lever @ at.place)
    expected = np.concatenate([(1 + at.gyro_scale) * seen + at.gyro_bias, (1 + at.acc_scale) * felt + at.acc_bias], 1)
    rows = np.zeros((len(time), 6, sum(size for _, size in _SIZES)))
    turned = at.mount.T @ along
    swing = motion.twist[:, None] * turned
    for part, vector, name in ((slice(0, 3), seen, "gyro"), (slice(3, 6), felt, "acc")):
        rows[:, part, _AT["turn"]] = so3.hat(vector)
        rows[:, part, _AT[f"{name}_scale"]] = vector[:, :, None] * np.eye(3)
        rows[:, part, _AT[f"{name}_bias"]] = np.eye(3)
        rows[:, part, _AT["lag"].start] = np.cross(swing, vector)
    rows[:, :3, _AT["lag"].start] -= motion.twist_rate[:, None] * turned
    rows[:, 3:, _AT["place"]] = back @ lever
    rows[:, :, _AT["shift"].start] = slope
    rows[:, :, _AT["drift"].start] = slope * (time - middle)[:, None]
    off = measured - expected
    there = np.isfinite(off).all(axis=1) & np.isfinite(slope).all(axis=1)
    size = np.stack([np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)], axis=1)
    usual = np.sqrt(np.mean(size[there] ** 2, axis=0))
    off[~there], rows[~there] = 0.0, 0.0
    return rows, off, (there[:, None] & (size < _FAR * usual)).astype(np.float64)


def _sizes(off: FloatArray, kept: FloatArray, thin: int) -> tuple[FloatArray, FloatArray]:
    """Return the rms (2,) of a component's residual, and the numbers (2,) of frames with correlated residuals."""
    left, together = np.empty(2), np.empty(2)
    padded = next_fast_len(2 * len(off), real=True)
    for k in range(2):
        own = off[:, 3 * k : 3 * k + 3] * kept[:, k : k + 1]
        left[k] = np.sqrt(np.sum(own**2) / max(3 * kept[:, k].sum(), 1.0))
        power = np.abs(rfft(own - own.mean(axis=0), padded, axis=0)) ** 2
        lags = irfft(power.sum(axis=1), padded)[: len(own)]
        ends = np.flatnonzero(lags <= 0)
        last = int(ends[0]) if len(ends) else len(lags)
        together[k] = 1.0 + 2.0 * float(np.sum(lags[1:last])) / max(float(lags[0]), 1e-30)
    return np.maximum(left, 1e-9), together


def _departure(found: Calibrated, clock: Clock, middle: float, lag: float) -> FloatArray:
    """Return the parameters minus their prior values; the mounting has no prior."""
    out = np.zeros(sum(size for _, size in _SIZES))
    for name in ("gyro_scale", "gyro_bias", "place", "acc_scale", "acc_bias"):
        out[_AT[name]] = getattr(found, name)
    out[_AT["lag"]] = found.lag - lag
    out[_AT["drift"]] = found.clock.drift - clock.drift
    out[_AT["shift"]] = float(clock.stamps(np.array(middle)) - found.clock.stamps(np.array(middle)))
    return out


def _moved(found: Calibrated, step: FloatArray, middle: float) -> Calibrated:
    """Return the parameters after a step; the clock is shifted at the middle of the trial."""
    stamp = float(found.clock.stamps(np.array(middle))) - float(step[_AT["shift"]][0])
    drift = found.clock.drift + float(step[_AT["drift"]][0])
    offset = middle - stamp * (1 + drift)
    return replace(
        found,
        clock=replace(found.clock, offset=offset, drift=drift),
        mount=found.mount @ so3.exp(step[_AT["turn"]]),
        lag=found.lag + float(step[_AT["lag"]][0]),
        **{
            name: getattr(found, name) + step[_AT[name]]
            for name in ("gyro_scale", "gyro_bias", "place", "acc_scale", "acc_bias")
        },
    )
