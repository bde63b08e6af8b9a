"""Angle errors from skin: each slide compared with a new joint fit, and the properties of their sum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap_id.kinematics import skin_slides
from mocap_id.kinematics.chain_fit import ChainProblem, ChainState, gauss_newton_step

JOINTS, MARKERS, FRAMES = 3, 3, 40


def solved(points: np.ndarray, segment: np.ndarray, start: ChainState) -> ChainState:
    """Fit everything, including centres and coordinates."""
    nowhere = np.zeros(len(segment), dtype=bool)
    problem, state = ChainProblem(points, np.ones(points.shape), segment, nowhere, JOINTS), start
    for _ in range(12):
        state = state.change(*gauss_newton_step(problem, state))
    return state


def refitted(points: np.ndarray, segment: np.ndarray, start: ChainState) -> np.ndarray:
    """Return the joint angles (T, n) without their mean."""
    relative = np.diff(solved(points, segment, start).angles, axis=1, prepend=0.0)
    return relative - relative.mean(axis=0)


def written(state: ChainState, segment: np.ndarray) -> ChainState:
    """Return the chain with +y of each segment towards its next joint (last: towards its markers' centroid)."""
    towards = np.append(state.centres[1:], state.local[segment == JOINTS].mean())
    turn = 1j * np.abs(towards) / towards
    centres = state.centres * np.append(1, turn[:-1])
    return ChainState(centres, state.local * turn[segment - 1], state.angles - np.angle(turn))


def first_turn(state: ChainState, segment: np.ndarray) -> np.ndarray:
    """Return the resulting changes (n,) of the joint angles."""
    return np.diff((written(state, segment).angles - state.angles)[0], prepend=0.0)


@pytest.fixture(scope="module")
def posed(chain):
    """Return an exact chain: points of the moving markers, their segments, the state, joint angles."""
    truth = chain(31, joints=JOINTS, markers=MARKERS, frames=FRAMES)
    moving = np.flatnonzero(truth.segment)
    angles = np.cumsum(truth.relative, axis=1)
    arms = np.concatenate(
        [np.full((FRAMES, 1), truth.centres[0]), np.exp(1j * angles[:, :-1]) * truth.centres[1:]], axis=1
    )
    own = truth.segment[moving] - 1
    local = ((truth.points[:, moving] - np.cumsum(arms, axis=1)[:, own]) * np.exp(-1j * angles[:, own])).mean(axis=0)
    return truth.points[:, moving], truth.segment[moving], ChainState(truth.centres, local, angles), truth.relative


def test_each_slide_moves_the_angles_as_in_a_new_fit(posed) -> None:
    points, segment, state, relative = posed
    skin = skin_slides.fit_skin(points, segment, state, np.arange(FRAMES), camera_sd=0.0)
    skin = replace(skin, size=np.ones(len(segment)))
    said = skin.errors(relative)[0]
    said = (said - said.mean(axis=0))[..., : 4 * len(segment)].reshape(FRAMES, JOINTS, -1, 2, 2)
    shape = skin_slides.scale_angles(relative - relative.mean(axis=0), skin.spread, segment)
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


def test_each_slide_moves_the_chain_as_in_a_new_fit(posed) -> None:
    """The frames of the stored chain turn with the joints and the markers."""
    points, segment, state, relative = posed
    skin = skin_slides.fit_skin(points, segment, written(state, segment), np.arange(FRAMES), camera_sd=0.0)
    skin = replace(skin, size=np.ones(len(segment)))
    moved, turned = (part[..., : 4 * len(segment)] for part in skin.stored_chain_errors())
    angles = (skin.errors(relative + first_turn(state, segment))[0][..., : 4 * len(segment)] + turned).mean(axis=0)
    shape = skin_slides.scale_angles(relative - relative.mean(axis=0), skin.spread, segment)
    step = 1e-5
    for mode in range(0, 4 * len(segment), 3):
        marker, which, side = np.unravel_index(mode, (len(segment), 2, 2))
        turn = np.exp(1j * (np.cumsum(relative + first_turn(state, segment), axis=1))[:, segment[marker] - 1])
        slide = np.zeros(points.shape, dtype=complex)
        slide[:, marker] = step * (1, 1j)[side] * shape[:, marker, which] * turn
        both = [written(solved(points + sign * slide, segment, state), segment) for sign in (1, -1)]
        centres = (both[0].centres - both[1].centres) / (2 * step)
        np.testing.assert_allclose(moved[:, :, mode] @ [1, 1j], centres, atol=5e-4 * np.abs(moved).max())
        slope = np.diff(both[0].angles - both[1].angles, axis=1, prepend=0.0).mean(axis=0) / (2 * step)
        np.testing.assert_allclose(angles[:, mode], slope, atol=5e-4 * np.abs(angles).max())


def run(posed, points: np.ndarray, camera_sd: float, rate: float = 50.0) -> np.ndarray:
    _, segment, state, relative = posed
    skin = skin_slides.fit_skin(points, segment, state, np.arange(FRAMES), camera_sd)
    frames, variance = skin_slides.angle_errors(skin, relative, rate)
    return np.stack([np.interp(np.arange(FRAMES), frames, column) for column in variance.reshape(len(frames), -1).T], 1)


def test_without_residuals_and_noise_there_is_no_error(posed) -> None:
    assert run(posed, posed[0], 0.0).max() < 1e-12


def test_the_errors_grow_with_the_slides(posed) -> None:
    """Above a tenth of a millimetre the weights follow the residuals at any scale."""
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
    monkeypatch.setattr(skin_slides, "_CHUNK", 7)
    np.testing.assert_allclose(run(posed, points, 5e-4), whole, rtol=1e-9)


def test_a_centre_of_unknown_covariance_has_no_error(posed) -> None:
    """As the centres of `fit-joints: {estimator: circle}`."""
    _, segment, state, relative = posed
    unknown = np.full((len(state.centres), 2, 2), np.nan)
    skin = skin_slides.skin_from_residuals(state, segment, np.full(len(segment), 1e-3), unknown)
    assert not skin.noise.any()
    assert np.isfinite(skin.errors(relative)[0]).all()
