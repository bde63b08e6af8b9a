"""Fits of all bodies with a prior: the closed form, its covariance, clock and folds, and the two ends of looseness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES
from pose_cases import BODIES, CENTROID, INFORMATION, moving, poses_of, recorded_of, slow
from scipy.linalg import block_diag

from mocap_id.dynamics.fit import REFERENCE, Fit, determines_parameters, fit, number_parts
from mocap_id.dynamics.identification import predict_left_out
from mocap_id.dynamics.measured_motion import BodyPoses, map_to_chain
from mocap_id.dynamics.preparation import FitSettings, PreparedTrial, TrialData, prepare, profile_offset
from mocap_id.dynamics.priors import BodyPrior, build_table_prior
from mocap_id.dynamics.regressor import (
    CompressedProblem,
    estimate_covariance,
    move_chain,
    number_blocks,
    structural_base,
    wrench_regressor,
)
from mocap_id.geometry import planar

TIME = np.arange(3000) / 100
EVERYTHING = np.ones(len(TIME), dtype=bool)
NOISE = (2.0, 2.0, 0.6)
WRONG = BODIES * [1.2, 0.9, 1.1, 1.3]
PRIOR = build_table_prior(WRONG.ravel(), "a table", others=True)
SPANS = np.array([[0.5, 9.0], [11.0, 19.0], [21.0, 29.5]])


def trial(
    noise: tuple[float, float, float] = NOISE, prior: BodyPrior = PRIOR, **settings: object
) -> tuple[TrialData, PreparedTrial]:
    recorded = recorded_of(TIME, moving(TIME), noise=noise)
    return recorded, prepare(recorded, FitSettings(**settings), prior)  # type: ignore[arg-type]


def scaled(covariance: float) -> BodyPrior:
    return replace(PRIOR, covariance=covariance * PRIOR.covariance)


def rows_of(found: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Weighted rows of base and nuisance parameters, and the target."""
    return found.design[..., :-1].reshape(found.target.size, -1), found.target.reshape(-1)


def test_the_solution_is_the_most_likely_one() -> None:
    """(XᵀX + P)⁻¹ (Xᵀy + P ρ₀), with the rows built anew and the bias without a prior."""
    recorded, prepared = trial()
    found = fit(prepared, EVERYTHING)
    assert found.base == 20
    design = np.concatenate([prepared.filtered[found.samples], np.zeros((len(found.samples), 3, 1))], axis=-1)
    design[:, 0, -1] = 1.0
    wrench = prepared.filtered_measured(found.samples, recorded.time[found.samples] - found.offset)
    rows = (design * found.weights[:, None]).reshape(-1, 21)
    precision = block_diag(np.linalg.inv(PRIOR.covariance), 0.0)
    right = rows.T @ (wrench * found.weights).reshape(-1) + precision @ np.append(PRIOR.mean, 0.0)
    expected = np.linalg.solve(rows.T @ rows + precision, right)
    solution = found.problem.free_solution()
    sd = np.sqrt(np.diag(found.covariance))[:21]
    np.testing.assert_allclose((solution - expected) / sd, 0.0, atol=1e-5)
    size = np.sqrt(np.diag(PRIOR.covariance))
    both = np.sqrt(np.diag(found.prior_precision))[:20] * size
    assert (both >= 1 - 1e-9).all()
    np.testing.assert_allclose(found.prior_precision[:20, :20], np.linalg.inv(PRIOR.covariance), rtol=1e-6, atol=1e-9)
    assert (found.prior_precision[20:] == 0.0).all()


def test_data_count_by_their_time_not_by_their_samples() -> None:
    """The squares of every component's weighted residual sum up to its number of independent samples."""
    worth = []
    for rate in (100, 200):
        time = np.arange(30 * rate) / rate
        recorded = recorded_of(time, moving(time), noise=NOISE)
        found = fit(prepare(recorded, FitSettings(), PRIOR), np.ones(len(time), dtype=bool))
        rows, target = rows_of(found)
        residual = (target - rows @ found.problem.free_solution()).reshape(-1, 3)
        np.testing.assert_allclose(np.sum(residual**2, axis=0), found.in_fit.sum() / rate / REFERENCE, rtol=0.05)
        worth.append(float(np.sum(residual**2)) / (found.in_fit.sum() / rate))
    assert worth[0] == pytest.approx(worth[1], rel=0.1)
    recorded, _ = trial()
    without = fit(prepare(replace(recorded, measured=None), FitSettings()), EVERYTHING)
    assert without.prior is None
    assert (without.prior_precision == 0.0).all()


