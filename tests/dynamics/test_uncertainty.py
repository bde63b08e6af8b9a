"""Standard deviations: classical where residuals are white, honest where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, independent, moving_body, waves
from scipy.signal import butter, lfilter, sosfiltfilt

from mocap_id.dynamics.consistency import build_grid
from mocap_id.dynamics.fit import fit
from mocap_id.dynamics.identification import identify
from mocap_id.dynamics.instrument_errors import KinematicError, propagate_to_parameters
from mocap_id.dynamics.prediction import centre_of_pressure, centre_of_pressure_rows, estimate_chain_noise, predict
from mocap_id.dynamics.preparation import FitSettings, TrialData, prepare
from mocap_id.dynamics.regressor import estimate_covariance, number_blocks, planar_regressor, structural_base, variance

EVERYTHING = np.ones(1200, dtype=bool)
NO_ERROR = KinematicError.none(3)


def regression(rng: np.random.Generator, memory: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Design and residual noise, both with memory, and the blocks."""
    time = np.arange(0, 40, 0.02)

    def coloured(*shape: int) -> np.ndarray:
        return lfilter([1.0], [1.0, -memory], rng.normal(size=shape), axis=0) * np.sqrt(1 - memory**2)

    return coloured(len(time), 2, 3), coloured(len(time), 2), number_blocks(time, 1.0)


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_intervals_hold_the_truth(memory: float) -> None:
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(300):
        design, noise, block = regression(rng, memory)
        error = np.linalg.lstsq(design.reshape(-1, 3), noise.reshape(-1), rcond=None)[0]
        sd = np.sqrt(np.diag(estimate_covariance(design, noise - design @ error, block)))
        inside.append(np.abs(error) < 1.96 * sd)
    assert 0.91 < np.mean(inside) < 0.98


def test_ignoring_the_memory_would_be_wrong() -> None:
    """The test above can fail: blocks of one sample, the classical formula's assumption, do not hold the truth."""
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(100):
        design, noise, _ = regression(rng, 0.9)
        error = np.linalg.lstsq(design.reshape(-1, 3), noise.reshape(-1), rcond=None)[0]
        sd = np.sqrt(np.diag(estimate_covariance(design, noise - design @ error, np.arange(len(noise)))))
        inside.append(np.abs(error) < 1.96 * sd)
    assert np.mean(inside) < 0.75


def test_blocks_are_counted_without_gaps() -> None:
    np.testing.assert_array_equal(number_blocks(np.array([2.0, 2.4, 2.6, 9.1, 9.2]), 0.5), [0, 0, 1, 2, 2])


def test_variance_is_the_quadratic_form() -> None:
    rng = np.random.default_rng(0)
    rows, root = rng.normal(size=(4, 2, 3)), rng.normal(size=(3, 3))
    expected = np.einsum("tij,jk,tik->ti", rows, root @ root.T, rows)
    np.testing.assert_allclose(variance(rows, root @ root.T), expected)


def following(q: np.ndarray, size: float) -> KinematicError:
    """Every joint's error follows every joint's angle, by ``size`` (rad) in all, either way."""
    mean, spread = q.mean(axis=0), q.std(axis=0)

    def angle(postures: np.ndarray) -> np.ndarray:
        shape = size / np.sqrt(3) * (postures - mean) / spread
        return np.einsum("ij,tk->tijk", np.eye(3), shape).reshape(len(postures), 3, 9)

    return KinematicError(angle, np.zeros((3, 2, 9)))


