"""The quintic smoothing spline minimises its criterion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import BSpline, make_smoothing_spline

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.smoothing import DEGREE, _freedom, _penalty, fit_smoothing_spline


def everything(angle: FloatArray) -> BoolArray:
    return np.ones(len(angle), dtype=np.bool_)


@pytest.mark.parametrize("rate", [25.0, 100.0, 2000.0])
def test_a_parabola_is_kept_with_its_derivatives(rate: float) -> None:
    time = np.arange(200) / rate
    angle = 40.0 + 2.0 * time - 3.0 * time**2
    found = fit_smoothing_spline(angle, everything(angle), 1.0 / rate)
    np.testing.assert_allclose(found[:, 0], angle, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found[:, 1], 2.0 - 6.0 * time, rtol=0, atol=1e-4)
    np.testing.assert_allclose(found[:, 2], -6.0, rtol=0, atol=2e-2)


@pytest.mark.parametrize("rate", [50.0, 100.0, 480.0, 2000.0])
def test_a_noisy_swing_is_found_at_any_rate(rate: float) -> None:
    time = np.arange(int(6 * rate)) / rate
    w = 2 * np.pi * 0.7
    truth = np.stack([w**d * np.sin(w * time + d * np.pi / 2) for d in range(3)], axis=-1)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(time))
    found = fit_smoothing_spline(truth[:, 0] + noise, everything(time), 1.0 / rate)[:, :3]
    error, size = found - truth, np.std(truth, axis=0)
    inside = slice(int(rate / 2), -int(rate / 2))
    assert np.all(np.std(error[inside], axis=0) <= np.array([1e-3, 0.003, 0.015]) * size)
    assert np.all(np.std(error, axis=0) <= np.array([1e-3, 0.006, 0.04]) * size)


def test_acceleration_is_better_than_that_of_a_cubic_spline() -> None:
    """scipy's cubic smoothing spline, also cross-validated, has piecewise linear accelerations."""
    time, rng = np.arange(400) / 100, np.random.default_rng(1)
    w = 2 * np.pi * 0.7
    truth, quintic, cubic = -(w**2) * np.sin(w * time), [], []
    for _ in range(5):
        angle = np.sin(w * time) + 1e-3 * rng.standard_normal(len(time))
        quintic.append(fit_smoothing_spline(angle, everything(angle), 0.01)[:, 2] - truth)
        cubic.append(make_smoothing_spline(time, angle)(time, nu=2) - truth)
    assert np.std(quintic) < 0.8 * np.std(cubic)


def test_unseen_samples_are_ignored() -> None:
    time = np.arange(300) / 100
    angle = np.sin(4 * time) + 1e-3 * np.random.default_rng(0).standard_normal(300)
    seen = everything(angle)
    seen[[0, 299]] = True
    seen[140:150] = False
    one, other = (fit_smoothing_spline(np.where(seen, angle, value), seen, 0.01) for value in (0.0, 9.0))
    np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(one[140:150, 0], np.sin(4 * time[140:150]), atol=3e-3)


def test_the_penalty_is_the_integral_of_the_squared_third_derivative() -> None:
    intervals = 7
    coefficients = np.random.default_rng(0).standard_normal(intervals + DEGREE)
    spline = BSpline(np.arange(-DEGREE, intervals + DEGREE + 1.0), coefficients, DEGREE)
    exact = sum(quad(lambda t: spline(t, nu=3) ** 2, k, k + 1)[0] for k in range(intervals))
    assert coefficients @ (_penalty(intervals) @ coefficients) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("per_interval", [1, 3])
@pytest.mark.parametrize("stiffness", [1e0, 1e3, 1e6])
def test_the_freedom_is_the_trace_of_the_smoother(per_interval: int, stiffness: float) -> None:
    intervals = 300
    place = np.linspace(0.0, intervals, per_interval * intervals + 1)
    basis = BSpline.design_matrix(place, np.arange(-DEGREE, intervals + DEGREE + 1.0), DEGREE).toarray()
    normal = basis.T @ basis
    trace = np.trace(np.linalg.solve(normal + stiffness * _penalty(intervals).toarray(), normal))
    assert _freedom(stiffness, intervals, len(place)) == pytest.approx(trace, rel=0.05)