def test_a_fit_like_another_takes_its_clock_and_weights() -> None:
    recorded, prepared = trial()
    found = fit(prepared, EVERYTHING)
    again = fit(prepared, EVERYTHING, found)
    assert again.offset == found.offset
    np.testing.assert_array_equal(again.weights, found.weights)
    np.testing.assert_allclose(again.problem.free_solution(), found.problem.free_solution(), rtol=1e-9, atol=1e-9)
    other = prepare(replace(recorded, wrench=recorded.wrench * [1.5, 1.0, 1.0]), FitSettings(), PRIOR)
    np.testing.assert_array_equal(fit(other, EVERYTHING, found).weights, found.weights)


def test_a_wide_prior_leaves_the_data_alone_and_a_tight_one_is_the_answer() -> None:
    _, prepared = trial(prior=scaled(1e-12))
    np.testing.assert_allclose(fit(prepared, EVERYTHING).problem.free_solution()[:20], PRIOR.mean, rtol=0, atol=1e-4)
    recorded, loose = trial(noise=(0.0, 0.0, 0.0), prior=scaled(1e4))
    wrench = wrench_regressor(recorded.motion) @ fit(loose, EVERYTHING).problem.free_solution()[:20]
    np.testing.assert_allclose(wrench[100:-100], recorded.wrench[100:-100], atol=0.05)


def on_chain() -> tuple[TrialData, BodyPoses, np.ndarray]:
    """A pinned chain whose four bodies count by their own motion, its poses and angles."""
    states = tuple(values[:, :3] for values in slow(TIME))
    motion = move_chain(CENTRES, *states)
    wrench = wrench_regressor(motion) @ BODY.ravel()
    recorded = TrialData(TIME, *states, np.zeros_like(states[0]), EVERYTHING, wrench, CENTRES, measured=motion)
    place = motion.origin + planar.rotate(motion.angle, CENTROID[:4])
    poses = BodyPoses(TIME, place, motion.angle, CENTROID[:4], INFORMATION[:4], np.arange(4), CENTRES)
    return recorded, poses, states[0]


@pytest.mark.parametrize("wide", [True, False])
def test_on_an_exact_chain_it_says_what_the_chain_s_fit_says(wide: bool) -> None:
    """Both through the fold: base parameters of the truth under a wide prior, of the prior's mean under a tight one."""
    recorded, poses, q = on_chain()
    mean = (BODY * [1.2, 0.9, 1.1, 1.3]).ravel()
    table = build_table_prior(mean, "")
    prior = replace(table, covariance=(1e6 if wide else 1e-10) * table.covariance)
    prepared = prepare(recorded, FitSettings(cutoff=5.0), prior)
    found = fit(prepared, EVERYTHING)
    base = structural_base(CENTRES)
    folded = map_to_chain(poses, q, found.in_fit, np.full(16, np.nan), np.full(16, np.nan))
    value = base.regrouping @ folded.apply(found.problem.free_solution()[:16])
    chain = fit(prepare(replace(recorded, measured=None), FitSettings(cutoff=5.0)), EVERYTHING)
    own = chain.problem.free_solution()[:11]
    np.testing.assert_allclose(own, base.regrouping @ BODY.ravel(), rtol=1e-5, atol=1e-5)
    expected = own if wide else base.regrouping @ mean
    np.testing.assert_allclose(value, expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("spread", [[1.0, 1.0, 1.0], [0.4, 0.4, 1.0]])
def test_the_covariance_is_the_sandwich_with_the_prior_s_rows(spread: list[float]) -> None:
    rng = np.random.default_rng(0)
    design, residual = rng.normal(size=(400, 2, 4)), rng.normal(size=(400, 2))
    prior, block = rng.normal(size=(3, 4)), number_blocks(np.arange(400) / 20, 1.0)
    bread = np.linalg.inv(np.einsum("rca,rcb->ab", design, design) + prior.T @ prior)
    scores = [np.einsum("rcb,rc->b", design[block == g], residual[block == g]) for g in range(20)]
    few = 20 / 19 * 799 / 796
    expected = bread @ (few * sum(np.outer(s, s) for s in scores) + prior.T @ np.diag(spread) ** 2 @ prior) @ bread
    found = estimate_covariance(design, residual, block, prior, np.array(spread))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)
    none = estimate_covariance(design, residual, block, np.zeros((0, 4)))
    np.testing.assert_allclose(none, estimate_covariance(design, residual, block), rtol=1e-12)


