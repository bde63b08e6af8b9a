"""Covariance of the joint centres with skin that slides in step with the joints."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from mocap_id.kinematics.bundle import fit_chain, rigid_body_links
from mocap_id.kinematics.chain_fit import (
    ChainProblem,
    ChainState,
    centre_covariance,
    eliminate_angles,
    gauss_newton_step,
    joint_positions,
    slide_responses,
    slide_shapes,
    slide_variances,
)

TOO_FEW, TOO_MANY = 0.88, 0.99  # share of 95 % intervals that contain the truth


def posed(truth, weights: np.ndarray | float = 1.0, pinned: int | None = None) -> tuple[ChainProblem, ChainState]:
    """Return the fit's equations for a fully visible chain; ``pinned`` adds a marker on that joint."""
    moving = np.flatnonzero(truth.segment > 0)
    start = rigid_body_links(truth.points, truth.segment)
    state = ChainState(start.centres, start.local[moving], start.angles)
    points, segment = truth.points[:, moving], truth.segment[moving]
    extra = 0
    if pinned is not None:
        joint = joint_positions(state)[0][:, pinned - 1 : pinned]
        points, segment, extra = np.concatenate([points, joint], axis=1), np.append(segment, pinned), 1
        state = ChainState(state.centres, np.append(state.local, 0), state.angles)
    seen = np.isfinite(points)
    columns = np.arange(points.shape[1])
    problem = ChainProblem(
        np.where(seen, points, 0), seen * weights, segment, columns >= len(moving), len(state.centres)
    )
    assert int(problem.pinned.sum()) == extra
    return problem, settled(problem, state)


def settled(problem: ChainProblem, state: ChainState) -> ChainState:
    """Run Gauss-Newton with fixed weights."""
    for _ in range(12):
        state = state.change(*gauss_newton_step(problem, state))
    return state


@pytest.mark.parametrize(("joints", "pinned"), [(1, None), (2, None), (3, None), (3, 2)])
def test_slide_responses_match_finite_differences(chain, joints: int, pinned: int | None) -> None:
    truth = chain(31, joints=joints, markers=3, frames=40)
    count = 3 * joints + (pinned is not None)
    weights = np.random.default_rng(0).uniform(0.3, 1.5, (40, count))
    weights[7:15, 1] = 0  # a gap
    problem, state = posed(truth, weights, pinned)
    course, turn = slide_shapes(problem, state), joint_positions(state)[1]
    inverse, _, solved = eliminate_angles(problem, state)
    said = slide_responses(problem, state, solved, course, inverse[:, : 2 * problem.joints])  # (K, S, 2, 2 n)
    assert np.sum(np.mean(course**2, axis=0), axis=1) == pytest.approx(1)
    step = 1e-5
    for marker in range(count):
        for shape in range(2):
            for side, direction in enumerate((1, 1j)):
                slide = np.zeros(problem.points.shape, dtype=complex)
                slide[:, marker] = direction * course[:, marker, shape] * turn[:, problem.segment[marker] - 1]
                centres = [
                    settled(ChainProblem(problem.points + sign * step * slide, *rest(problem)), state).centres
                    for sign in (1, -1)
                ]
                slope = (centres[0] - centres[1]) / (2 * step)
                expected = np.stack([slope.real, slope.imag], axis=1).ravel()
                assert said[marker, shape, side] == pytest.approx(expected, abs=2e-5)


def rest(problem: ChainProblem) -> tuple:
    return problem.weights, problem.segment, problem.pinned, problem.joints


def skin(truth, rng: np.random.Generator, size: float) -> np.ndarray:
    """Let every moving marker slide in step with the joints at both ends, by ``size`` m rms per coordinate."""
    angle = np.cumsum(truth.relative, axis=1)
    ends = np.concatenate([truth.relative, 0 * truth.relative[:, :1]], axis=1)
    ends = ends - ends.mean(axis=0)
    out = np.zeros(truth.points.shape, dtype=complex)
    for marker in np.flatnonzero(truth.segment):
        k = truth.segment[marker]
        shape = ends[:, k - 1 : k + 1] / np.sqrt(np.mean(np.sum(ends[:, k - 1 : k + 1] ** 2, axis=1)))
        along = rng.standard_normal(2) + 1j * rng.standard_normal(2)
        out[:, marker] = np.exp(1j * angle[:, k - 1]) * size * (shape @ along)
    return out


def errors_in_deviations(chain, size: float, noise: float, count: int) -> np.ndarray:
    """Return errors (count, 2) of the two lengths over their standard deviations."""
    found = []
    for seed in range(count):
        truth = chain(seed, frames=120, markers=4)
        rng = np.random.default_rng(1000 + seed)
        white = rng.standard_normal(truth.points.shape) + 1j * rng.standard_normal(truth.points.shape)
        fit = fit_chain(truth.points + skin(truth, rng, size) + noise * white, truth.segment)
        found.append((fit.lengths - np.abs(truth.centres[1:])) / fit.length_sd)
    return np.array(found)


@pytest.mark.parametrize(("size", "noise"), [(2e-3, 5e-4), (5e-3, 1e-3)])
def test_intervals_of_lengths_cover_the_truth_with_sliding_skin(chain, size: float, noise: float) -> None:
    """They must not be far too wide either. Chains are independent, the two lengths of one chain are not."""
    off = errors_in_deviations(chain, size, noise, 60)
    within = np.abs(off) < stats.norm.ppf(0.975)
    for held in within.T:
        assert stats.binomtest(int(held.sum()), len(held), TOO_FEW, "less").pvalue > 0.01
    assert TOO_FEW <= within.mean() <= TOO_MANY


