"""Signals of a calibrated sensor at the cameras' frames, in the axes of its segment, with their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.inertial.calibration import Calibrated
from mocap_id.estimation.inertial.signals import GRAVITY, SegmentMotion, SensorSignals
from mocap_id.geometry import so3

SHARES = (0.5, 1.0)
"""Standard deviations of one frame in the filter, relative to the residuals against the markers.

Skin turns a sensor, and the chain cannot follow it. With smaller values, the joints would follow the skin.
"""

_MOST_OFF = 0.35  # of the segment's rms angular velocity
_LEAST_MOVED = 0.15  # rad/s
_MOST_FORCE, _MOST_BIAS = 2.0, 3.0  # m/s²
_UNKNOWN_LAG = 0.08  # share of the twist: skin under markers and sensor misses it by different and changing shares
_UNKNOWN_TWIST, _BRIDGED_TWIST = 0.3, 0.1  # rad, where no marker shows the segment: interpolated, and by sensors


@dataclass(frozen=True)
class Prepared:
    """A sensor as a filter uses it, at F frames.

    Parameters
    ----------
    gyro : (F, 3) array
        Angular velocity of the skin under the sensor, rad/s, in the segment's axes; NaN where missing.
    force : (F, 3) array
        Specific force at the sensor, m/s², in the segment's axes.
    variance : (F, 2) array
        Of a component of each.
    lasting : (F,) array
        Variance of a component of the gyroscope by slow errors: scale, mounting, bias and skin.
    spread : (2,) array
        Variance of the difference between markers and sensor.
    """

    gyro: FloatArray
    force: FloatArray
    variance: FloatArray
    lasting: FloatArray
    spread: FloatArray


def prepare_sensor(  # noqa: PLR0917
    signals: SensorSignals,
    found: Calibrated,
    motion: SegmentMotion,
    time: FloatArray,
    seen: BoolArray,
    shares: tuple[float, float] = SHARES,
    *,
    twist: FloatArray | None = None,
) -> Prepared:
    """Return a sensor's signals at the cameras' frames.

    Parameters
    ----------
    signals : SensorSignals
    found : Calibrated
    motion : SegmentMotion
        From markers alone; its twist takes the sensor back to the segment's axes.
    time : (F,) array
        s.
    seen : (F,) bool array
        The frame's own markers determine the segment's pose.
    shares : (float, float)
        Standard deviations of gyroscope and accelerometer in a frame, relative to their residuals against the markers.
    twist : (F,) array, optional
        Of the segment, rad, if it is also known in frames that are not seen; otherwise it is interpolated there.
    """
    frame = float(time[1] - time[0])
    gyro, force = signals.at(found.clock.stamps(time), frame)
    shown = np.where(seen, motion.twist, np.nan) if twist is None else twist
    known = np.flatnonzero(np.isfinite(shown))
    turned = np.interp(np.arange(len(time)), known, shown[known])
    back = so3.exp(-found.lag * turned[:, None] * motion.long_axis) @ found.mount
    gyro = np.einsum("fij,fj->fi", back, (gyro - found.gyro_bias) / (1 + found.gyro_scale))
    force = np.einsum("fij,fj->fi", back, (force - found.acc_bias) / (1 + found.acc_scale))
    lag = np.hypot(float(found.sd["lag"][0]), _UNKNOWN_LAG if found.lag else 0.0)
    speed = np.nan_to_num(np.sum(gyro**2, axis=1))
    tilt = float(np.mean(found.sd["turn"] ** 2))
    spin = np.nan_to_num(gyro @ motion.long_axis) ** 2
    lasting = speed * (tilt + np.mean(found.sd["gyro_scale"] ** 2)) + spin * lag**2
    lasting += float(np.mean(found.sd["gyro_bias"] ** 2))
    unknown = (found.lag * (_UNKNOWN_TWIST if twist is None else _BRIDGED_TWIST)) ** 2 * ~seen
    white = signals.noise**2 / (frame * signals.rate)
    variance = np.empty((len(time), 2))
    variance[:, 0] = white[0] + (shares[0] * found.left[0]) ** 2
    variance[:, 1] = white[1] + (shares[1] * found.left[1]) ** 2 + unknown * GRAVITY**2
    return Prepared(gyro, force, variance, lasting + unknown * speed, found.left**2)


def disagreement(found: Calibrated) -> str | None:
    """Return why a sensor contradicts the motion of its segment, or None."""
    off = float(found.left[0]) * np.sqrt(3.0)
    limit = _MOST_OFF * max(found.moved, _LEAST_MOVED)
    if off > limit:
        return f"its gyroscope differs from the markers by {off:.2g} rad/s rms; expected at most {limit:.2g}"
    if found.left[1] > _MOST_FORCE:
        off = found.left[1]
        return f"its accelerometer differs from the markers by {off:.2g} m/s² rms; expected at most {_MOST_FORCE:g}"
    bias = float(np.linalg.norm(found.acc_bias))
    if bias > _MOST_BIAS:
        return (
            f"its accelerometer has a bias of {bias:.2g} m/s², expected at most {_MOST_BIAS:g}: gravity was probably "
            "removed from its signal, or its unit is not that of the file"
        )
    return None