def test_the_fit_s_covariance_holds_its_prior() -> None:
    """Where the data say nothing the prior's deviation is left; nowhere more than that and some of the data's."""
    _, prepared = trial()
    found = fit(prepared, EVERYTHING)
    rows = found.design.reshape(-1, 22)
    gained = np.linalg.inv(rows.T @ rows + found.prior_precision)
    sd, of_prior = np.sqrt(np.diag(found.covariance)), np.sqrt(np.diag(PRIOR.covariance))
    assert found.prior is not None
    own = np.pad(found.prior[0], ((0, 0), (0, 1))) * PRIOR.spread[:, None]
    rest = found.covariance - gained @ own.T @ own @ gained
    assert np.linalg.eigvalsh(rest / np.outer(sd, sd)).min() > -1e-6
    sd = sd[:20]
    assert (sd < of_prior).all()
    assert (sd / of_prior).min() < 0.2 < (sd / of_prior).max()


def test_intervals_hold_bodies_drawn_from_the_prior() -> None:
    """Truths from the prior itself, the foot with the spread of published tables, each with its own noise."""
    rng, inside = np.random.default_rng(5), []
    motion = moving(TIME)
    for k in range(12):
        bodies = rng.multivariate_normal(PRIOR.mean, PRIOR.covariance * np.outer(PRIOR.spread, PRIOR.spread)).reshape(
            5, 4
        )
        recorded = recorded_of(TIME, motion, noise=NOISE, bodies=bodies)
        recorded = replace(recorded, wrench=recorded.wrench + rng.normal(size=(len(TIME), 3)) * (1 + k % 2))
        found = fit(prepare(recorded, FitSettings(offset_limit=0.02), PRIOR), EVERYTHING)
        error = found.problem.free_solution()[:20] - bodies.ravel()
        inside.append(np.abs(error) < 1.96 * np.sqrt(np.diag(found.covariance))[:20])
    assert 0.88 < np.mean(inside) <= 1.0


@pytest.mark.parametrize("offset", [-0.043, 0.02])
def test_the_clock_is_found_beside_a_prior(offset: float) -> None:
    recorded, _ = trial()
    late = wrench_regressor(moving(TIME + offset)) @ BODIES.ravel()  # stamped t, taken at t + offset
    late += np.random.default_rng(3).normal(size=late.shape) * NOISE
    prepared = prepare(replace(recorded, wrench=late), FitSettings(), PRIOR)
    found = fit(prepared, EVERYTHING)
    assert found.applied
    assert found.offset == pytest.approx(offset, abs=5 * found.offset_sd)
    assert found.offset_sd < 1e-3


def test_the_profile_counts_the_prior_s_cost() -> None:
    """One parameter, a sine against its shifted self: a prior that is sure of the size changes nothing of the clock."""
    time = np.arange(400) / 100
    regressor = np.sin(3 * time)[:, None, None]

    def wrench(stamped: np.ndarray) -> np.ndarray:
        return 2.0 * np.sin(3 * (stamped + 0.03))[..., None]

    # δ is where the plate's stamp t was taken at t + δ on the markers' clock: wrench(t - δ) fits sin(3 t)
    for prior in (None, (np.array([[1e4]]), np.array([2e4])), (np.array([[1e-9]]), np.array([0.0]))):
        found, edge = profile_offset(regressor, wrench, time, np.ones(1), 0.1, prior=prior)
        assert found == pytest.approx(0.03, abs=1e-5)
        assert not edge
    sure_of_wrong = (np.array([[1e6]]), np.array([0.0]))  # no parameter at all: the least of the wrench itself
    costs = [float(np.sum(wrench(time - shift) ** 2)) for shift in np.linspace(-0.1, 0.1, 201)]
    found, _ = profile_offset(regressor, wrench, time, np.ones(1), 0.1, prior=sure_of_wrong)
    assert found == pytest.approx(np.linspace(-0.1, 0.1, 201)[int(np.argmin(costs))], abs=2e-3)