def test_the_sandwich_alone_does_not_cover_the_truth(chain) -> None:
    """It contains only what the residuals show."""
    held = []
    for seed in range(20):
        truth = chain(seed, frames=120, markers=4)
        slid = truth.points + skin(truth, np.random.default_rng(1000 + seed), 2e-3)
        problem, state = posed(type(truth)(slid, truth.lateral, truth.segment, truth.centres, truth.relative))
        inverse, scores, _ = eliminate_angles(problem, state)
        blocks = np.stack([block.sum(axis=0) for block in np.array_split(scores, 20)]) @ inverse[:, :6]
        alone = 20 / 19 * blocks.T @ blocks
        whole = centre_covariance(problem, state)
        assert np.linalg.eigvalsh(whole - alone).min() > -1e-6 * np.trace(whole)
        for j in (1, 2):
            along = np.array([state.centres[j].real, state.centres[j].imag]) / abs(state.centres[j])
            error = abs(state.centres[j]) - abs(truth.centres[j])
            sds = [np.sqrt(along @ c[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] @ along) for c in (alone, whole)]
            held.append([abs(error) < 1.96 * sd for sd in sds])
    alone_held, whole_held = np.mean(held, axis=0)
    assert alone_held < 0.8
    assert whole_held > TOO_FEW


def test_camera_noise_is_not_a_slide(chain) -> None:
    """Almost nothing remains of white residuals with a variance of 1 mm^2."""
    slides = [slide_variances(*posed(chain(seed, frames=300, noise=1e-3))) for seed in range(10)]
    assert np.mean(slides) < 0.02e-6


def test_the_size_of_a_slide_is_found(chain) -> None:
    """The slide is slow and independent of the joints, so the fit absorbs only the three coordinates of a pose."""
    found = []
    for seed in range(12):
        truth = chain(seed, frames=600, noise=3e-4)
        rng = np.random.default_rng(seed)
        t = np.linspace(0, 2 * np.pi, 600)[:, None]
        slow = np.zeros(truth.points.shape, dtype=complex)
        for rhythm in range(11, 31):
            turn = rng.standard_normal((4, truth.points.shape[1]))
            slow += (turn[0] + 1j * turn[1]) * np.sin(rhythm * t) + (turn[2] + 1j * turn[3]) * np.cos(rhythm * t)
        slow *= 2e-3 / np.sqrt(20) * (truth.segment > 0)
        angle = np.concatenate([0 * truth.relative[:, :1], np.cumsum(truth.relative, axis=1)], axis=1)
        points = truth.points + np.exp(1j * angle[:, truth.segment]) * slow
        moving = type(truth)(points, truth.lateral, truth.segment, truth.centres, truth.relative)
        found.append(slide_variances(*posed(moving)).mean())
    assert np.sqrt(np.mean(found)) == pytest.approx(2e-3, rel=0.15)


def test_pinned_and_unseen_markers_do_not_slide(chain) -> None:
    truth = chain(33, noise=5e-4)
    truth.points[:, 8] = np.nan
    problem, state = posed_unseen(truth)
    slide = slide_variances(problem, state)
    assert slide[problem.pinned].tolist() == [0.0]
    assert slide[4] == 0.0
    assert np.isfinite(slide).all()


def posed_unseen(truth) -> tuple[ChainProblem, ChainState]:
    """Residuals without a fit, because a marker that is never seen has no coordinates."""
    problem, state = posed(truth_without(truth, 8), pinned=2)
    points, weights = (np.insert(values, 4, 0, axis=1) for values in (problem.points, problem.weights))
    whole = ChainProblem(points, weights, np.insert(problem.segment, 4, 1), np.insert(problem.pinned, 4, False), 3)
    return whole, ChainState(state.centres, np.insert(state.local, 4, 0.1), state.angles)


def truth_without(truth, marker: int):
    kept = np.arange(len(truth.segment)) != marker
    return type(truth)(truth.points[:, kept], truth.lateral[kept], truth.segment[kept], truth.centres, truth.relative)


def test_a_covariance_is_symmetric_and_grows_with_the_skin(chain) -> None:
    traces = []
    for size in (0.0, 1e-3, 2e-3, 4e-3):
        truth = chain(34, noise=3e-4)
        truth.points[:] += skin(truth, np.random.default_rng(1), size)
        problem, state = posed(truth)
        covariance = centre_covariance(problem, state)
        assert covariance.shape == (6, 6)
        assert np.allclose(covariance, covariance.T, rtol=1e-9, atol=0)
        assert np.linalg.eigvalsh(covariance).min() > -1e-9 * np.trace(covariance)
        traces.append(np.trace(covariance))
    assert (np.diff(traces) > 0).all()
    assert traces[3] / traces[2] == pytest.approx(4, rel=0.25)  # variances scale with the square


def test_the_covariance_does_not_depend_on_the_orientation_of_the_plane(chain) -> None:
    truth = chain(35, noise=5e-4)
    truth.points[:] += skin(truth, np.random.default_rng(2), 2e-3)
    plain = fit_chain(truth.points, truth.segment)
    turned = fit_chain(np.exp(0.7j) * truth.points + (1 - 2j), truth.segment)
    assert turned.length_sd == pytest.approx(plain.length_sd, rel=1e-3)
    assert np.linalg.eigvalsh(turned.covariance[0]) == pytest.approx(np.linalg.eigvalsh(plain.covariance[0]), rel=1e-3)
