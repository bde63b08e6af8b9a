"""States of a planar chain from inertial sensors alone, on the chain of another trial, which has markers.

The trial with markers calibrates the sensors on their segments. Dead reckoning then gives angles, biases and clocks,
and the filter smooths the corrected signals. The trial with markers is also tracked without its markers; the
differences give the persistent errors of mounting, chain and skin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, as_xy
from mocap_id.errors import NumericalError
from mocap_id.estimation import compiled_filter
from mocap_id.estimation.dead_reckoning import SWITCHED_ON, DeadReckoning, KnownChain, Reckoning
from mocap_id.estimation.filter_kernels import Inertial
from mocap_id.estimation.filter_problem import Anchors, FilterProblem, SigmaPoints
from mocap_id.estimation.inertial import SensorSignals, calibrate_all
from mocap_id.estimation.inertial.signals import GRAVITY
from mocap_id.estimation.inertial_smoothing import SHARES, calibrate_worn_sensor, compute_segment_motions
from mocap_id.estimation.smoothing import States

_GATE = 8.0  # largest innovation in the filter, in standard deviations
_ACCELERATION_SHARE = 0.35  # factor on the filter's sd, from simulated people: it treats lasting errors as white noise
_LEAST = 1.0  # s, least time that the logs must have in common
_MARGIN = 0.3  # s left out at both ends, because the clocks of the sensors may differ


@dataclass(frozen=True)
class TrackedStates:
    """States of n joints at F times from inertial sensors alone."""

    mean: FloatArray  # (F, n, 4) angle, rad, velocity, rad/s, acceleration, rad/s², and jerk, rad/s³
    sd: FloatArray  # (F, n, 3) standard deviations of angle, velocity and acceleration
    reckoning: Reckoning  # motion before the filter, with biases and clocks
    level: (
        FloatArray  # (n,) mean specific force out of the plane, m/s²; not zero if a sensor was rotated on its segment
    )
    heading: FloatArray  # (n,) rotation of each sensor about the vertical between start and end, rad
    heading_sd: FloatArray  # (n,) its standard deviation, rad


@dataclass(frozen=True)
class CalibratedChain:
    """A chain with its calibrated sensors, and the errors of its states if they are estimated without markers."""

    known: KnownChain
    errors: FloatArray  # (n, 3) rms errors of angle, rad, velocity, rad/s, and acceleration, rad/s²


def calibrate_chain(
    states: States, time: FloatArray, sensors: Mapping[int, SensorSignals], density: FloatArray
) -> CalibratedChain:
    """Calibrate the sensors on a trial with markers, and track the same trial without the markers.

    ``states`` are those of the trial with markers; only ``mean``, ``observed`` and ``chain`` are used. ``time`` (F,)
    are uniform times of the cameras, s. ``sensors`` has one sensor for each moving segment 1 … n. ``density`` (n,) is
    the spectral density of each joint's snap, rad²/s⁷.

    Raises
    ------
    NumericalError
        A sensor contradicts the markers, the logs have no time in common, or a covariance is not positive definite.
    """
    rate = (len(time) - 1) / float(time[-1] - time[0])
    motions = compute_segment_motions(states, rate)
    results = calibrate_all(sensors, motions, time)
    worn = []
    for s in range(1, len(motions)):
        result = results[s]
        if result.used is None:
            raise NumericalError(f"segment {s}: {result.why}")
        worn.append(calibrate_worn_sensor(sensors[s], s, result.used, motions[s], states, time))
    rest = np.nanmean(states.mean[..., 0], axis=0)
    known = KnownChain(states.chain.centres, tuple(worn), rest, density)
    signals = [sensors[s] for s in range(1, len(motions))]
    stamps = worn[0].calibration.clock.stamps(time)
    first, last = max(each.time[0] for each in signals), min(each.time[-1] for each in signals)
    inside = np.flatnonzero((stamps > first + _MARGIN) & (stamps < last - _MARGIN))
    if len(inside) < _LEAST * rate:
        raise NumericalError(
            f"by their times the logs have only {len(inside) / rate:.1f} s in common with each other and with the "
            "markers: use logs of one recording, of sensors whose clocks started together"
        )
    mean, _, _ = _track(DeadReckoning(signals, stamps[inside], known))
    off = mean[..., :3] - states.mean[inside][..., :3]
    return CalibratedChain(known, np.sqrt(np.nanmean(off**2, axis=0)))


def track_without_markers(signals: Sequence[SensorSignals], time: FloatArray, chain: CalibratedChain) -> TrackedStates:
    """Return the states of the joints from ``signals``, those of the sensors on the moving segments 1 … n.

    ``time`` (F,) are uniform times on the first sensor's clock, s.

    Raise NumericalError if a covariance is not positive definite.
    """
    problem = DeadReckoning(signals, time, chain.known)
    mean, sd, reckoning = _track(problem)
    variance = sd[..., :3] ** 2
    variance[..., 2] *= _ACCELERATION_SHARE**2
    lasting = np.broadcast_to(chain.errors**2, variance.shape).copy()
    before = np.concatenate([np.zeros((len(sd), 1)), reckoning.angle_sd[:, :-1]], axis=1)
    lasting[..., 0] += np.hypot(reckoning.angle_sd, before) ** 2
    out_of_plane = _measure_out_of_plane(problem, reckoning)
    return TrackedStates(mean, np.sqrt(variance + lasting), reckoning, *out_of_plane)


def _track(reckoned: DeadReckoning) -> tuple[FloatArray, FloatArray, Reckoning]:
    """Return the filter's states (F, n, 4), their standard deviations (F, n, 4), and the motion before the filter."""
    reckoning, known = reckoned.solve(), reckoned.chain
    gyro, force = reckoned.sample(tuple(reckoning.shift))
    residual = np.array([each.calibration.residual for each in known.sensors])
    residual[:, 1] = np.fmax(residual[:, 1], reckoning.residual)
    joints = np.diff(reckoning.angle, axis=1, prepend=0.0)
    frames, n = joints.shape
    none = np.zeros(0)
    problem = FilterProblem(
        observed=np.zeros((frames, 0, 2)),
        dt=float(reckoned.time[1] - reckoned.time[0]),
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
        inertial=Inertial(
            segment=np.arange(1, n + 1),
            place=np.array([each.calibration.place[:2] for each in known.sensors]),
            share=np.array([each.share for each in known.sensors]),
            rest=known.rest,
            signal=np.concatenate(
                [(gyro - reckoning.gyro_bias)[..., None], as_xy(force) - reckoning.force_bias], axis=2
            ),
            variance=np.tile((np.array(SHARES) * residual) ** 2, (frames, 1, 1)),
            gravity=GRAVITY,
        ),
    )
    mean, sd = compiled_filter.smooth_backwards(problem, compiled_filter.filter_forwards(problem)).by_joint()
    return mean, sd, reckoning


def _measure_out_of_plane(reckoned: DeadReckoning, reckoning: Reckoning) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fields ``level``, ``heading`` and ``heading_sd`` of :class:`TrackedStates`, (n,) each."""
    sensors, time = reckoned.chain.sensors, reckoned.time
    level, heading, heading_sd = (np.empty(len(sensors)) for _ in range(3))
    duration = float(time[-1] - time[0])
    for k, worn in enumerate(sensors):
        gyro, force = reckoned.prepare(k, float(reckoning.shift[k]))
        upwards = as_xy(1j * np.exp(-1j * reckoning.angle[:, k]))
        level[k] = np.nanmean(force[:, 2])
        heading[k] = np.nanmean(np.sum(gyro[:, :2] * upwards, axis=1)) * duration
        heading_sd[k] = np.hypot(SWITCHED_ON, np.mean(worn.calibration.sd["gyro_bias"])) * duration
    return level, heading, heading_sd
