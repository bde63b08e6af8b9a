"""Smoothed states of a chain in space from its markers: entry point of the package."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.estimation.process_model import ORDER
from mocap_id.estimation.space.chain_model import chain_model, degrees_of_freedom, group_columns
from mocap_id.estimation.space.frame_poses import (
    FramePoses,
    find_frame_poses,
    marker_sizes,
    ordinary_sizes,
    own_sizes,
    predicted_markers,
    without_displacements,
)
from mocap_id.estimation.space.segment_rates import JointRates, SegmentRates, joint_rates, rate_jacobians, segment_rates
from mocap_id.estimation.space.skin_errors import (
    SkinErrors,
    cluster_variances,
    joint_variances,
    segment_variances,
    skin_errors,
    without_twist_rates,
)
from mocap_id.estimation.space.space_filter import SpatialTrack, filter_and_smooth, scale_to_movement
from mocap_id.estimation.space.space_kernels import ChainModel, Pose, Sensors, predict_markers
from mocap_id.estimation.space.spatial_noise import SpatialNoise, camera_noise, process_noise
from mocap_id.geometry.spatial_chain import SpatialChain

_LEAST_GATE = 2e-4  # m; nearly exact markers follow the movement when its snap exceeds the usual one


@dataclass(frozen=True)
class SpatialSettings:
    """Settings of the state estimation in space.

    Parameters
    ----------
    marker_sd : float, optional
        Standard deviation of a coordinate of every marker, m, skin included; estimated by default.
    sigma_v : float, optional
        Standard deviation of the snap held over one frame, rad/s⁴ (m/s⁴ for the base), for every degree of freedom;
        estimated by default.
    marker_sd_floor : float
        Least estimate of a marker's noise, m.
    gate : float
        A marker farther from its prediction than this many standard deviations is left out.
    angle_sd_limit : float
        Largest standard deviation of a rotation, rad; beyond it the states are NaN.
    origin_sd_limit : float
        The same for the base's position, m.
    """

    marker_sd: float | None = None
    sigma_v: float | None = None
    marker_sd_floor: float = 5e-5
    gate: float = 5.0
    angle_sd_limit: float = 0.2
    origin_sd_limit: float = 0.05


@dataclass(frozen=True)
class SpatialStates:
    """Smoothed states of a trial in space, F frames, n joints, M markers; NaN where they are too uncertain.

    Standard deviations include camera noise, movement beyond the smoother's band, and skin that slides with the joints.

    Parameters
    ----------
    origins, rotations : (F, n + 1, 3) and (F, n + 1, 3, 3) arrays
        Pose of each segment in the frame of the trial, m.
    omega, alpha : (F, n + 1, 3) arrays
        Angular velocity and acceleration of each segment in the trial's axes, rad/s and rad/s².
    sd_origin, sd_rotation, sd_omega, sd_alpha : (F, n + 1) arrays
        Standard deviations per axis.
    joint_rotations : (F, n, 3, 3) array
        Child to parent.
    velocity, acceleration, jerk : (F, n, 3) arrays
        Of each joint, in the child's axes.
    joint_covariance : (F, n, 9, 9) array
        Of rotation error (in the child's axes), velocity and acceleration of each joint.
    coordinates, sd_coordinates : (F, n, 3, 2) arrays
        Coordinates of hinges and two-axis joints, their velocities and accelerations; NaN for other joints.
    observed : (F, n + 1) bool array
        The frame's own markers determine the base and each joint; false where they are bridged.
    used : (F, M) bool array
        Markers used for the states.
    predicted : (F, M, 3) array
        Marker positions from the states, m.
    noise : SpatialNoise
    """

    origins: FloatArray
    rotations: FloatArray
    omega: FloatArray
    alpha: FloatArray
    sd_origin: FloatArray
    sd_rotation: FloatArray
    sd_omega: FloatArray
    sd_alpha: FloatArray
    joint_rotations: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    joint_covariance: FloatArray
    coordinates: FloatArray
    sd_coordinates: FloatArray
    observed: BoolArray
    used: BoolArray
    predicted: FloatArray
    noise: SpatialNoise


def smooth_in_space(
    points: FloatArray, rate: float, chain: SpatialChain, settings: SpatialSettings | None = None
) -> SpatialStates:
    """Estimate the states of all segments and joints at every frame.

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
    model = chain_model(chain)
    points = np.where(np.isfinite(points).all(axis=2, keepdims=True), points, np.nan)
    frames, steady, noise = estimate_noise(chain, model, points, rate, settings)
    track = run_both_ways(model, steady, 1.0 / rate, frames, noise, settings.gate)
    lost = find_lost(chain, model, track, settings)
    scale_to_movement(track, noise.errors)
    return collect_states(chain, model, frames, track, noise, lost)


def estimate_noise(
    chain: SpatialChain, model: ChainModel, points: FloatArray, rate: float, settings: SpatialSettings
) -> tuple[FramePoses, FloatArray, SpatialNoise]:
    """Return the poses of single frames, the markers (F, M, 3) without lasting displacements, and the noise."""
    floor = settings.marker_sd_floor
    size = (
        np.full(points.shape[1], settings.marker_sd)
        if settings.marker_sd
        else marker_sizes(chain, model, points, floor)
    )
    frames = find_frame_poses(chain, model, points, size, rate=rate, gate=settings.gate)
    camera = settings.marker_sd or camera_noise(frames, floor)
    size = np.maximum(size, camera)
    frames, steady = without_displacements(chain, model, points, frames, rate=rate, camera=camera)
    if settings.sigma_v is not None:
        snap = np.full(degrees_of_freedom(model), settings.sigma_v)
        return frames, steady, SpatialNoise(camera, size, snap, snap, np.full((ORDER - 1, len(snap)), np.nan))
    snap, gap_snap, errors = process_noise(model, frames, 1.0 / rate)
    return frames, steady, SpatialNoise(camera, size, snap, gap_snap, errors)


def run_both_ways(  # noqa: PLR0917
    model: ChainModel,
    points: FloatArray,
    dt: float,
    frames: FramePoses,
    noise: SpatialNoise,
    gate: float,
    sensors: Sensors | None = None,
) -> SpatialTrack:
    """Run filter and smoother over markers (F, M, 3) without lasting displacements, and inertial sensors if given."""
    return filter_and_smooth(
        model,
        points,
        dt,
        frames,
        camera=noise.camera_sd,
        gate_variance=_gate_sizes(frames, noise.camera_sd) ** 2,
        snap=noise.snap,
        gap_snap=noise.gap_snap,
        gate=gate,
        sensors=sensors,
    )


def _gate_sizes(frames: FramePoses, camera: float) -> FloatArray:
    """Return the standard deviations (M,) of the markers in the gate, m."""
    return ordinary_sizes(frames, np.fmax(own_sizes(frames), max(camera, _LEAST_GATE)))


def collect_states(  # noqa: PLR0917
    chain: SpatialChain,
    model: ChainModel,
    frames: FramePoses,
    track: SpatialTrack,
    noise: SpatialNoise,
    lost: BoolArray,
    lasting: SkinErrors | None = None,
    sensed: BoolArray | None = None,
) -> SpatialStates:
    """Return the states.

    ``lasting`` are errors in place of those of the skin. Beside the sensors of the segments ``sensed`` (n + 1,), the
    common twist of the skin does not count in the rates.
    """
    pose = track.pose
    origins, rotations = chain.place(pose.origin, pose.turn[:, 0], pose.turn[:, 1:])
    joints = joint_rates(chain, model, pose)
    rates = segment_rates(chain, pose, rotations, joints)
    known = np.flatnonzero(~lost.any(axis=1))
    skin = lasting or skin_errors(
        chain,
        model,
        pose,
        joints,
        lasting=noise.marker_sd**2 - noise.camera_sd**2 + cluster_variances(chain)[model.segment],
        weight=1.0 / noise.marker_sd**2,
        known=known if known.size else np.arange(len(lost)),
    )
    skin = skin if sensed is None else without_twist_rates(skin, sensed)
    deviations = _segment_deviations(chain, model, track, rotations, joints, rates, skin)
    joint_covariance, coordinates, sd_coordinates = _joint_deviations(chain, model, track, joints, skin)
    predicted = predicted_markers(model, pose)
    moved = lost[:, 1:]
    for each in (origins, rotations, rates.omega, rates.alpha, *deviations):
        each[lost] = np.nan
    joint_turns = pose.turn[:, 1:].copy()
    for each in (joint_turns, joints.velocity, joints.acceleration, joints.jerk, joint_covariance):
        each[moved] = np.nan
    coordinates[moved], sd_coordinates[moved] = np.nan, np.nan
    predicted[lost[:, model.segment]] = np.nan
    return SpatialStates(
        origins,
        rotations,
        rates.omega,
        rates.alpha,
        *deviations,
        joint_turns,
        joints.velocity,
        joints.acceleration,
        joints.jerk,
        joint_covariance,
        coordinates,
        sd_coordinates,
        frames.observed & ~lost,
        track.used,
        predicted,
        noise,
    )


def find_lost(chain: SpatialChain, model: ChainModel, track: SpatialTrack, settings: SpatialSettings) -> BoolArray:
    """Return where (F, n + 1) a segment's pose is too uncertain."""
    groups = group_columns(model)
    spread = np.diagonal(track.covariance, axis1=1, axis2=2)[:, : groups[-1].stop]
    weak = spread > settings.angle_sd_limit**2
    weak[:, :3] = spread[:, :3] > settings.origin_sd_limit**2
    lost = np.stack([weak[:, own].any(axis=1) for own in groups], axis=1)
    for k, joint in enumerate(chain.joints):
        lost[:, k + 1] |= lost[:, joint.parent]
    return lost


def _segment_deviations(  # noqa: PLR0917
    chain: SpatialChain,
    model: ChainModel,
    track: SpatialTrack,
    rotations: FloatArray,
    joints: JointRates,
    rates: SegmentRates,
    skin: SkinErrors,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the standard deviations (F, n + 1) per axis of origin, rotation, omega and alpha."""
    d = degrees_of_freedom(model)
    found = np.empty((4, *rotations.shape[:2]))
    for part in chunks(len(rotations), 256):
        turning = rate_jacobians(chain, model, rotations[part], joints.at(part), rates.at(part))
        shifting = _origin_jacobian(model, _some(track.pose, part))
        covariance = np.ascontiguousarray(track.covariance[part, : 3 * d, : 3 * d])
        found[0, part] = _spread(shifting, covariance[:, :d, :d])
        for order, each in enumerate(turning):
            found[order + 1, part] = _spread(each, covariance)
    at = skin.postures
    spin = rate_jacobians(chain, model, rotations[at], joints.at(at), rates.at(at))[0][..., :d]
    lasting = segment_variances(skin, spin, _origin_jacobian(model, _some(track.pose, at)), rates)
    origin, rotation, omega, alpha = np.sqrt(found + np.stack(lasting))
    return origin, rotation, omega, alpha


def _spread(jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the variances per axis (f, g) of J x, from J (f, g, 3, m) and the covariance (f, m, m) of x."""
    flat = jacobian.reshape(len(jacobian), -1, jacobian.shape[-1])
    squares = np.einsum("fik,fik->fi", flat @ covariance, flat)
    return np.asarray(np.maximum(squares.reshape(*jacobian.shape[:3]).mean(axis=2), 0.0))


def _some(pose: Pose, frames: slice | IntArray) -> Pose:
    return Pose(*(np.ascontiguousarray(each[frames]) for each in pose))


def _origin_jacobian(model: ChainModel, pose: Pose) -> FloatArray:
    """Return the change (f, n + 1, 3, d) of the segments' origins by the pose."""
    segments = len(model.freedom) + 1
    ends = model._replace(
        segment=np.arange(segments), local=np.zeros((segments, 3)), on_glide=np.zeros(segments, dtype=np.bool_)
    )
    shape = (len(pose.origin), segments, 3)
    jacobian = np.zeros((*shape, degrees_of_freedom(model)))
    predict_markers(ends, pose, np.empty(shape), jacobian)
    return jacobian


def _joint_deviations(
    chain: SpatialChain, model: ChainModel, track: SpatialTrack, joints: JointRates, skin: SkinErrors
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the joints' covariances, their coordinates, and the coordinates' standard deviations."""
    frames, n = joints.velocity.shape[:2]
    d = degrees_of_freedom(model)
    covariance = np.empty((frames, n, 9, 9))
    values, spreads = np.full((frames, n, 3, 2), np.nan), np.full((frames, n, 3, 2), np.nan)
    for k, own in enumerate(group_columns(model)[1:]):
        columns = np.concatenate([np.arange(order * d + own.start, order * d + own.stop) for order in range(ORDER - 1)])
        white = track.covariance[:, columns[:, None], columns]
        mapped = joints.maps[k]
        lasting, alone = joint_variances(skin, model, joints, k)
        covariance[:, k] = mapped @ white @ np.swapaxes(mapped, 1, 2) + lasting
        if chain.joints[k].kind == "ball":
            continue
        c = own.stop - own.start
        values[:, k, 0, :c] = track.pose.angle[:, k, :c]
        values[:, k, 1:, :c] = track.pose.rate[:, :2, own]
        turns = 2 * math.pi * np.round(values[0, k, 0, :c] / (2 * math.pi))
        values[:, k, 0, :c] -= turns
        spread = np.diagonal(white, axis1=1, axis2=2).reshape(frames, 3, c)
        spreads[:, k, :, :c] = np.sqrt(np.maximum(spread, 0.0) + alone)
    return covariance, values, spreads
