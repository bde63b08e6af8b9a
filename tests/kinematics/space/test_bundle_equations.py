"""The analytic Jacobians of the bundle equal finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.geometry import so3
from mocap_id.kinematics.space.bundle import (
    BundleProblem,
    BundleState,
    apply_step,
    eliminate_frames,
    linearise,
    prior_equations,
)

_STEP = 1e-6


def _units(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.fixture(params=[(0, 1, 2), (0, 1, 1)], ids=["chain", "tree"])
def case(request: pytest.FixtureRequest) -> tuple[BundleProblem, BundleState]:
    rng = np.random.default_rng(1)
    segment = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, 3, 3])
    frames, markers = 3, len(segment)
    problem = BundleProblem(
        rng.normal(size=(frames, markers, 3)),
        rng.uniform(0.5, 1, (frames, markers)),
        segment,
        request.param,
        ("ball", "two-axis", "hinge"),
        _units(rng, 1)[0],
        np.arange(markers) == 3,
        _units(rng, 3),
        np.array([0.5, 0.0, 2.0]),
        np.zeros((3, 3)),
        np.full(3, 0.1),
        np.array([False, True, False]),
        np.zeros(3, bool),
    )
    state = BundleState(
        rng.normal(size=(markers, 3)),
        rng.normal(size=(3, 3)),
        _units(rng, 3),
        _units(rng, 3),
        rng.uniform(-1, 1, 3),
        rng.normal(size=3),
        rng.uniform(-0.4, 0.4, markers),
        rng.normal(size=(frames, 3)),
        so3.exp(rng.normal(size=(frames, 4, 3))),
        rng.normal(size=(frames, 3, 3)) * [[1], [0], [1]],
    )
    return problem, state


def test_jacobians_equal_finite_differences(case: tuple[BundleProblem, BundleState]) -> None:
    problem, state = case
    linear, cols = linearise(problem, state), problem.columns
    off, by_frame, beyond_markers = linear
    frames, markers = problem.weights.shape
    by_chain = np.concatenate([np.zeros((*off.shape, 3 * markers)), beyond_markers], axis=2)
    by_chain[:, np.arange(3 * markers), np.arange(3 * markers)] = -np.repeat(problem.weights, 3, axis=1)

    def slope(chain: np.ndarray, frame: np.ndarray) -> np.ndarray:
        still = np.ones((frames, 1))
        ahead, behind = (
            linearise(problem, apply_step(problem, state, sign * chain, sign * frame * still))[0]
            for sign in (_STEP, -_STEP)
        )
        return (ahead - behind) / (2 * _STEP)

    none, fixed = np.zeros(cols.size), np.zeros(problem.frame_size)
    numeric = np.stack([slope(each, fixed) for each in np.eye(cols.size)], axis=-1)
    assert np.allclose(numeric, by_chain, atol=1e-6 * np.abs(by_chain).max())
    numeric = np.stack([slope(none, each) for each in np.eye(problem.frame_size)], axis=-1)
    assert np.allclose(numeric, by_frame, atol=1e-6 * np.abs(by_frame).max())


def test_schur_complement_equals_the_whole_system(case: tuple[BundleProblem, BundleState]) -> None:
    problem, state = case
    linear, cols = linearise(problem, state), problem.columns
    off, by_frame, beyond_markers = linear
    frames, markers = problem.weights.shape
    by_chain = np.concatenate([np.zeros((*off.shape, 3 * markers)), beyond_markers], axis=2)
    by_chain[:, np.arange(3 * markers), np.arange(3 * markers)] = -np.repeat(problem.weights, 3, axis=1)
    size, each = problem.frame_size, cols.size
    whole = np.zeros((off.size, each + frames * size))
    whole[:, :each] = by_chain.reshape(-1, each)
    for f in range(frames):
        rows = slice(f * off.shape[1], (f + 1) * off.shape[1])
        whole[rows, each + f * size : each + (f + 1) * size] = by_frame[f]
    normal, right = whole.T @ whole, -whole.T @ off.ravel()
    inner = normal[each:, each:] + 1e-9 * np.eye(frames * size)
    matrix, vector, _ = eliminate_frames(problem, linear)
    expected = normal[:each, :each] - normal[:each, each:] @ np.linalg.solve(inner, normal[each:, :each])
    assert np.allclose(matrix, expected, atol=1e-8 * np.abs(expected).max())
    remaining = right[:each] - normal[:each, each:] @ np.linalg.solve(inner, right[each:])
    assert np.allclose(vector, remaining, atol=1e-8 * np.abs(remaining).max())


def test_priors_equal_finite_differences(case: tuple[BundleProblem, BundleState]) -> None:
    problem, state = case
    cols = problem.columns
    still = np.zeros((len(problem.points), problem.frame_size))
    rows = prior_equations(problem, state)[1]
    hinge_row = 3 * 2 + 2 + 3  # its axis is fixed within a step
    for p in [*range(cols.centre[0].start, cols.size)]:
        step = _STEP * np.eye(cols.size)[p]
        ahead, behind = (
            prior_equations(problem, apply_step(problem, state, sign * step, still))[0] for sign in (1, -1)
        )
        numeric = (ahead - behind) / (2 * _STEP)
        kept = np.arange(len(numeric)) != hinge_row
        assert np.allclose(numeric[kept], rows[kept, p], atol=1e-5 * np.abs(rows).max())
