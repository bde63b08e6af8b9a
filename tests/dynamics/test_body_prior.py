"""The loose prior: a normal distribution as rows, bodies in other frames, and what no table tells."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import BODY
from scipy.stats import multivariate_normal

from mocap_id.dynamics.priors import (
    OTHERS_SHARE,
    average_transform,
    build_even_prior,
    build_table_prior,
    split_torso,
)
from mocap_id.geometry import planar

MASS = float(BODY[:, 0].sum())
TABLE = build_table_prior(BODY.ravel(), "a table")


def of_points(mass: np.ndarray, place: np.ndarray) -> np.ndarray:
    """m, mx, my, Izz of point masses."""
    return np.array([mass.sum(), *(mass @ place), mass @ np.sum(place**2, axis=1)])


@pytest.mark.parametrize("columns", [16, 19])
def test_rows_are_the_quadratic_form_of_the_distribution(columns: int) -> None:
    rows, aim = TABLE.rows(columns)
    assert rows.shape == (16, columns)
    rng, law = np.random.default_rng(0), multivariate_normal(TABLE.mean, TABLE.covariance)
    assert (rows[:, 16:] == 0.0).all()
    for _ in range(5):
        body = rng.multivariate_normal(TABLE.mean, TABLE.covariance)
        square = float(np.sum((rows @ np.pad(body, (0, columns - 16)) - aim) ** 2))
        assert square == pytest.approx(2 * (law.logpdf(TABLE.mean) - law.logpdf(body)), rel=1e-8)
    np.testing.assert_allclose(rows[:, :16] @ TABLE.mean, aim, atol=1e-9)


def test_a_body_moves_like_its_points() -> None:
    rng = np.random.default_rng(1)
    mass, place = rng.uniform(0.2, 3.0, size=6), rng.normal(size=(6, 2))
    angle, shift = rng.uniform(-3, 3, size=9), rng.normal(size=(9, 2))
    body = of_points(mass, place)
    each = [of_points(mass, s + planar.rotate(np.array(a), place)) for a, s in zip(angle, shift, strict=True)]
    for k in range(9):
        np.testing.assert_allclose(average_transform(angle[k : k + 1], shift[k : k + 1]) @ body, each[k], atol=1e-12)
    np.testing.assert_allclose(average_transform(angle, shift) @ body, np.mean(each, axis=0), atol=1e-12)
    np.testing.assert_array_equal(average_transform(np.zeros(3), np.zeros((3, 2))), np.eye(4))


def test_moves_follow_each_other() -> None:
    a, b, s, t = np.array([0.7]), np.array([-1.9]), np.array([[0.2, 0.5]]), np.array([[-0.4, 0.1]])
    both = average_transform(a + b, s + planar.rotate(a, t))
    np.testing.assert_allclose(average_transform(a, s) @ average_transform(b, t), both, atol=1e-12)


def test_torso_and_others_are_together_what_the_table_says() -> None:
    rng = np.random.default_rng(2)
    angle, shift = 0.4 * rng.normal(size=50), [0.1, 0.2] + 0.1 * rng.normal(size=(50, 2))
    torso, others = split_torso(BODY[3], angle, shift, MASS)
    np.testing.assert_allclose(torso + average_transform(angle, shift) @ others, BODY[3], atol=1e-12)
    assert others[0] == pytest.approx(OTHERS_SHARE * MASS)
    np.testing.assert_array_equal(others[1:3], 0.0)
    for body in (torso, others):
        assert body[0] * body[3] > body[1] ** 2 + body[2] ** 2


def test_what_is_left_of_the_torso_can_exist() -> None:
    """Others far from the torso leave it no moment of inertia: it keeps the least there is; mass and moments stand."""
    angle, shift = np.zeros(4), np.tile([0.0, 2.5], (4, 1))
    torso, others = split_torso(BODY[3], angle, shift, MASS)
    together = torso + average_transform(angle, shift) @ others
    np.testing.assert_allclose(together[:3], BODY[3, :3], atol=1e-12)
    assert together[3] > BODY[3, 3]
    assert torso[0] * torso[3] > torso[1] ** 2 + torso[2] ** 2
    light, _ = split_torso(np.array([3.0, 0.0, 0.6, 0.4]), angle, shift, MASS)
    assert light[0] == pytest.approx(1.5)


def test_without_a_table_the_mass_is_shared_evenly() -> None:
    centroid = np.array([[0.1, 0.02], [0.0, 0.2], [-0.03, 0.25]])
    prior = build_even_prior(60.0, centroid)
    m, mx, my, inertia = prior.mean.reshape(-1, 4).T
    np.testing.assert_allclose(m, 20.0)
    np.testing.assert_allclose(np.column_stack([mx, my]) / m[:, None], centroid)
    gyration = np.sqrt(inertia / m - np.sum(centroid**2, axis=1))
    np.testing.assert_allclose(gyration, gyration[0])
    assert 0.05 < gyration[0] < 0.3
    assert "even" in prior.source
    sd = np.sqrt(np.diag(prior.covariance)).reshape(-1, 4)
    np.testing.assert_allclose(sd[:, 0], m)  # as uncertain as it is large


@pytest.mark.parametrize("body", range(4))
def test_mass_centre_and_inertia_err_by_themselves(body: int) -> None:
    """First-order propagation: (m, mx, my, Izz) of draws of mass, centre and moment about the centre."""
    own = slice(4 * body, 4 * body + 4)
    m, mx, my, about = BODY[body]
    x, y, inner = mx / m, my / m, about - (mx**2 + my**2) / m
    small = 1e-3  # the covariance is that of small errors
    relative, centre = (0.3, 0.05) if body == 0 else (0.5, 0.1)
    rng = np.random.default_rng(body)
    e = small * rng.normal(size=(4, 200_000)) * np.array([[relative * m], [centre], [centre], [inner]])
    mass, cx, cy, i = m + e[0], x + e[1], y + e[2], inner + e[3]
    drawn = np.cov(np.stack([mass, mass * cx, mass * cy, i + mass * (cx**2 + cy**2)])) / small**2
    found = TABLE.covariance[own, own]
    size = np.sqrt(np.diag(found))
    np.testing.assert_allclose(drawn / np.outer(size, size), found / np.outer(size, size), atol=0.02)
    elsewhere = np.delete(TABLE.covariance[own], np.arange(4 * body, 4 * body + 4), axis=1)
    assert (elsewhere == 0.0).all()


def test_the_mass_of_arms_is_surer_than_a_segment_s() -> None:
    """Half as wide, since published tables scatter half as much; centre and moment of inertia as a segment's."""
    wide, arms = (build_table_prior(BODY.ravel(), "", others=others).covariance for others in (False, True))
    assert arms[12, 12] == pytest.approx(0.25 * wide[12, 12])
    np.testing.assert_array_equal(arms[:12], wide[:12])
    x, y = BODY[3, 1:3] / BODY[3, 0]
    along = np.array([x, y, x * x + y * y])  # what an error of the mass alone does
    rest = [each[13:, 13:] - each[12, 12] * np.outer(along, along) for each in (arms, wide)]
    np.testing.assert_allclose(*rest, atol=1e-12)


def test_a_body_without_mass_has_a_covariance_all_the_same() -> None:
    prior = build_table_prior(np.concatenate([np.zeros(4), BODY[1:].ravel()]), "")
    assert np.isfinite(prior.rows(16)[0]).all()
