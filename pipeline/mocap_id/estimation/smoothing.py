"""Smoothed joint states of a planar chain from its markers (ch. 3.2.6): main entry point of the package.

The loops of filter and smoother are in :mod:`mocap_id.estimation.filter_kernels`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation import alternative_estimators, compiled_filter
from mocap_id.estimation.alternative_estimators import Estimate
from mocap_id.estimation.backfill import backfill
from mocap_id.estimation.dropouts import compensate_dropouts
from mocap_id.estimation.filter_kernels import Inertial
from mocap_id.estimation.filter_problem import FilterProblem, SigmaPoints
from mocap_id.estimation.inverse_kinematics import MarkerChain, find_determined_angles, find_frame_angles
from mocap_id.estimation.noise import FilterNoise, estimate_marker_noise, estimate_process_noise
from mocap_id.geometry.planar import marker_positions

Method = Literal["rts", "two-filter", "butterworth", "spline"]

FRAMEWISE: tuple[Method, ...] = ("butterworth", "spline")
"""Methods that smooth the angles of single frames, joint by joint, and give no standard deviations."""


@dataclass(frozen=True)
class FilterSettings:
    """Settings of the state estimation in the plane."""

    method: Method = "rts"  # filter and smoother, or one of :mod:`mocap_id.estimation.alternative_estimators`
    butterworth_hz: float = 6.0  # cut-off of ``butterworth``, Hz
    engine: Literal["compiled", "filterpy"] = "compiled"  # filterpy gives the same result a hundred times slower
    marker_sd: float | None = None  # standard deviation of a marker's coordinate, m; None: estimated
    sigma_v: float | None = None  # sd of every joint's snap held over one frame, rad/s^4; None: estimated
    sigma_v_ratio: float = math.inf  # largest estimate of a joint's sigma_v, relative to the median of all joints
    marker_sd_floor: float = 5e-5  # least estimate of ``marker_sd``, m
    gate: float = 5.0  # a marker farther from its prediction is left out; standard deviations
    angle_sd_limit: float = 0.2  # largest standard deviation of an angle, rad; beyond it the states are NaN
    sigma_points: SigmaPoints = field(default_factory=SigmaPoints)


@dataclass(frozen=True)
class States:
    """Smoothed states of a trial with F frames, n joints and M markers.

    The standard deviations come from the filter, which treats all noise as white. Soft tissue is not white;
    :func:`mocap_id.estimation.lasting_errors.add_lasting_errors` corrects for this.
    """

    mean: FloatArray  # (F, n, 4) angle (rad, unwrapped), velocity, acceleration, jerk; NaN if the angle is uncertain
    sd: FloatArray  # (F, n, 4) standard deviations, also of uncertain states; NaN for methods that give none
    observed: BoolArray  # (F, n) the frame's own markers determine the angle; false where it is bridged
    used: BoolArray  # (F, M) markers used for the states: visible, on a moving segment, and within the gate
    noise: FilterNoise  # estimated or given
    log_likelihood: float  # of the filter's innovations; NaN for methods without one
    chain: MarkerChain  # with all M markers

    @property
    def predicted(self) -> FloatArray:
        """Positions (F, M, 2) of all markers from the states, plane frame, m (eq. 3.18)."""
        return self.predicted_in(slice(None))

    def predicted_in(self, frames: slice | IntArray) -> FloatArray:
        """Return the positions (..., M, 2), m, of all markers in the chosen frames (...), plane frame.

        They are NaN if the angle of a joint between base and marker is NaN.
        """
        return marker_positions(self.mean[frames, :, 0], self.chain.centres, self.chain.segment, self.chain.local)


def smooth(
    observed: FloatArray,
    rate: float,
    centres: FloatArray,
    segment: IntArray,
    local: FloatArray,
    *,
    settings: FilterSettings | None = None,
    overwrite: bool = False,
) -> States:
    """Return the states of every joint at every frame, estimated from markers.

    Parameters
    ----------
    observed : (F, M, 2) array
        Measured markers in the plane frame, m; NaN where missing.
    rate : float
        Frames per second, Hz.
    centres : (n, 2) array
        Joint centres in the frame of the segment before, m.
    segment : (M,) int array
        Segment of each marker, 0 = base. Base markers are predicted but not used.
    local : (M, 2) array
        Coordinates in the segment frame, m.
    settings : FilterSettings, optional
        Default: :class:`FilterSettings`.
    overwrite : bool
        Whether ``observed`` may be changed, which saves a copy: in frames with missing markers,
        :func:`mocap_id.estimation.dropouts.compensate_dropouts` moves the other markers.

    Raises
    ------
    NumericalError
        A covariance is not positive definite.
    """
    if not overwrite:
        observed = observed.copy()
    return prepare_states(observed, rate, centres, segment, local, settings=settings).estimate()


@dataclass(frozen=True)
class PreparedStates:
    """Markers of a trial and their noise, from which states can be estimated several times."""

    problem: FilterProblem  # with the markers of the moving segments
    noise: FilterNoise
    chain: MarkerChain  # with all M markers
    settings: FilterSettings

    def estimate(self, inertial: Inertial | None = None) -> States:
        """Return the states from the markers, and from inertial sensors if given.

        Sensors need the method ``rts`` and the compiled engine. Raise NumericalError if a covariance is not positive
        definite.
        """
        problem = self.problem if inertial is None else replace(self.problem, inertial=inertial)
        estimate = _estimate(problem, self.settings)
        mean, sd = estimate.mean, estimate.sd
        determined = _find_determined(estimate, problem, self.noise, self.settings)
        mean[sd[..., 0] > self.settings.angle_sd_limit] = math.nan
        mean[..., 0] -= _find_whole_rotations(mean[..., 0])
        used = np.zeros((len(mean), len(self.chain.segment)), dtype=np.bool_)
        used[:, self.chain.segment > 0] = estimate.used
        return States(mean, sd, determined, used, self.noise, estimate.log_likelihood, self.chain)


def prepare_states(
    observed: FloatArray,
    rate: float,
    centres: FloatArray,
    segment: IntArray,
    local: FloatArray,
    *,
    settings: FilterSettings | None = None,
) -> PreparedStates:
    """Estimate the noise of a trial, and prepare its markers for :meth:`PreparedStates.estimate`.

    The arguments are as for :func:`smooth`; ``observed`` may be changed in place, as with its ``overwrite``.
    """
    settings = settings or FilterSettings()
    moves, dt = segment > 0, 1.0 / rate
    moving = observed if moves.all() else observed[:, moves]
    chain = MarkerChain(centres.copy(), segment[moves], local[moves])  # numba would recompile for read-only arrays
    frames = find_frame_angles(moving, chain, settings.gate, settings.marker_sd_floor)
    marker_sd = settings.marker_sd or estimate_marker_noise(frames, settings.marker_sd_floor)
    frames = compensate_dropouts(moving, frames, chain, marker_sd, 1.0 / dt)
    anchors = frames.anchors(marker_sd)
    given = settings.sigma_v
    sigma_v = estimate_process_noise(anchors, dt) if given is None else np.full(len(chain.centres), given)
    sigma_v = np.minimum(sigma_v, settings.sigma_v_ratio * np.median(sigma_v))
    problem = FilterProblem(
        observed=moving,
        dt=dt,
        centres=chain.centres,
        segment=chain.segment,
        local=chain.local,
        variance=np.full(len(chain.segment), marker_sd**2),
        gate_variance=np.fmax(marker_sd, frames.scale) ** 2,
        gate=settings.gate,
        density=sigma_v**2 * dt,
        anchors=anchors,
        sigma_points=settings.sigma_points,
    )
    return PreparedStates(problem, FilterNoise(marker_sd, sigma_v), MarkerChain(centres, segment, local), settings)


def _estimate(problem: FilterProblem, settings: FilterSettings) -> Estimate:
    engine: ModuleType = compiled_filter
    if settings.engine == "filterpy":
        from mocap_id.estimation import filterpy_engine as engine  # noqa: PLC0415  slow import, seldom used
    if settings.method == "two-filter":
        return alternative_estimators.average_two_passes(problem, engine.filter_forwards)
    if settings.method == "butterworth":
        return alternative_estimators.smooth_butterworth(problem.anchors, problem.dt, settings.butterworth_hz)
    if settings.method == "spline":
        return alternative_estimators.smooth_spline(problem.anchors, problem.dt)
    track = engine.smooth_backwards(problem, engine.filter_forwards(problem))
    mean, sd = track.by_joint()
    filled = backfill(problem, track, mean, sd)
    return Estimate(mean, sd, track.used, track.log_likelihood, filled)


def _find_determined(
    estimate: Estimate, problem: FilterProblem, noise: FilterNoise, settings: FilterSettings
) -> BoolArray:
    """Return which angles (F, n) are determined by the markers that are used in the same frame."""
    if settings.method in FRAMEWISE:  # these start from the frames' own angles and bridge no long gap
        return np.asarray(problem.anchors.observed & np.isfinite(estimate.mean[..., 0]))
    chain = MarkerChain(problem.centres, problem.segment, problem.local)
    determined = find_determined_angles(estimate.mean[..., 0], estimate.used, chain, noise.marker_sd)
    return determined if estimate.filled is None else np.asarray(determined & ~estimate.filled)


def _find_whole_rotations(angles: FloatArray) -> FloatArray:
    """Return the multiples of 2π (n,), rad, that bring each joint's first finite angle (F, n) into (-π, π]."""
    first = angles[np.isfinite(angles).argmax(axis=0), np.arange(angles.shape[1])]
    return np.where(np.isfinite(first), 2.0 * math.pi * np.round(first / (2.0 * math.pi)), 0.0)
