"""Errors that skin leaves in the angles: each slide's against a joint fit made anew, their sum against its laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap_id.kinematics import skin_errors
from mocap_id.kinematics.chain_equations import Problem, State, moved, reduce

JOINTS, MARKERS, FRAMES = 3, 3, 40


def refitted(points: np.ndarray, segment: np.ndarray, start: State) -> np.ndarray:
    """(T, n) joint angles of the whole fit, centres and coordinates included, less their mean."""
    nowhere = np.zeros(len(segment), dtype=bool)
    problem, state = Problem(points, np.ones(points.shape), segment, nowhere, JOINTS), start
    for _ in range(12):
        state = moved(state, reduce(problem, state).step())
    relative = np.diff(state.angles, axis=1, prepend=0.0)
    return relative - relative.mean(axis=0)


@pytest.fixture(scope="module")
def posed(chain):
    """A chain without any error: points of the moving markers, their segments, the state, joint angles."""
    truth = chain(31, joints=JOINTS, markers=MARKERS, frames=FRAMES)
    moving = np.flatnonzero(truth.segment)
    angles = np.cumsum(truth.relative, axis=1)
    arms = np.concatenate(
        [np.full((FRAMES, 1), truth.centres[0]), np.exp(1j * angles[:, :-1]) * truth.centres[1:]], axis=1
    )
    own = truth.segment[moving] - 1
    local = ((truth.points[:, moving] - np.cumsum(arms, axis=1)[:, own]) * np.exp(-1j * angles[:, own])).mean(axis=0)
    return truth.points[:, moving], truth.segment[moving], State(truth.centres, local, angles), truth.relative


def test_each_slide_moves_the_angles_as_a_new_fit_says(posed) -> None:
    points, segment, state, relative = posed
    skin = skin_errors._linearised(points, segment, state, np.arange(FRAMES), camera_sd=0.0)
    skin = replace(skin, size=np.ones(len(segment)))
    said = skin_errors._series(skin, np.arange(FRAMES))[0]
    said = (said - said.mean(axis=0))[..., : 4 * len(segment)].reshape(FRAMES, JOINTS, -1, 2, 2)
    shape = skin_errors._shapes(relative - relative.mean(axis=0), skin.spread, segment)
    assert np.sum(np.mean(shape**2, axis=0), axis=1) == pytest.approx(1)
    step = 1e-5
    for marker in range(len(segment)):
        for which in range(2):
            for side, direction in enumerate((1, 1j)):
                slide = np.zeros(points.shape, dtype=complex)
                turn = np.exp(1j * state.angles[:, segment[marker] - 1])
                slide[:, marker] = step * direction * shape[:, marker, which] * turn
                slope = (refitted(points + slide, segment, state) - refitted(points - slide, segment, state)) / (
                    2 * step
                )
                np.testing.assert_allclose(said[:, :, marker, which, side], slope, atol=2e-4 * np.abs(said).max())


def run(posed, points: np.ndarray, camera_sd: float, rate: float = 50.0) -> np.ndarray:
    _, segment, state, relative = posed
    frames, variance = skin_errors.angle_errors(
        points,
        segment,
        state.centres,
        state.local,
        relative,
        observed=np.ones(FRAMES, dtype=bool),
        camera_sd=camera_sd,
        rate=rate,
    )
    return np.stack([np.interp(np.arange(FRAMES), frames, column) for column in variance.reshape(len(frames), -1).T], 1)


def test_without_residuals_and_noise_there_is_no_error(posed) -> None:
    assert run(posed, posed[0], 0.0).max() < 1e-12


def test_the_errors_grow_with_the_slides(posed) -> None:
    """Above a tenth of a millimetre, where markers weigh by their residuals whatever the scale."""
    points, segment, state, relative = posed
    rng = np.random.default_rng(0)
    along = rng.standard_normal((2, len(segment)))
    course = (relative - relative.mean(axis=0))[:, segment - 1]
    slide = 1e-3 * course * (along[0] + 1j * along[1]) * np.exp(1j * state.angles[:, segment - 1])
    small, large = run(posed, points + slide, 0.0), run(posed, points + 2 * slide, 0.0)
    assert small.max() > 0
    np.testing.assert_allclose(large, 4 * small, rtol=0.01)


def test_chunks_make_no_difference(posed, monkeypatch) -> None:
    rng = np.random.default_rng(1)
    points = posed[0] + 1e-3 * rng.standard_normal(posed[0].shape)
    whole = run(posed, points, 5e-4)
    monkeypatch.setattr(skin_errors, "_CHUNK", 7)
    np.testing.assert_allclose(run(posed, points, 5e-4), whole, rtol=1e-9)
