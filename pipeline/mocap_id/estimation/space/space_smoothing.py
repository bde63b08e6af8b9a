"""Smoothed states of a chain in space from its markers: entry point of the package."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, chunks
from mocap_id.estimation.dropouts import find_rejected_segments, find_stretches
from mocap_id.estimation.process_model import ORDER
from mocap_id.estimation.space.chain_model import degrees_of_freedom, group_columns, make_chain_model, select_frames
from mocap_id.estimation.space.frame_poses import (
    FramePoses,
    estimate_marker_sds,
    find_frame_poses,
    predict_positions,
    remove_displacements,
)
from mocap_id.estimation.space.segment_rates import (
    JointRates,
    SegmentRates,
    compute_joint_rates,
    compute_rate_jacobians,
    compute_segment_rates,
)
from mocap_id.estimation.space.skin_errors import (
    SkinErrors,
    compute_cluster_variances,
    compute_joint_variances,
    compute_segment_variances,
    drop_axial_rates,
    estimate_skin_errors,
)
from mocap_id.estimation.space.space_filter import SpatialTrack, filter_and_smooth, scale_to_movement
from mocap_id.estimation.space.space_kernels import ChainModel, Pose, predict_markers
from mocap_id.estimation.space.spatial_noise import SpatialNoise, estimate_camera_noise, estimate_process_noise
from mocap_id.geometry.spatial_chain import SpatialChain

_LEAST_GATE = 2e-4  # m; nearly exact markers follow the movement when its snap exceeds the usual one


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
    sd_origin: FloatArray  # (F, n + 1) standard deviation per axis, m
    sd_rotation: FloatArray  # (F, n + 1) rad
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

    Parameters
    ----------
    points : (F, M, 3) array
        Measured markers in the frame of the trial, m; NaN where missing.
    rate : float
        Frames per second, Hz.
    chain : SpatialChain
        The joints and all M markers.
    settings : SpatialSettings, optional
        Default: :class:`SpatialSettings`.

    Raises
    ------
    NumericalError
        A covariance is not positive definite.
    """
    settings = settings or SpatialSettings()
    model = make_chain_model(chain)
    points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
    frames, steady, noise = estimate_noise(chain, model, points, rate, settings)
    track = filter_and_smooth(model, steady, 1.0 / rate, frames, noise, gate=settings.gate)
    again = _leave_out_rejected(model, points, frames, steady, track.used)
    if again is not None:
        frames, steady = again
        track = filter_and_smooth(model, steady, 1.0 / rate, frames, noise, gate=settings.gate)
    lost = find_uncertain_segments(chain, model, track, settings)
    scale_to_movement(track, noise.errors)
    return collect_states(chain, model, frames, track, noise, lost)


