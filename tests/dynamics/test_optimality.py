"""The optimality check: what is optimal passes, what is not does not, and the bound is a bound."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import BODY
from grid_cases import GRID, B, M, impossible, problem

from mocap_id.dynamics.consistency import BodyCone, ConeBodies, GridBodies, check_optimality, solve_links, solve_nnls

CONE, BOUNDED = ConeBodies(M), ConeBodies(M, GRID.boxes())


def solved(bodies: BodyCone, seed: int = 5):
    """A problem that its constraint holds back, and its solution."""
    small = problem(seed, 1.0, impossible(seed))
    answer = solve_nnls(small, B) if isinstance(bodies, GridBodies) else solve_links(small, bodies)
    return small, answer.body


every = pytest.mark.parametrize("bodies", [GridBodies(B), CONE, BOUNDED], ids=["grid", "cone", "bounded"])


@every
def test_a_solution_passes(bodies: BodyCone) -> None:
    small, body = solved(bodies)
    found = check_optimality(small, bodies, body)
    assert found.proven
    assert found.primal <= 1e-12
    assert found.stationarity == 0.0


@every
@pytest.mark.parametrize("size", [1e-3, 1e-2, 0.1])
def test_a_perturbed_solution_does_not(bodies: BodyCone, size: float) -> None:
    """Whichever way it is moved within the cone; and the bound covers what was lost."""
    small, body = solved(bodies)
    least = small.cost(bodies.mapping @ body)
    rng = np.random.default_rng(0)
    heaviest = int(np.argmax(body))
    missing = body.copy()
    if isinstance(bodies, GridBodies):
        missing[heaviest] = (1 - size) * body[heaviest]
    else:
        missing[-4:] = (1 - size) * body[-4:]
    others = [body * (1 + size), body * (1 - size), missing]
    if isinstance(bodies, GridBodies):
        others.append(body + size * rng.exponential(0.1, len(body)))
    for moved in others:
        found = check_optimality(small, bodies, moved)
        lost = small.cost(bodies.mapping @ moved) / least - 1
        assert lost > 0
        assert not found.proven
        assert found.excess >= lost * least / small.cost(bodies.mapping @ moved) * (1 - 1e-9)


def test_a_negative_mass_does_not_pass() -> None:
    small = problem(5, 1.0, impossible(5))
    bodies = GridBodies(B)
    _, body = solved(bodies)
    body = body.copy()
    body[np.argmin(body)] = -1e-6
    assert check_optimality(small, bodies, body).primal > 0
    assert not check_optimality(small, bodies, body).proven
    free = np.linalg.lstsq(B, small.free_solution(), rcond=None)[0]
    found = check_optimality(small, bodies, free)  # the least cost of all, by masses of either sign
    assert found.excess < 1e-12
    assert not found.proven


@pytest.mark.parametrize("bodies", [CONE, BOUNDED], ids=["cone", "bounded"])
def test_links_that_cannot_exist_do_not_pass(bodies: ConeBodies) -> None:
    small, body = solved(bodies)
    for parameter, value in ((7, 0.9 * body[7]), (12, -1e-3), (13, body[13] + 3.0)):
        moved = body.copy()
        moved[parameter] = value
        assert bodies.measure_violation(moved) > 1e-6
        assert not check_optimality(small, bodies, moved).proven


def test_a_mass_outside_the_box_is_outside_the_bounded_cone_alone() -> None:
    body = BODY.ravel().copy()
    assert CONE.measure_violation(body) == BOUNDED.measure_violation(body) == 0.0
    m, x, y = 5.0, 0.0, 3.0  # added three metres up the shank
    body[4:8] += [m, m * x, m * y, m * (x * x + y * y)]
    assert CONE.measure_violation(body) == 0.0
    assert BOUNDED.measure_violation(body) > 0.1


def test_nothing_is_no_solution_where_mass_would_help() -> None:
    """With no mass to compare with the bound says nothing: the best single mass does."""
    small = problem(5, 1.0)
    for bodies in (GridBodies(B), CONE, BOUNDED):
        found = check_optimality(small, bodies, np.zeros(bodies.mapping.shape[1]))
        assert found.dual > 1e-2
        assert found.complementarity == 0.0


def test_free_parameters_have_to_be_stationary() -> None:
    small = problem(5, 1.0, nuisance=1)
    masses = solve_nnls(small.eliminate_others(11), B).body
    best = small.complete(B @ masses)
    assert check_optimality(small, GridBodies(B), masses, best[11:]).proven
    found = check_optimality(small, GridBodies(B), masses, best[11:] + 0.1)
    assert found.stationarity > 1e-4
    assert not found.proven


def test_not_a_number_is_no_solution() -> None:
    small = problem(5, 1.0)
    body = np.full(B.shape[1], np.nan)
    found = check_optimality(small, GridBodies(B), body)
    assert np.isinf(found.excess)
    assert not found.proven


def test_prices_are_least_where_the_cone_says() -> None:
    """Against a dense search over the box."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        prices = rng.normal(size=16) * np.tile([0.1, 1, 1, 2], 4)
        points = BOUNDED.find_cheapest(prices)
        for k, (low, high) in enumerate(GRID.boxes()):
            x, y = np.meshgrid(*(np.linspace(low[i], high[i], 101) for i in (0, 1)))
            m, mx, my, izz = prices[4 * k : 4 * k + 4]
            least = (m + mx * x + my * y + izz * (x * x + y * y)).min()
            assert prices @ points[:, k] <= least + 1e-12
            assert prices @ points[:, k] == pytest.approx(least, abs=1e-3)
            assert BOUNDED.measure_violation(points[:, k]) < 1e-12