def test_skin_that_slides_is_covered() -> None:
    """Angles wrong by a smooth function of posture: the residuals hardly show it, the geometry's covariance does."""
    rng = np.random.default_rng(3)
    truth = structural_base(CENTRES).regrouping @ BODY.ravel()
    size = np.radians(0.15)
    plain, whole = [], []
    for seed in range(30):
        recorded = moving_body(seed=seed, noise=(0.5, 0.5, 0.15))
        slope = rng.normal(size=(3, 3)) * size / np.sqrt(3) / recorded.q.std(axis=0)
        shifted = TrialData(
            **{
                **recorded.__dict__,
                "q": recorded.q + (recorded.q - recorded.q.mean(axis=0)) @ slope.T,
                "dq": recorded.dq + recorded.dq @ slope.T,
                "ddq": recorded.ddq + recorded.ddq @ slope.T,
            }
        )
        prepared = prepare(shifted, FitSettings())
        found = fit(prepared, EVERYTHING)
        base = found.problem.free_solution()[:11]
        response = propagate_to_parameters(prepared, found, base, following(recorded.q, size))
        extra = response @ response.T
        error = np.abs(base - truth)
        plain.append(error < 1.96 * np.sqrt(np.diag(found.covariance)[:11]))
        whole.append(error < 1.96 * np.sqrt(np.diag(found.covariance + extra)[:11]))
    assert np.mean(plain) < 0.7
    assert 0.88 < np.mean(whole) < 0.99


def test_misplaced_joints_are_covered() -> None:
    rng = np.random.default_rng(4)
    truth = structural_base(CENTRES).regrouping @ BODY.ravel()
    error = KinematicError(lambda q: np.zeros((*q.shape, 6)), 0.003 * np.eye(6).reshape(3, 2, 6))
    inside = []
    for seed in range(40):
        recorded = moving_body(seed=seed, noise=(0.5, 0.5, 0.15))
        moved = TrialData(**{**recorded.__dict__, "centres": CENTRES + 0.003 * rng.normal(size=CENTRES.shape)})
        prepared = prepare(moved, FitSettings())
        found = fit(prepared, EVERYTHING)
        base = found.problem.free_solution()[:11]
        response = propagate_to_parameters(prepared, found, base, error)
        covariance = found.covariance + response @ response.T
        inside.append(np.abs(base - truth) < 1.96 * np.sqrt(np.diag(covariance)[:11]))
    assert 0.88 < np.mean(inside) < 0.99


def test_errors_of_the_states_are_those_of_the_postures_in_time() -> None:
    """Along a movement with known derivatives, a mode that is a polynomial of the posture has known ones too."""
    t = np.linspace(0.0, 4.0, 200)[:, None]
    rates = np.array([0.9, 1.3, 0.7])
    q, dq, ddq = np.sin(rates * t), rates * np.cos(rates * t), -(rates**2) * np.sin(rates * t)
    error = KinematicError(lambda q: 0.01 * np.stack([q, q**2], axis=-1), np.zeros((3, 2, 2)))
    position, velocity, acceleration = np.split(error.states(q, dq, ddq), 3, axis=1)
    np.testing.assert_allclose(position[..., 1], 0.01 * q**2)
    np.testing.assert_allclose(velocity[..., 0], 0.01 * dq, atol=1e-4)
    np.testing.assert_allclose(velocity[..., 1], 0.02 * q * dq, atol=1e-4)
    np.testing.assert_allclose(acceleration[..., 0], 0.01 * ddq, atol=1e-4)
    np.testing.assert_allclose(acceleration[..., 1], 0.02 * (dq**2 + q * ddq), atol=1e-4)


def test_a_mode_moves_the_parameters_as_a_fit_to_wrong_states_does() -> None:
    """The response is the derivative of the fit by the mode's size, here by differences; the low-pass lets all pass."""
    recorded, settings = moving_body(seed=1, noise=(0.0, 0.0, 0.0)), FitSettings(cutoff=20.0)
    centre = 3e-4 * np.random.default_rng(2).normal(size=(3, 2, 9))
    error = KinematicError(following(recorded.q, 1e-4).angle, centre)
    found = fit(prepare(recorded, settings), EVERYTHING)
    base = found.problem.free_solution()[:11]
    said = propagate_to_parameters(prepare(recorded, settings), found, base, error)[:11]
    states = np.split(error.states(recorded.q, recorded.dq, recorded.ddq), 3, axis=1)
    for mode in range(9):
        both = []
        for sign in (1, -1):
            parts = zip(("q", "dq", "ddq"), states, strict=True)
            wrong = {name: getattr(recorded, name) + sign * part[..., mode] for name, part in parts}
            again = prepare(replace(recorded, **wrong, centres=CENTRES + sign * centre[..., mode]), settings)
            rows = again.filtered[found.samples] * found.weights[:, None]
            columns = np.concatenate([rows, found.design[..., 11:12]], axis=-1).reshape(found.target.size, -1)
            both.append(np.linalg.lstsq(columns, found.target.reshape(-1), rcond=None)[0][:11])
        np.testing.assert_allclose(said[:, mode], (both[0] - both[1]) / 2, atol=0.02 * np.abs(said[:, mode]).max())


