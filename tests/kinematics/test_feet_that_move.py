"""Place of an ankle whose foot turns about the toes, from the measured poses of foot and shank."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.arrays import ComplexArray, FloatArray
from mocap_id.kinematics.base_motion import find_moving_markers
from mocap_id.kinematics.clusters import locate_ankle

ANKLE, SHANK_ANKLE = 0.02 + 0.09j, 0.004 - 0.002j  # m, in the frames of foot and shank
TOE = -0.15 + 0.0j
RATE = 100.0

Frame = tuple[ComplexArray, FloatArray]


def frames(lift: float, noise: float = 0.0, arc: float = np.radians(25), seed: int = 0) -> tuple[Frame, Frame]:
    """Origin and angle of foot and shank: five rises in which the foot turns by up to ``lift``, rad, about the toes."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0, 10 * np.pi, 2000)
    foot = lift * np.sin(phase / 2) ** 2
    shank = foot - arc * np.sin(phase) ** 2
    origin = TOE - np.exp(1j * foot) * TOE
    ankle = origin + np.exp(1j * foot) * ANKLE

    def jitter() -> ComplexArray:
        return np.asarray(noise * (rng.normal(size=len(phase)) + 1j * rng.normal(size=len(phase))))

    return (origin + jitter(), foot), (ankle - np.exp(1j * shank) * SHANK_ANKLE + jitter(), shank)


def held_still(foot: Frame, shank: Frame) -> complex:
    """The ankle of a fit that holds the foot still, in the plane frame."""
    columns = np.column_stack([np.ones(len(foot[1]), dtype=complex), -np.exp(1j * shank[1])])
    return complex(np.linalg.lstsq(columns, shank[0], rcond=None)[0][0])


def test_the_ankle_is_where_a_fit_with_a_still_foot_does_not_find_it() -> None:
    foot, shank = frames(np.radians(3))
    start = held_still(foot, shank)
    assert abs(start - ANKLE) > 0.005
    place = locate_ankle(foot, shank, start)
    assert place is not None
    assert abs(place[0] - ANKLE) < 1e-6
    assert abs(place[1] - SHANK_ANKLE) < 1e-6


def test_its_standard_deviation_is_that_of_errors_that_recur() -> None:
    """Three independent observations of noise of 0.5 mm: the rms error is the stated one within its own uncertainty."""
    off, sd = [], []
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        foot, shank = frames(np.radians(3))
        constant = 5e-4 * (rng.normal(size=3) + 1j * rng.normal(size=3))
        slide = np.repeat(constant, [667, 667, 666])  # one error in each third of the trial
        place = locate_ankle(foot, (shank[0] + slide, shank[1]), ANKLE + 0.004)
        assert place is not None
        off.append(abs(place[0] - ANKLE))
        sd.append(place[2])
    ratio = np.sqrt(np.mean(np.square(off)) / 2) / np.sqrt(np.mean(np.square(sd)))
    assert 0.2 < ratio < 1.5


def test_an_ankle_that_hardly_turns_stays_where_the_joint_fit_placed_it() -> None:
    foot, shank = frames(np.radians(3), noise=1e-3, arc=np.radians(0.1))
    start = ANKLE + 0.005
    foot = foot[0], np.zeros_like(foot[1])
    place = locate_ankle(foot, (shank[0], np.zeros_like(shank[1])), start)
    assert place is not None
    assert abs(place[0] - start) < 0.001
    assert place[2] == pytest.approx(0.01, rel=0.05)


def test_an_ankle_that_does_not_turn_at_all_stays_too() -> None:
    foot, shank = frames(np.radians(3), arc=0.0)
    start = ANKLE + 0.005
    place = locate_ankle(foot, shank, start)
    assert place is not None
    assert abs(place[0] - start) < 1e-4


@pytest.mark.parametrize("slide", [0.01 + 0.0j, 0.02j, -0.02 + 0.01j])
def test_skin_that_slides_on_a_foot_at_rest_does_not_move_the_ankle(slide: complex) -> None:
    """Heel markers that slide with the shank turn and move the measured foot; the shank shows an ankle at rest."""
    (_, still), shank = frames(0.0, noise=3e-4)
    share = np.sin(np.linspace(0, 10 * np.pi, 2000)) ** 2
    turned = still + np.angle(0.25 + share * slide)
    foot = share * slide / 2 + TOE - np.exp(1j * turned) * TOE, turned
    place = locate_ankle(foot, shank, ANKLE)
    assert place is not None
    assert abs(place[0] - ANKLE) < 0.001


def test_the_turn_of_the_foot_limits_how_far_the_ankle_is_moved() -> None:
    """A heel that rises by 5 mm does not justify a place of the ankle that is 15 mm away."""
    foot, shank = frames(0.005 / 0.25)
    place = locate_ankle(foot, shank, ANKLE + 0.015)
    assert place is not None
    assert 0.001 < abs(place[0] - ANKLE - 0.015) < 0.0051


def test_too_few_frames_place_nothing() -> None:
    foot, shank = frames(np.radians(3))
    unseen = np.full_like(shank[1], np.nan)
    unseen[:5] = shank[1][:5]
    assert locate_ankle(foot, (shank[0], unseen), ANKLE) is None


def base_markers(heel: float, noise: float = 5e-4) -> np.ndarray:
    """Two markers on a foot whose heel rises, one at its toe, and two on the plate, (F, 5, 2)."""
    rng = np.random.default_rng(1)
    phase = np.linspace(0, 10 * np.pi, 2000)
    still = np.array([[0.1, 0.05], [0.08, 0.09], [-0.14, 0.04], [-0.2, 0.0], [0.3, 0.0]])
    points = np.broadcast_to(still, (2000, 5, 2)) + noise * rng.normal(size=(2000, 5, 2))
    points[:, :2, 1] += heel * np.sin(phase)[:, None] ** 2
    return points


def test_only_markers_on_feet_that_move_show_the_foot() -> None:
    assert find_moving_markers(base_markers(0.01), RATE).tolist() == [True, True, False, False, False]


def test_feet_that_stand_still_and_single_markers_that_move_are_no_foot() -> None:
    assert not find_moving_markers(base_markers(0.0), RATE).any()
    loose = base_markers(0.0)
    loose[:, 0, 1] += 0.01 * np.sin(np.linspace(0, 10 * np.pi, 2000)) ** 2
    assert not find_moving_markers(loose, RATE).any()
    assert not find_moving_markers(np.full((500, 3, 2), np.nan), RATE).any()
    assert find_moving_markers(np.zeros((500, 0, 2)), RATE).shape == (0,)
    hidden = base_markers(0.01)
    hidden[:, 3] = np.nan
    assert find_moving_markers(hidden, RATE).tolist() == [True, True, False, False, False]
