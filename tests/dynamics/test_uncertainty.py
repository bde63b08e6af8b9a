"""Standard deviations: classical where residuals are white, honest where they are not."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, independent, moving_body, waves
from scipy.signal import butter, lfilter, sosfiltfilt

from mocap_id.dynamics.base import structural_base
from mocap_id.dynamics.fit import fit
from mocap_id.dynamics.grid import segment_grid
from mocap_id.dynamics.identify import identify
from mocap_id.dynamics.kinematic_error import KinematicError, from_markers, kinematic_covariance
from mocap_id.dynamics.predict import predict
from mocap_id.dynamics.prepare import FitSettings, Recorded, prepare
from mocap_id.dynamics.pressure import centre_of_pressure, centre_of_pressure_rows
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.dynamics.uncertainty import block_covariance, time_blocks, variance
from mocap_id.geometry import planar

EVERYTHING = np.ones(1200, dtype=bool)
NO_ERROR = KinematicError(np.zeros((3, 3)), np.zeros((3, 2, 2)))


def regression(rng: np.random.Generator, memory: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Design and residual noise, both with memory, and the blocks."""
    time = np.arange(0, 40, 0.02)

    def coloured(*shape: int) -> np.ndarray:
        return lfilter([1.0], [1.0, -memory], rng.normal(size=shape), axis=0) * np.sqrt(1 - memory**2)

    return coloured(len(time), 2, 3), coloured(len(time), 2), time_blocks(time, 1.0)


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_intervals_hold_the_truth(memory: float) -> None:
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(300):
        design, noise, block = regression(rng, memory)
        error = np.linalg.lstsq(design.reshape(-1, 3), noise.reshape(-1), rcond=None)[0]
        sd = np.sqrt(np.diag(block_covariance(design, noise - design @ error, block)))
        inside.append(np.abs(error) < 1.96 * sd)
    assert 0.91 < np.mean(inside) < 0.98


def test_ignoring_the_memory_would_be_wrong() -> None:
    """The test above can fail: blocks of one sample, the classical formula's assumption, do not hold the truth."""
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(100):
        design, noise, _ = regression(rng, 0.9)
        error = np.linalg.lstsq(design.reshape(-1, 3), noise.reshape(-1), rcond=None)[0]
        sd = np.sqrt(np.diag(block_covariance(design, noise - design @ error, np.arange(len(noise)))))
        inside.append(np.abs(error) < 1.96 * sd)
    assert np.mean(inside) < 0.75


def test_blocks_are_counted_without_gaps() -> None:
    np.testing.assert_array_equal(time_blocks(np.array([2.0, 2.4, 2.6, 9.1, 9.2]), 0.5), [0, 0, 1, 2, 2])


def test_variance_is_the_quadratic_form() -> None:
    rng = np.random.default_rng(0)
    rows, root = rng.normal(size=(4, 2, 3)), rng.normal(size=(3, 3))
    expected = np.einsum("tij,jk,tik->ti", rows, root @ root.T, rows)
    np.testing.assert_allclose(variance(rows, root @ root.T), expected)


def test_skin_that_slides_is_covered() -> None:
    """Angles wrong by a smooth function of posture: the residuals hardly show it, the geometry's covariance does."""
    rng = np.random.default_rng(3)
    truth = structural_base(CENTRES).regrouping @ BODY.ravel()
    size = np.radians(0.15)
    plain, whole = [], []
    for seed in range(30):
        recorded = moving_body(seed=seed, noise=(0.5, 0.5, 0.15))
        slope = rng.normal(size=(3, 3)) * size / np.sqrt(3) / recorded.q.std(axis=0)
        shifted = Recorded(
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
        extra = kinematic_covariance(prepared, found, base, KinematicError(size**2 * np.eye(3), np.zeros((3, 2, 2))))
        error = np.abs(base - truth)
        plain.append(error < 1.96 * np.sqrt(np.diag(found.covariance)[:11]))
        whole.append(error < 1.96 * np.sqrt(np.diag(found.covariance + extra)[:11]))
    assert np.mean(plain) < 0.7
    assert 0.88 < np.mean(whole) < 0.99


def test_misplaced_joints_are_covered() -> None:
    rng = np.random.default_rng(4)
    truth = structural_base(CENTRES).regrouping @ BODY.ravel()
    inside = []
    for seed in range(40):
        recorded = moving_body(seed=seed, noise=(0.5, 0.5, 0.15))
        moved = Recorded(**{**recorded.__dict__, "centres": CENTRES + 0.003 * rng.normal(size=CENTRES.shape)})
        prepared = prepare(moved, FitSettings())
        found = fit(prepared, EVERYTHING)
        base = found.problem.free_solution()[:11]
        error = KinematicError(np.zeros((3, 3)), np.tile(0.003**2 * np.eye(2), (3, 1, 1)))
        covariance = found.covariance + kinematic_covariance(prepared, found, base, error)
        inside.append(np.abs(base - truth) < 1.96 * np.sqrt(np.diag(covariance)[:11]))
    assert 0.88 < np.mean(inside) < 0.99


def test_angle_errors_follow_from_the_markers() -> None:
    """A Monte Carlo over marker displacements gives the covariance that the formula gives."""
    rng = np.random.default_rng(5)
    segment = np.repeat([0, 1, 2, 3], 3)
    local = rng.uniform([-0.1, 0.0], [0.1, 0.4], size=(12, 2))
    residual = np.where(segment > 0, rng.uniform(0.001, 0.003, 12), 0.0)
    q = np.tile([[0.1, -0.8, 0.6]], (10, 1))
    covariance = from_markers(
        q, CENTRES, segment, local, residual=residual, centre_covariance=np.zeros((3, 2, 2))
    ).angle
    gain = np.linalg.pinv(planar.marker_jacobian(q[0], CENTRES, segment, local).reshape(-1, 3))
    drawn = gain @ (np.repeat(residual, 2)[:, None] / np.sqrt(2) * rng.normal(size=(24, 40_000)))
    np.testing.assert_allclose(np.cov(drawn), covariance, atol=0.03 * covariance.max())


def test_the_plate_s_zero_is_in_the_mass_and_nowhere_else() -> None:
    prepared = {sd: prepare(moving_body(noise=(1, 1, 0.3)), FitSettings(plate_zero=sd)) for sd in ((0, 0), (2.0, 0.5))}
    grid = segment_grid(CENTRES, np.array([3]), np.array([[0.0, 0.8]]))
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
    prepared = prepare(Recorded(**{**recorded.__dict__, **states}), FitSettings(cutoff=3.0))
    grid = segment_grid(CENTRES, np.repeat([1, 2, 3], 2), np.tile([[-0.1, 0.0], [0.1, 0.8]], (3, 1)))
    found = identify(prepared, np.ones(len(noisy), dtype=bool), grid, np.full(16, np.nan), NO_ERROR)
    model = predict(prepared, found, independent(recorded), 20.0)
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
