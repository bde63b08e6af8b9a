"""Identification of a robot in space on a plate, from true kinematics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from space_cases import SIX, identified, record, robot, true_base

from mocap_id.dynamics.fit import determines_parameters
from mocap_id.dynamics.space.identification import (
    BaseEstimate,
    SpatialIdentification,
    identify_parameters_in_space,
    identify_payload,
    make_exact,
    measure_excitation_in_space,
    predict_in_space,
)
from mocap_id.dynamics.space.preparation import prepare_in_space, shift_wrench
from mocap_id.geometry import se3, so3


def everywhere(trial: object) -> np.ndarray:
    return np.ones(len(trial.time), dtype=np.bool_)  # type: ignore[attr-defined]


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_exact_instruments_give_exact_parameters(joints: int) -> None:
    trial, (prepared, found) = robot(5, "clean", joints), identified(5, "clean", joints)
    np.testing.assert_allclose(found.base, true_base(trial, prepared), atol=2e-4)
    assert abs(found.fit.best_offset) < 1e-4
    assert set(measure_excitation_in_space(prepared, found).verdict) == {"known"}
    model = predict_in_space(prepared, found)
    inside = found.fit.in_fit
    np.testing.assert_allclose(model.wrench[inside], trial.wrench[inside], atol=5e-3)
    np.testing.assert_allclose(model.torque[inside], trial.torque[inside], atol=5e-3)


def test_intervals_contain_the_truth() -> None:
    inside, error = [], []
    for seed in range(3):
        trial, (prepared, found) = robot(seed), identified(seed)
        true = true_base(trial, prepared)
        inside.append(np.abs(found.base - true) < 1.96 * found.base_sd)
        error.append(np.linalg.norm(found.base - true) / np.linalg.norm(true))
        assert abs(found.fit.best_offset - trial.clock_offset) < 5 * found.offset_sd + 1e-4
    assert np.mean(inside) >= 0.8
    assert max(error) < 0.03


def test_a_wrong_zero_of_horizontal_forces_changes_no_parameter() -> None:
    trial = robot(1)
    recorded = record(trial)
    plate, zero = recorded.base[:3, 3] - [0.02, 0.1, 0.03], np.array([8.0, 0.0, -5.0])
    plain, shifted = (
        identify_parameters_in_space(
            prepare_in_space(replace(recorded, plate=plate, wrench=recorded.wrench + error), SIX),
            everywhere(trial),
            trial.options.errors,
        )
        for error in (np.zeros(6), np.concatenate([zero, np.cross(plate, zero)]))
    )
    np.testing.assert_allclose(shifted.base, plain.base, atol=1e-5)
    np.testing.assert_allclose(shifted.plate_bias - plain.plate_bias, [8.0, -5.0, 0.0], atol=1e-5)


def test_torques_lie_within_their_intervals() -> None:
    trial, (prepared, found) = robot(1), identified(1)
    model = predict_in_space(prepared, found)
    off = np.abs(model.torque - trial.torque)[found.fit.in_fit] / model.torque_sd[found.fit.in_fit]
    assert np.mean(off < 1.96) > 0.8
    assert np.mean(off) > 0.1


def test_a_joint_at_rest_is_not_identifiable() -> None:
    trial = robot(2, "clean")
    recorded = record(trial)
    still = np.repeat(recorded.rotation[:1], len(recorded.time), axis=0)
    zeros = np.zeros_like(recorded.omega)
    resting = recorded.__class__(**{**vars_of(recorded), "rotation": still, "omega": zeros, "alpha": zeros})
    assert determines_parameters(prepare_in_space(recorded, SIX), everywhere(trial))
    assert not determines_parameters(prepare_in_space(resting, SIX), everywhere(trial))


def vars_of(recorded: object) -> dict[str, object]:
    return {name: getattr(recorded, name) for name in recorded.__dataclass_fields__}  # type: ignore[attr-defined]


def test_a_turned_and_shifted_laboratory_changes_nothing() -> None:
    trial, (_, found) = robot(3), identified(3)
    turn, shift = so3.exp(np.array([0.0, 1.1, 0.0])), np.array([2.0, 0.3, -1.0])
    recorded = record(trial)
    moved = recorded.__class__(
        **{
            **vars_of(recorded),
            "base": se3.pose(turn, shift) @ recorded.base,
            "plate": turn @ recorded.plate + shift,
            "rotation": turn @ recorded.rotation,
            "omega": recorded.omega @ turn.T,
            "alpha": recorded.alpha @ turn.T,
            "wrench": np.hstack([recorded.wrench[:, :3] @ turn.T, recorded.wrench[:, 3:] @ turn.T])
            @ shift_wrench(shift).T,
        }
    )
    again = identify_parameters_in_space(prepare_in_space(moved, SIX), everywhere(trial), make_exact())
    of_segments = prepare_in_space(recorded, SIX).base.kept >= 10
    sd = np.sqrt(np.diag(found.residual_covariance))
    assert np.abs((again.base - found.base) / sd)[of_segments].max() < 1.0  # only the weights of x and z differ
    assert again.base[0] == pytest.approx(found.base[0], abs=1e-2)


def estimate(found: SpatialIdentification) -> BaseEstimate:
    modes = np.array([change[: len(found.base)] for _, change, _, _ in found.modes])
    return found.base, found.unit_covariance, found.residual_covariance, modes


def test_the_difference_of_two_trials_is_the_payload() -> None:
    empty, loaded = identified(4), identified(4, payload=2.0)
    trial = robot(4, payload=2.0)
    found = identify_payload(loaded[0].structure.mapping, estimate(loaded[1]), estimate(empty[1]), segment=2)
    off = np.abs(found.value - trial.robot.payload) / found.sd
    assert np.mean(off < 3) >= 0.9
    assert found.value[0] == pytest.approx(2.0, abs=0.05)
    assert found.sd[0] < 0.05
    place, sd = found.centre()
    assert np.all(np.abs(place - trial.robot.payload[1:4] / 2.0) < 3 * sd)
    assert sd.max() < 0.02


def test_a_payload_of_another_chain_is_refused() -> None:
    with pytest.raises(ValueError, match="same chain"):
        other = estimate(identified(5, "clean", 3)[1])
        identify_payload(identified(4)[0].structure.mapping, estimate(identified(4)[1]), other, segment=2)


def test_a_payload_on_one_hinge_is_only_known_in_part() -> None:
    empty, loaded = identified(6, joints=1), identified(6, joints=1, payload=2.0)
    found = identify_payload(loaded[0].structure.mapping, estimate(loaded[1]), estimate(empty[1]), segment=1)
    assert 0 < np.isfinite(found.value).sum() < 10
