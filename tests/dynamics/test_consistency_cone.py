"""Links that can exist, exactly: what the cone holds, and which of its bodies are given."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import BODY
from grid_cases import GRID, B, M, impossible, problem

from mocap_id.dynamics.consistency import ConeBodies, find_closest_links, solve_links
from mocap_id.dynamics.priors import compute_reference_sd

ANYWHERE = ConeBodies(np.eye(16))
INSIDE = ConeBodies(np.eye(16), GRID.boxes())
kinds = pytest.mark.parametrize("boxes", [None, GRID.boxes()], ids=["cone", "bounded"])


def test_every_set_of_point_masses_is_in_the_cone() -> None:
    """On the grid in both; anywhere in the one without outlines."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        masses = rng.exponential(size=len(GRID.segment)) * (rng.random(len(GRID.segment)) < 0.1)
        body = GRID.moments() @ masses
        assert ANYWHERE.measure_violation(body) < 1e-12
        assert INSIDE.measure_violation(body) < 1e-12


def test_the_cone_is_what_its_inequality_says() -> None:
    rng = np.random.default_rng(1)
    seen = set()
    for _ in range(500):
        body = rng.normal(size=16) + np.tile([1.0, 0, 0, 1.5], 4)
        m, mx, my, izz = body.reshape(-1, 4).T
        possible = bool((m >= 0).all() and (m * izz >= mx**2 + my**2).all() and (izz >= 0).all())
        assert (ANYWHERE.measure_violation(body) == 0.0) == possible
        seen.add(possible)
    assert seen == {True, False}


def test_the_unit_of_length_does_not_matter_to_what_is_inside() -> None:
    body = BODY.ravel()
    on_the_edge = body.copy()
    on_the_edge[3::4] = (body[1::4] ** 2 + body[2::4] ** 2) / body[::4]
    assert ANYWHERE.measure_violation(on_the_edge) < 1e-12
    assert ANYWHERE.measure_violation(on_the_edge * np.tile([1, 1, 1, 0.999], 4)) > 1e-5


@kinds
def test_of_all_bodies_that_fit_the_closest_to_an_aim_is_given(boxes: np.ndarray | None) -> None:
    """Against random bodies with the same base parameters."""
    bodies = ConeBodies(M, boxes)
    whole = ConeBodies(np.eye(16), boxes)
    small = problem(2, 1.0)
    fitted = solve_links(small, bodies).body
    aim = BODY.ravel() * np.random.default_rng(5).uniform(0.8, 1.2, 16)
    scale = compute_reference_sd(aim, 0.15)
    found = find_closest_links(bodies, fitted, aim, scale)
    np.testing.assert_allclose(M @ found, M @ fitted, atol=1e-9)
    assert whole.measure_violation(found) < 1e-9
    best = np.sum(((found - aim) / scale) ** 2)
    directions = np.linalg.svd(M)[2][11:]
    rng, tried = np.random.default_rng(6), 0
    for size in 10 ** rng.uniform(-4, 0.5, 2000):
        moved = found + size * rng.normal(size=5) @ directions
        if whole.measure_violation(moved) == 0.0:
            tried += 1
            assert np.sum(((moved - aim) / scale) ** 2) >= best * (1 - 1e-7)
    assert tried > 20


def test_a_reference_that_fits_is_given_as_it_is() -> None:
    aim = BODY.ravel()
    fitted = solve_links(problem(0, 0.0), ConeBodies(M)).body
    np.testing.assert_allclose(
        find_closest_links(ConeBodies(M), fitted, aim, compute_reference_sd(aim, 0.15)), aim, rtol=1e-3, atol=1e-3
    )


def foot_without_mass() -> np.ndarray:
    """Base parameters of a body whose foot has a first moment and needs to have no mass."""
    body = BODY.copy()
    body[0] = 0.0
    body[1:, 3] = (body[1:, 1] ** 2 + body[1:, 2] ** 2) / body[1:, 0]  # no inertia to spare: no mass can move
    base = M @ body.ravel()
    base[1] -= 3.0
    return base


def test_what_only_a_limit_of_bodies_has_is_not_given() -> None:
    """Without outlines a foot of next to no mass carries any first moment, from far away: its Izz is without end."""
    small = problem(0, 0.01, foot_without_mass() * np.r_[1.0, 1.0, np.full(9, 1.02)])
    found = solve_links(small, ConeBodies(M))
    assert found.optimality.proven
    assert found.body[0] < 1e-6
    assert abs(found.body[1]) > 1
    closest = find_closest_links(ConeBodies(M), found.body, BODY.ravel(), compute_reference_sd(BODY.ravel(), 0.15))
    assert np.isnan(closest[3])
    assert np.isfinite(np.delete(closest, 3)).all()
    inside = solve_links(small, ConeBodies(M, GRID.boxes()))
    assert inside.optimality.proven
    assert inside.cost > 1.1 * found.cost


@kinds
@pytest.mark.parametrize("seed", range(5))
def test_rounding_is_taken_off(boxes: np.ndarray | None, seed: int) -> None:
    """What is given can exist exactly, not to the solver's tolerance."""
    bodies = ConeBodies(M, boxes)
    body = solve_links(problem(seed, 1.0, impossible(seed)), bodies).body
    m, mx, my, izz = body.reshape(-1, 4)[1:].T
    assert (m >= 0).all()
    assert (m * izz >= (mx**2 + my**2) * (1 - 1e-14)).all()


def test_outlines_so_wide_that_they_do_not_matter_give_the_cone() -> None:
    small = problem(1, 1.0, impossible(1))
    wide = np.tile([[-50.0, -50.0], [50.0, 50.0]], (4, 1, 1))
    assert solve_links(small, ConeBodies(M, wide)).cost == pytest.approx(
        solve_links(small, ConeBodies(M)).cost, rel=1e-3
    )


def test_the_grid_s_own_masses_are_bodies_of_the_bounded_cone() -> None:
    np.testing.assert_allclose(M @ GRID.moments(), B)
