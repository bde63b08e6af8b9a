"""Marker and process noise by maximum likelihood, from the angles of single frames.

To first order, the likelihood of the markers has two factors. The residuals of the chain within each frame determine
the marker noise alone. The angles of the frames, whose covariance follows from the marker noise, are linear
measurements of the process and determine the density of its noise. This density is estimated joint by joint from the
marginal variance of each angle. For every trial value, a filter with four states and a scalar measurement gives the
likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.compilation import compiled
from mocap_id.estimation.filter_kernels import refine
from mocap_id.estimation.filter_problem import ORDER, Anchors, MarkerChain, noise_shape, start_sd, transition
from mocap_id.geometry.planar import marker_positions, rotate

OBSERVED_SD = 0.1  # largest standard deviation, rad, of an angle that counts as observed in a frame

_WEAK_SD = 1.0  # rad; prior of an angle without markers
_UNOBSERVED_VARIANCE = 1e6  # rad^2; larger than any prior
_ITERATIONS = 20
_CONVERGED = 1e-6  # rad
_DAMPING = 1e-6  # m^2/rad^2; fixes angles that no marker determines, and hardly affects other angles
_OUTLIER_SHARE = 0.25  # largest fraction of outliers among a segment's markers with which its joint is reliable
_ROUNDS = 2  # the second round is needed because outliers inflate the ordinary residuals in the first
_BEYOND = 3.0  # limit of a marker's ordinary residual, relative to its median and to the markers of its segment
_ENOUGH = 4000  # residuals per marker, spread evenly over the trial, from which its ordinary residual is estimated
_QUANTILE = 0.8  # quantile of the residuals: bursts of errors take less than the rest of the time, movement more


@dataclass(frozen=True)
class FrameAngles:
    """Angles of every frame from its own markers."""

    angles: FloatArray  # (F, n) rad, unwrapped over the observed frames; interpolated where unobserved
    information: FloatArray  # (F, n, n) Jᵀ J of the used markers, m^2/rad^2: inverse covariance for 1 m of noise
    used: BoolArray  # (F, M) markers that are visible and not outliers
    reliable: BoolArray  # (F, n) few markers up to the joint's segment are outliers; with many, some stay undetected
    squares: float  # sum of squared distances of the used markers from their predictions, m^2, over reliable frames
    scale: FloatArray  # (M,) ordinary residual of each marker per coordinate, m; NaN if never visible

    def anchors(self, marker_sd: float) -> Anchors:
        """Return the angles as a linear measurement of the state, for a marker noise ``marker_sd``, m."""
        covariance, observed = np.empty_like(self.information), self.reliable.copy()
        for s in chunks(len(covariance)):
            found = compute_angle_covariance(self.information[s], marker_sd)
            observed[s] &= find_observed_angles(found)
            both = observed[s, :, None] & observed[s, None, :]
            covariance[s] = np.where(both, found, np.eye(both.shape[1]) * _UNOBSERVED_VARIANCE)
        return Anchors(self.angles, covariance, observed, self.used)


def compute_angle_covariance(information: FloatArray, marker_sd: float) -> FloatArray:
    """Return the covariance (F, n, n), rad^2, of the angles from Jᵀ J, m^2/rad^2, with a prior of 1 rad each."""
    n = information.shape[1]
    return np.asarray(np.linalg.inv(information / marker_sd**2 + np.eye(n) / _WEAK_SD**2))


def find_determined_angles(angles: FloatArray, used: BoolArray, chain: MarkerChain, marker_sd: float) -> BoolArray:
    """Return which angles (F, n) the ``used`` markers (F, M) of their frame determine, for a marker noise in m."""
    found = np.empty(angles.shape, dtype=np.bool_)
    for s in chunks(len(angles)):
        information = _compute_information(angles[s], used[s], chain)
        found[s] = find_observed_angles(compute_angle_covariance(information, marker_sd))
    return found


def find_observed_angles(covariance: FloatArray) -> BoolArray:
    """Return which angles (F, n) are certain enough to count as observed, from their covariance (F, n, n), rad^2."""
    return np.asarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) <= OBSERVED_SD, dtype=np.bool_)


def find_frame_angles(observed: FloatArray, chain: MarkerChain, gate: float, floor: float) -> FrameAngles:
    """Estimate the angles of every frame by Gauss–Newton, and find the outliers among its markers.

    A marker is an outlier in a frame if its residual exceeds ``gate`` times its ordinary residual, which is at least
    ``floor``, m. An outlier distorts the residuals of the other markers. Therefore, in each frame with an outlier, the
    worst marker is removed and the frame is solved again, until no marker is an outlier. ``observed`` (F, M, 2) are the
    markers of the moving segments, plane frame, m; NaN where missing.
    """
    parts = chunks(len(observed))
    used: BoolArray = np.concatenate([np.isfinite(observed[s]).all(axis=-1) for s in parts])
    angles, residual = _guess_angles(observed, used, chain), np.empty(used.shape)
    _refine(observed, used, angles, chain)
    for s in parts:
        residual[s] = _measure_residual(observed[s], angles[s], chain)
    scale = _estimate_scale(residual, used, chain.segment)
    for _ in range(_ROUNDS):
        limit = gate * np.fmax(scale, floor)
        for s in parts:
            frames = np.arange(s.start, s.stop)
            for _marker in range(observed.shape[1]):
                excess = np.where(used[frames], residual[frames] / limit, 0.0)
                worst = excess.argmax(axis=1)
                beyond = excess[np.arange(len(frames)), worst] > 1.0
                frames, worst = frames[beyond], worst[beyond]
                if not frames.size:
                    break
                used[frames, worst] = False
                refined, seen = angles[frames], observed[frames]
                _refine(seen, used[frames], refined, chain)
                angles[frames], residual[frames] = refined, _measure_residual(seen, refined, chain)
        scale = _estimate_scale(residual, used, chain.segment)
    # a joint is reliable if few markers are outliers, on its segment and on those before
    own = (chain.segment[:, None] == np.arange(1, len(chain.centres) + 1)).astype(np.int64)  # (M, n)
    reliable = np.empty(angles.shape, dtype=np.bool_)
    for s in parts:
        visible = np.isfinite(observed[s]).all(axis=-1).astype(np.int64) @ own
        out = visible - used[s].astype(np.int64) @ own
        reliable[s] = np.cumsum(out > _OUTLIER_SHARE * visible, axis=1) == 0
    counted = residual[used & np.all(reliable, axis=1, keepdims=True)]
    squares = float(counted @ counted)
    return FrameAngles(angles, _compute_information(angles, used, chain), used, reliable, squares, scale)


def _compute_information(angles: FloatArray, used: BoolArray, chain: MarkerChain) -> FloatArray:
    """Return Jᵀ J (F, n, n), m^2/rad^2, of the used markers (F, M) at angles (F, n), rad."""
    normal = np.empty((*angles.shape, angles.shape[1]))
    for s in chunks(len(angles)):
        here = np.array(angles[s])
        anywhere = np.zeros((*used[s].shape, 2))
        refine(anywhere, used[s], here, chain.centres, chain.segment, chain.local, _DAMPING, _CONVERGED, 0, normal[s])
    return normal


def _refine(observed: FloatArray, used: BoolArray, angles: FloatArray, chain: MarkerChain) -> None:
    """Run Gauss–Newton from ``angles`` (f, n), in place; angles that no marker determines stay unchanged."""
    n, limits = angles.shape[1], (_DAMPING, _CONVERGED, _ITERATIONS)
    for s in chunks(len(angles)):
        normal = np.empty((len(angles[s]), n, n))
        refine(observed[s], used[s], angles[s], chain.centres, chain.segment, chain.local, *limits, normal)


def _guess_angles(observed: FloatArray, used: BoolArray, chain: MarkerChain) -> FloatArray:
    """Return approximate angles (F, n), rad, found one after the other from base to tip.

    Each segment is rotated onto its own markers. Without them, it points to the next joint, whose position the next
    segment's markers determine. Frames without either are interpolated.
    """
    n = len(chain.centres)
    angles = np.zeros((len(observed), n))
    absolute, origin = np.zeros(len(observed)), np.zeros((len(observed), 2))
    for j in range(n):
        origin = origin + rotate(absolute, np.broadcast_to(chain.centres[j], origin.shape))
        turned = np.empty(len(observed))  # absolute angle of segment j + 1; NaN without markers
        own, beyond = chain.segment == j + 1, chain.segment == j + 2
        for s in chunks(len(observed)):
            arm = np.where(used[s, own, None], observed[s, own] - origin[s, None], 0.0)
            found = np.where(used[s, own].any(axis=1), _fit_rotation(chain.local[own][None], arm), np.nan)
            unseen = np.flatnonzero(np.isnan(found))
            if unseen.size and j + 1 < n:
                # the direction to the next joint, whose position needs two or more of the next segment's markers
                weight = used[s][unseen][:, beyond, None].astype(np.float64)
                count = np.maximum(weight.sum(axis=1), 1.0)
                z, local = np.where(weight > 0, observed[s][unseen][:, beyond], 0.0), chain.local[beyond]
                middle, local_middle = z.sum(axis=1) / count, (weight * local).sum(axis=1) / count
                next_turned = _fit_rotation(weight * (local - local_middle[:, None]), z - middle[:, None])
                joint = middle - rotate(next_turned, local_middle)
                pointed = _fit_rotation(chain.centres[j + 1][None, None], (joint - origin[s][unseen])[:, None])
                found[unseen] = np.where(count[:, 0] >= 2.0, pointed, np.nan)
            turned[s] = found
        known = np.flatnonzero(np.isfinite(turned))
        if known.size:
            angles[:, j] = np.interp(np.arange(len(observed)), known, np.unwrap((turned - absolute)[known]))
        absolute = absolute + angles[:, j]
    return angles


def _fit_rotation(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the angle (f,), rad, that best rotates the vectors ``start`` (f or 1, m, 2) onto ``end`` (f, m, 2)."""
    across = (start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]).sum(axis=1)
    return np.asarray(np.arctan2(across, (start * end).sum(axis=(1, 2))))


