"""For a linear problem, filter and smoother equal least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_triangular
from simulated_chains import Moving, swinging

from mocap_id.arrays import FloatArray
from mocap_id.estimation import filter_problem, filterpy_engine
from mocap_id.estimation.filter_problem import (
    START_SD,
    FilterProblem,
    MarkerChain,
    Track,
    joint_noise,
    joint_transition,
    noise_shape,
    transition,
)
from mocap_id.estimation.noise import find_frame_angles, log_likelihood
from mocap_id.geometry.planar import marker_jacobian, marker_positions

DT, NOISE = 0.04, 1e-2


def measured_angles(frames: int = 60) -> FloatArray:
    """Return noisy angles (F, 2) with gaps."""
    rng = np.random.default_rng(3)
    time = DT * np.arange(frames)[:, None]
    angles = np.sin(2.0 * time + [0.0, 1.0]) + NOISE * rng.standard_normal((frames, 2))
    angles[20:30, 0] = np.nan
    return np.asarray(angles)


def kalman(angles: FloatArray) -> tuple[Track, float]:
    """Run a textbook Kalman filter, angle by angle; return the track and its log-likelihood."""
    frames, n = angles.shape
    f, q = joint_transition(DT, n), joint_noise(DT, problem_density(n))
    x, p, total = np.zeros(4 * n), np.diag(np.repeat(START_SD, n) ** 2), 0.0
    mean, covariance = np.empty((frames, 4 * n)), np.empty((frames, 4 * n, 4 * n))
    for k in range(frames):
        if k > 0:
            x, p = f @ x, f @ p @ f.T + q
        for j in np.flatnonzero(np.isfinite(angles[k])):
            s, y = p[j, j] + NOISE**2, angles[k, j] - x[j]
            total -= 0.5 * (np.log(2 * np.pi * s) + y**2 / s)
            gain = p[:, j] / s
            x, p = x + gain * y, p - np.outer(gain, gain) * s
        mean[k], covariance[k] = x, p
    restarted = np.zeros((frames, n), dtype=bool)
    return Track(mean, covariance, np.zeros((frames, 1), dtype=bool), restarted, total), total


def problem_density(n: int) -> FloatArray:
    return np.full(n, 1e2)


def batch(angles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve for all states of all frames: whitened rows of prior, process and measurements, by QR."""
    frames, n = angles.shape
    size = 4 * n
    f, q = joint_transition(DT, n), joint_noise(DT, problem_density(n))
    whiten = np.linalg.inv(np.linalg.cholesky(q))
    start = np.zeros((size, frames * size))
    start[:, :size] = np.diag(1.0 / np.repeat(START_SD, n))
    rows, right = [start], [np.zeros(size)]
    for k in range(1, frames):
        row = np.zeros((size, frames * size))
        row[:, (k - 1) * size : (k + 1) * size] = whiten @ np.hstack([-f, np.eye(size)])
        rows.append(row)
        right.append(np.zeros(size))
    for k, j in np.argwhere(np.isfinite(angles)):
        row = np.zeros((1, frames * size))
        row[0, k * size + j] = 1.0 / NOISE
        rows.append(row)
        right.append(angles[k, j : j + 1] / NOISE)
    matrix = np.concatenate(rows)
    scale = np.linalg.norm(matrix, axis=0)
    orthogonal, triangle = np.linalg.qr(matrix / scale)
    inverse = solve_triangular(triangle, np.eye(len(triangle)))
    mean = inverse @ (orthogonal.T @ np.concatenate(right)) / scale
    sd = np.linalg.norm(inverse, axis=1) / scale
    return mean.reshape(frames, size), sd.reshape(frames, size)


@pytest.mark.parametrize(
    "smoother", [filter_problem.smooth_backwards, filterpy_engine.smooth_slowly], ids=["compiled", "filterpy"]
)
def test_smoother_is_batch_least_squares(smoother: Callable[[FilterProblem, Track], Track]) -> None:
    angles = measured_angles()
    problem = replace(
        swinging(joints=2, seconds=len(angles) * DT, rate=1 / DT).problem(marker_sd=1e-3, sigma_v=1.0),
        density=problem_density(2),
    )
    smoothed = smoother(problem, kalman(angles)[0])
    mean, sd = batch(angles)
    size = np.abs(mean).max(axis=0)
    np.testing.assert_allclose(smoothed.mean / size, mean / size, rtol=0, atol=1e-7)
    np.testing.assert_allclose(smoothed.sd, sd, rtol=1e-6)


