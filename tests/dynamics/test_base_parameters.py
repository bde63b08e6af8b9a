"""Base parameters: eq. 6.1 in symbols, the ranks, and the laws of the regrouping."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, random_chain, waves

from mocap_id.dynamics.regressor import (
    BaseSet,
    base_names,
    determines_rows,
    list_base_units,
    name_parameters,
    planar_regressor,
    planar_torque_regressor,
    regroup_columns,
    structural_base,
)

EQUATION_6_1 = (
    "m1+m2+m3+m4",
    "mx1+p2x*(m2+m3+m4)",
    "mx2+p3x*(m3+m4)",
    "my2+p3y*(m3+m4)",
    "I2+(p3x^2+p3y^2)*(m3+m4)",
    "mx3+p4x*m4",
    "my3+p4y*m4",
    "I3+(p4x^2+p4y^2)*m4",
    "mx4",
    "my4",
    "I4",
)


def moving_rows(centres: np.ndarray, components: tuple[int, ...] = (0, 1, 2)) -> np.ndarray:
    regressor = planar_regressor(centres, *waves(np.linspace(0, 5, 400), len(centres)))
    return regressor[:, list(components), :].reshape(-1, regressor.shape[-1])


@pytest.mark.parametrize("centres", [CENTRES, random_chain(np.random.default_rng(1), 3)], ids=["straight", "crooked"])
def test_foot_shank_thigh_torso_has_the_thesis_s_eleven(centres: np.ndarray) -> None:
    base = regroup_columns(moving_rows(centres))
    assert base_names(base, centres) == EQUATION_6_1
    assert list_base_units(base) == ("kg", "kg*m", *3 * ("kg*m", "kg*m", "kg*m^2"))


def test_their_values_are_those_of_the_equation() -> None:
    m, mx, my, inertia = BODY.T
    p = CENTRES
    beyond = [m[1:].sum(), m[2:].sum(), m[3]]
    expected = [m.sum(), mx[0] + p[0, 0] * beyond[0]]
    for k in (1, 2):
        expected += [mx[k] + p[k, 0] * beyond[k], my[k] + p[k, 1] * beyond[k], inertia[k] + p[k] @ p[k] * beyond[k]]
    expected += [mx[3], my[3], inertia[3]]
    base = regroup_columns(moving_rows(CENTRES))
    np.testing.assert_allclose(base.regrouping @ BODY.ravel(), expected, rtol=1e-12)


@pytest.mark.parametrize(("components", "rank"), [((0, 1, 2), 11), ((1, 2), 11), ((2,), 10), ((0, 2), 10), ((0, 1), 7)])
def test_rank_by_components(components: tuple[int, ...], rank: int) -> None:
    assert len(regroup_columns(moving_rows(CENTRES, components)).kept) == rank
    assert np.linalg.matrix_rank(moving_rows(CENTRES, components), tol=1e-9) == rank


@pytest.mark.parametrize("joints", [1, 2, 3, 5])
def test_regrouping_law(joints: int) -> None:
    centres = random_chain(np.random.default_rng(joints), joints)
    rows = moving_rows(centres)
    base = regroup_columns(rows)
    assert len(base.kept) == 2 + 3 * joints
    np.testing.assert_allclose(rows[:, base.kept] @ base.regrouping, rows, atol=1e-10 * np.abs(rows).max())
    np.testing.assert_array_equal(base.regrouping[:, base.kept], np.eye(len(base.kept)))


@pytest.mark.parametrize("joints", [1, 3, 5])
def test_torques_lie_in_the_row_space_of_the_base_parameters(joints: int) -> None:
    """What the wrench does not feel, the joints do not: the full parameters are not needed for the torques."""
    centres = random_chain(np.random.default_rng(joints), joints)
    q, dq, ddq = waves(np.linspace(0, 3, 50), joints)
    regressor = planar_regressor(centres, q, dq, ddq)
    torque = planar_torque_regressor(centres, q, regressor)
    base = structural_base(centres)
    np.testing.assert_allclose(torque[:, :, base.kept] @ base.regrouping, torque, atol=1e-9 * np.abs(torque).max())


def outside(rows: np.ndarray, base: BaseSet) -> float:
    """What the base parameters do not decide of all the rows, of the largest entry."""
    known = rows[np.isfinite(rows).all(axis=1)]
    return float(np.abs(known[:, base.kept] @ base.regrouping - known).max() / np.abs(known).max())


@pytest.mark.parametrize("moving", [slice(None), slice(9_000, 9_060)], ids=["all the time", "half a second in all"])
@pytest.mark.parametrize("components", [(0, 1, 2), (1, 2), (2,), (0, 2), (0, 1), (1,)], ids=str)
def test_a_thousand_rows_tell_what_all_of_a_long_trial_do(components: tuple[int, ...], moving: slice) -> None:
    """Nothing is between: outside the span by a hundredth at least, or by rounding."""
    states = [np.zeros((20_000, 3)) for _ in range(3)]
    for state, wave in zip(states, waves(np.linspace(0, 166, 20_000), 3), strict=True):
        state[moving] = wave[moving]
    regressor = planar_regressor(CENTRES, *states)
    base = regroup_columns(regressor[:, list(components)].reshape(-1, 16))
    regressor[400:700] = np.nan
    rows = np.concatenate([regressor, planar_torque_regressor(CENTRES, states[0], regressor)], axis=1)
    for each in np.moveaxis(rows, 1, 0):
        off = outside(each, base)
        assert off < 1e-10 or off > 1e-2
        assert determines_rows(each, base) == (off < 1e-10)


def test_structure_is_that_of_a_moving_trial() -> None:
    base, moving = structural_base(CENTRES), regroup_columns(moving_rows(CENTRES))
    np.testing.assert_array_equal(base.kept, moving.kept)
    np.testing.assert_allclose(base.regrouping, moving.regrouping, atol=1e-9)


def test_another_order_of_the_columns_is_another_set() -> None:
    rows = moving_rows(CENTRES)
    backwards = regroup_columns(rows[:, ::-1])
    assert len(backwards.kept) == 11
    assert set(rows.shape[1] - 1 - backwards.kept) != set(regroup_columns(rows).kept)


def test_a_joint_at_rest_leaves_fewer_parameters_and_numbers_in_their_names() -> None:
    q, dq, ddq = (state.copy() for state in waves(np.linspace(0, 5, 300), 3))
    q[:, 2], dq[:, 2], ddq[:, 2] = 0.3, 0.0, 0.0
    rows = planar_regressor(CENTRES, q, dq, ddq).reshape(-1, 16)
    base = regroup_columns(rows)
    assert len(base.kept) == 8
    np.testing.assert_allclose(rows[:, base.kept] @ base.regrouping, rows, atol=1e-10 * np.abs(rows).max())
    assert any("*mx4" in name for name in base_names(base, CENTRES))


def test_an_ankle_that_hardly_moves_keeps_the_rank() -> None:
    """The numerical zero measures rank, not excitation."""
    q, dq, ddq = (state.copy() for state in waves(np.linspace(0, 5, 300), 3))
    for state in (q, dq, ddq):
        state[:, 0] *= 0.01
    assert len(regroup_columns(planar_regressor(CENTRES, q, dq, ddq).reshape(-1, 16)).kept) == 11


def test_names_of_the_full_parameters_count_from_the_base_as_one() -> None:
    assert name_parameters(2) == ("m1", "mx1", "my1", "I1", "m2", "mx2", "my2", "I2")
