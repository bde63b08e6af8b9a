"""Compensation of dropouts, so that the angles do not jump when a marker vanishes.

Skin displaces every marker, and the fit averages the displacements. When a marker vanishes, the average jumps, and so
does the angle. A missing marker is therefore assumed to keep the residual r that it has beside the gap. This residual
decays with the time constant of the skin and changes the angles by δ (docs/concepts/dropouts.md), where J is the
Jacobian of a marker:

    (Σ_visible Jᵀ J) δ = Σ_missing Jᵀ r
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks, find_runs
from mocap_id.estimation.inverse_kinematics import FrameAngles, MarkerChain
from mocap_id.geometry.planar import marker_jacobian, marker_positions, rotate

SKIN_MEMORY = 0.9  # time constant, s, of the skin's displacement: its autocorrelation is 0.57 after 0.5 s
FEW = 3
"""Successive frames in which over half of a segment's visible markers may fail the gate without being reported."""

_BESIDE = 5  # frames before and after a gap over which the residual is averaged
PAIRS = 1000  # pairs of consecutive frames used to estimate the persistent part of a residual
_ROUNDS = 2  # the residuals beside a gap depend on the angles in other markers' gaps


@dataclass(frozen=True)
class _GappedMarker:
    """A marker with gaps, and the data with which its residual is bridged."""

    observed: FloatArray  # (F, 2) m
    used: BoolArray  # (F,)
    chain: MarkerChain  # the chain with this marker alone
    gaps: Gaps
    lasting: float  # variance of the part of the residual that persists to the next frame, m^2 per coordinate
    noise: float  # variance of the rest, m^2 per coordinate

    @classmethod
    def of(
        cls, observed: FloatArray, frames: FrameAngles, chain: MarkerChain, marker: int, memory: float
    ) -> _GappedMarker | None:
        """Return a marker with its gaps; None if it has no gap or is never used in two successive frames."""
        track, used = observed[:, marker], frames.used[:, marker]
        gaps = find_gaps(used, memory)
        pairs = np.flatnonzero(used[1:] & used[:-1])
        if not gaps.missing.size or not pairs.size:
            return None
        one = MarkerChain(chain.centres, chain.segment[[marker]], chain.local[[marker]])
        found = cls(track, used, one, gaps, 0.0, 0.0)
        pairs = pairs[:: max(1, len(pairs) // PAIRS)]
        first, second = (found.residual(frames.angles, pairs + step) for step in (0, 1))
        lasting, noise = split_variance(first, second)
        return replace(found, lasting=lasting, noise=noise)

    def add_push(self, push: FloatArray, angles: FloatArray) -> None:
        """Add Jᵀ r, m²/rad, to ``push`` (F, n), in place, in the frames without the marker."""
        sides = (shrink_mean(self.residual(angles, side), self.lasting, self.noise) for side in self.gaps.beside)
        displacement = self.gaps.bridge(*sides)
        at = angles[self.gaps.missing]
        rotation = at[:, : self.chain.segment[0]].sum(axis=1)
        jacobian = marker_jacobian(at, self.chain.centres, self.chain.segment, self.chain.local)[:, 0]
        push[self.gaps.missing] += np.einsum("fik,fi->fk", jacobian, rotate(rotation, displacement))

    def residual(self, angles: FloatArray, at: IntArray) -> FloatArray:
        """Return residuals (..., 2) at frames (...) in the segment's frame, m; NaN at frame -1 and where not used."""
        centres, segment, local = self.chain.centres, self.chain.segment, self.chain.local
        off = self.observed[at] - marker_positions(angles[at], centres, segment, local)[..., 0, :]
        rotation = angles[at][..., : segment[0]].sum(axis=-1)
        return np.where(((at >= 0) & self.used[at])[..., None], rotate(-rotation, off), np.nan)


def compensate_dropouts(
    observed: FloatArray, frames: FrameAngles, chain: MarkerChain, marker_sd: float, rate: float
) -> FrameAngles:
    """Return the angles of the frames as if the missing markers were still used.

    ``observed`` (F, M, 2) are the markers of the moving segments, plane frame, m; NaN where missing. They are changed
    in place: the visible markers move with their segments by the correction of the angles. ``marker_sd`` is the marker
    noise, m, and ``rate`` the number of frames per second.
    """
    anchors = frames.anchors(marker_sd)
    some = np.flatnonzero(~frames.used.all(axis=1) & anchors.observed.any(axis=1))
    if not some.size:
        return frames
    response = _invert_information(frames.information[some], anchors.observed[some])
    angles = frames.angles.copy()
    markers = [
        _GappedMarker.of(observed, frames, chain, marker, SKIN_MEMORY * rate) for marker in range(observed.shape[1])
    ]
    for _ in range(_ROUNDS):
        push = np.zeros_like(angles)
        for marker in markers:
            if marker is not None:
                marker.add_push(push, angles)
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
    marker is used, and 1 if the marker is never used. ``used`` (F, M) marks the used markers; ``rate`` is in frames per
    second.
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


def _invert_information(information: FloatArray, observed: BoolArray) -> FloatArray:
    """Return the inverse (f, n, n) of Jᵀ J (f, n, n) over the observed joints (f, n); its other entries are zero."""
    both = observed[:, :, None] & observed[:, None, :]
    inverse = np.linalg.inv(np.where(both, information, np.eye(observed.shape[1])))
    return np.where(both, inverse, 0.0)


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
