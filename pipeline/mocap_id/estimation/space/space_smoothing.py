"""Smoothed states of a chain in space from its markers, and their standard deviations: entry point of the package.

The variances of the states contain skin that slides with the joints. A marker's lasting error, which is the same in all
frames with the same posture, is proportional to the motion of the joints beside its segment. The error of the pose is
the gain of the weighted fit times this error. The errors of velocity and acceleration are proportional to the velocity
and acceleration of the joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_problem import ANCHOR_SD, ORDER, PATIENCE, noise_shape, start_sd, transition
from mocap_id.estimation.smoothing import find_rejected_segments, find_stretches
from mocap_id.estimation.space.frame_poses import (
    FramePoses,
    degrees_of_freedom,
    estimate_marker_sds,
    estimate_residual_sds,
    find_frame_poses,
    group_columns,
    make_chain_model,
    make_track,
    predict_positions,
    remove_displacements,
    select_frames,
    sum_steps,
    widen_sds,
)
from mocap_id.estimation.space.space_kernels import (
    ChainModel,
    Noise,
    Pose,
    Sensors,
    locate_markers,
    run_filter_in_space,
    run_smoother_in_space,
)
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint

SNAP_BOUNDS = (1e-1, 1e6)  # search range of the snap's standard deviation over one frame, rad/s⁴ or m/s⁴

_LARGEST_RATIO = 2.0  # of the snaps of two coordinates of one joint
_STILL = 0.3  # of the rms speed; slower samples are at rest and do not count
_AROUND = 0.25  # s; samples at rest that are this near to a moving sample also count
_WINDOW = 4.0  # s
_MOST = 100  # windows
_MOSTLY = 0.5  # least fraction of moving samples in a window
_GAP_SHARE = 0.36  # s^½; with this factor, white snap and a constant snap cause equal errors after 0.3 s
_REACH = 1.9  # highest frequency, relative to the corner, of the movement that the smoother does not pass
_CAUTION = 1.3  # factor on the best snap for autocorrelated noise, because fast movement needs more than the average
_LEAST = 16  # frames of a window
_FASTEST = 4.0  # Hz, highest frequency of movement that exceeds autocorrelated noise
_NEAR = 10.0  # ratio of measured power to noise power below which the power of the movement is modelled
_STEEPNESS = np.array([4.0, 6.0, 8.0, 12.0, 16.0])  # exponents of the fall of movement relative to noise; 4: constant
_CROSSINGS = 80  # frequencies at which movement and noise may be equal
_TRIALS = 120  # values of the snap


Colour: TypeAlias = Callable[[FloatArray], FloatArray]
"""Power of noise at frequencies (K,), Hz, relative to white noise of the same variance."""


@dataclass(frozen=True)
class SpatialNoise:
    """Noise of the filter in space, for M markers and d degrees of freedom."""

    camera_sd: float  # standard deviation of a marker's white noise, per coordinate, m
    marker_sd: FloatArray  # (M,) the same with the lasting error of the skin, for each marker, m
    snap: FloatArray  # (d,) standard deviation of the snap, held over one frame, rad/s⁴ or m/s⁴
    gap_snap: FloatArray  # (d,) the same in gaps; it is larger, because the snap of a real movement is not white
    errors: FloatArray  # (3, d) mean squared error of pose, velocity, acceleration, without skin; NaN if unknown


def estimate_camera_noise(frames: FramePoses, floor: float) -> float:
    """Return the standard deviation, m, of the markers' white noise, at least ``floor``.

    It is estimated from second differences of the residuals, which remove lasting errors. It is increased for the
    fraction of the noise that the poses follow.
    """
    squares, freedom = 0.0, 0.0
    for s in chunks(len(frames.residual)):
        part = slice(s.start, s.stop + 2)
        off = np.where(frames.used[part, :, None], frames.residual[part], np.nan)
        bends = np.sum((off[2:] - 2 * off[1:-1] + off[:-2]) ** 2, axis=2)
        known = np.isfinite(bends)
        squares += float(np.sum(bends[known])) / 6.0
        freedom += 3.0 * float(np.sum((1.0 - frames.leverage[part][1:-1])[known]))
    return max(floor, math.sqrt(squares / freedom)) if freedom >= 1.0 else floor


def estimate_snaps(
    model: ChainModel, frames: FramePoses, dt: float, colour: Colour | None = None, slowest: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fields ``snap``, ``gap_snap`` and ``errors`` of :class:`SpatialNoise`, estimated from ``frames``.

    ``dt`` is the time step, s. The noise is white, or has the power ``colour`` relative to white noise of the same
    variance. ``slowest`` is the least corner of the smoother of a joint, Hz. Without observed frames, the snap is the
    upper end of :data:`SNAP_BOUNDS`.
    """
    series, variance = sum_steps(model, frames.track), frames.variance
    snaps, gaps = np.empty(series.shape[1]), np.empty(series.shape[1])
    errors = np.full((ORDER - 1, series.shape[1]), np.nan)
    # the groups of degrees of freedom with one snap: position and rotation of the base, each ball joint, and each
    # coordinate of other joints
    groups = [(0, slice(0, 3)), (0, slice(3, 6))]
    for k, at in enumerate(model.first[1:].tolist()):
        widths = [3] if model.ball[k] else [1] * int(model.freedom[k])
        groups += [(k + 1, slice(at + c, at + c + width)) for c, width in enumerate(widths)]
    for group, columns in groups:
        seen = frames.observed[:, group]
        starts, size = _find_windows(series[:, columns], seen, dt)
        if not starts.size:
            snaps[columns], gaps[columns] = SNAP_BOUNDS[1], SNAP_BOUNDS[1]
            continue
        numbers = range(columns.start, columns.stop)
        frequency = np.asarray(np.fft.rfftfreq(size, dt), dtype=np.float64)
        angular = np.asarray(2 * np.pi * np.fft.rfftfreq(size, dt), dtype=np.float64)
        spectra = [_compute_spectrum(series[:, c], variance[:, c], seen, starts, size) for c in numbers]
        if colour is None:
            spectra = [(_model_fall(power, noise), noise, white) for power, noise, white in spectra]
        else:
            # power of autocorrelated noise; at frequencies too high for movement, all measured power is noise
            shade, high = colour(frequency), frequency > _FASTEST
            spectra = [
                (power, np.where(high, np.maximum(noise * shade, power), noise * shade), white)
                for power, noise, white in spectra
            ]
        trials = np.geomspace(*SNAP_BOUNDS, _TRIALS)[:, None]
        risk = np.zeros(_TRIALS)
        for power, noise, white in spectra:
            passed = 1 / (1 + angular ** (2 * ORDER) * white / trials**2)
            risk += np.sum(passed**2 * power - 2 * passed * (power - noise), axis=1)
        snap = float(trials[np.argmin(risk), 0]) * (1.0 if colour is None else _CAUTION)
        if group:
            snap = max(snap, (2 * math.pi * slowest) ** ORDER * math.sqrt(max(white for _, _, white in spectra)))
        snaps[columns], lasting = snap, 0.0
        for c, (power, noise, white) in zip(numbers, spectra, strict=True):
            corner = (snap**2 / white) ** (1 / (2 * ORDER))
            passed = 1 / (1 + (angular / corner) ** (2 * ORDER))
            # mean squared errors of the series and two derivatives after smoothing
            near = (angular > 0) & (angular < _REACH * corner)  # beyond, the noise exceeds the movement by far
            averages = passed**2 * noise
            lost = np.where(near, (1 - passed) ** 2 * (power - noise), 0.0)
            for order in range(ORDER - 1):
                by = np.zeros(len(angular))
                by[1:] = angular[1:] ** (2.0 * order - 4.0) / dt**4
                errors[order, c] = np.sum(by * averages) + max(float(np.sum(by * lost)), 0.0)
            lasting = max(lasting, float(np.sum(passed**2 * power * angular**4)) / dt**4)
        gaps[columns] = max(snap, _GAP_SHARE * math.sqrt(lasting / dt))
    # The ratio between the two coordinates of a two-axis joint is limited. Without the limit, the snap of a limb's
    # axial rotation would be too large, because sliding skin adds fast motion.
    limited = snaps.copy()
    for k, at in enumerate(model.first[1:].tolist()):
        if not model.ball[k] and model.freedom[k] == 2:
            limited[at : at + 2] = np.minimum(snaps[at : at + 2], _LARGEST_RATIO * snaps[at : at + 2][::-1])
    return limited, gaps, errors


