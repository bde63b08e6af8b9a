"""The point-mass grid and its solvers: consistent by construction, optimal by proof, faithful to the data."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES

from mocap_id.dynamics import solve
from mocap_id.dynamics.base import structural_base
from mocap_id.dynamics.grid import PointGrid, segment_grid
from mocap_id.dynamics.solve import Compressed, fit_masses, kkt_gap, spread_masses
from mocap_id.errors import NumericalError

SEGMENT = np.repeat([0, 1, 2, 3], 4)
LOCAL = np.array(
    [
        *([-0.25, 0.02], [0.05, 0.03], [-0.2, 0.05], [-0.02, 0.08]),
        *([-0.06, 0.05], [0.06, 0.2], [-0.05, 0.4], [0.05, 0.35]),
        *([-0.08, 0.05], [0.08, 0.2], [-0.07, 0.38], [0.08, 0.3]),
        *([-0.12, 0.1], [0.12, 0.3], [-0.1, 0.5], [0.05, 0.85]),
    ]
)
GRID = segment_grid(CENTRES, SEGMENT, LOCAL)
BASE = structural_base(CENTRES)
B = BASE.regrouping @ GRID.moments()


def problem(seed: int, noise: float, base: np.ndarray | None = None, nuisance: int = 0) -> Compressed:
    """A well-posed least-squares problem around some base parameters."""
    rng = np.random.default_rng(seed)
    truth = BASE.regrouping @ BODY.ravel() if base is None else base
    rows = (
        rng.normal(size=(600, len(truth) + nuisance))
        * np.r_[10 ** rng.uniform(-0.5, 0.5, len(truth)), np.ones(nuisance)]
    )
    target = rows @ np.r_[truth, np.full(nuisance, 3.0)] + noise * rng.normal(size=600)
    return Compressed.of(rows, target)


def test_moments_of_a_point() -> None:
    grid = PointGrid(np.array([0, 1]), np.array([[0.3, -0.2], [0.1, 0.5]]), 2)
    expected = np.zeros((8, 2))
    expected[:4, 0], expected[4:, 1] = [1, 0.3, -0.2, 0.13], [1, 0.1, 0.5, 0.26]
    np.testing.assert_allclose(grid.moments(), expected)


def test_grid_holds_joints_and_markers_of_every_segment() -> None:
    for k in range(4):
        points = GRID.position[GRID.segment == k]
        known = np.vstack([[0.0, 0.0], LOCAL[k == SEGMENT], CENTRES[k : k + 1]])
        assert (points.min(axis=0) < known.min(axis=0)).all()
        assert (points.max(axis=0) > known.max(axis=0)).all()
        assert len(points) == 45


def test_any_masses_on_the_grid_are_a_body_that_can_exist() -> None:
    masses = np.random.default_rng(0).exponential(size=len(GRID.segment))
    m, mx, my, inertia = (GRID.moments() @ masses).reshape(-1, 4).T
    assert (m * inertia >= mx**2 + my**2).all()


def test_the_reference_person_is_on_the_grid() -> None:
    solution = fit_masses(problem(0, 0.0), B)
    np.testing.assert_allclose(solution.parameters, BASE.regrouping @ BODY.ravel(), rtol=1e-4, atol=1e-4)
    assert solution.price < 1e-5


@pytest.mark.parametrize("seed", range(20))
def test_both_solvers_agree_and_are_optimal(seed: int) -> None:
    """Half of the problems have bodies that cannot exist at their free optimum."""
    rng = np.random.default_rng(100 + seed)
    base = BASE.regrouping @ BODY.ravel()
    if seed % 2:
        base = base * rng.uniform(0.3, 1.7, len(base))
    solution = fit_masses(problem(seed, 2.0, base), B)
    assert solution.solver == "osqp"
    assert solution.kkt < 1e-6
    assert -1e-9 < solution.disagreement < 1e-6
    assert (solution.masses >= 0).all()
    np.testing.assert_allclose(solution.parameters, B @ solution.masses, rtol=1e-12, atol=1e-12)
    assert (solution.price > 0.01) == bool(seed % 2)


def test_a_nuisance_parameter_stays_free() -> None:
    solution = fit_masses(problem(3, 0.1, nuisance=1), B)
    assert solution.parameters[-1] == pytest.approx(3.0, abs=0.03)
    negative = problem(3, 0.1, nuisance=1)
    flipped = Compressed(negative.factor * np.r_[np.ones(11), -1.0], negative.target, negative.rest)
    assert fit_masses(flipped, B).parameters[-1] == pytest.approx(-3.0, abs=0.03)


def test_the_check_sees_a_solution_that_is_off() -> None:
    small = problem(5, 1.0)
    masses = fit_masses(small, B).masses
    assert kkt_gap(small, B, masses) < 1e-3
    assert kkt_gap(small, B, 1.001 * masses) > 1e-2
    moved = masses.copy()
    moved[np.argmax(masses)] = 0.0
    assert kkt_gap(small, B, moved) > 1e-2


def test_a_bad_answer_of_osqp_is_replaced_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    small = problem(6, 1.0)
    good = fit_masses(small, B)
    monkeypatch.setattr(solve, "_osqp_split", lambda *_: (np.full(B.shape[1], 0.4), "solved", 1))
    replaced = fit_masses(small, B)
    assert (good.solver, replaced.solver) == ("osqp", "nnls")
    assert replaced.disagreement > 1
    assert small.cost(replaced.parameters) == pytest.approx(small.cost(good.parameters), rel=1e-6)


def test_two_bad_answers_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solve, "_osqp_split", lambda *_: (np.full(B.shape[1], 0.4), "solved", 1))
    monkeypatch.setattr(solve, "_non_negative", lambda *_: np.full(B.shape[1], 0.3))
    with pytest.raises(NumericalError, match="did not converge"):
        fit_masses(problem(6, 1.0), B)


@pytest.mark.parametrize("aim", ["none", "person"])
def test_spreading_leaves_the_base_parameters_alone(aim: str) -> None:
    base = fit_masses(problem(7, 0.1), B).parameters
    moments = GRID.moments()
    target = BODY.ravel() if aim == "person" else np.full(16, np.nan)
    scale = np.maximum(0.15 * np.abs(BODY.ravel()), 0.01)
    masses = spread_masses(B, base, moments, target, scale)
    assert (masses >= 0).all()
    np.testing.assert_allclose(BASE.regrouping @ (moments @ masses), base, atol=1e-6)
    if aim == "person":  # the masses that the wrench cannot see come out at the reference's
        np.testing.assert_allclose((moments @ masses)[::4], BODY[:, 0], rtol=0.05)


def test_compression_keeps_solution_and_cost() -> None:
    rng = np.random.default_rng(0)
    rows, target = rng.normal(size=(300, 5)), rng.normal(size=300)
    expected, cost, *_ = np.linalg.lstsq(rows, target, rcond=None)
    small = Compressed.of(rows, target)
    np.testing.assert_allclose(small.free_solution(), expected, atol=1e-12)
    assert small.cost(expected) == pytest.approx(float(cost[0]))
    assert small.cost(expected + 0.1) == pytest.approx(float(np.sum((rows @ (expected + 0.1) - target) ** 2)))
