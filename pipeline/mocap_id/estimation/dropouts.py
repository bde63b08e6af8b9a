"""Compensation of dropouts, so that the angles do not step when a marker vanishes.

Skin displaces every marker, and the fit averages the displacements. When a marker vanishes, the average and the angle
step. A missing marker keeps the residual r that it has beside the gap, fading with the memory of the skin, and moves
the angles by δ (docs/concepts/dropouts.md):

    (Σ_seen Jᵀ J) δ = Σ_missing Jᵀ r
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.estimation.inverse_kinematics import FrameAngles, MarkerChain
from mocap_id.geometry.planar import marker_jacobian, marker_positions, rotate

SKIN_MEMORY = 0.9  # s; memory of the skin: its correlation is 0.57 after 0.5 s
_BESIDE = 5  # frames on either side of a gap, in which the residual is averaged
_PAIRS = 1000  # pairs of consecutive frames for the lasting part of a residual
_ROUNDS = 2  # the residuals beside a gap depend on angles in other markers' gaps


@dataclass(frozen=True)
class _GappedMarker:
    """A marker with gaps.

    Parameters
    ----------
    observed : (F, 2) array
    used : (F,) bool array
    chain : MarkerChain
        The chain with this marker alone.
    missing : (T,) int array
        Frames without the marker.
    gap : (T,) int array
        Gap of each of these frames.
    sides : pair of (G, b) int arrays
        Frames before and after every gap; -1 beyond the trial.
    since, until : (T,) array
        Time since the gap began and until it ends, in memories.
    lasting, noise : float
        Variances of the part of the residual that persists to the next frame, and of the rest, m^2 per coordinate.
    """

    observed: FloatArray
    used: BoolArray
    chain: MarkerChain
    missing: IntArray
    gap: IntArray
    sides: tuple[IntArray, IntArray]
    since: FloatArray
    until: FloatArray
    lasting: float
    noise: float

    @classmethod
    def of(
        cls, observed: FloatArray, frames: FrameAngles, chain: MarkerChain, marker: int, memory: float
    ) -> _GappedMarker | None:
        """Return the gaps of a marker; None for a marker that is never or always missing."""
        track, used = observed[:, marker], frames.used[:, marker]
        edges, missing = find_gaps(used)
        pairs = np.flatnonzero(used[1:] & used[:-1])
        if not missing.size or not pairs.size:
            return None
        since, until = memories_away(edges, missing, len(used), memory)
        gap = np.searchsorted(edges[:, 0], missing, side="right") - 1
        one = MarkerChain(chain.centres, chain.segment[[marker]], chain.local[[marker]])
        found = cls(track, used, one, missing, gap, frames_beside(edges, len(used)), since, until, 0.0, 0.0)
        pairs = pairs[:: max(1, len(pairs) // _PAIRS)]
        first, second = (found.residual(frames.angles, pairs + step) for step in (0, 1))
        lasting = max(float(np.mean(first * second)), 0.0)
        noise = max(float(np.mean(first**2 + second**2)) / 2 - lasting, 0.0)
        return replace(found, lasting=lasting, noise=noise)

    def add_push(self, push: FloatArray, angles: FloatArray) -> None:
        """Add Jᵀ r (F, n) in the frames without the marker; in place."""
        before, after = (self.displacement(angles, side) for side in self.sides)
        slid = bridge(before[self.gap], after[self.gap], self.since, self.until)
        at = angles[self.missing]
        turned = at[:, : self.chain.segment[0]].sum(axis=1)
        jacobian = marker_jacobian(at, self.chain.centres, self.chain.segment, self.chain.local)[:, 0]
        push[self.missing] += np.einsum("fik,fi->fk", jacobian, rotate(turned, slid))

    def displacement(self, angles: FloatArray, at: IntArray) -> FloatArray:
        """Return the displacement (G, 2) at frames (G, b), m: the mean residual, shrunk by its noise; NaN if unseen."""
        residual = self.residual(angles, at)
        count = np.isfinite(residual[..., 0]).sum(axis=1, keepdims=True)
        sure = self.lasting / np.maximum(count * self.lasting + self.noise, np.finfo(np.float64).tiny)
        return np.where(count > 0, sure * np.nansum(residual, axis=1), np.nan)

    def residual(self, angles: FloatArray, at: IntArray) -> FloatArray:
        """Return residuals (..., 2) at frames (...) in the segment's frame, m; NaN at frame -1 and where not used."""
        centres, segment, local = self.chain.centres, self.chain.segment, self.chain.local
        off = self.observed[at] - marker_positions(angles[at], centres, segment, local)[..., 0, :]
        turned = angles[at][..., : segment[0]].sum(axis=-1)
        return np.where(((at >= 0) & self.used[at])[..., None], rotate(-turned, off), np.nan)