def _model_fall(power: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the measured power, replaced by a smooth model at the frequencies at which it is near that of the noise.

    The power from few windows scatters. If it is by chance twice the power of the noise at a high frequency, it would
    be mistaken for movement. The model therefore begins at the first frequency at which the power of the noise is more
    than a tenth of the measured power. From there, the power is 1 + (c / k)^q times the power of the noise, where k is
    the index of the frequency, and c and q are the likeliest values for a periodogram.
    """
    ratio = power[1:] / noise[1:]
    near = np.flatnonzero(ratio < _NEAR)
    if not near.size:
        return power
    first = int(near[0]) + 1
    k = np.arange(first, len(power))
    crossings = np.geomspace(0.25, len(power), _CROSSINGS)
    modelled = 1.0 + (crossings[:, None, None] / k) ** _STEEPNESS[:, None]
    loss = np.sum(np.log(modelled) + ratio[first - 1 :] / modelled, axis=2)
    best = modelled[np.unravel_index(np.argmin(loss), loss.shape)]
    return np.concatenate([power[:first], noise[first:] * best])


def _find_windows(series: FloatArray, seen: BoolArray, dt: float) -> tuple[IntArray, int]:
    """Return the first frames of the windows with motion and without gaps, and the length of a window in frames.

    ``series`` (F, c) is one group of degrees of freedom, and ``seen`` (F,) are its observed frames. If no window is
    suitable, the middle window is returned; none if the trial is too short or nothing is observed.
    """
    size = min(round(_WINDOW / dt), len(seen) - 2)
    if size < _LEAST or not seen.any():
        return np.empty(0, dtype=np.int64), size
    # samples in motion or near motion; in a short trial all samples
    moving, half = seen, max(round(_AROUND / dt / 2), 1)
    if len(series) >= 8 * half:
        speed = np.zeros(len(series))
        speed[half:-half] = np.linalg.norm(series[2 * half :] - series[: -2 * half], axis=1)
        fast = speed > _STILL * np.sqrt(np.mean(speed[seen] ** 2))
        moving = seen & (np.convolve(fast, np.ones(4 * half + 1), mode="same") > 0)
    starts = np.arange(0, len(seen) - 1 - size, max(size // 2, 1))
    good = [moving[k : k + size + 2].mean() > _MOSTLY and seen[k : k + size + 2].all() for k in starts]
    kept = starts[np.array(good, dtype=np.bool_)]
    if not kept.size:
        kept = np.array([max((len(seen) - 2 - size) // 2, 0)])
    return kept[np.linspace(0, len(kept) - 1, min(len(kept), _MOST)).round().astype(np.int64)], size


def _compute_spectrum(
    series: FloatArray, variance: FloatArray, seen: BoolArray, starts: IntArray, size: int
) -> tuple[FloatArray, FloatArray, float]:
    """Return the power of the second differences, the power of their noise, and the noise variance of the series.

    Over the frequencies, the powers add up to variances. ``variance`` (F,) is the variance expected from the markers.
    """
    filled = np.interp(np.arange(len(series)), np.flatnonzero(seen), series[seen])
    bends = np.diff(filled, 2)
    windows = np.stack([bends[k : k + size] for k in starts])
    taper = np.hanning(size)
    taper /= np.sqrt(np.sum(taper**2) * size / 2)
    power = np.mean(np.abs(np.fft.rfft((windows - windows.mean(axis=1, keepdims=True)) * taper)) ** 2, axis=0)
    shape = (2 - 2 * np.cos(2 * np.pi * np.fft.rfftfreq(size))) ** 2 * np.sum(taper**2)
    top = slice(len(shape) // 2, None)  # a poor geometry in some postures has more noise than the median
    white = max(float(np.median(variance[seen])), float(np.sum(power[top]) / np.sum(shape[top])))
    return power, white * shape, white


_LEAST_GATE = 2e-4  # m; nearly exact markers follow the movement when its snap exceeds the usual snap
_SCALES = (0.25, 25.0)  # limits of the factor on a variance
_EMPTY, _NOBODY = np.zeros((0, 3)), np.zeros(0, np.int64)
_NO_SENSORS = Sensors(
    *(_NOBODY, _EMPTY, np.zeros(0), _EMPTY, _NOBODY, _EMPTY),
    *(np.zeros((0, 0, 3)), np.zeros((0, 0, 3)), np.zeros((0, 0, 3)), np.zeros((0, 2)), 0.0),
)


@dataclass(frozen=True)
class SpatialTrack:
    """Smoothed states of all d degrees of freedom at F frames."""

    pose: Pose  # poses with velocities, accelerations and jerks
    covariance: FloatArray  # (F, 4 d, 4 d) of pose (of rotation: error vector in the child's axes) and derivatives
    used: BoolArray  # (F, M) markers that were measured and passed the gate
    sensed: BoolArray  # (F, S, 2) gyroscopes and accelerometers that were measured and passed the gate


def filter_and_smooth(
    model: ChainModel,
    points: FloatArray,
    dt: float,
    frames: FramePoses,
    noise: SpatialNoise,
    *,
    gate: float,
    gate_sd: FloatArray | None = None,
    weight: FloatArray | None = None,
    sensors: Sensors | None = None,
) -> SpatialTrack:
    """Run the filter forwards and the smoother backwards, and return the smoothed states.

    ``points`` (F, M, 3) are the markers without lasting displacements, m; NaN where they are not used. ``dt`` is the
    time step, s. The filter starts from ``frames`` at the beginning and after gaps. ``gate`` is the limit of an
    innovation in standard deviations, and ``gate_sd`` (M,) the standard deviation of a coordinate in the gate, m, by
    default from the residuals of ``frames``. The variances of a sample are divided by its ``weight`` (F, M).

    Raise NumericalError if a covariance is not positive definite.
    """
    sensors = _NO_SENSORS if sensors is None else sensors
    count, d, camera = len(points), degrees_of_freedom(model), noise.camera_sd
    if gate_sd is None:
        gate_sd = widen_sds(frames, np.fmax(estimate_residual_sds(frames), max(camera, _LEAST_GATE)))
    constants = Noise(
        step=transition(dt)[0],
        shape=noise_shape(dt),
        density=noise.snap**2 * dt,
        gap_density=noise.gap_snap**2 * dt,
        start=np.tile(start_sd(dt) ** 2, (d, 1)),
        variance=camera**2,
        gate_variance=gate_sd**2,
        weight=np.ones(points.shape[:2]) if weight is None else weight,
        gate=gate,
        patience=math.ceil(PATIENCE / dt),
        anchor_limit=ANCHOR_SD**2,
    )
    track = SpatialTrack(
        make_track(model, count),
        np.empty((count, ORDER * d, ORDER * d)),
        np.zeros((count, points.shape[1]), np.bool_),
        np.zeros((count, len(sensors.segment), 2), np.bool_),
    )
    # the base or a joint is followed if markers determine it, or sensors on both its segments measure it
    observed, followed = frames.observed, frames.observed.copy()
    measured = np.zeros_like(observed)
    for j, s in enumerate(sensors.segment.tolist()):
        measured[:, s] |= np.isfinite(sensors.gyro[:, j, 0])
    for k, parent in enumerate(model.parent.tolist()):
        followed[:, k + 1] |= measured[:, k + 1] & measured[:, parent]
    restarted = np.zeros(observed.shape, dtype=np.bool_)
    outputs = (track.pose, track.covariance, track.used, track.sensed, restarted)
    failed = run_filter_in_space(model, constants, points, frames.track, observed, followed, sensors, *outputs)
    if failed >= 0:
        raise NumericalError(f"the filter's covariance is not positive definite at sample {failed} of {count}")
    failed = run_smoother_in_space(model, constants, followed, restarted, track.pose, track.covariance)
    if failed >= 0:
        raise NumericalError(f"the smoother's covariance is not positive definite at sample {failed} of {count}")
    return track


def scale_to_movement(track: SpatialTrack, errors: FloatArray) -> None:
    """Scale the covariance, in place, to ``errors`` (3, d), the mean squared errors of pose, velocity and acceleration.

    Each degree of freedom is scaled separately. It keeps its variance if its error is NaN. Variance that exceeds the
    median over all frames, as in gaps, is not scaled.
    """
    d = errors.shape[1]
    scale = np.ones((len(track.covariance), ORDER, d))
    for order in range(ORDER - 1):
        for c in np.flatnonzero(np.isfinite(errors[order])).tolist():
            at = order * d + c
            variance = track.covariance[:, at, at]
            steady = float(np.median(variance))
            factor = np.clip(errors[order, c] / steady, *_SCALES)
            total = np.minimum(variance, steady) * factor + np.maximum(variance - steady, 0.0)
            scale[:, order, c] = np.sqrt(total / variance)
    flat = scale.reshape(len(scale), ORDER * d)
    for part in chunks(len(flat)):
        track.covariance[part] *= flat[part, :, None] * flat[part, None, :]


@dataclass(frozen=True)
class SpatialSettings:
    """Settings of the state estimation in space."""

    marker_sd: float | None = None  # sd of a coordinate of every marker, m, skin included; None: estimated
    sigma_v: float | None = None  # sd of every snap held over one frame, rad/s⁴ (base: m/s⁴); None: estimated
    marker_sd_floor: float = 5e-5  # least estimate of a marker's noise, m
    gate: float = 5.0  # a marker farther from its prediction is left out; standard deviations
    angle_sd_limit: float = 0.2  # largest standard deviation of a rotation, rad; beyond it the states are NaN
    origin_sd_limit: float = 0.05  # largest standard deviation of the base's position, m; beyond it they are NaN


@dataclass(frozen=True)
class SpatialStates:
    """Smoothed states of a trial in space with F frames, n joints and M markers; NaN where they are too uncertain.

    Standard deviations include camera noise, movement that the smoother removes, and skin that slides with the joints.
    """

    origins: FloatArray  # (F, n + 1, 3) position of each segment in the frame of the trial, m
    rotations: FloatArray  # (F, n + 1, 3, 3) rotation of each segment
    omega: FloatArray  # (F, n + 1, 3) angular velocity of each segment in the trial's axes, rad/s
    alpha: FloatArray  # (F, n + 1, 3) angular acceleration, rad/s²
    sd_rotation: FloatArray  # (F, n + 1) standard deviation per axis, rad
    sd_omega: FloatArray  # (F, n + 1) rad/s
    sd_alpha: FloatArray  # (F, n + 1) rad/s²
    joint_rotations: FloatArray  # (F, n, 3, 3) child to parent
    velocity: FloatArray  # (F, n, 3) of each joint, in the child's axes, rad/s
    acceleration: FloatArray  # (F, n, 3) rad/s²
    jerk: FloatArray  # (F, n, 3) rad/s³
    joint_covariance: FloatArray  # (F, n, 9, 9) of rotation error (in the child's axes), velocity and acceleration
    coordinates: FloatArray  # (F, n, 3, 2) of hinges and two-axis joints, with velocity and acceleration; else NaN
    sd_coordinates: FloatArray  # (F, n, 3, 2) standard deviations of the coordinates
    observed: BoolArray  # (F, n + 1) the frame's own markers determine the base or joint; false where it is bridged
    used: BoolArray  # (F, M) markers used for the states
    predicted: FloatArray  # (F, M, 3) marker positions from the states, m
    noise: SpatialNoise


def smooth_in_space(
    points: FloatArray, rate: float, chain: SpatialChain, settings: SpatialSettings | None = None
) -> SpatialStates:
    """Return the states of all segments and joints at every frame, estimated from markers.

    ``points`` (F, M, 3) are the measured markers in the frame of the trial, m, NaN where missing; ``rate`` is in frames
    per second. Raise NumericalError if a covariance is not positive definite.
    """
    settings = settings or SpatialSettings()
    model = make_chain_model(chain)
    points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
    frames, steady, noise = estimate_noise(chain, model, points, rate, settings)
    track = filter_and_smooth(model, steady, 1.0 / rate, frames, noise, gate=settings.gate)
    # A segment whose visible markers the filter mostly rejects is left out, because its few markers that pass the gate
    # are probably wrong too. The filter then bridges the stretch like a gap, with standard deviations that grow.
    visible: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    rejected = find_rejected_segments(model.segment, frames.observed.shape[1], visible, track.used)
    observed, kept = frames.observed.copy(), steady.copy()
    for s, each in enumerate(rejected.T):
        for run in find_stretches(each):  # short stretches stay
            observed[run, s] = False
            kept[run, model.segment == s] = np.nan
    if not np.array_equal(kept, steady, equal_nan=True):
        frames, steady = replace(frames, observed=observed), kept
        track = filter_and_smooth(model, steady, 1.0 / rate, frames, noise, gate=settings.gate)
    lost = find_uncertain_segments(chain, model, track, settings)
    scale_to_movement(track, noise.errors)
    return collect_states(chain, model, frames, track, noise, lost)


def estimate_noise(
    chain: SpatialChain, model: ChainModel, points: FloatArray, rate: float, settings: SpatialSettings
) -> tuple[FramePoses, FloatArray, SpatialNoise]:
    """Return the poses of single frames, the markers (F, M, 3), m, without slow displacements, and the noise."""
    floor = settings.marker_sd_floor
    size = (
        np.full(points.shape[1], settings.marker_sd)
        if settings.marker_sd
        else estimate_marker_sds(chain, model, points, floor)
    )
    frames = find_frame_poses(chain, model, points, size, rate=rate, gate=settings.gate)
    camera = settings.marker_sd or estimate_camera_noise(frames, floor)
    size = np.maximum(size, camera)
    frames, steady = remove_displacements(chain, model, points, frames, rate=rate, camera=camera)
    if settings.sigma_v is not None:
        snap = np.full(degrees_of_freedom(model), settings.sigma_v)
        return frames, steady, SpatialNoise(camera, size, snap, snap, np.full((ORDER - 1, len(snap)), np.nan))
    snap, gap_snap, errors = estimate_snaps(model, frames, 1.0 / rate)
    return frames, steady, SpatialNoise(camera, size, snap, gap_snap, errors)


def collect_states(  # noqa: PLR0917
    chain: SpatialChain,
    model: ChainModel,
    frames: FramePoses,
    track: SpatialTrack,
    noise: SpatialNoise,
    lost: BoolArray,
    lasting: SkinErrors | None = None,
    counted: BoolArray | None = None,
) -> SpatialStates:
    """Return the states from the smoothed track; NaN where a segment is ``lost`` (F, n + 1).

    ``lasting``, if given, replaces the errors from skin. In the segments ``counted`` (n + 1,), standard deviations of
    velocities and accelerations do not include the common axial rotation of the skin, because the calibration of the
    sensors includes it.
    """
    pose = track.pose
    origins, rotations = chain.place(pose.origin, pose.turn[:, 0], pose.turn[:, 1:])
    rates = compute_chain_rates(chain, model, pose, rotations)
    skin, known = lasting, np.flatnonzero(~lost.any(axis=1))
    if skin is None:
        # a segment's marker cluster slides on its bone by half of the variances of the slides of the joints beside it
        slides = np.zeros(len(chain.joints) + 1)
        for k, joint in enumerate(chain.joints, start=1):
            slides[[joint.parent, k]] += joint.slide_sd**2 / 2
        skin = estimate_skin_errors(
            chain,
            model,
            pose,
            rates,
            lasting=noise.marker_sd**2 - noise.camera_sd**2 + slides[model.segment],
            weight=1.0 / noise.marker_sd**2,
            known=known if known.size else np.arange(len(lost)),
        )
    if counted is not None:
        motion = skin.motion.copy()
        motion[1:, :, len(counted) :][:, :, counted] = 0.0
        skin = replace(skin, motion=motion)
    segment_sds = _estimate_segment_sds(chain, model, track, rotations, rates, skin)
    joint_covariance, coordinates, sd_coordinates = _estimate_joint_covariances(chain, model, track, rates, skin)
    predicted = predict_positions(model, pose)
    moved = lost[:, 1:]
    segment_parts = (origins, rotations, rates.omega, rates.alpha, *segment_sds)
    for each in segment_parts:
        each[lost] = np.nan
    joint_parts = (pose.turn[:, 1:].copy(), rates.velocity, rates.acceleration, rates.jerk, joint_covariance)
    for each in (*joint_parts, coordinates, sd_coordinates):
        each[moved] = np.nan
    predicted[lost[:, model.segment]] = np.nan
    observed = frames.observed & ~lost
    markers = (track.used, predicted)
    return SpatialStates(*segment_parts, *joint_parts, coordinates, sd_coordinates, observed, *markers, noise)


def find_uncertain_segments(
    chain: SpatialChain, model: ChainModel, track: SpatialTrack, settings: SpatialSettings
) -> BoolArray:
    """Return where (F, n + 1) the pose of a segment, or of a segment between it and the base, is too uncertain."""
    groups = group_columns(model)
    spread = np.diagonal(track.covariance, axis1=1, axis2=2)[:, : groups[-1].stop]
    weak = spread > settings.angle_sd_limit**2
    weak[:, :3] = spread[:, :3] > settings.origin_sd_limit**2
    lost = np.stack([weak[:, own].any(axis=1) for own in groups], axis=1)
    for k, joint in enumerate(chain.joints):
        lost[:, k + 1] |= lost[:, joint.parent]
    return lost


def _estimate_segment_sds(  # noqa: PLR0917
    chain: SpatialChain, model: ChainModel, track: SpatialTrack, rotations: FloatArray, rates: Rates, skin: SkinErrors
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the standard deviations per axis of rotation, omega and alpha, (F, n + 1) each."""
    d = degrees_of_freedom(model)
    variance = np.empty((3, *rotations.shape[:2]))
    for part in chunks(len(rotations), 256):
        covariance = np.ascontiguousarray(track.covariance[part, : 3 * d, : 3 * d])
        for order, each in enumerate(compute_rate_jacobians(chain, model, rotations[part], rates.at(part))):
            flat = each.reshape(len(each), -1, each.shape[-1])
            squares = np.einsum("fik,fik->fi", flat @ covariance, flat)
            variance[order, part] = np.maximum(squares.reshape(*each.shape[:3]).mean(axis=2), 0.0)
    # skin, from the derivatives (T, n + 1, 3, d) of the segments' rotations by the pose at the postures
    at = skin.postures
    spin = compute_rate_jacobians(chain, model, rotations[at], rates.at(at))[0][..., :d]
    turned = skin.at_frames(np.einsum("tgik,tskl,tgil->tsg", spin, skin.pose, spin) / 3)
    still, rate, grows = (np.einsum("fs,fsg->fg", motion, turned) for motion in skin.motion)
    grows = grows + np.sum(rates.omega**2, axis=2) * rate
    rotation, omega, alpha = np.sqrt(variance + np.stack((still, rate, grows)))
    return rotation, omega, alpha


def _estimate_joint_covariances(
    chain: SpatialChain, model: ChainModel, track: SpatialTrack, rates: Rates, skin: SkinErrors
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fields ``joint_covariance``, ``coordinates`` and ``sd_coordinates`` of :class:`SpatialStates`."""
    frames, n = rates.velocity.shape[:2]
    d = degrees_of_freedom(model)
    covariance = np.empty((frames, n, 9, 9))
    values, sds = np.full((frames, n, 3, 2), np.nan), np.full((frames, n, 3, 2), np.nan)
    for k, own in enumerate(group_columns(model)[1:]):
        c = own.stop - own.start
        columns = np.concatenate([np.arange(order * d + own.start, order * d + own.stop) for order in range(ORDER - 1)])
        white, mapped = track.covariance[:, columns[:, None], columns], rates.maps[k]
        # skin: covariance of rotation error, velocity and acceleration in the child's axes
        block, here = skin.pose[:, :, own, own], mapped[skin.postures, :3, :c]
        turned = skin.at_frames(np.einsum("tik,tskl,tjl->tsij", here, block, here))
        still, rate, grows = (np.einsum("fs,fsij->fij", motion, turned) for motion in skin.motion)
        carried, parts = np.tile(np.eye(9), (frames, 1, 1)), np.zeros((frames, 9, 9))
        velocity, acceleration = so3.hat(rates.velocity[:, k]), so3.hat(rates.acceleration[:, k])
        carried[:, 3:6, :3], carried[:, 6:, :3], carried[:, 6:, 3:6] = velocity, acceleration, velocity
        parts[:, :3, :3], parts[:, 3:6, 3:6], parts[:, 6:, 6:] = still, rate, grows
        lasting = carried @ parts @ np.swapaxes(carried, 1, 2)
        del turned, still, rate, grows, carried, parts  # large in a long recording
        covariance[:, k] = mapped @ white @ np.swapaxes(mapped, 1, 2) + lasting
        if chain.joints[k].kind == "ball":
            continue
        values[:, k, 0, :c] = track.pose.angle[:, k, :c]
        values[:, k, 1:, :c] = track.pose.rate[:, :2, own]
        values[:, k, 0, :c] -= 2 * math.pi * np.round(values[0, k, 0, :c] / (2 * math.pi))
        variance = np.diagonal(white, axis1=1, axis2=2).reshape(frames, 3, c)
        alone = skin.at_frames(np.diagonal(block, axis1=2, axis2=3))
        slid = np.stack([np.einsum("fs,fsc->fc", motion, alone) for motion in skin.motion], axis=1)
        sds[:, k, :, :c] = np.sqrt(np.maximum(variance, 0.0) + slid)
    return covariance, values, sds


@dataclass(frozen=True)
class Rates:
    """Rates of n joints and n + 1 segments at F frames, and the joints' derivatives by their coordinates."""

    velocity: FloatArray  # (F, n, 3) of the joints, in the child's axes, rad/s
    acceleration: FloatArray  # (F, n, 3) rad/s²
    jerk: FloatArray  # (F, n, 3) rad/s³
    maps: list[FloatArray]  # n arrays (F, 9, 3 c): derivatives of rotation, velocity, acceleration by c coordinates
    omega: FloatArray  # (F, n + 1, 3) angular velocity of the segments, in the axes of the trial, rad/s
    alpha: FloatArray  # (F, n + 1, 3) angular acceleration, rad/s²

    def at(self, frames: slice | IntArray) -> Rates:
        """Return the rates in the chosen frames."""
        velocity, acceleration, jerk = (each[frames] for each in (self.velocity, self.acceleration, self.jerk))
        maps = [each[frames] for each in self.maps]
        return Rates(velocity, acceleration, jerk, maps, self.omega[frames], self.alpha[frames])


def compute_chain_rates(chain: SpatialChain, model: ChainModel, pose: Pose, turns: FloatArray) -> Rates:
    """Return the rates of all joints and segments; ``turns`` (F, n + 1, 3, 3) are the rotations of the segments."""
    frames, n = len(pose.origin), len(chain.joints)
    joint_rates, maps = np.zeros((3, frames, n, 3)), []
    omega, alpha = np.empty(turns.shape[:3]), np.empty(turns.shape[:3])
    omega[:, 0] = _rotate(turns[:, 0], pose.rate[:, 0, 3:6])
    alpha[:, 0] = _rotate(turns[:, 0], pose.rate[:, 1, 3:6])
    for k, (joint, columns) in enumerate(zip(chain.joints, group_columns(model)[1:], strict=True)):
        rate = pose.rate[:, :, columns]
        if joint.kind == "ball":
            joint_rates[:, :, k] = np.swapaxes(rate, 0, 1)
            maps.append(np.broadcast_to(np.eye(9), (frames, 9, 9)))
        else:
            joint_rates[:, :, k], own_map = _compute_axis_rates(joint, pose.turn[:, k + 1], rate)
            maps.append(own_map)
        before, own = joint.parent, _rotate(turns[:, k + 1], joint_rates[0, :, k])
        omega[:, k + 1] = omega[:, before] + own
        grows = _rotate(turns[:, k + 1], joint_rates[1, :, k]) + np.cross(omega[:, before], own)
        alpha[:, k + 1] = alpha[:, before] + grows
    return Rates(joint_rates[0], joint_rates[1], joint_rates[2], maps, omega, alpha)


def _compute_axis_rates(joint: SpatialJoint, rotation: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return velocity, acceleration and jerk (3, F, 3) of a hinge or two-axis joint, and its array of ``maps``."""
    first = np.einsum("fji,j->fi", rotation, joint.first_axis)
    second, c = joint.second_axis, joint.dimension
    dq, ddq, dddq = rate[:, 0], rate[:, 1], rate[:, 2]
    rates = np.stack([dq[:, :1] * first, ddq[:, :1] * first, dddq[:, :1] * first])
    parts = np.zeros((len(rotation), 3, 3, 3, c))  # of (error, velocity, acceleration) by (q, dq, ddq)
    for order in range(3):
        parts[:, order, :, order, 0] = first
    if joint.kind == "two-axis":
        bend = -np.cross(second, first)  # derivative of the first axis by the second coordinate
        twice = -np.cross(second, bend)
        one, two = dq[:, :1], dq[:, 1:]
        rates[0] += two * second
        rates[1] += ddq[:, 1:] * second + one * two * bend
        rates[2] += dddq[:, 1:] * second + (2 * ddq[:, :1] * two + one * ddq[:, 1:]) * bend + one * two**2 * twice
        for order in range(3):
            parts[:, order, :, order, 1] = second
        parts[:, 1, :, 0, 1] = one * bend
        parts[:, 2, :, 0, 1] = ddq[:, :1] * bend + one * two * twice
        parts[:, 2, :, 1, 0] = two * bend
        parts[:, 2, :, 1, 1] = one * bend
    return rates, parts.reshape(len(rotation), 9, 3 * c)


def compute_rate_jacobians(
    chain: SpatialChain, model: ChainModel, turns: FloatArray, rates: Rates
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives of rotation, omega and alpha by pose, velocity and acceleration, (F, n + 1, 3, 3 d) each.

    The change of a rotation is a rotation vector in the axes of the trial. ``turns`` (F, n + 1, 3, 3) are the rotations
    of the segments.
    """
    groups = group_columns(model)
    d = groups[-1].stop
    shape = (len(turns), len(groups), 3, 3, d)
    spin, omega, alpha = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    spin[:, 0, :, 0, 3:6] = turns[:, 0]
    omega[:, 0, :, 1, 3:6] = turns[:, 0]
    alpha[:, 0, :, 2, 3:6] = turns[:, 0]
    for m in range(3):  # a change of the base's rotation also rotates its rates
        omega[:, 0, m, 0, 3:6] = -(so3.hat(rates.omega[:, 0]) @ turns[:, 0])[:, m]
        alpha[:, 0, m, 0, 3:6] = -(so3.hat(rates.alpha[:, 0]) @ turns[:, 0])[:, m]
    flat = (len(turns), 3, 3 * d)
    for k, (joint, own) in enumerate(zip(chain.joints, groups[1:], strict=True)):
        before, c = joint.parent, joint.dimension
        part = np.zeros((3, len(turns), 3, 3, d))
        mapped = turns[:, None, k + 1] @ rates.maps[k].reshape(-1, 3, 3, 3 * c)
        for order in range(3):
            part[order][..., own] = mapped[:, order].reshape(-1, 3, 3, c)
        spins, velocity, acceleration = (each.reshape(flat) for each in part)
        spun = spin[:, before].reshape(flat) + spins
        own_rate = _rotate(turns[:, k + 1], rates.velocity[:, k])
        own_change = velocity - so3.hat(own_rate) @ spun
        omega[:, k + 1] = omega[:, before] + own_change.reshape(shape[0], *shape[2:])
        change = (
            acceleration
            - so3.hat(_rotate(turns[:, k + 1], rates.acceleration[:, k])) @ spun
            - so3.hat(own_rate) @ omega[:, before].reshape(flat)
            + so3.hat(rates.omega[:, before]) @ own_change
        )
        alpha[:, k + 1] = alpha[:, before] + change.reshape(shape[0], *shape[2:])
        spin[:, k + 1] = spun.reshape(shape[0], *shape[2:])
    whole = (len(turns), len(groups), 3, 3 * d)
    return spin.reshape(whole), omega.reshape(whole), alpha.reshape(whole)


def _rotate(turns: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("fij,fj->fi", turns, vectors))


_AXIAL_SHARE = 1.5
"""Common displacement of a segment's markers by skin that rotates about its long axis, relative to their lasting error.

The residuals do not contain a common displacement, so the value is assumed. It is valid for simulated arms.
"""

_ALIKE = 2.0  # assumed variance of the pose from markers that slide partly alike, relative to independent markers

_POSTURES = 40
_LEAST_MOTION = 0.01  # rad, rms; joints that move less do not move the skin
_DAMPING = 1e-6  # m²/rad², for degrees of freedom that no marker determines


@dataclass(frozen=True)
class SkinErrors:
    """Covariances of the pose due to the skin of S segments, at T postures.

    There are two for each segment: for independent displacements of its markers (the first S), and for a common
    rotation about its long axis (the last S).
    """

    pose: FloatArray  # (T, 2 S, d, d) covariance at the postures for a unit of ``motion``
    postures: IntArray  # (T,) frames of the postures
    motion: FloatArray  # (3, F, 2 S) squared motion, velocity and acceleration, relative to the mean square motion

    def at_frames(self, values: FloatArray) -> FloatArray:
        """Return values (F, …) in all frames, interpolated from their values (T, …) at the postures."""
        every = np.arange(self.motion.shape[1])
        upper = np.searchsorted(self.postures, every).clip(1, max(len(self.postures) - 1, 1))
        if len(self.postures) == 1:
            return np.repeat(values, len(every), axis=0)
        low, high = self.postures[upper - 1], self.postures[upper]
        share = ((every - low) / (high - low)).clip(0, 1).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[upper - 1] * (1 - share) + values[upper] * share)


def estimate_skin_errors(
    chain: SpatialChain,
    model: ChainModel,
    pose: Pose,
    rates: Rates,
    *,
    lasting: FloatArray,
    weight: FloatArray,
    known: IntArray,
) -> SkinErrors:
    """Return the variances of the states due to the motion of the skin.

    ``lasting`` (M,) is the variance of the lasting error of each marker's coordinate, m², and ``weight`` (M,) the
    weight of each marker, 1/m². ``known`` (K,) are the frames with complete states, from which postures are chosen.
    """
    postures = np.unique(known[np.linspace(0, len(known) - 1, _POSTURES).round().astype(np.int64)])
    d, count, n = degrees_of_freedom(model), len(model.segment), len(chain.joints)
    jacobian, positions = np.zeros((len(postures), count, 3, d)), np.empty((len(postures), count, 3))
    some = select_frames(pose, postures)
    locate_markers(model, some, positions, jacobian)
    normal = np.einsum("fmik,fmil,m->fkl", jacobian, jacobian, weight)
    normal += _DAMPING * weight.mean() * np.eye(d)
    gain = np.einsum("fkl,fmil,m->fmki", np.linalg.inv(normal), jacobian, weight)
    covariance = np.zeros((len(postures), 2 * (n + 1), d, d))
    axes = np.zeros(
        (n, 3)
    )  # unit vectors from each joint to the next joint, or to the mean marker, in the child's frame
    origins, turns = chain.place(some.origin, some.turn[:, 0], some.turn[:, 1:])
    for s in range(n + 1):
        mine = np.flatnonzero(model.segment == s)
        covariance[:, s] = _ALIKE * np.einsum("fmki,fmli,m->fkl", gain[:, mine], gain[:, mine], lasting[mine])
        if s > 0:
            ahead, own = [joint.centre for joint in chain.joints if joint.parent == s], chain.local[chain.segment == s]
            towards = ahead[0] if ahead else own.mean(axis=0) if len(own) else np.zeros(3)
            axes[s - 1] = towards / max(float(np.linalg.norm(towards)), 1e-9)
            around = np.cross((turns[:, s] @ axes[s - 1])[:, None], positions[:, mine] - origins[:, s, None])
            around /= np.maximum(np.linalg.norm(around, axis=2, keepdims=True), 1e-9)
            moved = np.einsum("fmki,fmi,m->fk", gain[:, mine], around, np.sqrt(lasting[mine]))
            covariance[:, n + 1 + s] = _AXIAL_SHARE**2 * moved[:, :, None] * moved[:, None, :]
    # squared motion of the joints beside each segment, then about its long axis; zero for joints that hardly move
    squares = np.zeros((3, len(pose.origin), 2 * (n + 1)))
    for k, joint in enumerate(chain.joints):
        u, _, v = np.linalg.svd(pose.turn[known, k + 1].mean(axis=0))
        middle = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
        bent = so3.log(middle.T @ pose.turn[:, k + 1])
        moves = (bent, rates.velocity[:, k], rates.acceleration[:, k])
        for s in (k + 1, joint.parent):
            squares[:, :, s] += [np.sum(each**2, axis=1) for each in moves]
        squares[:, :, n + 2 + k] = [(each @ axes[k]) ** 2 for each in moves]
    usual = squares[0, known].mean(axis=0)
    motion = np.where(usual > _LEAST_MOTION**2, squares / np.maximum(usual, _LEAST_MOTION**2), 0.0)
    return SkinErrors(covariance, postures, motion)