def _leave_out_rejected(
    model: ChainModel, points: FloatArray, frames: FramePoses, steady: FloatArray, used: BoolArray
) -> tuple[FramePoses, FloatArray] | None:
    """Return the poses and markers without the segments whose visible markers the filter mostly rejects; None if none.

    The few markers of such a segment that pass the gate are probably wrong too. The filter then bridges the stretch
    like a gap, with standard deviations that grow. Stretches of up to :data:`FEW` frames stay.
    """
    visible: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    rejected = find_rejected_segments(model.segment, frames.observed.shape[1], visible, used)
    observed, kept = frames.observed.copy(), steady.copy()
    for s, each in enumerate(rejected.T):
        for run in find_stretches(each):
            observed[run, s] = False
            kept[run, model.segment == s] = np.nan
    return None if np.array_equal(kept, steady, equal_nan=True) else (replace(frames, observed=observed), kept)


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
    snap, gap_snap, errors = estimate_process_noise(model, frames, 1.0 / rate)
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
    joints = compute_joint_rates(chain, model, pose)
    rates = compute_segment_rates(chain, pose, rotations, joints)
    known = np.flatnonzero(~lost.any(axis=1))
    skin = lasting or estimate_skin_errors(
        chain,
        model,
        pose,
        joints,
        lasting=noise.marker_sd**2 - noise.camera_sd**2 + compute_cluster_variances(chain)[model.segment],
        weight=1.0 / noise.marker_sd**2,
        known=known if known.size else np.arange(len(lost)),
    )
    skin = skin if counted is None else drop_axial_rates(skin, counted)
    segment_sds = _estimate_segment_sds(chain, model, track, rotations, joints, rates, skin)
    joint_covariance, coordinates, sd_coordinates = _estimate_joint_covariances(chain, model, track, joints, skin)
    predicted = predict_positions(model, pose)
    moved = lost[:, 1:]
    segment_parts = (origins, rotations, rates.omega, rates.alpha, *segment_sds)
    for each in segment_parts:
        each[lost] = np.nan
    joint_parts = (pose.turn[:, 1:].copy(), joints.velocity, joints.acceleration, joints.jerk, joint_covariance)
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
    chain: SpatialChain,
    model: ChainModel,
    track: SpatialTrack,
    rotations: FloatArray,
    joints: JointRates,
    rates: SegmentRates,
    skin: SkinErrors,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the standard deviations per axis of origin, rotation, omega and alpha, (F, n + 1) each."""
    d = degrees_of_freedom(model)
    variance = np.empty((4, *rotations.shape[:2]))
    for part in chunks(len(rotations), 256):
        rotational = compute_rate_jacobians(chain, model, rotations[part], joints.at(part), rates.at(part))
        translational = _origin_jacobian(model, select_frames(track.pose, part))
        covariance = np.ascontiguousarray(track.covariance[part, : 3 * d, : 3 * d])
        variance[0, part] = _propagate(translational, covariance[:, :d, :d])
        for order, each in enumerate(rotational):
            variance[order + 1, part] = _propagate(each, covariance)
    at = skin.postures
    spin = compute_rate_jacobians(chain, model, rotations[at], joints.at(at), rates.at(at))[0][..., :d]
    lasting = compute_segment_variances(skin, spin, _origin_jacobian(model, select_frames(track.pose, at)), rates)
    origin, rotation, omega, alpha = np.sqrt(variance + np.stack(lasting))
    return origin, rotation, omega, alpha


def _propagate(jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the variances (f, g) per axis of J x, from J (f, g, 3, m) and the covariance (f, m, m) of x."""
    flat = jacobian.reshape(len(jacobian), -1, jacobian.shape[-1])
    squares = np.einsum("fik,fik->fi", flat @ covariance, flat)
    return np.asarray(np.maximum(squares.reshape(*jacobian.shape[:3]).mean(axis=2), 0.0))


def _origin_jacobian(model: ChainModel, pose: Pose) -> FloatArray:
    """Return the derivatives (f, n + 1, 3, d) of the segments' origins by the pose."""
    segments = len(model.freedom) + 1
    ends = model._replace(
        segment=np.arange(segments), local=np.zeros((segments, 3)), on_glide=np.zeros(segments, dtype=np.bool_)
    )
    shape = (len(pose.origin), segments, 3)
    jacobian = np.zeros((*shape, degrees_of_freedom(model)))
    predict_markers(ends, pose, np.empty(shape), jacobian)
    return jacobian


def _estimate_joint_covariances(
    chain: SpatialChain, model: ChainModel, track: SpatialTrack, joints: JointRates, skin: SkinErrors
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fields ``joint_covariance``, ``coordinates`` and ``sd_coordinates`` of :class:`SpatialStates`."""
    frames, n = joints.velocity.shape[:2]
    d = degrees_of_freedom(model)
    covariance = np.empty((frames, n, 9, 9))
    values, sds = np.full((frames, n, 3, 2), np.nan), np.full((frames, n, 3, 2), np.nan)
    for k, own in enumerate(group_columns(model)[1:]):
        columns = np.concatenate([np.arange(order * d + own.start, order * d + own.stop) for order in range(ORDER - 1)])
        white = track.covariance[:, columns[:, None], columns]
        mapped = joints.maps[k]
        lasting, alone = compute_joint_variances(skin, model, joints, k)
        covariance[:, k] = mapped @ white @ np.swapaxes(mapped, 1, 2) + lasting
        if chain.joints[k].kind == "ball":
            continue
        c = own.stop - own.start
        values[:, k, 0, :c] = track.pose.angle[:, k, :c]
        values[:, k, 1:, :c] = track.pose.rate[:, :2, own]
        values[:, k, 0, :c] -= 2 * math.pi * np.round(values[0, k, 0, :c] / (2 * math.pi))
        variance = np.diagonal(white, axis1=1, axis2=2).reshape(frames, 3, c)
        sds[:, k, :, :c] = np.sqrt(np.maximum(variance, 0.0) + alone)
    return covariance, values, sds
