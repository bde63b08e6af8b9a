"""How far off the model's wrench and torques are: the stated intervals hold the truth, and are no wider than that."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from dynamics_cases import CENTRES, independent, moving_body, random_chain
from scipy.signal import butter, sosfiltfilt

from mocap_id.dynamics.consistency import build_grid
from mocap_id.dynamics.identification import identify
from mocap_id.dynamics.instrument_errors import KinematicError, correlate_errors, estimate_model_error
from mocap_id.dynamics.prediction import Prediction, centre_of_pressure, estimate_chain_noise, predict
from mocap_id.dynamics.preparation import FitSettings, TrialData, prepare
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.estimation import smooth
from mocap_id.estimation.filter_problem import MarkerChain
from mocap_id.geometry import planar
from mocap_id.kinematics.chain_fit import ChainState
from mocap_id.kinematics.skin_slides import skin_from_residuals
from mocap_id_simulation import Options, SimulatedTrial, generate
from mocap_id_simulation.forces import TrueState

SEGMENT = np.repeat([0, 1, 2, 3], 4)
LOCAL = np.random.default_rng(0).uniform([-0.1, 0.0], [0.1, 0.45], size=(16, 2))


def spectral_correlation(q: np.ndarray, snap: np.ndarray) -> np.ndarray:
    """The smoother's error spectrum (omega^8 Q^-1 + Lambda)^-1 summed up over the frequencies, numerically."""
    jacobian = planar.marker_jacobian(q[None], CENTRES, SEGMENT, LOCAL).reshape(-1, 3)
    information = jacobian.T @ jacobian
    omega = np.geomspace(0.01, 1e5, 20_000)
    spectrum = np.linalg.inv(omega[:, None, None] ** 8 * np.diag(snap**-2.0) + information)
    covariance = np.trapezoid(omega[:, None, None] ** 4 * spectrum, omega, axis=0)
    size = np.sqrt(np.diag(covariance))
    return covariance / np.outer(size, size)


