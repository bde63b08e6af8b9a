"""Sampling of frames along the motion: many during movement, few at rest."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.kinematics.bundle import frames_along_motion

COUNT = 200


def still(frames: int, like: np.ndarray, seed: int = 0, noise: float = 5e-4) -> np.ndarray:
    """Return frames at rest with camera noise."""
    rng = np.random.default_rng(seed)
    shape = (frames, len(like))
    return like + noise * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))


def swinging(frames: int = 1500, noise: float = 5e-4) -> np.ndarray:
    """Return five markers on an arm that never stops."""
    t = np.arange(frames) / 100
    arm = np.exp(1j * np.stack([0.8 * np.sin(1.3 * t), 0.8 * np.cos(1.3 * t)]))
    points = np.stack([arm[0] * r for r in (0.2, 0.3, 0.4)] + [arm[0] * 0.4 + arm[1] * r for r in (0.2, 0.3)], axis=1)
    return still(frames, points[0], noise=noise) - points[0] + points


@pytest.mark.parametrize("frames", [1, 2, 50, COUNT])
def test_few_frames_are_all_chosen(frames: int) -> None:
    assert frames_along_motion(swinging(frames), COUNT).tolist() == list(range(frames))


@pytest.mark.parametrize("frames", [COUNT + 1, COUNT + 7, 777, 5000])
@pytest.mark.parametrize("rest", [0, 3000])
def test_chosen_frames_are_ascending_and_unique(frames: int, rest: int) -> None:
    moving = swinging(frames)
    points = np.concatenate([moving, still(rest, moving[-1])])
    found = frames_along_motion(points, COUNT)
    assert (np.diff(found) > 0).all()
    assert found[0] >= 0
    assert found[-1] < len(points)
    assert len(found) <= COUNT


@pytest.mark.parametrize("place", [0, 700, 1500])
@pytest.mark.parametrize("rest", [1500, 6000, 24000])
@pytest.mark.parametrize(("noise", "limit"), [(0.0, 0.1), (5e-4, 0.2)])
def test_a_long_rest_gets_a_tenth_of_the_frames(place: int, rest: int, noise: float, limit: float) -> None:
    """With 0.5 mm of noise a little more (measured: 0.14); frames evenly in time would give 0.94."""
    moving = swinging(noise=noise)
    held = still(rest, moving[min(place, 1499)], noise=noise)
    found = frames_along_motion(np.concatenate([moving[:place], held, moving[place:]]), COUNT)
    smeared = (1500 + rest) // 200  # frames at either edge, where the speed window includes motion
    within = ((found >= place + smeared) & (found < place + rest - smeared)).sum()
    assert within <= limit * COUNT + 1
    assert len(found) == COUNT


def test_the_moving_frames_are_the_same_however_long_the_rest() -> None:
    """A longer rest does not change the chosen postures of the motion."""
    moving = swinging(noise=0.0)
    path = np.concatenate([[0], np.cumsum(np.abs(np.diff(moving, axis=0)).mean(axis=1))])
    spread = []
    for rest in (2000, 20000):
        points = np.concatenate([still(rest, moving[0], noise=0.0), moving])
        found = frames_along_motion(points, COUNT)
        travelled = path[found[found >= rest] - rest] / path[-1]
        spread.append(np.quantile(travelled, np.linspace(0.1, 0.9, 9)))
    assert spread[0] == pytest.approx(spread[1], abs=0.02)
    assert spread[1] == pytest.approx(np.linspace(0.1, 0.9, 9), abs=0.03)  # evenly along the path


def test_nine_tenths_of_the_frames_follow_the_path() -> None:
    """Twice the speed for half of the time: two thirds of the path, and half of the tenth."""
    t = np.arange(8000) / 100
    phase = np.where(t < 40, t, 40 + 2 * (t - 40))
    points = np.exp(1j * phase)[:, None] * np.array([0.3, 0.4j])
    points = np.concatenate([np.tile(points[:1], (1000, 1)), points])  # some rest, the reference for the speed
    found = frames_along_motion(points, 1000)
    slow = ((found >= 1000) & (found < 5000)).sum()
    fast = (found >= 5000).sum()
    share = 0.1 * 4000 / 9000
    assert slow / 1000 == pytest.approx(share + 0.9 / 3, abs=0.01)
    assert fast / 1000 == pytest.approx(share + 0.9 * 2 / 3, abs=0.01)


def test_a_still_trial_is_sampled_evenly() -> None:
    found = frames_along_motion(np.zeros((5000, 3)) + 1j, 100)
    assert found == pytest.approx(25 + 50 * np.arange(100), abs=1)


def test_a_marker_never_seen_has_no_effect() -> None:
    moving = swinging()
    unseen = np.full((len(moving), 1), np.nan + 0j)
    assert (
        frames_along_motion(np.concatenate([moving, unseen], axis=1), COUNT) == frames_along_motion(moving, COUNT)
    ).all()


def test_frames_without_markers_count_as_still() -> None:
    moving = swinging()
    points = np.insert(moving, [700] * 1500, np.nan, axis=0)
    found = frames_along_motion(points, COUNT)
    assert ((found >= 700) & (found < 2200)).sum() <= 0.12 * COUNT
    empty = frames_along_motion(np.full((1000, 4), np.nan + 0j), 100)
    assert len(empty) == 100
    assert np.ptp(np.diff(empty)) <= 1


def test_gaps_in_a_translation_change_nothing() -> None:
    """All markers move alike, so it does not matter which are seen."""
    t = np.arange(3000) / 100
    points = np.cumsum(np.abs(np.sin(t)))[:, None] * 1e-3 + np.arange(8) * 0.1j
    holed = points.copy()
    holed[np.random.default_rng(3).uniform(size=points.shape) < 0.2] = np.nan
    assert (frames_along_motion(holed, COUNT) == frames_along_motion(points, COUNT)).all()
