"""Filter and smoother over all frames of a chain in space."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, chunks
from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_problem import ANCHOR_SD, PATIENCE, start_sd
from mocap_id.estimation.process_model import ORDER, noise_shape, transition
from mocap_id.estimation.space.chain_model import degrees_of_freedom, empty_track
from mocap_id.estimation.space.frame_poses import FramePoses
from mocap_id.estimation.space.space_kernels import ChainModel, Noise, Pose, Sensors, run_filter, run_smoother

_SCALES = (0.25, 25.0)  # limits of a variance's change


@dataclass(frozen=True)
class SpatialTrack:
    """Smoothed states of all degrees of freedom.

    Parameters
    ----------
    pose : Pose
        Poses and rates of F frames.
    covariance : (F, 4 d, 4 d) array
        Of the pose (rotations: error vectors in the child's axes), velocity, acceleration and jerk.
    used : (F, M) bool array
        Markers that were measured and passed the gate.
    sensed : (F, S, 2) bool array
        Gyroscopes and accelerometers that were measured and passed the gate.
    """

    pose: Pose
    covariance: FloatArray
    used: BoolArray
    sensed: BoolArray


def no_sensors() -> Sensors:
    """Return the sensors of a trial that has none."""
    flat, signals = np.zeros((0, 3)), np.zeros((0, 0, 3))
    none = np.zeros(0, np.int64)
    return Sensors(none, flat, np.zeros(0), flat, none, flat, signals, signals, signals, np.zeros((0, 2)), 0.0)


def filter_and_smooth(
    model: ChainModel,
    points: FloatArray,
    dt: float,
    frames: FramePoses,
    *,
    camera: float,
    gate_variance: FloatArray,
    snap: FloatArray,
    gap_snap: FloatArray,
    gate: float,
    weight: FloatArray | None = None,
    sensors: Sensors | None = None,
) -> SpatialTrack:
    """Run the filter forwards and the smoother backwards.

    Parameters
    ----------
    model : ChainModel
    points : (F, M, 3) array
        Markers without lasting displacements, m; NaN where they are not used.
    dt : float
        Time step, s.
    frames : FramePoses
        Poses for the start and after gaps.
    camera : float
        White noise of a coordinate, m.
    gate_variance : (M,) array
        Variance of a coordinate in the gate, m².
    snap, gap_snap : (d,) arrays
        Standard deviation of each snap over one frame; in frames whose markers do not determine the joint.
    gate : float
        Limit of an innovation, in standard deviations.
    weight : (F, M) array, optional
        Weight of each sample, relative to one with the variances above; default: 1.
    sensors : Sensors, optional
        Inertial sensors.

    Raises
    ------
    NumericalError
        A covariance is not positive definite.
    """
    sensors = no_sensors() if sensors is None else sensors
    weight = np.ones(points.shape[:2]) if weight is None else weight
    noise = _noise(dt, camera, (gate_variance, weight), (snap, gap_snap), gate)
    return _run_both_ways(model, noise, points, frames, sensors)


def _run_both_ways(
    model: ChainModel, noise: Noise, points: FloatArray, frames: FramePoses, sensors: Sensors
) -> SpatialTrack:
    count, d = len(points), degrees_of_freedom(model)
    followed = _followed(model, frames.observed, sensors)
    track = SpatialTrack(
        empty_track(model, count),
        np.empty((count, ORDER * d, ORDER * d)),
        np.zeros((count, points.shape[1]), np.bool_),
        np.zeros((count, len(sensors.segment), 2), np.bool_),
    )
    restarted = np.zeros((count, len(model.freedom) + 1), dtype=np.bool_)
    failed = run_filter(
        model,
        noise,
        points,
        frames.track,
        frames.observed,
        followed,
        sensors,
        track.pose,
        track.covariance,
        track.used,
        track.sensed,
        restarted,
    )
    if failed >= 0:
        raise NumericalError(f"the filter's covariance is not positive definite at sample {failed} of {count}")
    failed = run_smoother(model, noise, followed, restarted, track.pose, track.covariance)
    if failed >= 0:
        raise NumericalError(f"the smoother's covariance is not positive definite at sample {failed} of {count}")
    return track


def _followed(model: ChainModel, observed: BoolArray, sensors: Sensors) -> BoolArray:
    """Return where (F, n + 1) markers, or sensors on both sides of a joint, follow it."""
    if not len(sensors.segment):
        return observed
    followed = observed.copy()
    turned = np.zeros_like(observed)
    for j, s in enumerate(sensors.segment.tolist()):
        turned[:, s] |= np.isfinite(sensors.gyro[:, j, 0])
    for k, parent in enumerate(model.parent.tolist()):
        followed[:, k + 1] |= turned[:, k + 1] & turned[:, parent]
    return followed


def _noise(
    dt: float,
    camera: float,
    markers: tuple[FloatArray, FloatArray],
    snaps: tuple[FloatArray, FloatArray],
    gate: float,
) -> Noise:
    return Noise(
        step=transition(dt)[0],
        shape=noise_shape(dt),
        density=snaps[0] ** 2 * dt,
        gap_density=snaps[1] ** 2 * dt,
        start=np.tile(start_sd(dt) ** 2, (len(snaps[0]), 1)),
        variance=camera**2,
        gate_variance=markers[0],
        weight=markers[1],
        gate=gate,
        patience=math.ceil(PATIENCE / dt),
        anchor_limit=ANCHOR_SD**2,
    )


def scale_to_movement(track: SpatialTrack, errors: FloatArray) -> None:
    """Scale the covariance to the mean squared errors (3, d) of pose, velocity and acceleration, in place.

    Each degree of freedom is scaled by itself; those without an error (NaN) and gaps keep their variance.
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
