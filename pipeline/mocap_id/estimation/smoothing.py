"""Smoothed joint states of a planar chain from its markers (ch. 3.2.6): the room's main entrance."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import ModuleType
from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.estimation import compiled, rivals
from mocap_id.estimation.dropouts import hold
from mocap_id.estimation.inverse import Chain, determined_angles, frame_angles
from mocap_id.estimation.lost import carry_back
from mocap_id.estimation.noise import Noise, marker_noise, process_noise
from mocap_id.estimation.problem import Problem
from mocap_id.estimation.rivals import Estimate
from mocap_id.estimation.sigma_points import SigmaPoints
from mocap_id.geometry.planar import marker_positions

Engine = Literal["compiled", "filterpy"]
Method = Literal["rts", "two-filter", "butterworth", "spline"]

FRAMEWISE: tuple[Method, ...] = ("butterworth", "spline")
"""Methods that smooth the angles of single frames, joint by joint, and give no standard deviations."""


@dataclass(frozen=True)
class FilterSettings:
    """How the states are filtered.

    Parameters
    ----------
    method : {"rts", "two-filter", "butterworth", "spline"}
        Filter and smoother, or one of :mod:`mocap_id.estimation.rivals`.
    butterworth_hz : float
        Cutoff of ``butterworth``, Hz.
    engine : {"compiled", "filterpy"}
        Machine code, or filterpy's filter, which gives the same and is about a hundred times slower.
    marker_sd : float, optional
        Standard deviation of a marker's coordinate, m; estimated where not given.
    sigma_v : float, optional
        Standard deviation of the snap held over one frame, rad/s^4, for every joint; estimated where not given. Its
        spectral density is sigma_v^2 dt, which keeps its meaning at another frame rate where sigma_v does not.
    marker_sd_floor : float
        Least estimate of ``marker_sd``, m.
    gate : float
        A marker farther from its prediction than this many standard deviations is left out.
    angle_sd_limit : float
        An angle less certain than this, rad, is not given: its states are NaN.
    sigma_points : SigmaPoints
        Parameters of the unscented transform.
    """

    method: Method = "rts"
    butterworth_hz: float = 6.0
    engine: Engine = "compiled"
    marker_sd: float | None = None
    sigma_v: float | None = None
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
        Standard deviations, given everywhere by methods that know them, NaN by the others. Here they are the filter's,
        which take the noise for white; soft tissue is not, and
        :func:`mocap_id.estimation.skin.with_lasting_errors` tells them apart.
    observed : (F, n) bool array
        The frame's own markers determine the angle; false where it is bridged.
    used : (F, M) bool array
        Markers that the states rest on: measured, on a moving segment, within the gate.
    noise : Noise
        Marker and process noise, estimated or given.
    log_likelihood : float
        Of the filter's innovations; NaN where the method has none.
    chain : Chain
        That they are states of, with all M markers.
    """

    mean: FloatArray
    sd: FloatArray
    observed: BoolArray
    used: BoolArray
    noise: Noise
    log_likelihood: float
    chain: Chain

    @property
    def predicted(self) -> FloatArray:
        """Positions (F, M, 2) of all markers from the states, plane frame, m (eq. 3.18), as :meth:`predicted_in`."""
        return self.predicted_in(slice(None))

    def predicted_in(self, frames: slice | IntArray) -> FloatArray:
        """Positions (..., M, 2) in some frames (...); NaN beyond an angle that is not given."""
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
        Joint centres in the segment before, m.
    segment : (M,) int array
        Segment of each marker, 0 = base. Base markers are predicted, not used.
    local : (M, 2) array
        Coordinates in the segment frame, m.
    settings : FilterSettings, optional
        Default: :class:`FilterSettings`.
    overwrite : bool
        ``observed`` may be changed, which saves a copy: where markers are missing, the others are moved as
        :func:`mocap_id.estimation.dropouts.hold` tells.

    Returns
    -------
    States

    Raises
    ------
    NumericalError
        Where a covariance stops being positive definite.
    """
    settings = settings or FilterSettings()
    moves = segment > 0
    moving = observed[:, moves] if not moves.all() else observed if overwrite else observed.copy()
    chain = Chain(centres.copy(), segment[moves], local[moves])  # copies: numba compiles anew for read-only arrays
    noise, problem = _posed(moving, 1.0 / rate, chain, settings)
    found = _estimate(problem, settings)
    mean, sd = found.mean, found.sd
    determined = _determined(found, problem, noise, settings)
    mean[sd[..., 0] > settings.angle_sd_limit] = math.nan
    mean[..., 0] -= _turns(mean[..., 0])
    used = np.zeros(observed.shape[:2], dtype=np.bool_)
    used[:, moves] = found.used
    return States(mean, sd, determined, used, noise, found.log_likelihood, Chain(centres, segment, local))


def _estimate(problem: Problem, settings: FilterSettings) -> Estimate:
    """States by the method of choice."""
    engine = _engine(settings.engine)
    if settings.method == "two-filter":
        return rivals.two_filter(problem, engine.filter_forwards)
    if settings.method == "butterworth":
        return rivals.butterworth(problem.anchors, problem.dt, settings.butterworth_hz)
    if settings.method == "spline":
        return rivals.spline(problem.anchors, problem.dt)
    track = engine.smooth_backwards(problem, engine.filter_forwards(problem))
    mean, sd = track.by_joint()
    carried = carry_back(problem, track, mean, sd)
    return Estimate(mean, sd, track.used, track.log_likelihood, carried)


def _engine(name: Engine) -> ModuleType:
    """The module with ``filter_forwards`` and ``smooth_backwards``."""
    if name == "compiled":
        return compiled
    from mocap_id.estimation import reference  # noqa: PLC0415  filterpy takes a second to import, and is seldom asked

    return reference


def _determined(found: Estimate, problem: Problem, noise: Noise, settings: FilterSettings) -> BoolArray:
    """Which angles (F, n) the markers used in their own frame determine."""
    if settings.method in FRAMEWISE:  # they start from the frames' own angles, and give none beyond a long gap
        return np.asarray(problem.anchors.observed & np.isfinite(found.mean[..., 0]))
    chain = Chain(problem.centres, problem.segment, problem.local)
    determined = determined_angles(found.mean[..., 0], found.used, chain, noise.marker_sd)
    return determined if found.carried is None else np.asarray(determined & ~found.carried)


def _turns(angles: FloatArray) -> FloatArray:
    """Whole turns (n,), rad, that bring the first angle given of each joint (F, n) into (-pi, pi]."""
    first = angles[np.isfinite(angles).argmax(axis=0), np.arange(angles.shape[1])]
    return np.where(np.isfinite(first), 2.0 * math.pi * np.round(first / (2.0 * math.pi)), 0.0)


def _posed(observed: FloatArray, dt: float, chain: Chain, settings: FilterSettings) -> tuple[Noise, Problem]:
    """The noise, as the settings give it or estimated, and what the engines are given; ``observed`` changes."""
    frames = frame_angles(observed, chain, settings.gate, settings.marker_sd_floor)
    marker_sd = settings.marker_sd or marker_noise(frames, settings.marker_sd_floor)
    frames = hold(observed, frames, chain, marker_sd, 1.0 / dt)
    anchors = frames.anchors(marker_sd)
    given = settings.sigma_v
    sigma_v = process_noise(anchors, dt) if given is None else np.full(len(chain.centres), given)
    return Noise(marker_sd, sigma_v), Problem(
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
