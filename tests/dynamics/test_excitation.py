"""Excitation of each parameter, and the accuracy of the recommended changes of a movement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from excitation_cases import EXACT, SLIDING, identified, recorded

from mocap_id.design.proposal import FACTOR, Recommendation, recommend_changes
from mocap_id.dynamics.cautions import NOT_IDENTIFIABLE, WEAK
from mocap_id.dynamics.instrument_errors import KinematicError

SMALL = np.array([1.0, 0.4, 0.05])


def test_the_own_part_is_the_residual_of_a_regression_on_the_others() -> None:
    _, found, excited = identified(recorded(np.array([1.0, 1.0, 0.3])))
    rows = found.fit.design.reshape(-1, found.fit.design.shape[-1])
    for i in range(found.fit.base):
        others = np.delete(rows, i, axis=1)
        left = rows[:, i] - others @ np.linalg.lstsq(others, rows[:, i], rcond=None)[0]
        assert excited.own[i] == pytest.approx(np.linalg.norm(left), rel=1e-6)
        assert excited.share[i] == pytest.approx(np.linalg.norm(left) / np.linalg.norm(rows[:, i]), rel=1e-6)


def test_the_standard_deviation_falls_as_the_own_part_grows() -> None:
    """Their product is similar for all parameters; it depends on the correlation of the filtered noise."""
    _, found, excited = identified(recorded(SMALL))
    product = np.sqrt(np.diag(found.residual_covariance)) * excited.own
    assert np.ptp(np.log(excited.own)) > np.log(10)
    assert np.ptp(np.log(product)) < np.log(2)


def test_classification_follows_the_stated_rules() -> None:
    _, found, excited = identified(recorded(0.3 * SMALL, noise=(150.0, 150.0, 50.0)))
    assert set(excited.verdict) == {"known", "weak", "not identifiable"}
    for verdict, relative in zip(excited.verdict, excited.relative_sd, strict=True):
        expected = "not identifiable" if relative > NOT_IDENTIFIABLE else "weak" if relative > WEAK else "known"
        assert verdict == expected
    np.testing.assert_allclose(excited.relative_sd * excited.size, found.base_sd)


def test_a_body_that_moves_in_all_joints_is_known() -> None:
    _, _, excited = identified(recorded(np.ones(3)))
    assert set(excited.verdict) == {"known"}
    assert excited.doubtful == ()


def test_without_excitation_a_parameter_is_not_identifiable() -> None:
    """The last joint moves by a ten-thousandth of the others' arc, so the own part of its inertia is very small."""
    _, _, excited = identified(recorded(np.array([1.0, 1.0, 1e-4]), noise=(10.0, 10.0, 3.0)))
    assert excited.verdict[excited.names.index("I4")] == "not identifiable"
    assert excited.share[excited.names.index("I4")] < 1e-3


@pytest.mark.parametrize("error", [EXACT, SLIDING], ids=["noise", "noise and sliding skin"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_recommended_movement_has_the_predicted_deviations(error: KinematicError, seed: int) -> None:
    """Every standard deviation of the recorded movement decreases, about as predicted."""
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
    found, predicted = np.array(checked).T
    off = np.abs(np.log(found / predicted))
    assert len(found) >= 3
    assert np.all(found < 1.0)
    assert np.median(off) < np.log(1.3 if error is EXACT else 1.6)
    assert np.max(off) < np.log(2 if error is EXACT else 2.5)


def test_the_joint_that_hardly_moves_is_the_one_to_move() -> None:
    prepared, found, excited = identified(recorded(SMALL))
    advice = recommend_changes(prepared, found)[excited.names.index("I4")]
    assert advice is not None
    assert advice.joint in (None, 2)


def test_no_recommendation_if_no_movement_helps() -> None:
    """No movement reduces the error of the plate's zero."""
    prepared, found, _ = identified(recorded(np.ones(3), noise=(1e-3, 1e-3, 1e-3)))
    assert recommend_changes(prepared, replace(found, covariance=found.covariance + np.eye(11))) == (None,) * 11


def test_descriptions() -> None:
    joints = ("ankle", "knee", "hip")
    assert Recommendation("faster", None, 0.5).describe(joints) == "the whole movement 1.5 times faster"
    assert Recommendation("larger", 2, 0.5).describe(joints) == "the hip's movement 1.5 times larger"
    assert (
        Recommendation("faster", 2, 0.5).describe(joints)
        == "the hip's movement 1.5 times faster, independently of the other joints,"
    )
    assert Recommendation("alone", 0, 0.5).describe(joints).startswith("the ankle's movement by itself")
