"""Parameters recovered from simulated recordings with exact truth, and what a trial must survive."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, independent, moving_body

from mocap_id.design.proposal import describe_recommendations, recommend_if_doubtful
from mocap_id.dynamics.cautions import find_cautions, measure_excitation
from mocap_id.dynamics.consistency import Optimality, build_grid
from mocap_id.dynamics.fit import determines_parameters, fit, select_samples
from mocap_id.dynamics.identification import Identification, identify
from mocap_id.dynamics.instrument_errors import KinematicError, PlanarCalibration
from mocap_id.dynamics.prediction import agreement, centre_of_pressure, estimate_chain_noise, predict
from mocap_id.dynamics.preparation import FitSettings, PreparedTrial, TrialData, measure_arcs, prepare
from mocap_id.dynamics.regressor import base_names, planar_regressor, planar_torque_regressor
from mocap_id.verdict import Reason

GRID = build_grid(
    CENTRES, np.repeat([0, 1, 2, 3], 2), np.array([[-0.25, 0.0], [0.08, 0.1], *3 * [[-0.12, 0.1], [0.12, 0.85]]])
)
NO_REFERENCE = np.full(16, np.nan)
NO_ERROR = KinematicError.none(3)
NOISE = (0.5, 0.5, 0.15)


def with_(recorded: TrialData, **changes: np.ndarray) -> TrialData:
    return TrialData(**{**recorded.__dict__, **changes})


def cautions_of(prepared: PreparedTrial, found: Identification, **masses: float | None) -> tuple[Reason, ...]:
    excited = measure_excitation(prepared, found)
    recommendations = recommend_if_doubtful(prepared, found, excited)
    text = describe_recommendations(excited, recommendations, ["joint 1", "joint 2", "joint 3"])
    errors = PlanarCalibration(0.01, 0.01, 0.003, 0.005, 0.005, mass=None, mass_sd=1.0)
    return find_cautions(prepared, found, excited, text, **masses, calibration=errors)


def truth() -> np.ndarray:
    prepared = prepare(moving_body(), FitSettings())
    return prepared.base.regrouping @ BODY.ravel()


def identified(recorded: TrialData, settings: FitSettings | None = None, gate: np.ndarray | None = None):
    prepared = prepare(recorded, settings or FitSettings())
    free = np.ones(len(recorded.time), dtype=bool) if gate is None else gate
    return prepared, identify(prepared, free, GRID, NO_REFERENCE, NO_ERROR)


def test_a_noise_free_trial_is_exact() -> None:
    _, found = identified(moving_body())
    np.testing.assert_allclose(found.base, truth(), rtol=2e-4, atol=2e-4)
    assert found.fit.offset == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("components", [(0, 1, 2), (1, 2), (0, 2)])
def test_components_can_be_chosen(components: tuple[int, ...]) -> None:
    prepared, found = identified(moving_body(noise=NOISE), FitSettings(components=components))
    expected = prepared.base.regrouping @ BODY.ravel()
    assert len(found.base) == len(expected) == (10 if components == (0, 2) else 11)
    assert (np.abs(found.base - expected) < 4 * found.base_sd).all()


def test_a_constant_error_of_Fx_is_found_and_does_no_harm() -> None:
    recorded = moving_body(noise=NOISE)
    biased = with_(recorded, wrench=recorded.wrench + np.array([5.0, 0.0, 0.0]))
    _, found = identified(biased)
    assert found.plate_bias == pytest.approx(5.0, abs=4 * found.plate_bias_sd)
    np.testing.assert_allclose(found.base, identified(recorded)[1].base, rtol=1e-6, atol=1e-6)
    _, ignored = identified(biased, FitSettings(plate_bias=False))
    assert ignored.plate_bias is None
    off = [np.abs(one.base - truth()) / found.base_sd for one in (found, ignored)]
    assert off[0].max() < 4 < off[1].max()


@pytest.mark.parametrize(("component", "parameter"), [(1, 0), (2, 1)])
def test_a_constant_error_of_Fy_or_tauz_is_a_mass(component: int, parameter: int) -> None:
    """It changes only the first or the second base parameter, by error / g."""
    recorded = moving_body(noise=NOISE)
    shift = np.zeros(3)
    shift[component] = 3.0
    moved = identified(with_(recorded, wrench=recorded.wrench + shift))[1].base - identified(recorded)[1].base
    expected = np.zeros(11)
    expected[parameter] = 3.0 / 9.81
    np.testing.assert_allclose(moved, expected, atol=2e-3)


def test_gaps_in_states_and_wrench_stay_out_of_the_fit() -> None:
    recorded = moving_body(seconds=20.0, noise=NOISE)
    q, wrench, observed = recorded.q.copy(), recorded.wrench.copy(), recorded.observed.copy()
    q[300:340, 1] = np.nan
    wrench[900:930, 2] = np.nan
    observed[1500:1510] = False
    holed = with_(recorded, q=q, wrench=wrench, observed=observed)
    prepared, found = identified(holed)
    reach = prepared.lowpass.reach_samples
    used = found.fit.in_fit
    for low, high in ((300, 340), (900, 930), (1500, 1510)):
        assert not used[low - reach : high + reach].any()
    assert used.sum() > 1000
    assert (np.abs(found.base - truth()) < 4 * found.base_sd).all()
    model = predict(prepared, found, estimate_chain_noise(prepared, found, independent(holed)), 20.0)
    assert np.isnan(model.wrench[320]).all()
    assert np.isfinite(model.wrench[905]).all()
    assert np.isfinite(model.wrench_sd[905]).all()
    assert model.undetermined == ()


def test_garbage_outside_the_gate_does_not_leak_in() -> None:
    recorded = moving_body(seconds=20.0, noise=NOISE)
    gate = np.ones(len(recorded.time), dtype=bool)
    gate[600:1000] = False
    spoiled = recorded.wrench.copy()
    spoiled[600:1000] *= 0.2
    clean, found = (identified(r, gate=gate)[1].base for r in (recorded, with_(recorded, wrench=spoiled)))
    np.testing.assert_allclose(found, clean, rtol=1e-2, atol=2e-2)
    leaky = identified(with_(recorded, wrench=spoiled))[1].base
    assert np.abs(leaky - clean).max() > 20 * np.abs(found - clean).max()


def test_selection_and_determination() -> None:
    recorded = moving_body(seconds=20.0)
    prepared = prepare(recorded, FitSettings())
    nothing, everything = np.zeros(2000, dtype=bool), np.ones(2000, dtype=bool)
    assert not select_samples(prepared, nothing).any()
    assert determines_parameters(prepared, everything)
    short = nothing.copy()
    short[800:900] = True
    assert not determines_parameters(prepared, short)
    q, dq, ddq = (x.copy() for x in (recorded.q, recorded.dq, recorded.ddq))
    q[400:1600, 2], dq[400:1600, 2], ddq[400:1600, 2] = 0.1, 0.0, 0.0
    resting = prepare(with_(recorded, q=q, dq=dq, ddq=ddq), FitSettings())
    middle = nothing.copy()
    middle[600:1400] = True
    assert not determines_parameters(resting, middle)
    assert determines_parameters(resting, everything)


def test_arcs() -> None:
    q = np.column_stack([np.linspace(0, 1, 1001), np.zeros(1001)])
    np.testing.assert_allclose(measure_arcs(q, np.ones(1001, dtype=bool)), [0.95, 0.0], atol=1e-3)
    np.testing.assert_array_equal(measure_arcs(q, np.zeros(1001, dtype=bool)), [0.0, 0.0])


def test_agreement() -> None:
    measured = np.array([1.0, 2.0, 3.0, np.nan, 5.0])
    everything = np.ones(5, dtype=bool)
    found = agreement(measured + 0.5, measured, everything)
    assert (found.bias, found.sd) == (0.5, 0.0)
    assert found.r2 == pytest.approx(1 - 1.0 / 8.75)
    assert agreement(measured, measured, np.array([0, 0, 0, 1, 1], dtype=bool)) is None


def test_cautions() -> None:
    prepared, found = identified(moving_body(noise=NOISE))
    mass = float(BODY[:, 0].sum())

    def codes(given: float | None, standing: float | None) -> list[str]:
        return [reason.code for reason in cautions_of(prepared, found, given=given, standing=standing)]

    assert codes(mass, mass) == codes(mass, None) == codes(None, mass) == codes(None, None) == []
    assert codes(0.9 * mass, None) == codes(0.9 * mass, mass) == ["mass-contradiction"]
    assert measure_excitation(prepared, found).doubtful == ()


def test_caution_for_a_load_carried_by_something_else() -> None:
    """The identified mass is compared with the standing mass, and the given mass with the standing mass."""
    prepared, found = identified(moving_body(noise=NOISE))
    mass = float(BODY[:, 0].sum())
    (reason,) = cautions_of(prepared, found, given=1.2 * mass, standing=1.2 * mass)
    assert reason.code == "load-shared"
    assert "protocol: sit-to-stand" in reason.message
    assert f"{mass:.1f} kg" in reason.message
    assert f"{1.2 * mass:.1f} kg" in reason.message
    (contradiction,) = cautions_of(prepared, found, given=1.2 * mass, standing=None)
    assert contradiction.code == "mass-contradiction"
    assert "sit-to-stand" in contradiction.message


def test_reasons_name_the_solver_and_the_failed_check() -> None:
    prepared, found = identified(moving_body(noise=NOISE))
    solution = found.solution
    fine, off = solution.answer, Optimality(0.0, 0.0, 1e-4, 0.0)

    def codes(**changes: object) -> dict[str, str]:
        told = replace(found, solution=replace(solution, **changes))
        return {reason.code: reason.level for reason in cautions_of(prepared, told, given=None, standing=None)}

    assert codes() == {}
    assert codes(answer=replace(fine, solver="osqp")) == {"solver-fallback": "ok"}
    assert codes(answer=replace(fine, optimality=off)) == {"solver-unproven": "caution"}
    assert codes(requested="cone") == {"cone-unproven": "caution"}
    assert codes(requested="cone", answer=replace(fine, optimality=off)) == {
        "cone-unproven": "caution",
        "solver-unproven": "caution",
    }
    assert codes(requested="cone", consistency="cone") == {}


def test_without_Fy_the_identified_mass_is_not_compared() -> None:
    prepared, found = identified(moving_body(noise=NOISE), FitSettings(components=(2,)))
    mass = float(BODY[:, 0].sum())

    def cautions(given: float | None, standing: float | None) -> list[str]:
        reasons = cautions_of(prepared, found, given=given, standing=standing)
        return [reason.code for reason in reasons if reason.level == "caution"]

    assert cautions(None, mass) == []
    assert cautions(mass, 0.8 * mass) == ["mass-contradiction"]


@pytest.mark.parametrize(
    ("components", "untold"),
    [
        ((0, 1, 2), ()),
        ((1, 2), ()),
        ((2,), ("Fy", "cop_x")),
        ((0, 2), ("Fy", "cop_x")),
        ((0, 1), ("tauz", "cop_x", "tau_1", "tau_2", "tau_3")),
        ((1,), ("tauz", "cop_x", "tau_1", "tau_2", "tau_3")),
    ],
)
def test_undetermined_columns_are_nan(components: tuple[int, ...], untold: tuple[str, ...]) -> None:
    """Columns of the prediction are either correct or NaN."""
    recorded = moving_body(noise=NOISE)
    prepared, found = identified(recorded, FitSettings(components=components))
    model = predict(prepared, found, estimate_chain_noise(prepared, found, independent(recorded)), 20.0)
    assert model.undetermined == untold
    torque = planar_torque_regressor(CENTRES, recorded.q, prepared.regressor) @ BODY.ravel()
    wrench = prepared.regressor @ BODY.ravel()
    got = {
        name: (model.wrench[:, k], model.wrench_sd[:, k], wrench[:, k]) for k, name in enumerate(("Fx", "Fy", "tauz"))
    }
    got |= {f"tau_{j + 1}": (model.torque[:, j], model.torque_sd[:, j], torque[:, j]) for j in range(3)}
    got["cop_x"] = (model.cop, model.cop_sd, centre_of_pressure(wrench, 20.0))
    for name, (value, sd, true) in got.items():
        if name in untold:
            assert np.isnan(value).all(), name
            assert np.isnan(sd).all(), name
        else:
            assert np.sqrt(np.nanmean((value - true) ** 2)) < 0.01 * np.nanstd(true), name
            assert np.isfinite(sd[np.isfinite(value)]).all(), name


def test_caution_for_weak_excitation() -> None:
    """A hip that hardly moves: full rank, but the inertias of torso and thigh cannot be separated."""
    recorded = moving_body(noise=(5.0, 5.0, 2.0))
    noise = recorded.wrench - moving_body().wrench
    states = {name: getattr(recorded, name) * [1.0, 1.0, 1e-3] for name in ("q", "dq", "ddq")}
    exact = planar_regressor(CENTRES, **states) @ BODY.ravel()
    prepared = prepare(with_(recorded, **states, wrench=exact + noise), FitSettings())
    assert len(prepared.base.kept) == 11
    found = identify(prepared, np.ones(1200, dtype=bool), GRID, NO_REFERENCE, NO_ERROR)
    told = measure_excitation(prepared, found)
    assert "I4" in [told.names[i] for i in told.doubtful]
    (reason,) = [
        reason for reason in cautions_of(prepared, found, given=None, standing=None) if reason.code[-4:] == "weak"
    ]
    best = recommend_if_doubtful(prepared, found, told)[told.names.index("I4")]
    assert best is not None
    assert f"{best.describe(('joint 1', 'joint 2', 'joint 3'))[1:]} would reduce" in reason.message


def simulated(folder: Path, noise: float) -> tuple[TrialData, dict, dict]:
    """A simulated recording's own states and wrench, with some noise on accelerations and plate."""
    told = json.loads((folder / "truth.json").read_text())
    arrays = dict(np.load(folder / "truth.npz"))
    rng = np.random.default_rng(0)
    ddq = arrays["qdd"] + 0.08 * noise * rng.normal(size=arrays["qdd"].shape)
    wrench = arrays["wrench"] + noise * rng.normal(size=arrays["wrench"].shape) * [0.45, 0.45, 0.13]
    time, centres = arrays["t"], np.array([s["p_in_parent_m"] for s in told["segments"][1:]])
    observed = np.ones(len(time), dtype=bool)
    return TrialData(time, arrays["q"], arrays["qd"], ddq, 0 * ddq, observed, wrench, centres), told, arrays


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["sts-normal-clean", "sts-dynamic", "sts-stable-rotated-plate", "ur5-elbow-fast"])
def test_the_model_reproduces_simulated_recordings(recordings: Path, name: str) -> None:
    """Regressor times parameters is the wrench of another implementation, off the chair; so are the torques."""
    recorded, told, arrays = simulated(recordings / "simulated" / name, 0.0)
    parameters = np.array([[s[key] for key in ("m", "mx", "my", "Izz")] for s in told["segments"]]).ravel()
    prepared = prepare(recorded, FitSettings())
    free = np.hypot(*arrays["chair_force"].T) == 0
    np.testing.assert_allclose((prepared.regressor @ parameters)[free], arrays["wrench"][free], atol=1e-9)
    np.testing.assert_allclose(prepared.base.regrouping @ parameters, told["base_parameters"]["values"], atol=1e-9)
    assert len(base_names(prepared.base, recorded.centres)) == len(told["base_parameters"]["names"])


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("name", "noise", "parameters", "cop"),
    [("sts-normal-clean", 0.0, 3e-5, 1e-6), ("sts-normal", 1.0, 0.005, 3e-4), ("ur5-elbow-fast", 1.0, 0.002, 3e-5)],
)
def test_parameters_and_centre_of_pressure(
    recordings: Path, name: str, noise: float, parameters: float, cop: float
) -> None:
    recorded, told, arrays = simulated(recordings / "simulated" / name, noise)
    prepared = prepare(recorded, FitSettings())
    free = np.hypot(*arrays["chair_force"].T) == 0
    local = np.array([m["local_xyz_m"][:2] for m in told["markers"]])
    grid = build_grid(recorded.centres, np.array([m["segment"] for m in told["markers"]]), local)
    joints = len(recorded.centres)
    error = KinematicError.none(joints)
    found = identify(prepared, free, grid, np.full(4 * (joints + 1), np.nan), error)
    expected = np.array(told["base_parameters"]["values"])
    for pair in ([0], *[[2 + 3 * k, 3 + 3 * k] for k in range(joints)], *[[4 + 3 * k] for k in range(joints)]):
        assert np.linalg.norm(found.base[pair]) == pytest.approx(np.linalg.norm(expected[pair]), rel=parameters)
    exact = planar_regressor(recorded.centres, arrays["q"], arrays["qd"], arrays["qdd"])[:, :, prepared.base.kept]
    model = centre_of_pressure(exact @ found.base, 20.0)
    assert np.sqrt(np.mean((model - arrays["cop_x"])[free] ** 2)) < cop
    m, mx, my, inertia = found.full.reshape(-1, 4).T
    assert (m * inertia >= mx**2 + my**2 - 1e-12).all()
    assert fit(prepared, free).best_offset == pytest.approx(0.0, abs=5e-5)
