"""Smoothed joint states of a planar chain from its markers (ch. 3.2.6): main entry point of the package.

The loops of filter and smoother, with the smoother's gain, are in :mod:`mocap_id.estimation.filter_kernels`.
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
from mocap_id.estimation.filter_problem import FilterProblem, InertialSignals
from mocap_id.estimation.inverse_kinematics import MarkerChain, determined_angles, frame_angles
from mocap_id.estimation.noise import FilterNoise, marker_noise, process_noise
from mocap_id.estimation.sigma_points import SigmaPoints
from mocap_id.geometry.planar import marker_positions

Engine = Literal["compiled", "filterpy"]
Method = Literal["rts", "two-filter", "butterworth", "spline"]

FRAMEWISE: tuple[Method, ...] = ("butterworth", "spline")
"""Methods that smooth the angles of single frames, joint by joint, without standard deviations."""


@dataclass(frozen=True)
class FilterSettings:
    """Settings of the state estimation.

    Parameters
    ----------
    method : {"rts", "two-filter", "butterworth", "spline"}
        Filter and smoother, or one of :mod:`mocap_id.estimation.alternative_estimators`.
    butterworth_hz : float
        Cut-off of ``butterworth``, Hz.
    engine : {"compiled", "filterpy"}
        Machine code, or filterpy's filter with the same result, about a hundred times slower.
    marker_sd : float, optional
        Standard deviation of a marker's coordinate, m; estimated by default.
    sigma_v : float, optional
        Standard deviation of the snap held over one frame, rad/s^4, for every joint; estimated by default. Unlike
        sigma_v, its spectral density sigma_v^2 dt is independent of the frame rate.
    sigma_v_ratio : float
        Largest estimate of a joint's sigma_v, relative to the median of all joints.
    marker_sd_floor : float
        Least estimate of ``marker_sd``, m.
    gate : float
        A marker farther from its prediction than this many standard deviations is left out.
    angle_sd_limit : float
        Largest standard deviation of an angle, rad; beyond it the states are NaN.
    sigma_points : SigmaPoints
        Parameters of the unscented transform.
    """

    method: Method = "rts"
    butterworth_hz: float = 6.0
    engine: Engine = "compiled"
    marker_sd: float | None = None
    sigma_v: float | None = None
    sigma_v_ratio: float = math.inf
    marker_sd_floor: float = 5e-5
    gate: float = 5.0
    angle_sd_limit: float = 0.2
    sigma_points: SigmaPoints = field(default_factory=SigmaPoints)


@dataclass(frozen=True)
class States:
    """Smoothed states of a trial.

    Parameters
    ----------
    mean : (F, n, 4) array
        Angle (rad, unwrapped), velocity, acceleration and jerk of each joint; NaN where the angle is too uncertain.
    sd : (F, n, 4) array
        Standard deviations in every frame, NaN for methods without them. These are the filter's, which treat all
        noise as white. Soft tissue is not white; :func:`mocap_id.estimation.lasting_errors.add_lasting_errors`
        corrects for this.
    observed : (F, n) bool array
        The frame's own markers determine the angle; false where it is bridged.
    used : (F, M) bool array
        Markers used for the states: measured, on a moving segment, within the gate.
    noise : FilterNoise
        Marker and process noise, estimated or given.
    log_likelihood : float
        Log-likelihood of the filter's innovations; NaN for methods without one.
    chain : MarkerChain
        The chain with all M markers.
    """

    mean: FloatArray
    sd: FloatArray
    observed: BoolArray
    used: BoolArray
    noise: FilterNoise
    log_likelihood: float
    chain: MarkerChain

    @property
    def predicted(self) -> FloatArray:
        """Return the positions (F, M, 2) of all markers from the states, plane frame, m (eq. 3.18)."""
        return self.predicted_in(slice(None))

    def predicted_in(self, frames: slice | IntArray) -> FloatArray:
        """Return the positions (..., M, 2) in given frames (...), m; NaN beyond an angle that is NaN."""
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
    """Estimate the states of every joint at every frame.

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
        Allow changes of ``observed``, which saves a copy: where markers are missing, the others are moved by
        :func:`mocap_id.estimation.dropouts.compensate_dropouts`.

    Returns
    -------
    States

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
    """Noise and markers of a trial, prepared once to be smoothed once or several times.

    Parameters
    ----------
    problem : FilterProblem
        Of the moving segments' markers.
    noise : FilterNoise
    chain : MarkerChain
        With all M markers.
    settings : FilterSettings
    """

    problem: FilterProblem
    noise: FilterNoise
    chain: MarkerChain
    settings: FilterSettings

    def estimate(self, inertial: InertialSignals | None = None) -> States:
        """Return the states, from the markers alone or with inertial sensors (``rts`` by the compiled engine).

        Raises
        ------
        NumericalError
            A covariance is not positive definite.
        """
        problem = self.problem if inertial is None else replace(self.problem, inertial=inertial)
        found = _estimate(problem, self.settings)
        mean, sd = found.mean, found.sd
        determined = _determined(found, problem, self.noise, self.settings)
        mean[sd[..., 0] > self.settings.angle_sd_limit] = math.nan
        mean[..., 0] -= _turns(mean[..., 0])
        used = np.zeros((len(mean), len(self.chain.segment)), dtype=np.bool_)
        used[:, self.chain.segment > 0] = found.used
        return States(mean, sd, determined, used, self.noise, found.log_likelihood, self.chain)


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

    Parameters
    ----------
    observed, rate, centres, segment, local, settings
        As for :func:`smooth`; ``observed`` is changed as by ``overwrite``.
    """
    settings = settings or FilterSettings()
    moves = segment > 0
    moving = observed if moves.all() else observed[:, moves]
    chain = MarkerChain(centres.copy(), segment[moves], local[moves])  # numba would recompile for read-only arrays
    noise, problem = _filter_problem(moving, 1.0 / rate, chain, settings)
    return PreparedStates(problem, noise, MarkerChain(centres, segment, local), settings)


def _estimate(problem: FilterProblem, settings: FilterSettings) -> Estimate:
    engine = _engine(settings.engine)
    if settings.method == "two-filter":
        return alternative_estimators.two_filter(problem, engine.filter_forwards)
    if settings.method == "butterworth":
        return alternative_estimators.butterworth(problem.anchors, problem.dt, settings.butterworth_hz)
    if settings.method == "spline":
        return alternative_estimators.spline(problem.anchors, problem.dt)
    track = engine.smooth_backwards(problem, engine.filter_forwards(problem))
    mean, sd = track.by_joint()
    filled = backfill(problem, track, mean, sd)
    return Estimate(mean, sd, track.used, track.log_likelihood, filled)


def _engine(name: Engine) -> ModuleType:
    """Return the module with ``filter_forwards`` and ``smooth_backwards``."""
    if name == "compiled":
        return compiled_filter
    from mocap_id.estimation import reference  # noqa: PLC0415  slow import, seldom used

    return reference


def _determined(found: Estimate, problem: FilterProblem, noise: FilterNoise, settings: FilterSettings) -> BoolArray:
    """Return which angles (F, n) the markers used in their own frame determine."""
    if settings.method in FRAMEWISE:  # these start from the frames' own angles and bridge no long gap
        return np.asarray(problem.anchors.observed & np.isfinite(found.mean[..., 0]))
    chain = MarkerChain(problem.centres, problem.segment, problem.local)
    determined = determined_angles(found.mean[..., 0], found.used, chain, noise.marker_sd)
    return determined if found.filled is None else np.asarray(determined & ~found.filled)


def _turns(angles: FloatArray) -> FloatArray:
    """Return the whole turns (n,), rad, that bring each joint's first finite angle (F, n) into (-pi, pi]."""
    first = angles[np.isfinite(angles).argmax(axis=0), np.arange(angles.shape[1])]
    return np.where(np.isfinite(first), 2.0 * math.pi * np.round(first / (2.0 * math.pi)), 0.0)


def _filter_problem(
    observed: FloatArray, dt: float, chain: MarkerChain, settings: FilterSettings
) -> tuple[FilterNoise, FilterProblem]:
    """Return the noise, given or estimated, and the input of the engine; changes ``observed``."""
    frames = frame_angles(observed, chain, settings.gate, settings.marker_sd_floor)
    marker_sd = settings.marker_sd or marker_noise(frames, settings.marker_sd_floor)
    frames = compensate_dropouts(observed, frames, chain, marker_sd, 1.0 / dt)
    anchors = frames.anchors(marker_sd)
    given = settings.sigma_v
    sigma_v = process_noise(anchors, dt) if given is None else np.full(len(chain.centres), given)
    sigma_v = np.minimum(sigma_v, settings.sigma_v_ratio * np.median(sigma_v))
    return FilterNoise(marker_sd, sigma_v), FilterProblem(
        observed=observed,
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
