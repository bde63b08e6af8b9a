"""Reference engine: filterpy's unscented Kalman filter, and a smoother in plain numpy.

It is slow and serves to verify the compiled engine.

filterpy leaves three tasks to its caller. A missing marker must be removed from measurement, noise and measurement
function, because one NaN spoils the state. The first frame needs explicit sigma points, because ``update`` uses the
points of the preceding ``predict``. The smoother of filterpy has one process noise for all steps and cannot start
joints again, so it is not used.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import NumericalError
from mocap_id.estimation.filter_kernels import ENOUGH
from mocap_id.estimation.filter_problem import (
    ANCHOR_SD,
    START_SD,
    FilterProblem,
    Track,
    joint_noise,
    joint_transition,
    start_sd,
)
from mocap_id.geometry.planar import marker_positions


def filter_slowly(problem: FilterProblem) -> Track:
    """Return the filtered states of all frames; NumericalError if a covariance is not positive definite."""
    frames, markers = problem.observed.shape[:2]
    n = problem.joints
    mean, covariance = np.empty((frames, 4 * n)), np.empty((frames, 4 * n, 4 * n))
    used, restarted = np.zeros((frames, markers), dtype=np.bool_), np.zeros((frames, n), dtype=np.bool_)
    ukf, last_angle, log_likelihood = _make_filter(problem), problem.anchors.angles[0].copy(), 0.0
    own = problem.chain.segment[:, None] == np.arange(1, n + 1)  # (M, n)
    failing = np.zeros(n, dtype=np.int64)  # successive frames in which over half of a segment's markers fail
    for k in range(frames):
        try:
            if k > 0:
                ukf.predict()
            diverged = (failing > 0) & bool((failing > problem.patience).any())
            lost = restarted[k] = (k == 0) | (np.diag(ukf.P)[:n] > START_SD[0] ** 2) | diverged
            failing[lost] = 0
            # lost joints start at their last angle, at rest, with their initial covariance
            rows = np.tile(lost, 4)
            ukf.P[rows, :] = 0.0
            ukf.P[:, rows] = 0.0
            ukf.P[rows, rows] = np.repeat(start_sd(problem.dt) ** 2, n)[rows]
            ukf.x[rows] = np.concatenate([last_angle, np.zeros(3 * n)])[rows]
            ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
            gained, used[k] = _measure(ukf, problem, k)
        except np.linalg.LinAlgError as error:
            raise NumericalError(
                f"the filter's covariance is not positive definite at sample {k} of {frames}"
            ) from error
        log_likelihood += gained
        # a frame in which no marker of the segment is visible does not count
        seen = (own & np.isfinite(problem.observed[k]).all(axis=-1)[:, None]).sum(axis=0)
        passed = (own & used[k][:, None]).sum(axis=0)
        failing = np.asarray(np.where(seen > 0, np.where(2 * passed < seen, failing + 1, 0), failing))
        last_angle = np.where(problem.anchors.observed[k] & (failing == 0), ukf.x[:n], last_angle)
        mean[k], covariance[k] = ukf.x, ukf.P
    return Track(mean, covariance, used, restarted, log_likelihood)


def smooth_slowly(problem: FilterProblem, track: Track) -> Track:
    """Run the Rauch–Tung–Striebel smoother over a filtered track, and return the smoothed states as a new track."""
    n = problem.joints
    f, q = joint_transition(problem.dt, n), joint_noise(problem.dt, problem.density)
    start = np.repeat(start_sd(problem.dt) ** 2, n)
    mean, covariance = track.mean.copy(), track.covariance.copy()
    for k in range(len(mean) - 2, -1, -1):
        predicted = f @ covariance[k] @ f.T + q
        cross = covariance[k] @ f.T
        lost = np.tile(track.restarted[k + 1], 4)
        cross[:, lost] = 0.0
        predicted[lost, :] = 0.0
        predicted[:, lost] = 0.0
        predicted[lost, lost] = start[lost]
        gain = np.linalg.solve(predicted, cross.T).T
        mean[k] += gain @ (mean[k + 1] - f @ mean[k])
        keep = np.eye(4 * n) - gain @ f
        covariance[k] = keep @ covariance[k] @ keep.T + gain @ (covariance[k + 1] + q) @ gain.T
    return Track(mean, covariance, track.used, track.restarted, track.log_likelihood)


def _make_filter(problem: FilterProblem) -> UnscentedKalmanFilter:
    size = 4 * problem.joints
    f = joint_transition(problem.dt, problem.joints)
    ukf = UnscentedKalmanFilter(
        dim_x=size,
        dim_z=2 * len(problem.chain.segment),
        dt=problem.dt,
        fx=lambda x, dt: f @ x,
        hx=lambda x, markers: _forward(problem, x, markers).ravel(),
        points=MerweScaledSigmaPoints(size, alpha=1.0, beta=2.0, kappa=0.0),
    )
    ukf.Q = joint_noise(problem.dt, problem.density)
    ukf.P = np.zeros((size, size))
    return ukf


def _forward(problem: FilterProblem, states: FloatArray, markers: BoolArray) -> FloatArray:
    """Return the positions (..., m, 2) of the m chosen markers (eq. 3.18) for states (..., 4n)."""
    angles, chain = states[..., : problem.joints], problem.chain
    return marker_positions(angles, chain.centres, chain.segment[markers], chain.local[markers])


def _measure(ukf: UnscentedKalmanFilter, problem: FilterProblem, k: int) -> tuple[float, BoolArray]:
    """Update the filter with frame k; return the increase of the log-likelihood and the markers used (M,)."""
    visible = np.isfinite(problem.observed[k]).all(axis=-1)
    uncertain = np.flatnonzero(np.diag(ukf.P)[: problem.joints] > ANCHOR_SD**2)
    if uncertain.size and np.any(visible & (problem.chain.segment > uncertain[0])):
        if not problem.anchors.observed[k].any():
            return 0.0, np.zeros_like(visible)
        taken = _anchor(ukf, problem.anchors.angles[k], problem.anchors.covariance[k], problem.gate)
        return 0.0, problem.anchors.used[k] & taken
    # the gate around the prediction
    points = _forward(problem, ukf.sigmas_f, visible)  # (2L + 1, m, 2)
    expected = np.einsum("s,smi->mi", ukf.Wm, points)
    deviation = points - expected
    spread = np.einsum("s,smi,smj->mij", ukf.Wc, deviation, deviation)
    spread += problem.gate_variance[visible, None, None] * np.eye(2)
    innovation = problem.observed[k, visible] - expected
    squared = np.einsum("mi,mi->m", innovation, np.linalg.solve(spread, innovation[..., None])[..., 0])
    passed = visible.copy()
    passed[visible] = squared <= problem.gate**2
    own = problem.chain.segment[:, None] == np.arange(1, problem.joints + 1)  # (M, n)
    seen, through, fitting = ((own & each[:, None]).sum(axis=0) for each in (visible, passed, problem.anchors.used[k]))
    lost = problem.anchors.observed[k] & (seen >= ENOUGH) & (2 * through < seen) & (seen < 2 * fitting)
    if lost.any() and np.count_nonzero(problem.anchors.used[k]) > np.count_nonzero(passed):
        _anchor(ukf, problem.anchors.angles[k], problem.anchors.covariance[k], np.inf)
        return 0.0, problem.anchors.used[k].copy()
    if not passed.any():
        return 0.0, passed
    noise = np.diag(np.repeat(problem.variance[passed], 2))
    ukf.update(problem.observed[k, passed].ravel(), R=noise, markers=passed)
    return float(ukf.log_likelihood), passed


def _anchor(ukf: UnscentedKalmanFilter, angles: FloatArray, noise: FloatArray, gate: float) -> bool:
    """Update the filter with the angles (n,) of one frame and their covariance; return whether they passed the gate.

    Whole rotations are added to the angles to bring them near the state. The update is linear, in Joseph form.
    """
    n, size = len(angles), len(ukf.x)
    h = np.eye(n, size)
    innovation = angles - ukf.x[:n]
    innovation -= 2.0 * np.pi * np.round(innovation / (2.0 * np.pi))
    spread = ukf.P[:n, :n] + noise
    if innovation @ np.linalg.solve(spread, innovation) > gate**2:
        return False
    gain = np.linalg.solve(spread, ukf.P[:n]).T
    keep = np.eye(size) - gain @ h
    ukf.x = ukf.x + gain @ innovation
    ukf.P = keep @ ukf.P @ keep.T + gain @ noise @ gain.T
    return True
