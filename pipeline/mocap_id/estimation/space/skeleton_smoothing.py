"""Smoothed states of an arm from a skeleton recording, and of any chain from markers and inertial sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, IntArray, chunks, find_runs
from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_problem import ORDER
from mocap_id.estimation.inertial import (
    WORSE,
    MotionFromMarkers,
    PreparedSensor,
    SensorCalibration,
    SensorResult,
    SensorSignals,
    calibrate_all,
    find_observed_segments,
    measure_rms_distance,
    prepare_sensor,
)
from mocap_id.estimation.space.frame_poses import (
    FramePoses,
    degrees_of_freedom,
    group_columns,
    make_chain_model,
    make_track,
    predict_positions,
    select_frames,
)
from mocap_id.estimation.space.space_kernels import ChainModel, Sensors, locate_markers
from mocap_id.estimation.space.space_smoothing import (
    Colour,
    SkinErrors,
    SpatialNoise,
    SpatialSettings,
    SpatialStates,
    collect_states,
    compute_chain_rates,
    estimate_noise,
    estimate_snaps,
    filter_and_smooth,
    find_uncertain_segments,
    scale_to_movement,
)
from mocap_id.geometry.spatial_chain import SpatialChain

LEAST_FLEXION = float(np.radians(-10))
"""Smallest flexion of an elbow, rad. In a pose with a smaller flexion, the humerus is wrongly rotated by 180°."""

_STRAIGHT = float(np.sin(np.radians(15)))
"""Sine of the angle between the directions of upper arm and forearm below which the humerus's rotation is unknown."""
_WEAK = 1.0  # rad and m, prior standard deviation of degrees of freedom that no joint of the skeleton determines


def find_skeleton_poses(
    chain: SpatialChain, model: ChainModel, points: FloatArray, trunk: tuple[FloatArray, FloatArray], sd: FloatArray
) -> tuple[FramePoses, BoolArray]:
    """Return the poses of single frames, and whether each (F,) determines the axial rotation of the humerus.

    The segments of the chain are trunk, upper arm (ball joint), forearm (hinge) and, in some chains, hand (two-axis
    joint). Each segment of the arm has one joint of the skeleton. ``points`` (F, M, 3) are all joints of the skeleton,
    m, NaN where missing; ``sd`` (M,) is the standard deviation of their coordinates, m. ``trunk`` is the trunk's
    rotation (F, 3, 3) and position (F, 3), m; NaN where unknown. Where a joint of the skeleton is missing, the pose of
    the frame before is kept.
    """
    frames, segments = len(points), len(chain.joints) + 1
    track = make_track(model, frames)
    observed = np.zeros((frames, segments), dtype=np.bool_)
    rotation, origin = (_hold_last(each) for each in trunk)
    observed[:, 0] = np.isfinite(trunk[1]).all(axis=1)
    track.turn[:, 0], track.origin[:] = rotation, origin
    ends = [points[:, int(np.flatnonzero(chain.segment == s)[0])] for s in range(1, segments)]
    shoulder = origin + rotation @ chain.joints[0].centre
    # the humerus's rotation and the flexion, from the vectors from shoulder to elbow and from elbow to wrist
    upper, lower = ends[0] - shoulder, ends[1] - ends[0]
    wrist = chain.local[int(np.flatnonzero(chain.segment == 2)[0])]
    along = chain.joints[1].offset @ (wrist / np.linalg.norm(wrist))
    y = -upper / np.linalg.norm(upper, axis=1, keepdims=True)
    v = lower / np.linalg.norm(lower, axis=1, keepdims=True)
    rise = np.einsum("fi,fi->f", v, y)
    size, phase = np.hypot(along[0], along[1]), np.arctan2(along[0], along[1]) % (2 * np.pi)
    flexion = np.maximum(phase - np.arccos(np.clip(rise / size, -1, 1)), LEAST_FLEXION)
    forward = np.cos(flexion) * along[0] - np.sin(flexion) * along[1]
    across = v - rise[:, None] * y
    bent = np.linalg.norm(across, axis=1)
    first = across / np.maximum(bent, 1e-9)[:, None]
    second = np.cross(first, y)
    x = (forward[:, None] * first - along[2] * second) / np.hypot(forward, along[2])[:, None]
    observed[:, 1] = observed[:, 2] = observed[:, 0] & np.isfinite(flexion)
    upper, flexion = _hold_last(np.stack([x, y, np.cross(x, y)], axis=2)), _hold_last(flexion)
    track.turn[:, 1] = np.swapaxes(rotation, 1, 2) @ upper
    track.angle[:, 1, 0] = flexion
    track.turn[:, 2] = chain.joints[1].rotation(flexion[:, None])
    if segments > 3:
        forearm = upper @ track.turn[:, 2]
        hand = np.einsum("fji,fj->fi", forearm, ends[2] - ends[1])
        observed[:, 3] = observed[:, 2] & np.isfinite(hand).all(axis=1)
        lean = -np.arcsin(hand[:, 2] / np.linalg.norm(hand, axis=1))
        track.angle[:, 2] = _hold_last(np.stack([np.arctan2(hand[:, 0], -hand[:, 1]), lean], axis=1))
        track.turn[:, 3] = chain.joints[2].rotation(track.angle[:, 2])
    # variances of the pose due to the errors of the skeleton's joints
    d, count = degrees_of_freedom(model), points.shape[1]
    jacobian = np.zeros((frames, count, 3, d))
    locate_markers(model, track, np.empty((frames, count, 3)), jacobian)
    seen = np.asarray(np.isfinite(points).all(axis=2))
    weight = np.sqrt(seen) / sd
    rows = (jacobian * weight[..., None, None]).reshape(frames, -1, d)
    normal = np.swapaxes(rows, 1, 2) @ rows + np.eye(d) / _WEAK**2
    variance = np.diagonal(np.linalg.inv(normal), axis1=1, axis2=2).copy()
    residual, none = points - predict_positions(model, track), np.zeros((frames, count))
    poses = FramePoses(track, variance, observed, seen, residual, none, np.zeros(points.shape))
    return poses, np.asarray(bent > _STRAIGHT) & observed[:, 1]