def reweighed(found: Fit, weights: np.ndarray) -> np.ndarray:
    """The most likely parameters of the same rows with other weights: a fold keeps those of the whole trial."""
    scale = weights / found.weights
    rows = (found.design[..., :-1] * scale[:, None]).reshape(found.target.size, -1)
    assert found.prior is not None
    both = np.concatenate([rows, found.prior[0]]), np.concatenate([(found.target * scale).reshape(-1), found.prior[1]])
    return np.asarray(np.linalg.lstsq(*both, rcond=None)[0])


def test_a_fold_is_a_fit_to_the_rest_with_the_whole_prior() -> None:
    _, prepared = trial(cutoff=10.0)
    assert prepared.lowpass.step == 1  # so that both fit the same samples
    part, whole = number_parts(TIME, SPANS), fit(prepared, EVERYTHING)
    held = predict_left_out(prepared, EVERYTHING, whole, part, CompressedProblem.free_solution)
    assert held is not None
    sd = np.sqrt(np.diag(whole.covariance))[:20]
    for k in range(3):
        alone = fit(prepared, part != k)
        assert held.offset[k] == pytest.approx(alone.offset, abs=1e-5)
        np.testing.assert_allclose((held.base[k] - reweighed(alone, whole.weights)[:20]) / sd, 0.0, atol=0.05)
    np.testing.assert_array_equal(held.samples, whole.in_fit)


def test_a_prior_determines_what_a_rest_leaves_open() -> None:
    """Bodies that stand still but for the arm: without a prior there is nothing to fit."""
    motion = moving(TIME, size=0.0)
    q = np.zeros((len(TIME), 3))
    recorded = replace(recorded_of(TIME, motion), q=q, dq=q, ddq=q)
    still = prepare(replace(recorded, measured=None), FitSettings())
    assert (
        not determines_parameters(prepare(replace(recorded, measured=None), FitSettings()), EVERYTHING)
        or len(still.base.kept) < 11
    )
    assert determines_parameters(prepare(recorded, FitSettings(), PRIOR), EVERYTHING)
    assert not determines_parameters(prepare(recorded, FitSettings(), PRIOR), TIME < 0.9)


@pytest.mark.parametrize("column", [0, 6, 18])
def test_the_answer_is_what_a_fit_to_the_changed_wrench_says(column: int) -> None:
    """An error in the shape of a body's column, and one of the clock, beside noise; weights hardly feel it."""
    recorded, prepared = trial()
    found = fit(prepared, EVERYTHING)
    size = 0.02 * np.sqrt(PRIOR.covariance[column, column])
    error = size * prepared.rows[..., column]
    changed = fit(prepare(replace(recorded, wrench=recorded.wrench + error), FitSettings(), PRIOR), EVERYTHING)
    filtered = prepared.lowpass(error)[found.samples] * found.weights
    said = found.response(filtered[..., None])[:, 0]
    moved = np.append(changed.problem.free_solution() - found.problem.free_solution(), changed.offset - found.offset)
    scale = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(moved / scale, said / scale, atol=0.05 * np.abs(said / scale).max())
    rate = found.design[..., -1:]
    np.testing.assert_allclose(found.response(rate)[:, 0], np.eye(22)[21], atol=1e-6)


def test_an_unmoved_body_keeps_its_prior() -> None:
    """The foot rests: gravity tells the sum of the masses, not its moment of inertia."""
    _, prepared = trial()
    found = fit(prepared, EVERYTHING)
    assert found.problem.free_solution()[3] == pytest.approx(PRIOR.mean[3], abs=0.3 * np.sqrt(PRIOR.covariance[3, 3]))
    regressor = wrench_regressor(poses_motion := moving(TIME))
    assert (np.abs(regressor[..., 3]) < 1e-12).all()
    assert poses_of(TIME, poses_motion).rate == pytest.approx(100.0)
