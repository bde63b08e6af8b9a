"""Smoothed states of a chain in space from its markers and inertial sensors.

The markers alone give a first motion. Each sensor is calibrated with this motion, and a sensor that contradicts it is
left out. The filter then runs again with markers and sensors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, chunks, find_runs
from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_problem import ORDER
from mocap_id.estimation.inertial import (
    GRAVITY,
    MotionFromMarkers,
    PreparedSensor,
    SensorCalibration,
    SensorResult,
    SensorSignals,
    calibrate_all,
    find_observed_segments,
    prepare_sensor,
)
from mocap_id.estimation.space.frame_poses import FramePoses, group_columns, make_chain_model
from mocap_id.estimation.space.space_kernels import ChainModel, Sensors
from mocap_id.estimation.space.space_smoothing import (
    SpatialSettings,
    SpatialStates,
    collect_states,
    estimate_noise,
    filter_and_smooth,
    find_uncertain_segments,
    scale_to_movement,
)
from mocap_id.estimation.space.spatial_noise import SpatialNoise
from mocap_id.geometry.spatial_chain import SpatialChain

_UP = (0.0, 1.0, 0.0)  # long axis of the base, which has no axial rotation
_SNAP = 2.0  # factor on the snap, because sensors measure faster movement than markers
_ACCELERATION_SHARE = 0.35  # factor on the filter's sd, from simulated arms at rest; errors from skin are added later
_LONG = 0.1  # s without markers, after which the axial rotation is not interpolated
_LASTS = 0.3  # s, time for which errors of a gyroscope keep their sign
_WORSE = 1.5  # times the residual of the markers alone, at which the sensors contradict them
_LEAST_USED = 0.8  # least fraction of the samples that must pass the gate


def fuse_in_space(
    points: FloatArray,
    time: FloatArray,
    chain: SpatialChain,
    sensors: Mapping[int, SensorSignals],
    settings: SpatialSettings | None = None,
) -> tuple[SpatialStates, dict[int, SensorResult]]:
    """Return the states of all segments from markers and inertial sensors, and the result of each sensor by segment.

    If all sensors are left out, the states come from the markers alone. ``points`` (F, M, 3) are the measured markers
    in the frame of the trial (y up), m, NaN where missing. ``time`` (F,) are uniform times of the cameras, s.
    ``sensors`` are numbered by their segment.

    Raise NumericalError if a covariance is not positive definite.
    """
    settings = settings or SpatialSettings()
    model, rate = make_chain_model(chain), 1.0 / float(time[1] - time[0])
    points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
    frames, steady, noise = estimate_noise(chain, model, points, rate, settings)
    trial = _Smoothing(chain, model, frames, steady, noise, rate, settings)

    def prepare(axial: Sequence[FloatArray | None]) -> dict[int, PreparedSensor]:
        seen = frames.observed
        return {s: prepare_sensor(sensors[s], kept[s], motions[s], time, seen[:, s], axial=axial[s]) for s in kept}

    alone = trial.smooth({}, {})
    motions = _compute_motions_from_markers(chain, alone, rate, find_observed_segments(frames.observed, rate))
    results = calibrate_all(sensors, motions, time)
    kept = {s: each.used for s, each in results.items() if each.used is not None}
    if not kept:
        return alone, results
    try:
        both = trial.smooth(kept, prepare([None] * len(motions)))
        if not _measure_residual(both, points) < _WORSE * _measure_residual(alone, points):
            raise NumericalError("the sensors pull the chain away from the markers")
        # a segment whose skin lags may be hidden for too long to interpolate its axial rotation
        soft = [s for s, each in kept.items() if each.lag]
        if any(run.stop - run.start > _LONG * rate for s in soft for run in find_runs(~frames.observed[:, s])):
            turns = [_unwrap(joint.twist(both.joint_rotations[:, k])) for k, joint in enumerate(chain.joints)]
            both = trial.smooth(kept, prepare([None, *turns]))
    except NumericalError as error:
        return alone, {s: replace(each, why=each.why or str(error)) for s, each in results.items()}
    return replace(both, noise=noise), results


@dataclass(frozen=True)
class _Smoothing:
    """Markers of a trial and their noise, from which states can be estimated with and without sensors."""

    chain: SpatialChain
    model: ChainModel
    frames: FramePoses
    steady: FloatArray  # (F, M, 3) markers without lasting displacements, m
    noise: SpatialNoise
    rate: float
    settings: SpatialSettings

    def smooth(self, found: Mapping[int, SensorCalibration], ready: Mapping[int, PreparedSensor]) -> SpatialStates:
        """Return the states from the markers, and from the sensors ``ready``, if any, with their calibrations."""
        chain, model, dt, noise = self.chain, self.model, 1.0 / self.rate, self.noise
        groups, observed = group_columns(model), self.frames.observed
        own, sensors, followed = list(ready), None, np.zeros(groups[-1].stop, dtype=np.bool_)
        if ready:
            above = [chain.joints[s - 1] if s > 0 else None for s in own]
            sensors = Sensors(
                segment=np.array(own, dtype=np.int64),
                place=np.array([found[s].place for s in own]),
                lag=np.array([found[s].lag for s in own]),
                long_axis=np.array([_UP if joint is None else joint.long_axis for joint in above]),
                parent=np.array([0 if joint is None else joint.parent for joint in above], dtype=np.int64),
                rest_axis=np.array([_UP if joint is None else joint.untwisted @ joint.long_axis for joint in above]),
                gyro=np.ascontiguousarray(np.stack([ready[s].gyro for s in own], axis=1)),
                force=np.ascontiguousarray(np.stack([ready[s].force for s in own], axis=1)),
                variance=np.ascontiguousarray(np.stack([ready[s].variance for s in own], axis=1)),
                spread=np.array([ready[s].spread for s in own]),
                gravity=GRAVITY,
            )
            # the sensors measure the rates of joints with sensors on both segments; the base needs one, on the base
            followed[groups[0]] = 0 in own
            for k, parent in enumerate(model.parent.tolist()):
                followed[groups[k + 1]] = k + 1 in own and parent in own
            errors = noise.errors.copy()
            errors[1:, followed] = np.nan
            noise = replace(noise, snap=np.where(followed, _SNAP, 1.0) * noise.snap, errors=errors)
        gate = self.settings.gate
        track = filter_and_smooth(model, self.steady, dt, self.frames, noise, gate=gate, sensors=sensors)
        if sensors is not None:
            given = np.isfinite(sensors.gyro[..., 0]).mean(axis=0)
            if np.any(track.sensed[:, :, 0].mean(axis=0) < _LEAST_USED * given):
                raise NumericalError("most samples of a gyroscope contradict the markers and the other sensors")
        lost = find_uncertain_segments(chain, model, track, self.settings)
        scale_to_movement(track, noise.errors)
        if sensors is not None:
            scale = np.ones(ORDER * len(followed))
            scale[2 * len(followed) : 3 * len(followed)][followed] = _ACCELERATION_SHARE
            for part in chunks(len(track.covariance)):
                track.covariance[part] *= scale[:, None] * scale
            # errors of the gyroscopes, integrated over gaps of markers
            for k, group in enumerate(groups):
                both = (k,) if k == 0 else (k, int(model.parent[k - 1]))
                if any(s not in ready for s in both):
                    continue
                lasting = np.sum([np.nan_to_num(ready[s].lasting) for s in both], axis=0)
                columns = np.arange(max(group.start, 3), group.stop)
                for run in find_runs(~observed[:, k]):
                    grown = np.cumsum(lasting[run]) * _LASTS * dt
                    inside = run.start > 0 and run.stop < len(observed)
                    bridged = grown * (1.0 - grown / grown[-1]) if inside else grown
                    track.covariance[run, columns, columns] += bridged[:, None]
        # segments with a sensor, and with skin whose axial rotation has an estimated uncertainty
        every, skin = np.arange(len(chain.joints) + 1), chain.skin
        soft = chain.segment[skin != 0] if len(chain.skin_sd) else every[:0]
        counted = np.isin(every, own) & np.isin(every, soft)
        return collect_states(chain, model, self.frames, track, noise, lost, counted=counted)


def _unwrap(angle: FloatArray) -> FloatArray:
    """Return angles (F,), rad, without jumps by 2π between samples that are not NaN."""
    unwrapped, known = angle.copy(), np.isfinite(angle)
    unwrapped[known] = np.unwrap(angle[known])
    return unwrapped


def _compute_motions_from_markers(
    chain: SpatialChain, states: SpatialStates, rate: float, known: BoolArray
) -> list[MotionFromMarkers]:
    """Return the motion of every segment, base first, in its own axes; NaN where ``known`` (F, n + 1) is false."""
    motions = []
    for s in range(len(chain.joints) + 1):
        rotation, origin = states.rotations[:, s], states.origins[:, s]
        force = np.full(origin.shape, np.nan)
        force[1:-1] = (origin[2:] - 2 * origin[1:-1] + origin[:-2]) * rate**2 + [0.0, GRAVITY, 0.0]
        own = [np.einsum("fji,fj->fi", rotation, each) for each in (states.omega[:, s], states.alpha[:, s], force)]
        axial, speed, along = np.zeros(len(rotation)), np.zeros(len(rotation)), np.array(_UP)
        if s > 0:
            joint = chain.joints[s - 1]
            along = joint.long_axis
            axial = _unwrap(joint.twist(states.joint_rotations[:, s - 1]))
            speed = np.sum(states.velocity[:, s - 1] * joint.twist_axis(states.joint_rotations[:, s - 1]), axis=1)
        for each in (*own, axial, speed):
            each[~known[:, s]] = np.nan
        motions.append(MotionFromMarkers(own[0], own[1], own[2], axial, speed, along))
    return motions


def _measure_residual(states: SpatialStates, points: FloatArray) -> float:
    squares = np.sum((points - states.predicted) ** 2, axis=2)[states.used]
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else np.inf
