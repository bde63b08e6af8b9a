"""The grid of point masses: consistent by construction, shaped by the skeleton; spread without touching the fit."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES
from grid_cases import BASE, GRID, LOCAL, NO_REFERENCE, SEGMENT, B, M, problem

from mocap_id.dynamics.consistency import PointGrid, build_grid, solve_nnls, spread_masses
from mocap_id.dynamics.priors import compute_reference_sd


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
        np.testing.assert_array_equal(GRID.boxes()[k], [points.min(axis=0), points.max(axis=0)])


def test_a_grid_has_more_points_along_a_segment_than_across() -> None:
    lying = build_grid(np.array([[0.5, 0.0]]), np.array([1]), np.array([[0.4, 0.05]]), (3, 7))
    for k, axis in ((0, 0), (1, 0)):
        points = lying.position[lying.segment == k]
        assert len(np.unique(points[:, axis])) == 7
        assert len(np.unique(points[:, 1 - axis])) == 3


def test_any_masses_on_the_grid_are_a_body_that_can_exist() -> None:
    masses = np.random.default_rng(0).exponential(size=len(GRID.segment))
    m, mx, my, inertia = (GRID.moments() @ masses).reshape(-1, 4).T
    assert (m * inertia >= mx**2 + my**2).all()


@pytest.mark.parametrize("aim", ["none", "person"])
def test_spreading_leaves_the_base_parameters_alone(aim: str) -> None:
    fitted = solve_nnls(problem(7, 0.1), B).body
    moments = GRID.moments()
    target = BODY.ravel() if aim == "person" else NO_REFERENCE
    masses = spread_masses(B, fitted, moments, target, compute_reference_sd(target, 0.15))
    assert (masses >= 0).all()
    np.testing.assert_allclose(M @ (moments @ masses), B @ fitted, atol=1e-6)
    if aim == "person":  # the masses that the wrench cannot see come out at the reference's
        np.testing.assert_allclose((moments @ masses)[::4], BODY[:, 0], rtol=0.05)


def test_masses_are_spread_where_the_first_base_parameter_is_no_mass() -> None:
    """Of the moment alone the total mass is unknown; the spread must keep to what was fitted all the same."""
    kept = BASE.kept[1:]
    rows = M[1:]
    moments, fitted = rows @ GRID.moments(), np.random.default_rng(3).exponential(0.4, len(GRID.segment))
    assert (moments @ fitted)[0] < 0.0
    assert kept[0] == 1
    masses = spread_masses(moments, fitted, GRID.moments(), NO_REFERENCE, NO_REFERENCE)
    np.testing.assert_allclose(moments @ masses, moments @ fitted, atol=1e-6)
    assert np.sum(masses**2) < np.sum(fitted**2)
