"""States of a planar chain from inertial sensors alone, on a chain that a trial with markers has shown.

That trial calibrates the sensors on their segments. Dead reckoning then gives angles, biases and clocks, and the filter
smooths the corrected signals. The trial with markers is tracked in the same way without its markers; this shows the
lasting errors of mounting, chain and skin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, as_xy
from mocap_id.errors import NumericalError
from mocap_id.estimation import compiled_filter
from mocap_id.estimation.dead_reckoning import SWITCHED_ON, DeadReckoning, KnownChain, Reckoning
from mocap_id.estimation.filter_problem import Anchors, FilterProblem, InertialSignals
from mocap_id.estimation.inertial import SensorSignals, calibrate_all
from mocap_id.estimation.inertial.signals import GRAVITY
from mocap_id.estimation.inertial_smoothing import SHARES, carry_sensor, segment_motions
from mocap_id.estimation.sigma_points import SigmaPoints
from mocap_id.estimation.smoothing import States

_GATE = 8.0  # standard deviations of a sample in the filter
_ACCELERATION_SHARE = 0.35  # of the filter's standard deviation, in simulated people: it takes lasting errors for white
_LEAST = 1.0  # s that the logs must have in common
_MARGIN = 0.3  # s at the ends, where the clocks of the sensors may not overlap


@dataclass(frozen=True)
class Tracked:
    """States of n joints at F times.

    Parameters
    ----------
    mean : (F, n, 4) array
        Angle, rad, velocity, rad/s, acceleration, rad/s², and jerk, rad/s³.
    sd : (F, n, 3) array
        Standard deviations of angle, rad, velocity, rad/s, and acceleration, rad/s².
    reckoning : Reckoning
        Motion before the filter, with biases and clocks.
    level : (n,) array
        Mean specific force of each sensor out of the plane, m/s²: not zero if a sensor is turned on its segment.
    heading, heading_sd : (n,) arrays
        Turn of each sensor about the vertical between start and end, rad, and its standard deviation.
    """

    mean: FloatArray
    sd: FloatArray
    reckoning: Reckoning
    level: FloatArray
    heading: FloatArray
    heading_sd: FloatArray


@dataclass(frozen=True)
class ShownChain:
    """A chain with its sensors, and the errors of states without markers.

    Parameters
    ----------
    known : KnownChain
    errors : (n, 3) array
        Rms errors of angle, rad, velocity, rad/s, and acceleration, rad/s², in the trial that shows the chain.
    """

    known: KnownChain
    errors: FloatArray


def show_chain(
    states: States, time: FloatArray, sensors: Mapping[int, SensorSignals], density: FloatArray
) -> ShownChain:
    """Calibrate the sensors on a trial with markers, and track the same trial without the markers.

    Parameters
    ----------
    states : States
        Of the trial with markers; only ``mean``, ``observed`` and ``chain`` are used.
    time : (F,) array
        Uniform times of the cameras, s.
    sensors : mapping from int to SensorSignals
        One on every moving segment 1 … n.
    density : (n,) array
        Spectral density of each joint's snap, rad²/s⁷.

    Raises
    ------
    NumericalError
        A sensor contradicts the markers, the logs have no time in common, or a covariance is not positive definite.
    """
    rate = (len(time) - 1) / float(time[-1] - time[0])
    motions = segment_motions(states, rate)
    results = calibrate_all(sensors, motions, time)
    carried = []
    for s in range(1, len(motions)):
        result = results[s]
        if result.found is None or result.why is not None:
            raise NumericalError(f"segment {s}: {result.why or 'its sensor has no motion in common with the markers'}")
        carried.append(carry_sensor(sensors[s], s, result.found, motions[s], states, time))
    rest = np.nanmean(states.mean[..., 0], axis=0)
    known = KnownChain(states.chain.centres, tuple(carried), rest, density)
    signals = [sensors[s] for s in range(1, len(motions))]
    stamps = carried[0].found.clock.stamps(time)
    first, last = max(each.time[0] for each in signals), min(each.time[-1] for each in signals)
    inside = np.flatnonzero((stamps > first + _MARGIN) & (stamps < last - _MARGIN))
    if len(inside) < _LEAST * rate:
        raise NumericalError(
            f"by their times the logs have only {len(inside) / rate:.1f} s in common with each other and with the "
            "markers: use logs of one recording, of sensors whose clocks started together"
        )
    mean, _, _ = _tracked(signals, stamps[inside], known)
    off = mean[..., :3] - states.mean[inside][..., :3]
    return ShownChain(known, np.sqrt(np.nanmean(off**2, axis=0)))


def track_alone(signals: Sequence[SensorSignals], time: FloatArray, shown: ShownChain) -> Tracked:
    """Return the states of the joints from their sensors.

    Parameters
    ----------
    signals : sequence of SensorSignals, length n
        Of the sensor on each moving segment.
    time : (F,) array
        Uniform times on the first sensor's clock, s.
    shown : ShownChain

    Raises
    ------
    NumericalError
        A covariance is not positive definite.
    """
    mean, filtered, reckoning = _tracked(signals, time, shown.known)
    variance = filtered[..., :3] ** 2
    variance[..., 2] *= _ACCELERATION_SHARE**2
    lasting = np.broadcast_to(shown.errors**2, variance.shape).copy()
    lasting[..., 0] += _of_joints(reckoning.angle_sd) ** 2
    level, heading, heading_sd = _out_of_plane(DeadReckoning(signals, time, shown.known), reckoning, time, shown.known)
    return Tracked(mean, np.sqrt(variance + lasting), reckoning, level, heading, heading_sd)


def _of_joints(sd: FloatArray) -> FloatArray:
    """Return the standard deviations (F, n) of the differences of successive segments."""
    before = np.concatenate([np.zeros((len(sd), 1)), sd[:, :-1]], axis=1)
    return np.asarray(np.hypot(sd, before))


def _tracked(
    signals: Sequence[SensorSignals], time: FloatArray, known: KnownChain
) -> tuple[FloatArray, FloatArray, Reckoning]:
    """Return mean and standard deviation (F, n, 4) of the filter's states, and the motion before the filter."""
    reckoned = DeadReckoning(signals, time, known)
    found = reckoned.solve()
    gyro, force = reckoned.sampled(tuple(found.shift))
    rate = gyro - found.gyro_bias
    forces = as_xy(force) - found.force_bias
    left = np.array([each.found.left for each in known.carried])
    left[:, 1] = np.fmax(left[:, 1], found.residual)
    joints = np.diff(found.angle, axis=1, prepend=0.0)
    frames, n = joints.shape
    none = np.zeros(0)
    problem = FilterProblem(
        observed=np.zeros((frames, 0, 2)),
        dt=float(time[1] - time[0]),
        centres=known.centres.copy(),
        segment=none.astype(np.int64),
        local=np.zeros((0, 2)),
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
        sigma_points=SigmaPoints(),
        inertial=InertialSignals(
            segment=np.arange(1, n + 1),
            place=np.array([each.found.place[:2] for each in known.carried]),
            share=np.array([each.share for each in known.carried]),
            rest=known.rest,
            signal=np.concatenate([rate[..., None], forces], axis=2),
            variance=np.tile((np.array(SHARES) * left) ** 2, (frames, 1, 1)),
            gravity=GRAVITY,
        ),
    )
    mean, sd = compiled_filter.smooth_backwards(problem, compiled_filter.filter_forwards(problem)).by_joint()
    return mean, sd, found


def _out_of_plane(
    reckoned: DeadReckoning, found: Reckoning, time: FloatArray, known: KnownChain
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean forces out of the plane, the turns about the vertical and their deviations (n,) each."""
    level, heading, spread = (np.empty(len(known.carried)) for _ in range(3))
    lasts = float(time[-1] - time[0])
    for k, worn in enumerate(known.carried):
        gyro, force = reckoned.prepared(k, float(found.shift[k]))
        upwards = as_xy(1j * np.exp(-1j * found.angle[:, k]))
        speed = np.sum(gyro[:, :2] * upwards, axis=1)
        level[k] = np.nanmean(force[:, 2])
        heading[k] = np.nanmean(speed) * lasts
        bias = np.hypot(SWITCHED_ON, np.mean(worn.found.sd["gyro_bias"]))
        spread[k] = bias * lasts
    return level, heading, spread