def compensate_dropouts(
    observed: FloatArray, frames: FrameAngles, chain: MarkerChain, marker_sd: float, rate: float
) -> FrameAngles:
    """Move the markers and the frames' angles as if the missing markers still took part.

    Parameters
    ----------
    observed : (F, M, 2) array
        Markers of the moving segments, plane frame, m; NaN where missing. Changed in place: the markers move with
        the segments by the correction of the angles.
    frames : FrameAngles
        Angles found from these markers.
    chain : MarkerChain
    marker_sd : float
        Marker noise, m.
    rate : float
        Frames per second.

    Returns
    -------
    FrameAngles
        The same with corrected angles.
    """
    anchors = frames.anchors(marker_sd)
    some = np.flatnonzero(~frames.used.all(axis=1) & anchors.observed.any(axis=1))
    if not some.size:
        return frames
    response = _response(frames.information[some], anchors.observed[some])
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


def forgotten_share(used: BoolArray, frames: IntArray, rate: float) -> FloatArray:
    """Return the share (T, M) of the variance of a marker's displacement that is unknown at given frames.

    It is that of a first-order Markov process between two known values: 0 where the marker is used, and 1 if it is
    never used.
    """
    new = np.zeros((len(frames), used.shape[1]))
    for marker in range(used.shape[1]):
        edges, missing = find_gaps(used[:, marker])
        if missing.size:
            s, u = memories_away(edges, missing, len(used), SKIN_MEMORY * rate)
            share = np.zeros(len(used))
            share[missing] = np.expm1(-2 * s) * np.expm1(-2 * u) / -np.expm1(-2 * (s + u))
            new[:, marker] = share[frames]
    return new


def _response(information: FloatArray, observed: BoolArray) -> FloatArray:
    """Return the inverse (f, n, n) of Jᵀ J over the observed joints, zero elsewhere."""
    both = observed[:, :, None] & observed[:, None, :]
    inverse = np.linalg.inv(np.where(both, information, np.eye(observed.shape[1])))
    return np.where(both, inverse, 0.0)


def find_gaps(used: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the first frames of the gaps and the frames after them (G, 2), and all frames within."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], used, [True]]).astype(np.int8)))
    return edges.reshape(-1, 2), np.flatnonzero(~used)


def memories_away(edges: IntArray, missing: IntArray, frames: int, memory: float) -> tuple[FloatArray, FloatArray]:
    """Return the time since the gap began and until it ends, divided by the memory; infinite beyond the trial."""
    first, after = edges[np.searchsorted(edges[:, 0], missing, side="right") - 1].T
    since = np.where(first > 0, missing - first + 1, np.inf)
    until = np.where(after < frames, after - missing, np.inf)
    return since / memory, until / memory


def frames_beside(edges: IntArray, frames: int) -> tuple[IntArray, IntArray]:
    """Return the frames (G, b) before and after every gap; -1 beyond the trial."""
    beside = np.arange(_BESIDE)
    before, after = edges[:, :1] - 1 - beside, edges[:, 1:] + beside
    return np.maximum(before, -1), np.where(after < frames, after, -1)


def bridge(before: FloatArray, after: FloatArray, since: FloatArray, until: FloatArray) -> FloatArray:
    """Return the displacements (T, 2) expected between the values ``before`` and ``after`` (T, 2).

    The mean of a first-order Markov process, s = ``since`` and u = ``until`` memories (T,) away: weights sinh(u)/sinh(s
    + u) and sinh(s)/sinh(s + u).
    """
    both = -np.expm1(-2 * (since + until))
    one, other = np.exp(-since) * -np.expm1(-2 * until) / both, np.exp(-until) * -np.expm1(-2 * since) / both
    return one[:, None] * np.nan_to_num(before) + other[:, None] * np.nan_to_num(after)
