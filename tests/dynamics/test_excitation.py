"""How much a movement tells of each parameter, and whether the movement that is recommended keeps its promise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from excitation_cases import EXACT, SLIDING, identified, recorded

from mocap_id.design.recommendation import FACTOR, Recommendation, recommend_changes
from mocap_id.dynamics.excitation import LOST, WEAK
from mocap_id.dynamics.kinematic_error import KinematicError

SMALL = np.array([1.0, 0.4, 0.05])


def test_the_own_part_is_what_a_regression_on_the_others_leaves() -> None:
    _, found, told = identified(recorded(np.array([1.0, 1.0, 0.3])))
    rows = found.fit.design.reshape(-1, found.fit.design.shape[-1])
    for i in range(found.fit.base):
        others = np.delete(rows, i, axis=1)
        left = rows[:, i] - others @ np.linalg.lstsq(others, rows[:, i], rcond=None)[0]
        assert told.own[i] == pytest.approx(np.linalg.norm(left), rel=1e-6)
        assert told.share[i] == pytest.approx(np.linalg.norm(left) / np.linalg.norm(rows[:, i]), rel=1e-6)


def test_the_standard_deviation_falls_as_the_own_part_grows() -> None:
    """Their product is the same for all parameters: how much the filtered noise is correlated, and chance."""
    _, found, told = identified(recorded(SMALL))
    product = np.sqrt(np.diag(found.residual_covariance)) * told.own
    assert np.ptp(np.log(told.own)) > np.log(10)
    assert np.ptp(np.log(product)) < np.log(2)


def test_standing_follows_the_stated_rules() -> None:
    _, found, told = identified(recorded(0.3 * SMALL, noise=(150.0, 150.0, 50.0)))
    assert set(told.verdict) == {"known", "weak", "not identifiable"}
    for verdict, relative in zip(told.verdict, told.relative_sd, strict=True):
        expected = "not identifiable" if relative > LOST else "weak" if relative > WEAK else "known"
        assert verdict == expected
    np.testing.assert_allclose(told.relative_sd * told.size, found.base_sd)


def test_a_body_that_moves_all_over_is_known() -> None:
    _, _, told = identified(recorded(np.ones(3)))
    assert set(told.verdict) == {"known"}
    assert told.doubtful == ()


def test_without_excitation_a_parameter_is_not_identifiable() -> None:
    """The last joint shivers by a ten-thousandth of the others' arc: its inertia has hardly a column of its own."""
    _, _, told = identified(recorded(np.array([1.0, 1.0, 1e-4]), noise=(10.0, 10.0, 3.0)))
    assert told.verdict[told.names.index("I4")] == "not identifiable"
    assert told.share[told.names.index("I4")] < 1e-3


@pytest.mark.parametrize("error", [EXACT, SLIDING], ids=["noise", "noise and sliding skin"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_recommended_movement_keeps_its_promise(error: KinematicError, seed: int) -> None:
    """Record it: every standard deviation falls, and about as far as was promised."""
    noise = (5.0, 5.0, 2.0)
    prepared, before, _ = identified(recorded(SMALL, seed=seed, noise=noise), error)
    after: dict[tuple[str, int | None], np.ndarray] = {}
    checked = []
    for i, advice in enumerate(recommend_changes(prepared, before)):
        if advice is None or advice.change == "alone":
            continue
        more = np.where(np.arange(3) == advice.joint if advice.joint is not None else np.ones(3, bool), FACTOR, 1.0)
        size, speed = (SMALL, more) if advice.change == "faster" else (SMALL * more, 1.0)
        key = (advice.change, advice.joint)
        if key not in after:
            after[key] = identified(recorded(size, speed, seed, noise), error)[1].base_sd
        checked.append((after[key][i] / before.base_sd[i], advice.ratio))
    found, promised = np.array(checked).T
    off = np.abs(np.log(found / promised))
    assert len(found) >= 3
    assert np.all(found < 1.0)
    assert np.median(off) < np.log(1.3 if error is EXACT else 1.6)
    assert np.max(off) < np.log(2 if error is EXACT else 2.5)


def test_the_joint_that_hardly_moves_is_the_one_to_move() -> None:
    prepared, found, told = identified(recorded(SMALL))
    advice = recommend_changes(prepared, found)[told.names.index("I4")]
    assert advice is not None
    assert advice.joint in (None, 2)


def test_where_no_movement_helps_none_is_recommended() -> None:
    """The zero of the plate is no business of the movement's."""
    prepared, found, _ = identified(recorded(np.ones(3), noise=(1e-3, 1e-3, 1e-3)))
    assert recommend_changes(prepared, replace(found, covariance=found.covariance + np.eye(11))) == (None,) * 11


def test_in_words() -> None:
    joints = ("ankle", "knee", "hip")
    assert Recommendation("faster", None, 0.5).describe(joints) == "the whole movement 1.5 times faster"
    assert Recommendation("larger", 2, 0.5).describe(joints) == "the hip's movement 1.5 times larger"
    assert (
        Recommendation("faster", 2, 0.5).describe(joints)
        == "the hip's movement 1.5 times faster, out of step with the others,"
    )
    assert Recommendation("alone", 0, 0.5).describe(joints).startswith("the ankle's movement by itself")