def _hold_last(values: FloatArray) -> FloatArray:
    """Return values (F, …) with NaN replaced by the last known frame, at the start by the first, or by zero."""
    known = np.isfinite(values).reshape(len(values), -1).all(axis=1)
    if not known.any():
        return np.zeros_like(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.asarray(values[np.where(last < 0, int(np.argmax(known)), last)])


_LIMITS = SpatialSettings(angle_sd_limit=1.0, origin_sd_limit=0.1)
"""Wide limits: a straight elbow does not determine the rotation of the humerus, but the rest of the pose is known."""
_POSTURES = 60
_SLOWEST = 1.5  # Hz, least corner of the smoother, because every movement of an arm needs it
_DAMPING = 4.0  # 1/rad², prior of degrees of freedom that no joint determines: a standard deviation of half a radian
_LEAST_WEIGHT = 1e-3
_HALF = 2  # frames on each side of a running median


def smooth_skeleton(
    points: FloatArray,
    rate: float,
    chain: SpatialChain,
    trunk: tuple[FloatArray, FloatArray],
    *,
    sd: FloatArray,
    weight: FloatArray,
    colour: Colour,
    lasting: FloatArray,
    gate: float,
) -> SpatialStates:
    """Return the states of trunk and arm at every frame.

    ``points`` (F, M, 3) are the joints of the skeleton, m, without jumps and known lasting errors. Short gaps are
    filled; long gaps are NaN. ``chain`` and ``trunk`` are as for :func:`find_skeleton_poses`. ``sd`` (M,) is the
    standard deviation of the noise of a coordinate of each joint, m, and ``colour`` the power of this noise. ``weight``
    (F, M) is usually 1, less if the sample is guessed or its bone has a wrong length, and 0 in gaps. ``lasting`` (M,)
    is the standard deviation of the part of each lasting error that changes with the posture, m. A sample farther from
    its prediction than ``gate`` standard deviations is left out.

    Raise NumericalError if a covariance is not positive definite.
    """
    model = make_chain_model(chain)
    camera = float(np.median(sd))
    frames, shown = find_skeleton_poses(chain, model, points, trunk, sd)
    # the shoulder counts only where the elbow is bent, unless it never is
    bent = frames.observed.copy()
    bent[:, 1] &= shown
    if not bent[:, 1].any():
        bent[:, 1] = frames.observed[:, 1]
    moving = replace(frames, observed=bent)
    snap, gap_snap, errors = estimate_snaps(model, moving, 1.0 / rate, colour, _SLOWEST)
    # samples without weight were not measured
    there = np.asarray(weight > 0)
    seen = np.stack([there[:, model.segment == s].any(axis=1) for s in range(frames.observed.shape[1])], axis=1)
    seen[:, 1:3] &= seen[:, 1:2] & seen[:, 2:3]
    frames = replace(frames, observed=frames.observed & seen, used=there & frames.used)
    noise = SpatialNoise(camera, sd, snap, gap_snap, errors)
    measured = np.where(weight[..., None] > 0, points, np.nan)
    weight = np.maximum(weight, _LEAST_WEIGHT) * (camera / sd) ** 2
    track = filter_and_smooth(model, measured, 1.0 / rate, frames, noise, gate=gate, gate_sd=sd, weight=weight)
    # a pose with a wrongly rotated humerus is replaced by the anatomical pose with the same positions
    wrong = np.flatnonzero(track.pose.angle[:, 1, 0] < LEAST_FLEXION)
    if wrong.size:
        some = select_frames(track.pose, wrong)
        place = (some.turn[:, 0], some.origin)
        right, _ = find_skeleton_poses(chain, model, predict_positions(model, some), place, sd)
        track.pose.turn[wrong], track.pose.angle[wrong] = right.track.turn, right.track.angle
    lost = find_uncertain_segments(chain, model, track, _LIMITS)
    scale_to_movement(track, errors)
    # errors of the pose due to lasting errors of the skeleton, at postures from frames with all segments
    known, pose = np.asarray(~lost.any(axis=1)), track.pose
    at = np.flatnonzero(known) if known.any() else np.arange(len(known))
    postures: IntArray = np.unique(at[np.linspace(0, len(at) - 1, _POSTURES).round().astype(np.int64)])
    d, segments = degrees_of_freedom(model), len(chain.joints) + 1
    shape = (len(postures), len(model.segment), 3)
    jacobian = np.zeros((*shape, d))
    locate_markers(model, select_frames(pose, postures), np.empty(shape), jacobian)
    normal = np.einsum("fmik,fmil,m->fkl", jacobian, jacobian, sd**-2) + _DAMPING * np.eye(d)
    gain = np.einsum("fkl,fmil,m->fmki", np.linalg.inv(normal), jacobian, sd**-2)
    covariance = np.zeros((len(postures), 2 * segments, d, d))
    covariance[:, 0] = np.einsum("fmki,fmli,m->fkl", gain, gain, lasting**2)
    rates = compute_chain_rates(chain, model, pose, chain.place(pose.origin, pose.turn[:, 0], pose.turn[:, 1:])[1])
    motion = np.zeros((3, len(pose.origin), 2 * segments))
    motion[0, :, 0] = 1.0
    motion[1, :, 0] = np.sum(rates.velocity[:, :2] ** 2, axis=(1, 2))
    motion[2, :, 0] = np.sum(rates.acceleration[:, :2] ** 2, axis=(1, 2))
    return collect_states(chain, model, frames, track, noise, lost, SkinErrors(covariance, postures, motion))


def remove_jumps(points: FloatArray, limit: FloatArray) -> FloatArray:
    """Return points (F, M, 3) with NaN for each sample farther than ``limit`` (M,), m, from the median around it."""
    kept = points.copy()
    if len(points) <= 2 * _HALF:
        return kept
    padded = np.pad(points, ((_HALF, _HALF), (0, 0), (0, 0)), mode="edge")
    seen = np.asarray(np.isfinite(padded).all(axis=2))
    windows = np.stack([padded[k : k + len(points)] for k in range(2 * _HALF + 1)])
    enough = np.stack([seen[k : k + len(points)] for k in range(2 * _HALF + 1)]).sum(axis=0) >= _HALF + 1
    middle = np.full(points.shape, np.nan)
    middle[enough] = np.nanmedian(windows[:, enough], axis=0)
    with np.errstate(invalid="ignore"):
        kept[np.linalg.norm(points - middle, axis=2) > limit] = np.nan
    return kept


def bridge_short_gaps(points: FloatArray, longest: int) -> FloatArray:
    """Return points (F, M, 3) in which gaps of at most ``longest`` frames are interpolated linearly."""
    filled, every = points.copy(), np.arange(len(points))
    for m in range(points.shape[1]):
        seen = np.isfinite(points[:, m, 0])
        if seen.sum() < 2:
            continue
        for gap in find_runs(~seen):
            if gap.stop - gap.start <= longest and gap.start > 0 and gap.stop < len(points):
                for axis in range(3):
                    filled[gap, m, axis] = np.interp(every[gap], every[seen], points[seen, m, axis])
    return filled


_UP = (0.0, 1.0, 0.0)  # long axis of the base, which has no axial rotation
_SNAP = 2.0  # factor on the snap, because sensors measure faster movement than markers
_ACCELERATION_SHARE = 0.35  # factor on the filter's sd, from simulated arms at rest; errors from skin are added later
_LONG = 0.1  # s without markers, after which the axial rotation is not interpolated
_LASTS = 0.3  # s, time for which errors of a gyroscope keep their sign
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
    smooth = partial(_smooth_with_sensors, chain, model, frames, steady, noise, dt=1.0 / rate, settings=settings)

    def prepare(axial: Sequence[FloatArray | None]) -> dict[int, PreparedSensor]:
        seen = frames.observed
        return {s: prepare_sensor(sensors[s], kept[s], motions[s], time, seen[:, s], axial=axial[s]) for s in kept}

    alone = smooth(found={}, ready={})
    motions = _compute_motions_from_markers(chain, alone, rate, find_observed_segments(frames.observed, rate))
    results = calibrate_all(sensors, motions, time)
    kept = {s: each.used for s, each in results.items() if each.used is not None}
    if not kept:
        return alone, results
    try:
        both = smooth(found=kept, ready=prepare([None] * len(motions)))
        off, usual = (measure_rms_distance(points, each.predicted, each.used) for each in (both, alone))
        if not off < WORSE * usual:
            raise NumericalError("the sensors pull the chain away from the markers")
        # a segment whose skin lags may be hidden for too long to interpolate its axial rotation
        soft = [s for s, each in kept.items() if each.lag]
        if any(run.stop - run.start > _LONG * rate for s in soft for run in find_runs(~frames.observed[:, s])):
            turns = [_unwrap(joint.twist(both.joint_rotations[:, k])) for k, joint in enumerate(chain.joints)]
            both = smooth(found=kept, ready=prepare([None, *turns]))
    except NumericalError as error:
        return alone, {s: replace(each, why=each.why or str(error)) for s, each in results.items()}
    return replace(both, noise=noise), results


def _smooth_with_sensors(
    chain: SpatialChain,
    model: ChainModel,
    frames: FramePoses,
    steady: FloatArray,
    noise: SpatialNoise,
    *,
    dt: float,
    settings: SpatialSettings,
    found: Mapping[int, SensorCalibration],
    ready: Mapping[int, PreparedSensor],
) -> SpatialStates:
    """Return the states from the markers ``steady`` (F, M, 3), m, without lasting displacements, and from sensors.

    ``ready`` are the sensors by segment, with the calibrations ``found``; without sensors, the markers alone count.
    """
    groups, observed = group_columns(model), frames.observed
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
    track = filter_and_smooth(model, steady, dt, frames, noise, gate=settings.gate, sensors=sensors)
    if sensors is not None:
        given = np.isfinite(sensors.gyro[..., 0]).mean(axis=0)
        if np.any(track.sensed[:, :, 0].mean(axis=0) < _LEAST_USED * given):
            raise NumericalError("most samples of a gyroscope contradict the markers and the other sensors")
    lost = find_uncertain_segments(chain, model, track, settings)
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
    return collect_states(chain, model, frames, track, noise, lost, counted=counted)


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