def _measure_residual(observed: FloatArray, angles: FloatArray, chain: MarkerChain) -> FloatArray:
    off = observed - marker_positions(angles, chain.centres, chain.segment, chain.local)
    return np.asarray(np.abs(off.view(np.complex128)[..., 0]))


def _estimate_scale(residual: FloatArray, used: BoolArray, segment: IntArray) -> FloatArray:
    """Return the ordinary standard deviation (M,) of each marker per coordinate, m, from a quantile of its residuals.

    A marker with more bursts of errors than the quantile allows would raise its own limit. Its value is therefore
    limited by its median and by the markers of its segment. It is NaN if the marker is never used.
    """
    shares = (_QUANTILE, 0.5)
    quantiles = np.full((len(shares), residual.shape[1]), np.nan)
    for m in np.flatnonzero(used.any(axis=0)):
        own = residual[used[:, m], m]
        quantiles[:, m] = np.quantile(own[:: max(1, len(own) // _ENOUGH)], shares)
    # the errors of both coordinates are assumed to be normal, so the distances have a Rayleigh distribution
    scale, middle = quantiles / np.sqrt(-2.0 * np.log(1.0 - np.array(shares)))[:, None]
    limit = np.full(len(scale), np.nan)
    for s in np.unique(segment):
        own = (segment == s) & np.isfinite(scale)
        if not own.any():
            continue
        limit[own] = _BEYOND * np.fmax(middle[own], np.median(scale[own]))
    return np.asarray(np.fmin(scale, limit))


SIGMA_V_BOUNDS = (1.0, 1e6)  # search range of the snap's standard deviation over one frame, rad/s^4

_LEVER_SQUARED = 1e-4  # m^2; an angle uses a degree of freedom if its markers have a lever above 1 cm
OUTLIER_SHARE = 1e-3
"""Fraction of outliers among the angles of single frames; jumps count as outliers, not as process noise."""

_STEP = 0.25  # s; time between angles that are compared to detect motion
_RESTING = 0.1  # of a joint's largest change in this time; a joint with a smaller change is at rest
_LEAST_CHANGE = 0.05  # rad; a joint whose largest change is less does not move
_LARGEST = 0.99  # quantile that counts as the largest change
_LEAST_MOTION = 0.25  # fraction of frames with motion from which all frames count
_NEAR = 2  # number of times _STEP before and after motion that count as motion
_SETTLE = 10  # innovations that determine the unknown start; they are not counted


def estimate_marker_noise(frames: FrameAngles, floor: float) -> float:
    """Return an unbiased estimate of the marker noise, m, from the residuals of single frames, or ``floor`` if larger.

    The degrees of freedom used by the angles are subtracted. The floor is needed for filtered or synthetic recordings,
    which have almost no noise.
    """
    sound: BoolArray = np.all(frames.reliable, axis=1)
    n, lost_freedom = frames.information.shape[1], np.empty(len(sound))
    for s in chunks(len(sound)):
        kept = np.linalg.inv(np.eye(n) + frames.information[s] / _LEVER_SQUARED)
        lost_freedom[s] = n - np.trace(kept, axis1=1, axis2=2)
    freedom = 2.0 * np.count_nonzero(frames.used[sound]) - float(np.sum(lost_freedom[sound]))
    return max(floor, math.sqrt(frames.squares / freedom)) if freedom >= 1.0 else floor


def estimate_process_noise(anchors: Anchors, dt: float) -> FloatArray:
    """Return the standard deviation (n,) of each joint's snap, held over one frame, rad/s^4, for a time step in s.

    The search is limited to :data:`SIGMA_V_BOUNDS`. With too few observed angles the result is the upper bound, so that
    the states follow the angles of single frames. Frames at rest count only if rest takes at most three quarters of the
    time, because rest would make the estimate too small for the motion.
    """
    step, shape, start = transition(dt)[0], noise_shape(dt), start_sd(dt) ** 2
    low, high = np.log(SIGMA_V_BOUNDS)
    counted = anchors.observed & _find_motion(anchors, dt)[:, None]
    found = np.empty(anchors.angles.shape[1])
    for j in range(len(found)):
        angle = np.where(counted[:, j], anchors.angles[:, j], np.nan)
        variance = np.ascontiguousarray(anchors.covariance[:, j, j])

        def cost(log_sigma: float, angle: FloatArray = angle, variance: FloatArray = variance) -> float:
            process = math.exp(2.0 * log_sigma) * dt * shape
            return -log_likelihood(angle, variance, step, process, start, OUTLIER_SHARE)

        best = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 0.01})
        found[j] = math.exp(best.x)
    return found


def _find_motion(anchors: Anchors, dt: float) -> BoolArray:
    """Return the frames (F,) near motion; all frames unless rest takes most of the time."""
    step = max(1, round(_STEP / dt))
    angles = np.where(anchors.observed, anchors.angles, np.nan)[::step]
    changes = np.abs(np.diff(angles, axis=0, prepend=np.nan))
    if len(changes) < 2 or not np.isfinite(changes).any(axis=0).all():
        return np.ones(len(anchors.observed), dtype=np.bool_)
    changes = np.where(np.isfinite(changes), changes, 0.0)
    largest = np.quantile(changes, _LARGEST, axis=0)
    moving = (changes > _RESTING * np.where(largest > _LEAST_CHANGE, largest, np.inf)).any(axis=1)
    if moving.mean() >= _LEAST_MOTION or not moving.any():
        return np.ones(len(anchors.observed), dtype=np.bool_)
    near = np.convolve(moving, np.ones(2 * _NEAR + 1), mode="same") > 0
    return np.asarray(np.repeat(near, step)[: len(anchors.observed)])


@compiled
def log_likelihood(  # noqa: PLR0917
    angle: FloatArray, variance: FloatArray, step: FloatArray, process: FloatArray, start: FloatArray, outliers: float
) -> float:
    """Return the log-likelihood of the innovations of one angle for the process model (eq. 3.17), robust to outliers.

    ``angle`` (F,), rad, is NaN where unobserved, and ``variance`` (F,) is its noise, rad^2. ``step`` (4,) is dt^k / k!,
    and ``process`` (4, 4) is the process noise of a step. ``start`` (4,) are the initial variances of the state, which
    are used again after a gap if the variance of the angle has become larger. ``outliers`` is the fraction of angles
    that may have any value. An angle that is more likely an outlier is ignored.
    """
    x, p, gain = np.zeros(ORDER), np.zeros((ORDER, ORDER)), np.empty(ORDER)
    p[0, 0] = math.inf
    seen, total = 0, 0.0
    for k in range(len(angle)):
        _predict(x, p, step, process)
        if math.isnan(angle[k]):
            continue
        if not p[0, 0] <= start[0]:
            seen = 0
            for i in range(ORDER):
                x[i] = angle[k] if i == 0 else 0.0
                for j in range(ORDER):
                    p[i, j] = start[i] if i == j else 0.0
        s, y = p[0, 0] + variance[k], angle[k] - x[0]
        y -= 2.0 * math.pi * round(y / (2.0 * math.pi))
        likelihood = math.log(1.0 - outliers) - 0.5 * (math.log(2.0 * math.pi * s) + y * y / s)
        anywhere = math.log(outliers / (2.0 * math.pi)) if outliers > 0.0 else -math.inf
        seen += 1
        if seen > _SETTLE:
            total += max(likelihood, anywhere)
        if likelihood < anywhere:
            continue
        for i in range(ORDER):
            gain[i] = p[i, 0] / s
            x[i] += gain[i] * y
        for i in range(ORDER):
            for j in range(ORDER):
                p[i, j] -= gain[i] * gain[j] * s
    return total


@compiled
def _predict(x: FloatArray, p: FloatArray, step: FloatArray, process: FloatArray) -> None:
    """Replace x by F x and P by F P Fᵀ + Q for one joint, with the transition F (``step``) and Q (``process``)."""
    for d in range(ORDER):
        for e in range(d + 1, ORDER):
            x[d] += step[e - d] * x[e]
            for r in range(ORDER):
                p[r, d] += step[e - d] * p[r, e]
    for d in range(ORDER):
        for c in range(ORDER):
            for e in range(d + 1, ORDER):
                p[d, c] += step[e - d] * p[e, c]
            p[d, c] += process[d, c]
