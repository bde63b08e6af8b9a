"""Smoothed states of a chain in space from its markers and inertial sensors.

The markers alone give a first motion. On it each sensor is calibrated, and one that contradicts it is left out. The
filter then runs again with both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, chunks, find_runs
from mocap_id.errors import NumericalError
from mocap_id.estimation.inertial import (
    Calibrated,
    Prepared,
    SegmentMotion,
    SensorResult,
    SensorSignals,
    calibrate_all,
    find_shown,
    prepare_sensor,
)
from mocap_id.estimation.inertial.signals import GRAVITY
from mocap_id.estimation.process_model import ORDER
from mocap_id.estimation.space.chain_model import chain_model, group_columns
from mocap_id.estimation.space.frame_poses import FramePoses
from mocap_id.estimation.space.space_filter import SpatialTrack, scale_to_movement
from mocap_id.estimation.space.space_kernels import ChainModel, Sensors
from mocap_id.estimation.space.space_smoothing import (
    SpatialSettings,
    SpatialStates,
    collect_states,
    estimate_noise,
    find_lost,
    run_both_ways,
)
from mocap_id.estimation.space.spatial_noise import SpatialNoise
from mocap_id.geometry.spatial_chain import SpatialChain

_UP = (0.0, 1.0, 0.0)  # long axis of the base, which does not twist
_SNAP = 2.0  # the sensors show faster movement than the markers
_ACCELERATION_SHARE = 0.35  # of the filter's standard deviation, in still simulated arms; skin is counted by its motion
_LONG = 0.1  # s, without markers, after which the twist is not interpolated
_LASTS = 0.3  # s, in which errors of a gyroscope keep their sign
_WORSE = 1.5  # times the residual of the markers alone, at which the sensors contradict them
_LEAST_USED = 0.8  # share of the samples that pass the gate


def smooth_with_sensors(
    points: FloatArray,
    time: FloatArray,
    chain: SpatialChain,
    sensors: Mapping[int, SensorSignals],
    settings: SpatialSettings | None = None,
) -> tuple[SpatialStates, dict[int, SensorResult]]:
    """Estimate the states of all segments and joints from markers and inertial sensors.

    Parameters
    ----------
    points : (F, M, 3) array
        Measured markers in the frame of the trial (y up), m; NaN where missing.
    time : (F,) array
        Uniform times of the cameras, s.
    chain : SpatialChain
    sensors : mapping from int to SensorSignals
        Sensors by the number of their segment.
    settings : SpatialSettings, optional

    Returns
    -------
    SpatialStates
        From the markers alone if no sensor is left.
    dict from int to SensorResult

    Raises
    ------
    NumericalError
        A covariance is not positive definite.
    """
    settings = settings or SpatialSettings()
    model, rate = chain_model(chain), 1.0 / float(time[1] - time[0])
    points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
    frames, steady, noise = estimate_noise(chain, model, points, rate, settings)
    trial = _Smoothing(chain, model, frames, steady, noise, rate, settings)

    def prepare(twists: Sequence[FloatArray | None]) -> dict[int, Prepared]:
        seen = frames.observed
        return {s: prepare_sensor(sensors[s], kept[s], motions[s], time, seen[:, s], twist=twists[s]) for s in kept}

    alone = trial.smooth({}, {})
    motions = segment_motions(chain, alone, rate, find_shown(frames.observed, rate))
    results = calibrate_all(sensors, motions, time)
    kept = {s: each.found for s, each in results.items() if each.found is not None and each.why is None}
    if not kept:
        return alone, results
    try:
        both = trial.smooth(kept, prepare([None] * len(motions)))
        _check_residual(both, alone, points)
        if _hidden_for_long(frames.observed, kept, rate):
            both = trial.smooth(kept, prepare(_twists(chain, both)))
    except NumericalError as error:
        return alone, {s: replace(each, why=each.why or str(error)) for s, each in results.items()}
    return replace(both, noise=noise), results


@dataclass(frozen=True)
class _Smoothing:
    """Markers of a trial without lasting displacements (F, M, 3), their noise, and what smooths them."""

    chain: SpatialChain
    model: ChainModel
    frames: FramePoses
    steady: FloatArray
    noise: SpatialNoise
    rate: float
    settings: SpatialSettings

    def smooth(self, found: Mapping[int, Calibrated], ready: Mapping[int, Prepared]) -> SpatialStates:
        """Return the states from the markers and from the sensors that are ready, if any."""
        model, dt, noise = self.model, 1.0 / self.rate, self.noise
        fused, followed = None, None
        if ready:
            fused, followed = _as_arrays(self.chain, found, ready), _followed(model, list(ready))
            noise = _faster(noise, followed)
        track = run_both_ways(model, self.steady, dt, self.frames, noise, self.settings.gate, fused)
        _check_gate(track, fused)
        lost = find_lost(self.chain, model, track, self.settings)
        scale_to_movement(track, noise.errors)
        if followed is not None:
            _shrink_accelerations(track.covariance, followed)
            _add_lasting_errors(track.covariance, model, self.frames.observed, ready, dt)
        sensed = _counted_twists(self.chain, list(ready))
        return collect_states(self.chain, model, self.frames, track, noise, lost, sensed=sensed)


def _counted_twists(chain: SpatialChain, own: Sequence[int]) -> BoolArray:
    """Return the segments (n + 1,) with a sensor whose shares of the twist are estimated, with their uncertainty."""
    every = np.arange(len(chain.joints) + 1)
    if not len(chain.skin_sd):
        return every < 0
    return np.isin(every, own) & np.isin(every, chain.segment[chain.skin != 0])


def _hidden_for_long(observed: BoolArray, found: Mapping[int, Calibrated], rate: float) -> bool:
    """Return whether a segment with skin that lags is hidden too long to interpolate its axial rotation."""
    soft = (s for s, each in found.items() if each.lag)
    return any(run.stop - run.start > _LONG * rate for s in soft for run in find_runs(~observed[:, s]))


def _twists(chain: SpatialChain, states: SpatialStates) -> list[FloatArray | None]:
    """Return the twist (F,) of every segment, rad, also where only sensors show it; None for the base."""
    found: list[FloatArray | None] = [None]
    for k, joint in enumerate(chain.joints):
        found.append(_continuous(joint.twist(states.joint_rotations[:, k])))
    return found


def _continuous(angle: FloatArray) -> FloatArray:
    """Return angles (F,) without whole turns between known samples, rad."""
    known = np.isfinite(angle)
    found = angle.copy()
    found[known] = np.unwrap(angle[known])
    return found


def _check_gate(track: SpatialTrack, sensors: Sensors | None) -> None:
    """Raise NumericalError if most samples of a gyroscope fail the gate."""
    if sensors is not None:
        given = np.isfinite(sensors.gyro[..., 0]).mean(axis=0)
        if np.any(track.sensed[:, :, 0].mean(axis=0) < _LEAST_USED * given):
            raise NumericalError("most samples of a gyroscope are far from what markers and the other sensors show")


def _check_residual(both: SpatialStates, alone: SpatialStates, points: FloatArray) -> None:
    """Raise NumericalError if the markers fit much worse than without sensors."""
    if not _residual(both, points) < _WORSE * _residual(alone, points):
        raise NumericalError("the sensors pull the chain away from the markers")


def _faster(noise: SpatialNoise, followed: BoolArray) -> SpatialNoise:
    """Return the noise where sensors determine the rates (d,): markers say nothing on their errors."""
    errors = noise.errors.copy()
    errors[1:, followed] = np.nan
    return replace(noise, snap=np.where(followed, _SNAP, 1.0) * noise.snap, errors=errors)


def segment_motions(chain: SpatialChain, states: SpatialStates, rate: float, shown: BoolArray) -> list[SegmentMotion]:
    """Return the motion of every segment in its own axes, where markers show it (F, n + 1)."""
    found = []
    for s in range(len(chain.joints) + 1):
        turn, origin = states.rotations[:, s], states.origins[:, s]
        force = np.full(origin.shape, np.nan)
        force[1:-1] = (origin[2:] - 2 * origin[1:-1] + origin[:-2]) * rate**2 + [0.0, GRAVITY, 0.0]
        own = [np.einsum("fji,fj->fi", turn, each) for each in (states.omega[:, s], states.alpha[:, s], force)]
        twist, speed, along = np.zeros(len(turn)), np.zeros(len(turn)), np.array(_UP)
        if s > 0:
            joint = chain.joints[s - 1]
            along = joint.long_axis
            twist = _continuous(joint.twist(states.joint_rotations[:, s - 1]))
            speed = np.sum(states.velocity[:, s - 1] * joint.twist_axis(states.joint_rotations[:, s - 1]), axis=1)
        for each in (*own, twist, speed):
            each[~shown[:, s]] = np.nan
        found.append(SegmentMotion(own[0], own[1], own[2], twist, speed, along))
    return found


def _as_arrays(chain: SpatialChain, found: Mapping[int, Calibrated], ready: Mapping[int, Prepared]) -> Sensors:
    own = list(ready)
    above = [chain.joints[s - 1] if s > 0 else None for s in own]

    def stack(name: str) -> FloatArray:
        return np.ascontiguousarray(np.stack([getattr(ready[s], name) for s in own], axis=1))

    return Sensors(
        segment=np.array(own, dtype=np.int64),
        place=np.array([found[s].place for s in own]),
        lag=np.array([found[s].lag for s in own]),
        long_axis=np.array([_UP if joint is None else joint.long_axis for joint in above]),
        parent=np.array([0 if joint is None else joint.parent for joint in above], dtype=np.int64),
        rest_axis=np.array([_UP if joint is None else joint.untwisted @ joint.long_axis for joint in above]),
        gyro=stack("gyro"),
        force=stack("force"),
        variance=stack("variance"),
        spread=np.array([ready[s].spread for s in own]),
        gravity=GRAVITY,
    )


def _followed(model: ChainModel, own: Sequence[int]) -> BoolArray:
    """Return a mask (d,) of the degrees of freedom with rates from sensors: of joints between two segments with one."""
    groups = group_columns(model)
    found = np.zeros(groups[-1].stop, dtype=np.bool_)
    found[groups[0]] = 0 in own
    for k, parent in enumerate(model.parent.tolist()):
        found[groups[k + 1]] = k + 1 in own and parent in own
    return found


def _shrink_accelerations(covariance: FloatArray, followed: BoolArray) -> None:
    """Scale the accelerations of the covariance (F, 4 d, 4 d), in place."""
    scale = np.ones(ORDER * len(followed))
    scale[2 * len(followed) : 3 * len(followed)][followed] = _ACCELERATION_SHARE
    for part in chunks(len(covariance)):
        covariance[part] *= scale[:, None] * scale


def _add_lasting_errors(
    covariance: FloatArray, model: ChainModel, observed: BoolArray, ready: Mapping[int, Prepared], dt: float
) -> None:
    """Add the integrated lasting errors of gyroscopes in gaps to the covariance of the pose, in place."""
    for k, own in enumerate(group_columns(model)):
        both = (k,) if k == 0 else (k, int(model.parent[k - 1]))
        if any(s not in ready for s in both):
            continue
        lasting = np.sum([np.nan_to_num(ready[s].lasting) for s in both], axis=0)
        columns = np.arange(max(own.start, 3), own.stop)
        for run in find_runs(~observed[:, k]):
            grown = np.cumsum(lasting[run]) * _LASTS * dt
            inside = run.start > 0 and run.stop < len(observed)
            bridged = grown * (1.0 - grown / grown[-1]) if inside else grown
            covariance[run, columns, columns] += bridged[:, None]


def _residual(states: SpatialStates, points: FloatArray) -> float:
    squares = np.sum((points - states.predicted) ** 2, axis=2)[states.used]
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else np.inf
