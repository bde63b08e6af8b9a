"""Filter and smoother over all frames of a chain in space."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_problem import ANCHOR_SD, PATIENCE, start_sd
from mocap_id.estimation.process_model import ORDER, noise_shape, transition
from mocap_id.estimation.space.chain_model import degrees_of_freedom, empty_track
from mocap_id.estimation.space.frame_poses import FramePoses
from mocap_id.estimation.space.space_kernels import ChainModel, Noise, Pose, run_filter, run_smoother


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
    """

    pose: Pose
    covariance: FloatArray
    used: BoolArray


def filter_and_smooth(
    model: ChainModel,
    points: FloatArray,
    dt: float,
    frames: FramePoses,
    *,
    size: FloatArray,
    camera: float,
    gate_variance: FloatArray,
    snap: FloatArray,
    gate: float,
) -> SpatialTrack:
    """Run the filter forwards and the smoother backwards.

    Parameters
    ----------
    model : ChainModel
    points : (F, M, 3) array
        Markers, m; NaN where unseen.
    dt : float
        Time step, s.
    frames : FramePoses
        Poses for the start and after gaps.
    size : (M,) array
        Standard deviation of each marker's errors, m; it weights the markers.
    camera : float
        White part of them, m.
    gate_variance : (M,) array
        Variance of a coordinate in the gate, m².
    snap : (d,) array
        Standard deviation of each snap over one frame.
    gate : float
        Limit of an innovation, in standard deviations.

    Raises
    ------
    NumericalError
        A covariance is not positive definite.
    """
    count, d = len(points), degrees_of_freedom(model)
    noise = Noise(
        step=transition(dt)[0],
        shape=noise_shape(dt),
        density=snap**2 * dt,
        start=np.tile(start_sd(dt) ** 2, (d, 1)),
        weight=1.0 / size**2,
        white=camera**2,
        gate_variance=gate_variance,
        gate=gate,
        patience=math.ceil(PATIENCE / dt),
        anchor_limit=ANCHOR_SD**2,
    )
    track = SpatialTrack(
        empty_track(model, count), np.empty((count, ORDER * d, ORDER * d)), np.zeros((count, points.shape[1]), np.bool_)
    )
    restarted = np.zeros((count, len(model.freedom) + 1), dtype=np.bool_)
    measured = np.where(frames.used[..., None], points, np.nan)
    failed = run_filter(
        model, noise, measured, frames.slips, frames.track, frames.observed, track.pose, track.covariance, track.used,
        restarted,
    )
    if failed >= 0:
        raise NumericalError(f"the filter's covariance is not positive definite at sample {failed} of {count}")
    failed = run_smoother(model, noise, restarted, track.pose, track.covariance)
    if failed >= 0:
        raise NumericalError(f"the smoother's covariance is not positive definite at sample {failed} of {count}")
    return track