def test_the_likelihood_of_the_noise_search_equals_the_textbook() -> None:
    """Except for the first innovations, which determine the start; compares differences between trial values."""
    angles = measured_angles()[:, :1]
    angles[0] = 0.0

    def both(density: float) -> tuple[float, float]:
        start = np.array(START_SD) ** 2
        scalar = log_likelihood(
            angles[:, 0], np.full(len(angles), NOISE**2), transition(DT)[0], density * noise_shape(DT), start, 0.0
        )
        return scalar, textbook(angles[:, 0], density)

    assert both(1e3)[0] - both(1e1)[0] == pytest.approx(both(1e3)[1] - both(1e1)[1], rel=1e-6)


def textbook(angles: FloatArray, density: float) -> float:
    """Return the log-density of the innovations after the tenth, from a dense Kalman filter."""
    f, q = transition(DT), density * noise_shape(DT)
    x, p, total, seen = np.zeros(4), np.diag(np.array(START_SD) ** 2), 0.0, 0
    for z in angles:
        if seen > 0:
            x, p = f @ x, f @ p @ f.T + q
        if np.isnan(z):
            continue
        s, gain = p[0, 0] + NOISE**2, p[:, 0] / (p[0, 0] + NOISE**2)
        seen += 1
        total -= 0.5 * (np.log(2 * np.pi * s) + (z - x[0]) ** 2 / s) if seen > 10 else 0.0
        x, p = x + gain * (z - x[0]), p - np.outer(gain, gain) * s
    return total


def one_update(moving: Moving, sd: float) -> tuple[FloatArray, FloatArray]:
    """Return the states after one unscented and one linearised update of a prior of this spread."""
    n = len(moving.centres)
    problem = moving.problem(marker_sd=0.1 * sd, sigma_v=1.0, gate=1e9)
    prior = moving.truth[0].T.ravel() + sd * np.random.default_rng(1).standard_normal(4 * n)
    covariance = sd**2 * (np.eye(4 * n) + 0.5)
    ukf = filterpy_engine._make_filter(problem)
    ukf.x, ukf.P = prior.copy(), covariance.copy()
    ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
    filterpy_engine._measure(ukf, problem, 0)
    jacobian = marker_jacobian(prior[:n], moving.centres, moving.segment, moving.local).reshape(-1, n)
    h = np.hstack([jacobian, np.zeros((len(jacobian), 3 * n))])
    expected = marker_positions(prior[:n], moving.centres, moving.segment, moving.local)
    gain = covariance @ h.T @ np.linalg.inv(h @ covariance @ h.T + (0.1 * sd) ** 2 * np.eye(len(h)))
    return ukf.x, prior + gain @ (moving.markers[0] - expected).ravel()


def test_the_unscented_update_tends_to_kalmans_as_the_map_becomes_linear() -> None:
    """The effect of curvature is of second order in the spread of the prior."""
    moving = swinging(joints=2, seconds=0.1, noise=0.0)
    differences = [np.abs(np.subtract(*one_update(moving, sd))).max() for sd in (1e-2, 1e-3)]
    assert differences[1] < 1.5e-2 * differences[0]
    assert differences[1] < 1e-2 * 1e-3


def test_angles_of_a_frame_have_the_stated_covariance() -> None:
    moving, noise = swinging(joints=3, seconds=0.02, noise=0.0), 2e-3
    rng = np.random.default_rng(0)
    still = np.repeat(moving.markers[:1], 4000, axis=0)
    frames = find_frame_angles(
        still + noise * rng.standard_normal(still.shape),
        MarkerChain(moving.centres, moving.segment, moving.local),
        50.0,
        1e-4,
    )
    np.testing.assert_allclose(frames.angles.mean(axis=0), moving.truth[0, :, 0], atol=5 * noise / np.sqrt(4000))
    stated = frames.anchors(noise).covariance.mean(axis=0)
    deviation = np.sqrt(np.diag(stated))
    np.testing.assert_allclose(
        np.cov(frames.angles.T) / np.outer(deviation, deviation), stated / np.outer(deviation, deviation), atol=0.08
    )
