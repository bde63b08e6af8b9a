"""Circles through single tracks, and common centres: the fits of the pipeline, and those of the benchmark."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize

from mocap_id.kinematics import joint

with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(Path(__file__).resolve().parents[2] / "benchmarks")
    from circles import fit_circles, fit_common_centre

SEEDS = st.integers(0, 10_000)
METHODS = ["kasa", "taubin", "pratt", "geometric"]
COMMON = ["kasa", "taubin", "geometric"]
UNBIASED = ["taubin", "pratt", "geometric"]
RADIUS, NOISE = 0.35, 5e-4


def arcs(rng, degrees, radii, *, frames=60, noise=0.0, missing=0.0, centre=0j):
    """Return tracks (F, M) about a centre, in random directions, each over its own part of the arc."""
    directions = rng.uniform(0, 2 * np.pi, len(radii))
    angle = np.radians(degrees) * ((np.arange(frames) + 0.5) / frames - 0.5)
    points = centre + radii * np.exp(1j * (angle[:, None] + directions))
    points = points + noise * (rng.standard_normal(points.shape) + 1j * rng.standard_normal(points.shape))
    points[rng.uniform(size=points.shape) < missing] = np.nan
    return points


def short_arcs(degrees, *, frames=200, tracks=2000, seed=0):
    """Return tracks (F, tracks) of a marker above a joint at 0 with independent noise; radial errors are imaginary."""
    rng = np.random.default_rng(seed)
    angle = np.radians(degrees) * ((np.arange(frames) + 0.5) / frames - 0.5)
    noise = rng.standard_normal((frames, tracks)) + 1j * rng.standard_normal((frames, tracks))
    return RADIUS * 1j * np.exp(1j * angle)[:, None] + NOISE * noise


def bound(degrees, frames=200):
    return 26.8 * NOISE / np.sqrt(frames) / np.radians(degrees) ** 2


@pytest.mark.parametrize("method", METHODS)
@given(seed=SEEDS, degrees=st.floats(5, 360))
def test_clean_arcs_are_exact_with_gaps(method, seed, degrees):
    rng = np.random.default_rng(seed)
    centre, radii = complex(*rng.normal(size=2)), rng.uniform(0.05, 2, 3)
    fit = fit_circles(arcs(rng, degrees, radii, missing=0.2, centre=centre), method)
    assert np.abs(fit.centre - centre).max() < 1e-8
    assert fit.radius == pytest.approx(radii, abs=1e-8)
    assert fit.residual.max() < 1e-10


@pytest.mark.parametrize("method", COMMON)
@given(seed=SEEDS, degrees=st.floats(2, 360))
def test_a_clean_common_centre_is_exact_with_gaps(method, seed, degrees):
    rng = np.random.default_rng(seed)
    centre, radii = complex(*rng.normal(size=2)), rng.uniform(0.05, 2, 4)
    fit = fit_common_centre(arcs(rng, degrees, radii, missing=0.2, centre=centre), method)
    assert fit.centre.shape == (1,)
    assert abs(fit.centre[0] - centre) < 1e-8
    assert fit.radius == pytest.approx(radii, abs=1e-8)


@pytest.mark.parametrize(
    ("fit", "method"), [(fit_circles, each) for each in METHODS] + [(fit_common_centre, each) for each in COMMON]
)
@given(seed=SEEDS, turn=st.floats(0, 6.28), scale=st.floats(0.01, 1000))
def test_the_fit_turns_shifts_and_scales_with_the_points(fit, method, seed, turn, scale):
    rng = np.random.default_rng(seed)
    points = arcs(rng, 40, rng.uniform(0.2, 0.5, 3), noise=1e-3, missing=0.1)
    factor, shift = scale * np.exp(1j * turn), scale * complex(*rng.normal(size=2))
    before, after = fit(points, method), fit(factor * points + shift, method)
    assert np.abs(after.centre - (factor * before.centre + shift)).max() < 1e-7 * scale
    assert after.radius == pytest.approx(scale * before.radius, rel=1e-6)
    assert after.residual == pytest.approx(scale * before.residual, rel=1e-5)


@pytest.mark.parametrize("method", COMMON)
def test_the_common_centre_of_one_marker_is_its_own(method):
    rng = np.random.default_rng(4)
    points = arcs(rng, 50, np.array([0.4]), noise=1e-3)
    own, common = fit_circles(points, method), fit_common_centre(points, method)
    assert common.centre == pytest.approx(own.centre, abs=1e-12)


def test_each_fit_minimises_its_textbook_criterion():
    """Comparison with general minimisers, for the circle equation A|z|^2 + B.z + D = 0."""
    rng = np.random.default_rng(5)
    z = arcs(rng, 60, np.array([1.0]), noise=0.02, centre=0.3 - 0.2j)[:, 0]
    columns = np.stack([np.abs(z) ** 2, z.real, z.imag, np.ones(len(z))], axis=1)

    def centre(coefficients):
        return -complex(*coefficients[1:3]) / (2 * coefficients[0])

    def minimum(cost, start):
        return optimize.minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-16}).x

    def algebraic(p):  # A = 1
        return np.sum((columns[:, 0] - 2 * p[0] * z.real - 2 * p[1] * z.imag + p[0] ** 2 + p[1] ** 2 - p[2]) ** 2)

    def taubin(p):
        full = np.array([1.0, *p])
        gradient = np.mean(np.abs(2 * z + complex(*p[:2])) ** 2)
        return np.sum((columns @ full) ** 2) / gradient

    def pratt(p):
        return np.sum((columns @ np.array([1.0, *p])) ** 2) / (p[0] ** 2 + p[1] ** 2 - 4 * p[2])

    def geometric(p):
        return np.abs(z - complex(*p[:2])) - p[2]

    found = {method: fit_circles(z[:, None], method).centre[0] for method in METHODS}
    start = np.array([-0.6, 0.4, -0.8])
    assert complex(*minimum(algebraic, [0.3, -0.2, 1.0])[:2]) == pytest.approx(found["kasa"], abs=1e-6)
    assert centre(np.array([1.0, *minimum(taubin, start)])) == pytest.approx(found["taubin"], abs=1e-6)
    assert centre(np.array([1.0, *minimum(pratt, start)])) == pytest.approx(found["pratt"], abs=1e-6)
    true = optimize.least_squares(geometric, [0.3, -0.2, 1.0], xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    assert complex(*true[:2]) == pytest.approx(found["geometric"], abs=1e-7)


@pytest.mark.parametrize("method", ["kasa", "geometric"])
def test_the_common_centre_minimises_the_sum_over_the_markers(method):
    rng = np.random.default_rng(6)
    points = arcs(rng, 30, np.array([0.2, 0.5, 0.8]), noise=5e-3, missing=0.1, centre=0.1j)
    power = 2 if method == "kasa" else 1

    def off(p):
        distance = np.abs(points - complex(*p[:2])) ** power - p[2:]
        return distance[np.isfinite(distance)]

    true = optimize.least_squares(off, [0, 0.1, *np.array([0.2, 0.5, 0.8]) ** power], xtol=1e-14, ftol=1e-14).x
    assert complex(*true[:2]) == pytest.approx(fit_common_centre(points, method).centre[0], abs=1e-7)


@pytest.mark.parametrize("degrees", [10, 15, 30])
def test_noise_biases_the_algebraic_centre_by_the_known_amount(degrees):
    """r / (1 + (r arc^2 / 26.8 sigma)^2), in the limit of many frames."""
    error = fit_circles(short_arcs(degrees, frames=2000, tracks=300), "kasa").centre
    expected = RADIUS / (1 + (RADIUS * np.radians(degrees) ** 2 / (26.8 * NOISE)) ** 2)
    uncertainty = error.imag.std() / np.sqrt(len(error))
    assert abs(error.imag.mean() - expected) < 4 * uncertainty
    assert uncertainty < 0.02 * expected


@pytest.mark.parametrize("method", UNBIASED)
@pytest.mark.parametrize("degrees", [10, 15, 30])
def test_the_other_fits_reach_the_bound(method, degrees):
    error = fit_circles(short_arcs(degrees), method).centre.imag
    assert error.std() == pytest.approx(bound(degrees), rel=0.07)  # sampling error of the sd of 2000: 1.6 %
    # a radius is one over a curvature, so its mean is biased by the square of its relative deviation
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(len(error)) + 1.5 * error.std() ** 2 / RADIUS


@pytest.mark.parametrize("method", METHODS)
def test_the_residual_is_the_noise(method):
    assert np.median(fit_circles(short_arcs(30), method).residual) == pytest.approx(NOISE, rel=0.02)


def test_intersecting_normals_are_more_precise_than_curvature():
    rng = np.random.default_rng(7)
    spread, alone = [], []
    for _ in range(100):
        angle = np.radians(10) * (np.arange(200) / 200 - 0.5)
        points = np.exp(1j * angle)[:, None] * (RADIUS * np.exp(1j * np.array([1.2, 1.5, 1.8])))
        points = points + NOISE * (rng.standard_normal(points.shape) + 1j * rng.standard_normal(points.shape))
        spread.append(abs(fit_common_centre(points).centre[0]))
        alone.append(abs(fit_circles(points, "geometric").centre.mean()))
    assert np.median(spread) < np.median(alone) / 5


@pytest.mark.parametrize("method", METHODS)
def test_a_track_without_a_circle_has_no_centre(method):
    line, place, arc = np.linspace(0, 1, 50), np.full(50, 0.3 + 0.1j), np.exp(1j * np.linspace(0, 1.5, 50))
    points = np.stack([line * (1 + 0.5j), place, np.full(50, np.nan), arc], axis=1)
    points[2:, 1] = np.nan
    fit = fit_circles(points, method)
    assert np.isnan(fit.centre[:3]).all()
    assert np.isnan(fit.radius[:3]).all()
    assert (fit.residual[:3] == np.inf).all()
    assert abs(fit.centre[3]) < 1e-9


@settings(max_examples=20)
@given(SEEDS)
def test_an_arc_lost_in_noise_ends_without_harm(seed):
    points = arcs(np.random.default_rng(seed), 1, np.full(20, 0.3), noise=2e-3)
    fit, start = fit_circles(points, "geometric"), fit_circles(points, "taubin")
    known = np.isfinite(fit.centre)  # otherwise the best circle is a straight line
    assert known.mean() > 0.5
    assert (fit.residual[known] <= start.residual[known] * (1 + 1e-9)).all()


def test_a_common_centre_by_pratt_is_refused():
    with pytest.raises(ValueError, match="method 'pratt' has no common centre"):
        fit_common_centre(np.ones((5, 2), dtype=complex), "pratt")


@pytest.mark.parametrize("missing", [0.0, 0.2, 0.97])
def test_the_pipeline_has_the_fits_of_taubin_and_kasa(missing):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        points = arcs(rng, 40, rng.uniform(0.2, 0.5, 3), noise=1e-3, missing=missing)
        points[:, 2] = 0.1
        np.testing.assert_array_equal(joint.fit_circles(points), fit_circles(points, "taubin").centre)
        np.testing.assert_array_equal(joint.fit_common_centre(points), fit_common_centre(points, "kasa").centre[0])
