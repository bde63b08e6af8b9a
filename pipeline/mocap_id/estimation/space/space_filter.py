"""Filter and smoother over all frames of a chain in space."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, chunks
from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_problem import ANCHOR_SD, PATIENCE, start_sd
from mocap_id.estimation.process_model import ORDER, noise_shape, transition
from mocap_id.estimation.space.chain_model import degrees_of_freedom, make_track
from mocap_id.estimation.space.frame_poses import FramePoses, estimate_residual_sds, widen_sds
from mocap_id.estimation.space.space_kernels import ChainModel, Noise, Pose, Sensors, run_filter, run_smoother
from mocap_id.estimation.space.spatial_noise import SpatialNoise

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

    Raise NumericalError if a covariance is not positive definite.

    Parameters
    ----------
    points : (F, M, 3) array
        Markers without lasting displacements, m; NaN where they are not used.
    dt : float
        Time step, s.
    frames : FramePoses
        Poses of single frames, from which the filter starts at the beginning and after gaps.
    noise : SpatialNoise
        Noise of markers and movement; ``marker_sd`` and ``errors`` are not used.
    gate : float
        Limit of an innovation, in standard deviations.
    gate_sd : (M,) array, optional
        Standard deviation of a coordinate of each marker in the gate, m; by default from residuals of ``frames``.
    weight : (F, M) array, optional
        Weight of each sample; its variances are divided by the weight. Default: 1.
    sensors : Sensors, optional
        Inertial sensors.
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
    _run(model, constants, points, frames, sensors, track)
    return track


def _run(  # noqa: PLR0917
    model: ChainModel, noise: Noise, points: FloatArray, frames: FramePoses, sensors: Sensors, track: SpatialTrack
) -> None:
    """Run filter and smoother, and fill the arrays of ``track``."""
    count, observed = len(points), frames.observed
    followed = _find_followed(model, observed, sensors)
    restarted = np.zeros((count, len(model.freedom) + 1), dtype=np.bool_)
    outputs = (track.pose, track.covariance, track.used, track.sensed, restarted)
    failed = run_filter(model, noise, points, frames.track, observed, followed, sensors, *outputs)
    if failed >= 0:
        raise NumericalError(f"the filter's covariance is not positive definite at sample {failed} of {count}")
    failed = run_smoother(model, noise, followed, restarted, track.pose, track.covariance)
    if failed >= 0:
        raise NumericalError(f"the smoother's covariance is not positive definite at sample {failed} of {count}")


def _find_followed(model: ChainModel, observed: BoolArray, sensors: Sensors) -> BoolArray:
    """Return where (F, n + 1) markers determine the base or a joint, or sensors on both its segments measure it."""
    if not len(sensors.segment):
        return observed
    followed = observed.copy()
    measured = np.zeros_like(observed)
    for j, s in enumerate(sensors.segment.tolist()):
        measured[:, s] |= np.isfinite(sensors.gyro[:, j, 0])
    for k, parent in enumerate(model.parent.tolist()):
        followed[:, k + 1] |= measured[:, k + 1] & measured[:, parent]
    return followed


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
