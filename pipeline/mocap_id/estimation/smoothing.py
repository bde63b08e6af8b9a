"""Smoothed joint states of a planar chain from its markers (ch. 3.2.6): main entry point of the package.

The loops of filter and smoother are in :mod:`mocap_id.estimation.filter_kernels`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.interpolate import BSpline, PchipInterpolator
from scipy.linalg import solveh_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array, dia_array, diags_array

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks, find_runs
from mocap_id.errors import ConfigError
from mocap_id.estimation.filter_kernels import Inertial
from mocap_id.estimation.filter_problem import (
    ORDER,
    Anchors,
    FilterProblem,
    MarkerChain,
    Track,
    filter_forwards,
    noise_shape,
    smooth_backwards,
    transition,
)
from mocap_id.estimation.noise import (
    FrameAngles,
    estimate_marker_noise,
    estimate_process_noise,
    find_determined_angles,
    find_frame_angles,
)
from mocap_id.geometry.planar import marker_jacobian, marker_positions, rotate

BRIDGE_LIMIT = 0.2  # longest gap, s, that the low-pass and the spline bridge

LEAST_SAMPLES = 12  # least number of angles between long gaps that the low-pass and the spline smooth

_REVERSED = np.array([1.0, -1.0, 1.0, -1.0])  # reversing time changes the sign of odd derivatives
_POLES = 2  # of one pass; both passes together have four, as is usual in movement analysis


def average_two_passes(
    problem: FilterProblem, run_filter: Callable[[FilterProblem], Track]
) -> tuple[FloatArray, FloatArray, BoolArray, float]:
    """Return the average of a filter pass over the series and a pass over the reversed series (ch. 3.2.6).

    The errors of the two passes have an unknown correlation, because both use the frame itself. For any correlation,
    the standard deviation of the average is at most the mean of the two standard deviations. This bound is returned:
    states and standard deviations (F, n, 4), markers (F, M) that one of the passes used, and the log-likelihood of the
    forward pass.
    """
    ahead = run_filter(problem)
    anchors = problem.anchors
    backwards = Anchors(anchors.angles[::-1], anchors.covariance[::-1], anchors.observed[::-1], anchors.used[::-1])
    back = run_filter(replace(problem, observed=problem.observed[::-1], anchors=backwards))
    mean, sd = ahead.by_joint()
    other, other_sd = (each[::-1] for each in back.by_joint())
    other = other * _REVERSED
    other[..., 0] -= 2.0 * np.pi * np.round((other[..., 0] - mean[..., 0]) / (2.0 * np.pi))
    used = np.asarray(ahead.used | back.used[::-1])
    return 0.5 * (mean + other), 0.5 * (sd + other_sd), used, ahead.log_likelihood


def smooth_butterworth(anchors: Anchors, dt: float, cutoff: float) -> FloatArray:
    """Smooth the angles of single frames by a zero-phase Butterworth low-pass, and return the states (F, n, 4).

    ``cutoff`` is the cut-off of each of the two passes, Hz; both passes together halve the amplitude at this frequency.
    The derivatives are central differences. Long gaps are NaN. ConfigError is raised if the frame rate is too low.
    """
    if not cutoff < 0.5 / dt:
        raise ConfigError(
            f"ukf-smooth: butterworth_hz is {cutoff:g}, expected less than half the frame rate, {0.5 / dt:g} Hz"
        )
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415  it imports all of scipy.stats

    sections = butter(_POLES, cutoff, fs=1.0 / dt, output="sos")

    def derivatives(angle: FloatArray, seen: BoolArray, dt: float) -> FloatArray:
        frames = np.arange(len(angle))
        bridged = PchipInterpolator(frames[seen], angle[seen])(frames)
        pad = min(len(angle) - 1, round(1.0 / (cutoff * dt)))
        series = [sosfiltfilt(sections, bridged, padlen=pad)]
        for _ in range(ORDER - 1):
            series.append(np.gradient(series[-1], dt, edge_order=2))
        return np.stack(series, axis=-1)

    return smooth_joints(anchors, dt, derivatives)


def smooth_joints(anchors: Anchors, dt: float, fit: Callable[[FloatArray, BoolArray, float], FloatArray]) -> FloatArray:
    """Smooth the angles of single frames, joint by joint, and return the states (F, n, 4); long gaps are NaN.

    ``fit`` returns the states (f, 4) from an angle (f,), rad, flags of its known samples (f,) and the time step, s.
    """
    mean = np.full((*anchors.angles.shape, ORDER), np.nan)
    for j in range(mean.shape[1]):
        seen = anchors.observed[:, j]
        angle = np.where(seen, anchors.angles[:, j], 0.0)
        angle[seen] = np.unwrap(angle[seen])
        # the stretches with enough samples and without a long gap
        found = np.flatnonzero(seen)
        for own in np.split(found, np.flatnonzero(np.diff(found) > BRIDGE_LIMIT / dt + 1) + 1):
            if len(own) >= LEAST_SAMPLES:
                part = slice(int(own[0]), int(own[-1]) + 1)
                mean[part, j] = fit(angle[part], seen[part], dt)
    return mean


DEGREE = 5
_PENALISED = 3  # derivative
_KNOT_RATE = 200.0  # Hz, most knots per second: enough for joints, and well conditioned at any frame rate
_LOG_STIFFNESS = (-7.0, 28.0)  # natural logarithm of λ for unit knot spacing
_TOLERANCE = 0.01


def fit_smoothing_spline(angle: FloatArray, seen: BoolArray, dt: float) -> FloatArray:
    """Return the smoothing spline of the known samples as states (F, 4): angle, velocity, acceleration, jerk.

    ``angle`` (F,), rad, is unwrapped. ``seen`` (F,) is true for the known samples, which must be more than 10, and
    ``dt`` is the time step, s.
    """
    frames = len(angle)
    spacing = max(1.0, 1.0 / (_KNOT_RATE * dt))  # samples
    intervals = math.ceil((frames - 1) / spacing)
    spacing = (frames - 1) / intervals
    knots = np.arange(-DEGREE, intervals + DEGREE + 1, dtype=np.float64)
    position = np.minimum(np.arange(frames) / spacing, intervals)
    basis = csr_array(BSpline.design_matrix(position, knots, DEGREE))
    data = csr_array(basis[seen])
    middle = float(np.mean(angle[seen]))  # subtracted to avoid cancellation in the sums of squares
    given = angle[seen] - middle
    normal, penalty, moment = _bands(dia_array(data.T @ data)), _bands(_penalty(intervals)), np.asarray(data.T @ given)

    def coefficients(log_stiffness: float) -> FloatArray:
        return np.asarray(solveh_banded(normal + math.exp(log_stiffness) * penalty, moment, lower=True))

    def score(log_stiffness: float) -> float:
        misfit = given - data @ coefficients(log_stiffness)
        left = 1.0 - _freedom(math.exp(log_stiffness), intervals, len(given)) / len(given)
        return math.log(float(misfit @ misfit) + 1e-300) - 2.0 * math.log(max(left, 1e-12))

    best = minimize_scalar(score, bounds=_LOG_STIFFNESS, method="bounded", options={"xatol": _TOLERANCE})
    spline = BSpline(knots, coefficients(float(best.x)), DEGREE)
    states = np.stack([spline(position, nu=d) / (spacing * dt) ** d for d in range(ORDER)], axis=-1)
    states[:, 0] += middle
    return np.asarray(states)


def _penalty(intervals: int) -> dia_array:
    """Return the matrix of ∫ (third derivative)² as a quadratic form in the coefficients, for unit knot spacing.

    The third derivative is the quadratic spline whose coefficients are the third differences. Three Gauss points per
    interval integrate its square exactly.
    """
    size = intervals + DEGREE
    steps = [(-1.0) ** (_PENALISED - k) * math.comb(_PENALISED, k) for k in range(_PENALISED + 1)]
    difference = diags_array(steps, offsets=range(_PENALISED + 1), shape=(size - _PENALISED, size))
    order = DEGREE - _PENALISED
    knots = np.arange(-order, intervals + order + 1, dtype=np.float64)
    at, weight = np.polynomial.legendre.leggauss(order + 1)
    points = (np.arange(intervals)[:, None] + 0.5 * (1.0 + at)).ravel()
    basis = csr_array(BSpline.design_matrix(points, knots, order)) @ difference
    return dia_array(basis.T @ diags_array(np.tile(0.5 * weight, intervals)) @ basis)


def _bands(matrix: dia_array) -> FloatArray:
    size = matrix.shape[0]
    bands = np.zeros((DEGREE + 1, size))
    for k in range(DEGREE + 1):
        bands[k, : size - k] = matrix.diagonal(-k)
    return bands


def _freedom(stiffness: float, intervals: int, seen: int) -> float:
    """Return the trace of the smoother matrix (degrees of freedom), approximated by sine modes.

    For N samples on K intervals, smoothing with the stiffness λ multiplies mode k by 1 / (1 + λ (π k / K)⁶ K / N).
    Polynomials up to the second degree are not changed.
    """
    free_ends = 0.5 * (_PENALISED - 1)  # free ends raise the frequencies; those of a free beam have k + 1/2
    frequency = math.pi * (np.arange(1, min(seen, intervals + DEGREE) - _PENALISED + 1) + free_ends) / intervals
    passed = 1.0 / (1.0 + stiffness * frequency ** (2 * _PENALISED) * intervals / seen)
    return _PENALISED + float(passed.sum())


Method = Literal["rts", "two-filter", "butterworth", "spline"]

FRAMEWISE: tuple[Method, ...] = ("butterworth", "spline")
"""Methods that smooth the angles of single frames, joint by joint, and give no standard deviations."""


@dataclass(frozen=True)
class FilterSettings:
    """Settings of the state estimation in the plane."""

    method: Method = "rts"  # filter and smoother, or another estimator of this module
    butterworth_hz: float = 6.0  # cut-off of ``butterworth``, Hz
    engine: Literal["compiled", "filterpy"] = "compiled"  # filterpy gives the same result a hundred times slower
    marker_sd: float | None = None  # standard deviation of a marker's coordinate, m; None: estimated
    sigma_v: float | None = None  # sd of every joint's snap held over one frame, rad/s^4; None: estimated
    sigma_v_ratio: float = math.inf  # largest estimate of a joint's sigma_v, relative to the median of all joints
    marker_sd_floor: float = 5e-5  # least estimate of ``marker_sd``, m
    gate: float = 5.0  # a marker farther from its prediction is left out; standard deviations
    angle_sd_limit: float = 0.2  # largest standard deviation of an angle, rad; beyond it the states are NaN


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
    marker_sd: float  # standard deviation of a marker's coordinate, m: camera noise and soft tissue together
    sigma_v: FloatArray  # (n,) sd of each joint's snap held over one frame, rad/s^4; its density is sigma_v^2 dt
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
    chain: MarkerChain,
    *,
    settings: FilterSettings | None = None,
    overwrite: bool = False,
) -> States:
    """Return the states of every joint at every frame; NumericalError if a covariance is not positive definite.

    ``observed`` (F, M, 2) are the measured markers in the plane frame, m, NaN where missing; ``rate`` is in frames per
    second. Markers of the base are predicted but not used. With ``overwrite``, ``observed`` may be changed, which saves
    a copy: in frames with missing markers, :func:`compensate_dropouts` moves the other markers.
    """
    markers = observed if overwrite else observed.copy()
    return StateEstimator(markers, rate, chain, settings or FilterSettings()).estimate()


class StateEstimator:
    """Markers of a trial and their noise, from which states can be estimated several times.

    The arguments are as for :func:`smooth`; ``observed`` may be changed in place, as with its ``overwrite``.
    """

    def __init__(self, observed: FloatArray, rate: float, chain: MarkerChain, settings: FilterSettings) -> None:
        self.chain, self.settings = chain, settings
        moves, dt = chain.segment > 0, 1.0 / rate
        markers = observed if moves.all() else observed[:, moves]
        # numba would recompile for read-only arrays
        moving = MarkerChain(chain.centres.copy(), chain.segment[moves], chain.local[moves])
        frames = find_frame_angles(markers, moving, settings.gate, settings.marker_sd_floor)
        marker_sd = settings.marker_sd or estimate_marker_noise(frames, settings.marker_sd_floor)
        frames = compensate_dropouts(markers, frames, moving, marker_sd, 1.0 / dt)
        anchors, given = frames.anchors(marker_sd), settings.sigma_v
        sigma_v = estimate_process_noise(anchors, dt) if given is None else np.full(len(moving.centres), given)
        sigma_v = np.minimum(sigma_v, settings.sigma_v_ratio * np.median(sigma_v))
        self.marker_sd, self.sigma_v = marker_sd, sigma_v
        self.problem = FilterProblem(
            observed=markers,
            dt=dt,
            chain=moving,
            variance=np.full(len(moving.segment), marker_sd**2),
            gate_variance=np.fmax(marker_sd, frames.scale) ** 2,
            gate=settings.gate,
            density=sigma_v**2 * dt,
            anchors=anchors,
        )

    def estimate(self, inertial: Inertial | None = None) -> States:
        """Return the states from the markers, and from inertial sensors, which need ``rts`` and the compiled engine."""
        settings, problem = self.settings, replace(self.problem, inertial=inertial)
        if settings.method in FRAMEWISE:
            if settings.method == "butterworth":
                mean = smooth_butterworth(problem.anchors, problem.dt, settings.butterworth_hz)
            else:
                mean = smooth_joints(problem.anchors, problem.dt, fit_smoothing_spline)
            sd, passed, log_likelihood = np.full(mean.shape, np.nan), problem.anchors.used, math.nan
            # these start from the frames' own angles and bridge no long gap
            determined = np.asarray(problem.anchors.observed & np.isfinite(mean[..., 0]))
        else:
            forwards, backwards = filter_forwards, smooth_backwards
            if settings.engine == "filterpy":  # slow import, seldom used
                from mocap_id.estimation.filterpy_engine import filter_slowly, smooth_slowly  # noqa: PLC0415

                forwards, backwards = filter_slowly, smooth_slowly
            if settings.method == "two-filter":
                mean, sd, passed, log_likelihood = average_two_passes(problem, forwards)
                filled = np.zeros(mean.shape[:2], dtype=np.bool_)
            else:
                track = backwards(problem, forwards(problem))
                passed, log_likelihood = track.used, track.log_likelihood
                mean, sd = track.by_joint()
                filled = backfill(problem, track, mean, sd)
                del track  # its covariance is large
            # angles that the markers used in the same frame determine
            determined = find_determined_angles(mean[..., 0], passed, problem.chain, self.marker_sd)
            determined = np.asarray(determined & ~filled)
        mean[sd[..., 0] > settings.angle_sd_limit] = math.nan
        # whole rotations are removed, so that the first finite angle of each joint is in (-π, π]
        first = mean[np.isfinite(mean[..., 0]).argmax(axis=0), np.arange(mean.shape[1]), 0]
        mean[..., 0] -= np.where(np.isfinite(first), 2.0 * math.pi * np.round(first / (2.0 * math.pi)), 0.0)
        used = np.zeros((len(mean), len(self.chain.segment)), dtype=np.bool_)
        used[:, self.chain.segment > 0] = passed
        return States(mean, sd, determined, used, self.marker_sd, self.sigma_v, log_likelihood, self.chain)


def backfill(problem: FilterProblem, track: Track, mean: FloatArray, sd: FloatArray) -> BoolArray:
    """Extrapolate into the frames before each joint's last start where this reduces the variance; return where (F, n).

    ``track`` is the smoothed track. ``mean`` and ``sd`` (F, n, 4) are its states by joint, which are changed in place.
    The state x before a state x' = F x + w, where w has the covariance Q, has the covariance P = F⁻¹ (P' + Q) F⁻ᵀ.
    """
    back = np.linalg.inv(transition(problem.dt))
    filled = np.zeros(track.restarted.shape, dtype=np.bool_)
    for j, density in enumerate(problem.density):
        noise = density * noise_shape(problem.dt)
        own = np.arange(4) * problem.joints + j
        # frames in which the joint starts again and does not start again in the next frame
        starts = np.append(track.restarted[:-1, j] & ~track.restarted[1:, j], track.restarted[-1:, j])
        for k in np.flatnonzero(starts).tolist():
            x, p = mean[k, j], track.covariance[k][np.ix_(own, own)]
            for before in range(k - 1, -1, -1):
                x, p = back @ x, back @ (p + noise) @ back.T
                if p[0, 0] >= sd[before, j, 0] ** 2:
                    break
                mean[before, j], sd[before, j], filled[before, j] = x, np.sqrt(np.diagonal(p)), True
    return filled


SKIN_MEMORY = 0.9  # time constant, s, of the skin's displacement: its autocorrelation is 0.57 after 0.5 s
FEW = 3
"""Successive frames in which over half of a segment's visible markers may fail the gate without being reported."""

