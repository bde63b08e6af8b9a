"""The compiled engine: unscented Kalman filter and Rauch–Tung–Striebel smoother in machine code.

The update is the unscented Kalman filter's, arranged for many markers. With the weights' square roots taken into the
deviations of the sigma points, the innovation covariance is S = R + H Hᵀ, where R is diagonal and H has only 2n + 1
columns (see :mod:`mocap_id.estimation.process` for why not 8n + 1): the mean's deviation, and for each of the first n
columns of L = chol(P) the sum and the difference of its two points' deviations. The matrix inversion lemma reduces
everything to A = I + Hᵀ R⁻¹ H: with L₁ the first n columns of L, L₂ the others, and index d for the differences,

    x⁺ = x + L₁ [A⁻¹ Hᵀ R⁻¹ y]_d        P⁺ = L₁ [A⁻¹]_dd L₁ᵀ + L₂ L₂ᵀ

which is what x + K y and P − K S Kᵀ come to, without their cancellation: P⁺ is a sum of squares.

The covariances of all frames would take six times the memory of everything else. The filter keeps only the deviations:
it notes what it carries every few hundred frames, and the smoother, block by block from the last to the first, has it
filter the block again from there. That costs a second run of the filter, and gives the same to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, chunks
from mocap_id.errors import NumericalError
from mocap_id.estimation.kernels import Filtered, Measured, Memory, Model, run_filter, run_smoother
from mocap_id.estimation.problem import ANCHOR_SD, FilteredTrack, Problem, SmoothedTrack, start_sd
from mocap_id.estimation.process import noise_shape, transition

_BLOCK = 512
"""Frames whose covariances are held at a time."""


def filter_forwards(problem: Problem) -> FilteredTrack:
    """Run the filter over all frames.

    Raises
    ------
    NumericalError
        Where a covariance stops being positive definite.
    """
    frames, n = len(problem.observed), problem.joints
    model, measured = _model(problem), _measured(problem)
    whole = _blank(frames, measured, block=min(_BLOCK, frames))
    sd, log_likelihood, noted = np.empty_like(whole.mean), 0.0, []
    memory = Memory(  # every joint starts over at once
        np.zeros(4 * n), np.zeros((4 * n, 4 * n)), measured.angles[0].copy(), np.full(n, problem.patience + 1)
    )
    for part in chunks(frames, _BLOCK):
        noted.append(_copied(memory))
        here = whole._replace(
            mean=whole.mean[part],
            covariance=whole.covariance[: part.stop - part.start],
            used=whole.used[part],
            restarted=whole.restarted[part],
        )
        failed, gained = run_filter(model, _part(measured, part), memory, here)
        if failed >= 0:
            sample = part.start + failed
            raise NumericalError(f"the filter's covariance is not positive definite at sample {sample} of {frames}")
        log_likelihood += gained
        sd[part] = _deviations(here.covariance)
    again = _Again(model, measured, tuple(noted))
    return FilteredTrack(whole.mean, sd, whole.used, whole.restarted, log_likelihood, again)


def smooth_backwards(problem: Problem, track: FilteredTrack) -> SmoothedTrack:
    """Run the Rauch–Tung–Striebel smoother over a filtered track, whose arrays it overwrites.

    Raises
    ------
    NumericalError
        Where a predicted covariance is not positive definite.
    """
    model, mean = _model(problem), track.mean
    found = np.flatnonzero(track.found.any(axis=1))
    kept: dict[int, FloatArray] = {}
    beyond = np.empty((0, mean.shape[1], mean.shape[1]))
    for part in reversed(chunks(len(mean), _BLOCK)):
        start = part.start
        covariance = np.concatenate([track.covariance(part), beyond])  # (f + 1, 4n, 4n), but for the last block
        reach = slice(start, start + len(covariance))
        failed = run_smoother(model, track.restarted[reach], mean[reach], covariance)
        if failed >= 0:
            raise NumericalError(f"the smoother's covariance is not positive definite at sample {start + failed}")
        track.sd[part] = _deviations(covariance[: part.stop - start])
        kept |= {k: covariance[k - start].copy() for k in found[(found >= start) & (found < part.stop)].tolist()}
        beyond = covariance[:1].copy()
    return SmoothedTrack(mean, track.sd, track.used, track.restarted, track.log_likelihood, kept)


@dataclass(frozen=True)
class _Again:
    """Covariances of a stretch of frames, by filtering it again from where the filter's memory was noted last."""

    model: Model
    measured: Measured
    noted: tuple[Memory, ...]

    def __call__(self, frames: slice) -> FloatArray:
        start, stop, _ = frames.indices(len(self.measured.markers))
        first = start // _BLOCK * _BLOCK
        part = _part(self.measured, slice(first, stop))
        filtered = _blank(stop - first, part, block=stop - first)
        run_filter(self.model, part, _copied(self.noted[start // _BLOCK]), filtered)
        return filtered.covariance[start - first :]


def _blank(frames: int, measured: Measured, block: int) -> Filtered:
    """Room for what the filter gives, and for the covariances of a block."""
    markers, n = measured.markers.shape[1], measured.angles.shape[1]
    return Filtered(
        np.empty((frames, 4 * n)),
        np.empty((block, 4 * n, 4 * n)),
        np.zeros((frames, markers), dtype=np.bool_),
        np.zeros((frames, n), dtype=np.bool_),
    )


def _part(measured: Measured, frames: slice) -> Measured:
    return Measured._make(each[frames] for each in measured)


def _copied(memory: Memory) -> Memory:
    return Memory._make(each.copy() for each in memory)


def _deviations(covariance: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))


def _measured(problem: Problem) -> Measured:
    anchors = problem.anchors
    return Measured(
        np.ascontiguousarray(problem.observed),
        np.ascontiguousarray(anchors.angles),
        np.ascontiguousarray(anchors.covariance),
        np.ascontiguousarray(anchors.observed),
        np.ascontiguousarray(anchors.used),
    )


def _model(problem: Problem) -> Model:
    size = 4 * problem.joints
    return Model(
        step=transition(problem.dt)[0],
        shape=noise_shape(problem.dt),
        density=np.ascontiguousarray(problem.density),
        start=start_sd(problem.dt) ** 2,
        anchor_limit=ANCHOR_SD**2,
        centres=np.ascontiguousarray(problem.centres),
        segment=np.ascontiguousarray(problem.segment),
        local=np.ascontiguousarray(problem.local),
        variance=np.ascontiguousarray(problem.variance),
        gate_variance=np.ascontiguousarray(problem.gate_variance),
        gate=float(problem.gate),
        patience=problem.patience,
        weights=problem.sigma_points.weights(size),
        spread=problem.sigma_points.spread(size),
    )
