"""Inverse kinematics: the joint angles of each frame from its own markers alone.

These angles start the filter, and restart it after gaps. They are also used to find which angles are observed, and to
estimate the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.estimation.filter_kernels import refine
from mocap_id.estimation.filter_problem import Anchors
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
class MarkerChain:
    """Geometry of a chain of n joints with M markers."""

    centres: FloatArray  # (n, 2) joint centres in the frame of the segment before, m
    segment: IntArray  # (M,) segment of each marker, 0 = base
    local: FloatArray  # (M, 2) coordinates in the segment frame, m


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
