"""Identification with external wrenches: the truth comes back, on either clock, and what is wrong is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, independent, moving_body, waves

from mocap_id.dynamics.built_in_sensors import fit_sensor
from mocap_id.dynamics.cautions import estimate_gains
from mocap_id.dynamics.consistency import build_grid
from mocap_id.dynamics.fit import fit
from mocap_id.dynamics.identification import Identification, identify
from mocap_id.dynamics.instrument_errors import KinematicError
from mocap_id.dynamics.prediction import estimate_chain_noise, predict
from mocap_id.dynamics.preparation import FitSettings, PreparedTrial, TrialData, prepare
from mocap_id.dynamics.regressor import SEAT, ExternalWrench, planar_regressor, planar_torque_regressor
from mocap_id.geometry import planar

MASS = float(BODY[:, 0].sum())


def push(time: np.ndarray, segment: int, name: str, *, by_plates: bool, late: float = 0.0) -> ExternalWrench:
    """A force of some 250 N that comes and goes at a place that moves, stamped ``late`` s too early."""
    t = time + late + segment  # each in its own time
    force = np.stack([40 * np.sin(1.1 * t), 250 + 150 * np.sin(0.7 * t + 1)], axis=1)
    x, y = 0.4 + 0.1 * np.cos(0.5 * t), 0.5 + 0.05 * np.sin(0.9 * t)
    wrench = np.column_stack([force, x * force[:, 1] - y * force[:, 0]])
    return ExternalWrench(name, segment, wrench, by_plates)


def supported(*pushes: tuple[int, str, bool], late: float = 0.0, seconds: float = 14.0) -> TrialData:
    """A moving body that the ground carries less, by what external wrenches do; the plates stamp ``late`` s early."""
    recorded = moving_body(seconds=seconds, noise=(0.5, 0.5, 0.15))
    time = recorded.time
    noise = recorded.wrench - moving_body(seconds=seconds).wrench
    then = planar_regressor(CENTRES, *waves(time + late, len(CENTRES))) @ BODY.ravel()
    external = tuple(push(time, s, name, by_plates=own, late=late if own else 0.0) for s, name, own in pushes)
    taken = sum(push(time, s, name, by_plates=own, late=late).wrench for s, name, own in pushes)
    return replace(recorded, wrench=then + noise - taken, external=external)


def identified(recorded: TrialData) -> tuple[PreparedTrial, Identification]:
    prepared = prepare(recorded, FitSettings())
    grid = build_grid(CENTRES, np.repeat([0, 1, 2, 3], 2), np.tile([[-0.3, -0.2], [0.3, 1.0]], (4, 1)), (5, 9))
    error = KinematicError.none(3)
    everything = np.ones(len(recorded.time), dtype=bool)
    return prepared, identify(prepared, everything, grid, np.full(16, np.nan), error)


CHAIR, HAND = (2, SEAT, True), (3, "hand", False)


@pytest.mark.parametrize("pushes", [(CHAIR,), (HAND,), (CHAIR, HAND)])
def test_the_body_comes_back_whatever_else_carries_it(pushes: tuple[tuple[int, str, bool], ...]) -> None:
    prepared, found = identified(supported(*pushes))
    truth = prepared.base.regrouping @ BODY.ravel()
    np.testing.assert_allclose(found.base[0], MASS, rtol=2e-4)
    assert np.abs((found.base - truth) / np.maximum(np.abs(truth), 1.0)).max() < 0.01
    blind = identified(replace(prepared.recorded, external=()))[1]
    assert abs(blind.base[0] / MASS - 1) > 0.1


def test_a_sensor_in_a_joint_carries_less_by_what_a_handle_carries() -> None:
    recorded, last = supported(HAND), 3
    rows = planar_regressor(CENTRES, recorded.q, recorded.dq, recorded.ddq)[..., 4 * last :]
    carried = rows @ BODY[last] - recorded.external[0].wrench
    sensor = ExternalWrench("elbow", last, carried, by_plates=False)
    everything = np.ones(len(recorded.time), dtype=bool)
    found = fit_sensor(prepare(recorded, FitSettings()), everything, sensor)
    assert found is not None
    rows, values, _ = found
    np.testing.assert_allclose(values, rows @ BODY.ravel(), rtol=1e-3, atol=1e-3)
    blind = fit_sensor(prepare(replace(recorded, external=()), FitSettings()), everything, sensor)
    assert blind is not None
    assert np.abs(blind[1] - values).max() > 1.0


@pytest.mark.parametrize("late", [-0.04, 0.025])
def test_plates_share_one_clock_and_a_sensor_keeps_its_own(late: float) -> None:
    prepared, found = identified(supported(CHAIR, HAND, late=late))
    assert found.fit.best_offset == pytest.approx(late, abs=2e-4)
    np.testing.assert_allclose(found.base[0], MASS, rtol=3e-4)
    inner = slice(60, -60)
    for each, name in zip(prepared.external(found.fit.offset), (CHAIR, HAND), strict=True):
        truth = push(prepared.recorded.time, name[0], name[1], by_plates=True).wrench
        np.testing.assert_allclose(each[inner], truth[inner], atol=0.1)


def test_the_model_says_what_the_ground_and_the_joints_feel() -> None:
    prepared, found = identified(supported(CHAIR, HAND))
    model = predict(prepared, found, estimate_chain_noise(prepared, found, independent(prepared.recorded)), 20.0)
    recorded, inner = prepared.recorded, slice(5, -5)  # the plates' clock leaves no chair at the very ends
    np.testing.assert_allclose(model.wrench[inner], recorded.wrench[inner], atol=4.0)
    needed = planar_torque_regressor(CENTRES, recorded.q, prepared.regressor) @ BODY.ravel()
    _, origin = planar.segment_poses(recorded.q, CENTRES)
    chair, hand = (each.wrench for each in recorded.external)
    for j, carried in enumerate((chair + hand, chair + hand, hand), start=1):
        x, y = origin[:, j].T
        moment = carried[:, 2] - (x * carried[:, 1] - y * carried[:, 0])
        np.testing.assert_allclose(model.torque[inner, j - 1], (needed[:, j - 1] - moment)[inner], atol=1.0)
        assert np.abs(moment).max() > 50
    loaded = model.wrench[:, 1] > 20
    np.testing.assert_allclose(model.cop[loaded], (model.wrench[:, 2] / model.wrench[:, 1])[loaded])


def test_a_sample_whose_external_wrench_is_unknown_is_not_fitted_and_has_no_ground() -> None:
    recorded = supported(HAND)
    hand = recorded.external[0]
    gap = hand.wrench.copy()
    gap[600:650, 1] = np.nan
    prepared, found = identified(replace(recorded, external=(replace(hand, wrench=gap),)))
    assert not found.fit.in_fit[600:650].any()
    model = predict(prepared, found, estimate_chain_noise(prepared, found, independent(recorded)), 20.0)
    assert np.isnan(model.wrench[600:650]).all()
    assert np.isfinite(model.wrench[700:]).all()
    np.testing.assert_allclose(found.base[0], MASS, rtol=5e-4)


def wrong(recorded: TrialData, factors: tuple[float, float, float]) -> TrialData:
    return replace(recorded, external=tuple(replace(each, wrench=each.wrench * factors) for each in recorded.external))


@pytest.mark.parametrize("pushes", [(CHAIR,), (HAND,)])
@pytest.mark.parametrize("factors", [(1.0, 1.0, 1.0), (-1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (1.0, 1.3, 1.0)])
def test_factors_tell_a_right_wrench_from_a_wrong_one(
    pushes: tuple[tuple[int, str, bool], ...], factors: tuple[float, float, float]
) -> None:
    recorded = wrong(supported(*pushes), factors)
    prepared = prepare(recorded, FitSettings())
    found = estimate_gains(prepared, fit(prepared, np.ones(len(recorded.time), dtype=bool)))
    assert {gain.component for gain in found} == {"Fx", "Fy", "tauz"}
    for gain in found:
        factor = factors[("Fx", "Fy", "tauz").index(gain.component)]
        assert gain.value == pytest.approx(1 / factor, abs=0.02 + 5 * gain.sd)
        assert gain.contradicts == (factor != 1.0)


def test_a_constant_wrench_cannot_be_told_from_the_body_and_is_not_judged() -> None:
    recorded = supported(CHAIR)
    still = np.tile([0.0, 200.0, 90.0], (len(recorded.time), 1))
    prepared = prepare(replace(recorded, external=(ExternalWrench(SEAT, 2, still, True),)), FitSettings())
    assert estimate_gains(prepared, fit(prepared, np.ones(len(recorded.time), dtype=bool))) == ()


def test_a_wrench_in_step_with_the_body_is_not_judged() -> None:
    """Three quarters of all that the body needs, and noise: any factor of it fits as well."""
    recorded = moving_body(seconds=14.0)
    noise = np.random.default_rng(0).normal(size=(2, *recorded.wrench.shape)) * [0.5, 0.5, 0.15]
    chair = ExternalWrench(SEAT, 2, 0.75 * recorded.wrench + noise[0], True)
    shared = replace(recorded, wrench=0.25 * recorded.wrench + noise[1], external=(chair,))
    prepared = prepare(shared, FitSettings())
    assert estimate_gains(prepared, fit(prepared, np.ones(len(recorded.time), dtype=bool))) == ()
