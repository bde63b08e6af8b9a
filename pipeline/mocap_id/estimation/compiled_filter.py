"""Compiled engine: unscented Kalman filter and Rauch–Tung–Striebel smoother.

The update of the unscented Kalman filter is arranged for many markers. If the deviations of the sigma points are
multiplied by the square roots of their weights, the innovation covariance is S = R + H Hᵀ. The marker noise R is
diagonal, and H has only 2n + 1 columns; :mod:`mocap_id.estimation.process_model` explains why it does not have 8n + 1.
One column is the deviation of the mean point. The other columns are the sum and the difference of the deviations of two
opposite points, for each of the first n columns of L = chol(P). By the matrix inversion lemma, only A = I + Hᵀ R⁻¹ H
must be inverted. L₁ are the first n columns of L, L₂ the other columns, y is the innovation, and d stands for the
columns with differences:

    x⁺ = x + L₁ [A⁻¹ Hᵀ R⁻¹ y]_d        P⁺ = L₁ [A⁻¹]_dd L₁ᵀ + L₂ L₂ᵀ

These equal x + K y and P − K S Kᵀ with the Kalman gain K, but have no cancellation, because P⁺ is a sum of squares.
"""

from __future__ import annotations

import numpy as np

from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_kernels import (
    FilterModel,
    FilterOutput,
    Inertial,
    Measurements,
    run_filter,
    run_smoother,
)
from mocap_id.estimation.filter_problem import ANCHOR_SD, FilterProblem, Track, start_sd
from mocap_id.estimation.process_model import noise_shape, transition

_EMPTY = np.empty((0, 0))
_NO_SENSORS = Inertial(
    np.empty(0, dtype=np.int64), _EMPTY, _EMPTY, np.empty(0), np.empty((1, 0, 0)), np.empty((1, 0, 0)), 0.0
)


def filter_forwards(problem: FilterProblem) -> Track:
    """Run the filter over all frames, and return the filtered states.

    Raise NumericalError if a covariance is not positive definite.
    """
    frames, markers = problem.observed.shape[:2]
    n = problem.joints
    filtered = FilterOutput(
        np.empty((frames, 4 * n)),
        np.empty((frames, 4 * n, 4 * n)),
        np.zeros((frames, markers), dtype=np.bool_),
        np.zeros((frames, n), dtype=np.bool_),
    )
    anchors = problem.anchors
    measured = Measurements(
        np.ascontiguousarray(problem.observed),
        np.ascontiguousarray(anchors.angles),
        np.ascontiguousarray(anchors.covariance),
        np.ascontiguousarray(anchors.observed),
        np.ascontiguousarray(anchors.used),
    )
    failed, log_likelihood = run_filter(_make_model(problem), measured, problem.inertial or _NO_SENSORS, filtered)
    if failed >= 0:
        raise NumericalError(f"the filter's covariance is not positive definite at sample {failed} of {frames}")
    return Track(*filtered, log_likelihood)


def smooth_backwards(problem: FilterProblem, track: Track) -> Track:
    """Run the Rauch–Tung–Striebel smoother over a filtered track, and return this track with its arrays overwritten.

    Raises
    ------
    NumericalError
        A predicted covariance is not positive definite.
    """
    failed = run_smoother(_make_model(problem), track.restarted, track.mean, track.covariance)
    if failed >= 0:
        raise NumericalError(f"the smoother's covariance is not positive definite at sample {failed}")
    return track


def _make_model(problem: FilterProblem) -> FilterModel:
    size = 4 * problem.joints
    return FilterModel(
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
