"""What a marker that vanishes takes along: the angle stepped by it would be, if nothing were known of how it had slid.

Skin carries every marker off its place in the segment, and the angle that a frame gives is off by what its markers
slid, averaged as the fit does. Where a marker vanishes the average is over fewer and the angle steps, which smoothed is
a swing of the acceleration. But how far the marker had slid is seen beside the gap, in its residual, and skin moves
slowly: it is taken to be there still, and to fade as it is remembered. A missing marker with a residual r of which
nothing else is known adds Jᵀ r to the right side of the normal equations, and nothing to the left:

    (Σ_seen Jᵀ J) δ = Σ_missing Jᵀ r

At either edge of the gap δ is just what the missing markers had added to the angles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.estimation.inverse import Chain, FrameAngles
from mocap_id.geometry.planar import marker_jacobian, marker_positions, rotate, segment_poses

_MEMORY = 0.9  # s, in which what skin did is forgotten: its correlation is 0.57 after 0.5 s
_BESIDE = 5  # frames on either side of a gap over which a residual is averaged
_PAIRS = 1000  # of consecutive frames that tell what of a residual lasts
_ROUNDS = 2  # the residuals beside a gap are those of angles within others


@dataclass(frozen=True)
class _Missed:
    """A marker with gaps.

    Parameters
    ----------
    observed : (F, 2) array
    used : (F,) bool array
    chain : Chain
        With this marker alone.
    missing : (T,) int array
        Frames without it.
    gap : (T,) int array
        Of each of them.
    sides : pair of (G, b) int arrays
        Frames before and after every gap; -1 where there are none.
    since, until : (T,) array
        How long the gap has lasted and will last, in memories.
    lasting, noise : float
        Variances, m^2 a coordinate, of what of the residual is there still one frame later, and of the rest.
    """

    observed: FloatArray
    used: BoolArray
    chain: Chain
    missing: IntArray
    gap: IntArray
    sides: tuple[IntArray, IntArray]
    since: FloatArray
    until: FloatArray
    lasting: float
    noise: float

    @classmethod
    def of(cls, observed: FloatArray, frames: FrameAngles, chain: Chain, marker: int, memory: float) -> _Missed | None:
        """None for a marker that is never missing, or always."""
        track, used = observed[:, marker], frames.used[:, marker]
        edges, missing = _gaps(used)
        pairs = np.flatnonzero(used[1:] & used[:-1])
        if not missing.size or not pairs.size:
            return None
        since, until = _away(edges, missing, len(used), memory)
        gap = np.searchsorted(edges[:, 0], missing, side="right") - 1
        one = Chain(chain.centres, chain.segment[[marker]], chain.local[[marker]])
        found = cls(track, used, one, missing, gap, _sides(edges, len(used)), since, until, 0.0, 0.0)
        pairs = pairs[:: max(1, len(pairs) // _PAIRS)]
        first, second = (found.residual(frames.angles, pairs + step) for step in (0, 1))
        lasting = max(float(np.mean(first * second)), 0.0)
        noise = max(float(np.mean(first**2 + second**2)) / 2 - lasting, 0.0)
        return replace(found, lasting=lasting, noise=noise)

    def push(self, push: FloatArray, angles: FloatArray) -> None:
        """Add Jᵀ r (F, n) in the frames that miss it; in place."""
        before, after = (self.slid(angles, side) for side in self.sides)
        slid = _bridge(before[self.gap], after[self.gap], self.since, self.until)
        at = angles[self.missing]
        turned = segment_poses(at, self.chain.centres)[0][:, self.chain.segment[0]]
        jacobian = marker_jacobian(at, self.chain.centres, self.chain.segment, self.chain.local)[:, 0]
        push[self.missing] += np.einsum("fik,fi->fk", jacobian, rotate(turned, slid))

    def slid(self, angles: FloatArray, at: IntArray) -> FloatArray:
        """(G, 2) what it had slid at frames (G, b), m: the mean of what is seen, less as noise has a part in it.

        NaN where it is not seen.
        """
        residual = self.residual(angles, at)
        count = np.isfinite(residual[..., 0]).sum(axis=1, keepdims=True)
        sure = self.lasting / np.maximum(count * self.lasting + self.noise, np.finfo(np.float64).tiny)
        return np.where(count > 0, sure * np.nansum(residual, axis=1), np.nan)

    def residual(self, angles: FloatArray, at: IntArray) -> FloatArray:
        """(..., 2) at frames (...), in the segment's frame, m; NaN at frame -1 and where it is not used."""
        centres, segment, local = self.chain.centres, self.chain.segment, self.chain.local
        off = self.observed[at] - marker_positions(angles[at], centres, segment, local)[..., 0, :]
        turned = segment_poses(angles[at], centres)[0][..., segment[0]]
        return np.where(((at >= 0) & self.used[at])[..., None], rotate(-turned, off), np.nan)