_BESIDE = 5  # frames before and after a gap over which the residual is averaged
PAIRS = 1000  # pairs of consecutive frames used to estimate the persistent part of a residual
_ROUNDS = 2  # the residuals beside a gap depend on the angles in other markers' gaps


def compensate_dropouts(
    observed: FloatArray, frames: FrameAngles, chain: MarkerChain, marker_sd: float, rate: float
) -> FrameAngles:
    """Return the angles of the frames as if the missing markers were still used.

    ``observed`` (F, M, 2), the markers of the moving segments, are changed in place: the visible markers move with
    their segments by the correction of the angles. ``marker_sd`` is the marker noise, m.
    """
    anchors = frames.anchors(marker_sd)
    some = np.flatnonzero(~frames.used.all(axis=1) & anchors.observed.any(axis=1))
    if not some.size:
        return frames
    # inverse of Jᵀ J over the observed joints; its other entries are zero
    both = anchors.observed[some, :, None] & anchors.observed[some, None, :]
    inverse = np.linalg.inv(np.where(both, frames.information[some], np.eye(anchors.observed.shape[1])))
    response = np.where(both, inverse, 0.0)

    def residual(m: int, angles: FloatArray, at: IntArray) -> FloatArray:
        """Return residuals (..., 2) at frames (...) in the segment's frame, m; NaN at frame -1 and where not used."""
        off = (
            observed[at, m]
            - marker_positions(angles[at], chain.centres, chain.segment[[m]], chain.local[[m]])[..., 0, :]
        )
        rotation = angles[at][..., : chain.segment[m]].sum(axis=-1)
        return np.where(((at >= 0) & frames.used[at, m])[..., None], rotate(-rotation, off), np.nan)

    # the markers with gaps, with the variance of their residuals that persists to the next frame, and of the rest;
    # without markers that are never used in two successive frames
    gapped = []
    for m in range(observed.shape[1]):
        used = frames.used[:, m]
        gaps, pairs = find_gaps(used, SKIN_MEMORY * rate), np.flatnonzero(used[1:] & used[:-1])
        if gaps.missing.size and pairs.size:
            pairs = pairs[:: max(1, len(pairs) // PAIRS)]
            first, second = (residual(m, frames.angles, pairs + step) for step in (0, 1))
            gapped.append((m, gaps, *split_variance(first, second)))
    angles = frames.angles.copy()
    for _ in range(_ROUNDS):
        push = np.zeros_like(angles)  # Jᵀ r, m²/rad, of the missing markers
        for m, gaps, lasting, noise in gapped:
            displacement = gaps.bridge(
                *(shrink_mean(residual(m, angles, side), lasting, noise) for side in gaps.beside)
            )
            at, segment = angles[gaps.missing], chain.segment[[m]]
            rotation = at[:, : segment[0]].sum(axis=1)
            jacobian = marker_jacobian(at, chain.centres, segment, chain.local[[m]])[:, 0]
            push[gaps.missing] += np.einsum("fik,fi->fk", jacobian, rotate(rotation, displacement))
        angles[some] = frames.angles[some] + np.einsum("fkl,fl->fk", response, push[some])
    for part in chunks(len(some)):
        own = some[part]
        for sign, at in ((-1.0, frames.angles[own]), (1.0, angles[own])):
            observed[own] += sign * marker_positions(at, chain.centres, chain.segment, chain.local)
    return replace(frames, angles=angles)


def find_rejected_segments(segment: IntArray, count: int, visible: BoolArray, used: BoolArray) -> BoolArray:
    """Return where (F, ``count``) over half of the visible markers of a segment are not ``used`` (F, M).

    ``segment`` (M,) is the segment of each marker, less than ``count``, and ``visible`` (F, M) marks its samples.
    """
    own = (segment[:, None] == np.arange(count)).astype(np.int64)
    return np.asarray(2 * ((visible & used).astype(np.int64) @ own) < visible.astype(np.int64) @ own)


def find_stretches(rejected: BoolArray) -> list[slice]:
    """Return the stretches of more than :data:`FEW` frames in ``rejected`` (F,); interruptions of up to FEW count."""
    joined = rejected.copy()
    for between in find_runs(~rejected):
        if between.stop - between.start <= FEW and between.start > 0 and between.stop < len(rejected):
            joined[between] = True
    return [run for run in find_runs(joined) if run.stop - run.start > FEW]


def compute_forgotten_share(used: BoolArray, frames: IntArray, rate: float) -> FloatArray:
    """Return the fraction (T, M) of the variance of each marker's displacement that is unknown in ``frames`` (T,).

    The displacement is a first-order Markov process between the known values beside a gap. The fraction is 0 where the
    marker is ``used`` (F, M), and 1 if it is never used.
    """
    unknown = np.zeros((len(frames), used.shape[1]))
    for marker in range(used.shape[1]):
        gaps = find_gaps(used[:, marker], SKIN_MEMORY * rate)
        if gaps.missing.size:
            s, u = gaps.since, gaps.until
            share = np.zeros(len(used))
            share[gaps.missing] = np.expm1(-2 * s) * np.expm1(-2 * u) / -np.expm1(-2 * (s + u))
            unknown[:, marker] = share[frames]
    return unknown


@dataclass(frozen=True)
class Gaps:
    """Gaps of a marker: T frames in G gaps. The unit of time is the time constant of the skin."""

    missing: IntArray  # (T,) frames in the gaps
    gap: IntArray  # (T,) number of the gap in which each of these frames is
    since: FloatArray  # (T,) time since the gap began; infinite if the trial begins with it
    until: FloatArray  # (T,) time until the gap ends; infinite if the trial ends with it
    beside: tuple[IntArray, IntArray]  # (G, b) b frames before and b frames after every gap; -1 beyond the trial

    def bridge(self, before: FloatArray, after: FloatArray) -> FloatArray:
        """Return the displacements (T, k) expected in the gaps, from the values ``before`` and ``after`` (G, k) them.

        At s = ``since`` and u = ``until``, the mean of a first-order Markov process is the sum of these values with the
        weights sinh(u)/sinh(s + u) and sinh(s)/sinh(s + u). NaN counts as 0.
        """
        s, u = self.since, self.until
        both = -np.expm1(-2 * (s + u))
        one, other = np.exp(-s) * -np.expm1(-2 * u) / both, np.exp(-u) * -np.expm1(-2 * s) / both
        return one[:, None] * np.nan_to_num(before[self.gap]) + other[:, None] * np.nan_to_num(after[self.gap])


def find_gaps(used: BoolArray, memory: float) -> Gaps:
    """Return the gaps of a marker, ``used`` (F,) in some frames; ``memory`` is the skin's time constant in frames."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], used, [True]]).astype(np.int8))).reshape(-1, 2)
    missing, frames = np.flatnonzero(~used), len(used)
    gap = np.searchsorted(edges[:, 0], missing, side="right") - 1
    first, after = edges[gap].T
    since = np.where(first > 0, missing - first + 1, np.inf)
    until = np.where(after < frames, after - missing, np.inf)
    frames_before, frames_after = edges[:, :1] - 1 - np.arange(_BESIDE), edges[:, 1:] + np.arange(_BESIDE)
    beside = (np.maximum(frames_before, -1), np.where(frames_after < frames, frames_after, -1))
    return Gaps(missing, gap, since / memory, until / memory, beside)


def split_variance(first: FloatArray, second: FloatArray) -> tuple[float, float]:
    """Return the variance of the part of a residual that persists to the next frame, and the variance of the rest.

    ``first`` and ``second`` (P, k) are the residuals in pairs of consecutive frames.
    """
    lasting = max(float(np.mean(first * second)), 0.0)
    return lasting, max(float(np.mean(first**2 + second**2)) / 2 - lasting, 0.0)


def shrink_mean(residual: FloatArray, lasting: float, noise: float) -> FloatArray:
    """Return the mean (G, k) of residuals (G, b, k) over b, reduced towards zero according to its noise.

    ``lasting`` and ``noise`` are as from :func:`split_variance`. The mean is NaN where all residuals are NaN.
    """
    count = np.isfinite(residual[..., 0]).sum(axis=1, keepdims=True)
    factor = lasting / np.maximum(count * lasting + noise, np.finfo(np.float64).tiny)
    return np.where(count > 0, factor * np.nansum(residual, axis=1), np.nan)
