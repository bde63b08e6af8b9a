"""The compiled engine: unscented Kalman filter and Rauch–Tung–Striebel smoother in machine code.

The update is the unscented Kalman filter's, arranged for many markers. With the weights' square roots taken into the
deviations of the sigma points, the innovation covariance is S = R + H Hᵀ, where R is diagonal and H has only 2n + 1
columns (see :mod:`mocap_id.estimation.process` for why not 8n + 1): the mean's deviation, and for each of the first n
columns of L = chol(P) the sum and the difference of its two points' deviations. The matrix inversion lemma reduces
everything to A = I + Hᵀ R⁻¹ H: with L₁ the first n columns of L, L₂ the others, and index d for the differences,

    x⁺ = x + L₁ [A⁻¹ Hᵀ R⁻¹ y]_d        P⁺ = L₁ [A⁻¹]_dd L₁ᵀ + L₂ L₂ᵀ

which is what x + K y and P − K S Kᵀ come to, without their cancellation: P⁺ is a sum of squares.
"""

from __future__ import annotations

import numpy as np

from mocap_id.errors import NumericalError
from mocap_id.estimation.kernels import Filtered, Measured, Model, run_filter, run_smoother
from mocap_id.estimation.problem import ANCHOR_SD, Problem, Track, start_sd
from mocap_id.estimation.process import noise_shape, transition


def filter_forwards(problem: Problem) -> Track:
    """Run the filter over all frames.

    Raises
    ------
    NumericalError
        Where a covariance stops being positive definite.
    """
    frames, markers = problem.observed.shape[:2]
    n = problem.joints
    filtered = Filtered(
        np.empty((frames, 4 * n)),
        np.empty((frames, 4 * n, 4 * n)),
        np.zeros((frames, markers), dtype=np.bool_),
        np.zeros((frames, n), dtype=np.bool_),
    )
    failed, log_likelihood = run_filter(_model(problem), _measured(problem), filtered)
    if failed >= 0:
        raise NumericalError(f"the filter's covariance is not positive definite at sample {failed} of {frames}")
    return Track(*filtered, log_likelihood)


def smooth_backwards(problem: Problem, track: Track) -> Track:
    """Run the Rauch–Tung–Striebel smoother over a filtered track, whose arrays it overwrites.

    Raises
    ------
    NumericalError
        Where a predicted covariance is not positive definite.
    """
    failed = run_smoother(_model(problem), track.restarted, track.mean, track.covariance)
    if failed >= 0:
        raise NumericalError(f"the smoother's covariance is not positive definite at sample {failed}")
    return track


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
