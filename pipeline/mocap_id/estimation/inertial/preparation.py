"""Signals of a calibrated sensor at the cameras' frames, in the axes of its segment, with their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.inertial.calibration import SensorCalibration
from mocap_id.estimation.inertial.signals import GRAVITY, SegmentMotion, SensorSignals
from mocap_id.geometry import so3

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
    motion: SegmentMotion,
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


def explain_disagreement(found: SensorCalibration) -> str | None:
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