@pytest.mark.parametrize("snap", [np.ones(3), np.array([200.0, 450.0, 900.0])], ids=["alike", "unlike"])
def test_correlation_is_that_of_the_smoother(snap: np.ndarray) -> None:
    q = np.array([[0.1, -0.8, 0.6], [0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    found = correlate_errors(q, CENTRES, SEGMENT, LOCAL, snap)
    for posture, correlation in zip(q[:2], found, strict=False):
        np.testing.assert_allclose(correlation, spectral_correlation(posture, snap), atol=2e-4)
    assert (found[:2, 0, 1] < -0.2).all()  # what the ankle has too much the knee has too little
    assert np.isnan(found[2]).all()


@pytest.mark.parametrize("joints", [1, 2, 5])
def test_correlations_are_correlations(joints: int) -> None:
    rng = np.random.default_rng(joints)
    segment, local = np.repeat(np.arange(joints + 1), 3), rng.uniform(-0.2, 0.2, size=(3 * (joints + 1), 2))
    found = correlate_errors(
        rng.normal(size=(20, joints)), random_chain(rng, joints), segment, local, rng.uniform(1, 9, joints)
    )
    np.testing.assert_allclose(np.diagonal(found, axis1=1, axis2=2), 1.0)
    assert np.linalg.eigvalsh(found).min() > 0.0


@pytest.mark.parametrize("joints", [1, 3, 5])
def test_it_is_that_of_the_markers_jacobian(joints: int) -> None:
    """Q^½ (Q^½ JᵀJ Q^½)^(-3/8) Q^½ with J written out."""
    rng = np.random.default_rng(joints)
    q, centres, snap = rng.normal(size=(20, joints)), random_chain(rng, joints), rng.uniform(1, 9, joints)
    segment = np.repeat(np.arange(joints + 1), 3)
    local = rng.uniform(-0.2, 0.2, size=(len(segment), 2))
    jacobian = planar.marker_jacobian(q, centres, segment, local).reshape(20, -1, joints) * snap
    values, vectors = np.linalg.eigh(np.swapaxes(jacobian, 1, 2) @ jacobian)
    covariance = (vectors * values[:, None] ** (-3 / 8)) @ np.swapaxes(vectors, 1, 2) * np.outer(snap, snap)
    size = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    found = correlate_errors(q, centres, segment, local, snap)
    np.testing.assert_allclose(found, covariance / (size[:, :, None] * size[:, None]), atol=1e-10)


def coloured(rng: np.random.Generator, size: int) -> np.ndarray:
    """Smooth noise of unit variance, at 100 Hz."""
    noise = sosfiltfilt(butter(4, 8.0, fs=100.0, output="sos"), rng.normal(size=size))
    return noise / noise.std()


@pytest.mark.parametrize("plate", [0.0, 0.5, 2.0])
def test_the_model_s_error_is_told_from_the_plate_s_noise(plate: float) -> None:
    """A steady part and one that comes and goes, of known sizes, under white noise up to twice as large."""
    rng = np.random.default_rng(1)
    said = (2 + np.sin(np.linspace(0, 30, 20_000))) ** 2
    error = 0.8 * coloured(rng, 20_000) + 0.5 * np.sqrt(said) * coloured(rng, 20_000)
    residual = 3.0 + error + plate * rng.normal(size=20_000)  # the plate's zero is no error of the model
    steady, scale, overall = estimate_model_error(residual, said, np.ones(20_000, dtype=bool), 100.0)
    assert overall * said.mean() == pytest.approx(error.var(), rel=0.1)
    assert steady + scale * said.mean() == pytest.approx(error.var(), rel=0.1)
    assert scale == pytest.approx(0.25, rel=0.3)


def test_where_the_plate_shows_nothing_there_is_no_size() -> None:
    residual, said = np.random.default_rng(0).normal(size=500), np.ones(500)
    assert estimate_model_error(residual, said, np.zeros(500, dtype=bool), 100.0) is None
    assert estimate_model_error(np.full(500, np.nan), said, np.ones(500, dtype=bool), 100.0) is None


@cache
def trial(seed: int, strategy: str, tissue: float) -> tuple[SimulatedTrial, TrueState, Prediction, np.ndarray]:
    """A simulated sit-to-stand, smoothed and identified on its true geometry; its truth and its free samples."""
    options = Options(seed=seed, strategy=strategy, repetitions=3, soft_tissue=tissue, rate=100.0)
    made = generate("sit-to-stand", options)
    state, scene = made.state, made.scene
    centres = np.array([link.centre for link in scene.body.links[1:]])
    segment, local = scene.markers.link, scene.markers.local[:, :2]
    observed = scene.plane.to_plane(made.points)[..., :2]
    states = smooth(observed, options.rate, MarkerChain(centres, segment, local))
    known = states.observed.all(axis=1)
    noise = np.random.default_rng(seed).normal(size=state.wrench.shape) * [1.0, 1.0, 0.3]
    angles = (states.mean[..., k] for k in range(3))
    recorded = TrialData(state.time, *angles, states.sd[..., 2], known, state.wrench + noise, centres)
    residual = np.sqrt(np.nanmean(np.sum((observed - states.predicted) ** 2, axis=2), axis=0))
    moves = segment > 0
    placed = ChainState(centres @ [1, 1j], local[moves] @ [1, 1j], np.cumsum(recorded.q, axis=1))
    true = np.zeros((len(centres), 2, 2))
    skin = skin_from_residuals(placed, segment[moves], residual[moves], true)
    error = KinematicError(lambda q: skin.errors(q)[0], skin.stored_chain_errors()[0])
    prepared = prepare(recorded, FitSettings())
    free = np.hypot(*state.chair_force.T) == 0.0
    reference = np.full(4 * (len(centres) + 1), np.nan)
    found = identify(prepared, free, build_grid(centres, segment, local), reference, error)
    correlation = correlate_errors(recorded.q, centres, segment, local, states.sigma_v)
    inner = (state.time > 0.5) & (state.time < state.time[-1] - 0.5)
    return made, state, predict(prepared, found, estimate_chain_noise(prepared, found, correlation), 20.0), free & inner


TRIALS = [(0, "normal", 1.0), (1, "dynamic", 1.0), (2, "stable", 1.0), (3, "normal", 0.0), (4, "normal", 2.0)]


def scaled_errors(case: tuple[int, str, float]) -> dict[str, np.ndarray]:
    """Error by stated standard deviation, off the chair."""
    _, state, model, free = trial(*case)
    cop = centre_of_pressure(state.wrench, 20.0)
    errors = {
        name: (model.wrench - state.wrench)[:, k] / model.wrench_sd[:, k] for k, name in enumerate(WRENCH_COMPONENTS)
    }
    errors["cop"] = (model.cop - cop) / model.cop_sd
    errors |= {f"tau_{j + 1}": (model.torque - state.tau)[:, j] / model.torque_sd[:, j] for j in range(3)}
    return {name: error[free & np.isfinite(error)] for name, error in errors.items()}


@pytest.mark.slow
@pytest.mark.parametrize("case", TRIALS, ids=["normal", "dynamic", "stable", "no soft tissue", "much soft tissue"])
def test_the_stated_deviations_of_every_trial_have_the_errors_size(case: tuple[int, str, float]) -> None:
    errors = scaled_errors(case)
    for name in ("Fx", "Fy", "tauz", "cop"):
        assert 0.75 < np.sqrt(np.mean(errors[name] ** 2)) < 1.45, name  # as if independent: 0.15 to 0.3


@pytest.mark.parametrize("names", [("Fx",), ("Fy",), ("tauz",), ("cop",), ("tau_1", "tau_2", "tau_3")], ids="/".join)
def test_the_intervals_hold_the_truth(names: tuple[str, ...]) -> None:
    """Over all trials together: the errors of the torques are the geometry's, one draw a trial."""
    inside = [np.abs(scaled_errors(case)[name]) < 1.96 for case in TRIALS for name in names]
    assert 0.9 < np.mean(np.concatenate(inside)) <= 0.99


@pytest.mark.parametrize(("component", "factor"), [(0, 1.0), (1, 1.0), (2, 3.0)], ids=WRENCH_COMPONENTS)
def test_the_torques_deviations_follow_those_of_tauz(component: int, factor: float) -> None:
    """A force that the model misses says nothing of the moments; a moment that it misses does."""
    recorded, noise = moving_body(seconds=30.0, noise=(1.0, 1.0, 0.3)), np.random.default_rng(4)
    recorded = replace(recorded, ddq_sd=np.full_like(recorded.q, 0.2))
    free, reference = np.ones(len(recorded.time), dtype=bool), np.full(16, np.nan)
    exact = KinematicError.none(3)
    prepared = prepare(recorded, FitSettings())
    found = identify(prepared, free, build_grid(CENTRES, SEGMENT, LOCAL), reference, exact)
    missed = recorded.wrench.copy()
    missed[:, component] += 10.0 * coloured(noise, len(missed))
    usual, wider = (
        predict(with_wrench, found, estimate_chain_noise(with_wrench, found, independent(recorded)), 20.0)
        for with_wrench in (prepared, prepare(replace(recorded, wrench=missed), FitSettings()))
    )
    assert np.mean(wider.wrench_sd[:, component]) > 3.0 * np.mean(usual.wrench_sd[:, component])
    assert (wider.torque_sd >= factor * usual.torque_sd).all()
    if factor == 1.0:
        np.testing.assert_array_equal(wider.torque_sd, usual.torque_sd)


def test_a_noisy_plate_hides_the_models_error_but_leaves_it_a_size() -> None:
    """The plate's noise, as seen above the band, is more than all that is seen within it."""
    rng = np.random.default_rng(2)
    rate, noise = 100.0, np.full(1000, 1e-3)
    jagged = 50.0 * rng.standard_normal(1000)
    high = jagged - sosfiltfilt(butter(4, 20.0, fs=rate, output="sos"), jagged)
    found = estimate_model_error(high, noise, np.ones(1000, dtype=bool), rate)
    assert found is not None
    steady, scale, overall = found
    assert all(np.isfinite(found))
    assert steady + scale * noise[0] == pytest.approx(overall * noise[0])


def test_a_joint_that_may_give_way_errs_by_the_force_through_it() -> None:
    """The force that the bodies beyond the joint need, times the error of its centre; on that joint alone."""
    recorded = moving_body(seconds=30.0, noise=(1.0, 1.0, 0.3))
    free, reference = np.ones(len(recorded.time), dtype=bool), np.full(16, np.nan)
    prepared = prepare(recorded, FitSettings())
    found = identify(prepared, free, build_grid(CENTRES, SEGMENT, LOCAL), reference, KinematicError.none(3))
    correlation, hip = independent(recorded), np.array([0.0, 0.0, 0.003])
    loose, pinned = (estimate_chain_noise(prepared, found, correlation, sd)[2] for sd in (hip, None))
    more = loose - pinned
    np.testing.assert_allclose(more[:, :2], 0.0, atol=1e-9)
    force = prepared.regressor[:, :2, 12:] @ found.full[12:]
    np.testing.assert_allclose(np.sqrt(more[:, 2]), 0.003 * np.hypot(*force.T), rtol=1e-6)
    assert np.median(force[:, 1]) == pytest.approx(9.81 * found.full[12], rel=0.1)