def hold(observed: FloatArray, frames: FrameAngles, chain: Chain, marker_sd: float, rate: float) -> FrameAngles:
    """Move the markers, and the frames' angles, as if those that are missing still took part.

    Parameters
    ----------
    observed : (F, M, 2) array
        Markers of the moving segments, plane frame, m; NaN where missing. Changed: moved with the segments by what
        the missing ones would turn them.
    frames : FrameAngles
        Found from them.
    chain : Chain
    marker_sd : float
        m.
    rate : float
        Frames per second.

    Returns
    -------
    FrameAngles
        With these angles.
    """
    anchors = frames.anchors(marker_sd)
    some = np.flatnonzero(~frames.used.all(axis=1) & anchors.observed.any(axis=1))
    if not some.size:
        return frames
    turn = _response(frames.information[some], anchors.observed[some])
    angles = frames.angles.copy()
    missed = [_Missed.of(observed, frames, chain, marker, _MEMORY * rate) for marker in range(observed.shape[1])]
    for _ in range(_ROUNDS):
        push = np.zeros_like(angles)
        for marker in missed:
            if marker is not None:
                marker.push(push, angles)
        angles[some] = frames.angles[some] + np.einsum("fkl,fl->fk", turn, push[some])
    for part in chunks(len(some)):
        own = some[part]
        for sign, at in ((-1.0, frames.angles[own]), (1.0, angles[own])):
            observed[own] += sign * marker_positions(at, chain.centres, chain.segment, chain.local)
    return replace(frames, angles=angles)


def forgotten(used: BoolArray, frames: IntArray, rate: float) -> FloatArray:
    """(T, M) share of the variance of what a marker slid that its residuals beside a gap do not tell, at some frames.

    That of a first-order Markov process between two values. Where a marker is used it is 0, where it never is, 1.
    """
    new = np.zeros((len(frames), used.shape[1]))
    for marker in range(used.shape[1]):
        edges, missing = _gaps(used[:, marker])
        if missing.size:
            s, u = _away(edges, missing, len(used), _MEMORY * rate)
            share = np.zeros(len(used))
            share[missing] = np.expm1(-2 * s) * np.expm1(-2 * u) / -np.expm1(-2 * (s + u))
            new[:, marker] = share[frames]
    return new


def _response(information: FloatArray, observed: BoolArray) -> FloatArray:
    """(f, n, n) inverse of Jᵀ J over the joints that are observed, zero elsewhere."""
    both = observed[:, :, None] & observed[:, None, :]
    inverse = np.linalg.inv(np.where(both, information, np.eye(observed.shape[1])))
    return np.where(both, inverse, 0.0)


def _gaps(used: BoolArray) -> tuple[IntArray, IntArray]:
    """First frames of the gaps and frames after them (G, 2), and all frames within."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], used, [True]]).astype(np.int8)))
    return edges.reshape(-1, 2), np.flatnonzero(~used)


def _away(edges: IntArray, missing: IntArray, frames: int, memory: float) -> tuple[FloatArray, FloatArray]:
    """How long since the gap began and until it ends, in memories; infinite where it does not within the trial."""
    first, after = edges[np.searchsorted(edges[:, 0], missing, side="right") - 1].T
    since = np.where(first > 0, missing - first + 1, np.inf)
    until = np.where(after < frames, after - missing, np.inf)
    return since / memory, until / memory


def _sides(edges: IntArray, frames: int) -> tuple[IntArray, IntArray]:
    """The frames (G, b) before and after every gap; -1 where there are none."""
    beside = np.arange(_BESIDE)
    before, after = edges[:, :1] - 1 - beside, edges[:, 1:] + beside
    return np.maximum(before, -1), np.where(after < frames, after, -1)


def _bridge(before: FloatArray, after: FloatArray, since: FloatArray, until: FloatArray) -> FloatArray:
    """(T, 2) what is expected between residuals ``before`` and ``after`` (T, 2), so many memories from either (T,).

    The mean of a first-order Markov process: sinh(u)/sinh(s + u) of the one and sinh(s)/sinh(s + u) of the other.
    """
    both = -np.expm1(-2 * (since + until))
    one, other = np.exp(-since) * -np.expm1(-2 * until) / both, np.exp(-until) * -np.expm1(-2 * since) / both
    return one[:, None] * np.nan_to_num(before) + other[:, None] * np.nan_to_num(after)