def test_the_plate_s_zero_is_in_the_mass_and_nowhere_else() -> None:
    prepared = {sd: prepare(moving_body(noise=(1, 1, 0.3)), FitSettings(plate_zero=sd)) for sd in ((0, 0), (2.0, 0.5))}
    grid = build_grid(CENTRES, np.array([3]), np.array([[0.0, 0.8]]))
    without, with_zero = (
        identify(p, EVERYTHING, grid, np.full(16, np.nan), NO_ERROR).base_sd for p in prepared.values()
    )
    np.testing.assert_allclose(with_zero[:2], np.hypot(without[:2], [2 / 9.81, 0.5 / 9.81]))
    np.testing.assert_array_equal(with_zero[2:], without[2:])


@pytest.mark.parametrize("told", [1.0, 3.0], ids=["states right", "states three times too uncertain"])
def test_predictions_are_as_far_off_as_they_say(told: float) -> None:
    """Smooth errors of the accelerations: the stated sd is that of the actual errors, whatever the states claim."""
    recorded = moving_body(seconds=30.0, noise=(0.5, 0.5, 0.15))
    noise = 0.2
    sections = butter(4, 8.0, fs=recorded.rate, output="sos")
    smooth = sosfiltfilt(sections, np.random.default_rng(0).normal(size=recorded.ddq.shape), axis=0)
    noisy = recorded.ddq + noise * smooth / smooth.std()
    states = {"ddq": noisy, "ddq_sd": np.full_like(noisy, told * noise)}
    prepared = prepare(TrialData(**{**recorded.__dict__, **states}), FitSettings(cutoff=3.0))
    grid = build_grid(CENTRES, np.repeat([1, 2, 3], 2), np.tile([[-0.1, 0.0], [0.1, 0.8]], (3, 1)))
    found = identify(prepared, np.ones(len(noisy), dtype=bool), grid, np.full(16, np.nan), NO_ERROR)
    model = predict(prepared, found, estimate_chain_noise(prepared, found, independent(recorded)), 20.0)
    truth = planar_regressor(CENTRES, recorded.q, recorded.dq, recorded.ddq) @ BODY.ravel()
    for error, sd in (
        (model.wrench - truth, model.wrench_sd),
        (model.cop - centre_of_pressure(truth, 20.0), model.cop_sd),
    ):
        scaled = error / sd
        assert np.nanstd(scaled) == pytest.approx(1.0, abs=0.1)
    assert (model.torque_sd > 0).all()


def test_centre_of_pressure_and_its_derivative() -> None:
    rng = np.random.default_rng(0)
    rows, base = rng.normal(size=(6, 3, 4)), rng.normal(size=4)
    rows[:, 1] += 200 * base / (base @ base)
    wrench = rows @ base
    wrench[0, 1] = 5.0
    cop = centre_of_pressure(wrench, 20.0)
    assert np.isnan(cop[0])
    np.testing.assert_allclose(cop[1:], wrench[1:, 2] / wrench[1:, 1])
    derivative = centre_of_pressure_rows(rows, wrench, 20.0)
    assert np.isnan(derivative[0]).all()
    for k in range(4):
        step = np.zeros(4)
        step[k] = 1e-6
        moved = centre_of_pressure(rows @ (base + step), 20.0) - centre_of_pressure(rows @ (base - step), 20.0)
        np.testing.assert_allclose(derivative[1:, k], moved[1:] / 2e-6, atol=1e-7)


def test_states_of_the_cases_are_consistent() -> None:
    """The oracle's own derivatives."""
    time = np.arange(0, 1, 1e-4)
    q, dq, ddq = waves(time, 2)
    np.testing.assert_allclose(np.gradient(q, time, axis=0)[2:-2], dq[2:-2], atol=1e-4)
    np.testing.assert_allclose(np.gradient(dq, time, axis=0)[2:-2], ddq[2:-2], atol=1e-3)
