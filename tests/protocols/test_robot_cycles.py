"""Cycles of a robot joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_id.protocols.movement import find_robot_cycles

TIME = np.arange(0, 12, 0.01)


def swing(start: float, end: float, period: float = 2.0) -> np.ndarray:
    moving = (start <= TIME) & (end >= TIME)
    return np.where(moving, 0.8 * np.sin(2 * np.pi * (TIME - start) / period), 0.0)[:, None]


def test_every_cycle_begins_where_the_last_ends() -> None:
    found = find_robot_cycles(TIME, swing(1.0, 11.0))
    assert len(found) == 5
    np.testing.assert_allclose([rep.start for rep in found], [1, 3, 5, 7, 9], atol=0.02)
    np.testing.assert_allclose([rep.end for rep in found], [3, 5, 7, 9, 11], atol=0.02)
    assert all(rep.complete for rep in found)
    assert all(np.isnan([rep.seat_off, rep.stand, rep.seat_on]).all() for rep in found)


def test_direction_and_middle_do_not_matter() -> None:
    assert len(find_robot_cycles(TIME, 2.0 - swing(1.0, 11.0))) == 5


def test_a_cut_cycle_is_incomplete() -> None:
    found = find_robot_cycles(TIME[:820], swing(1.0, 11.0)[:820])
    assert [rep.complete for rep in found] == [True, True, True, False]
    assert found[-1].why == "the recording ends within the cycle"


def test_noise_and_gaps_do_not_add_cycles() -> None:
    q = swing(1.0, 11.0) + 0.02 * np.random.default_rng(0).normal(size=(len(TIME), 1))
    q[400:410] = np.nan
    assert len(find_robot_cycles(TIME, q)) == 5


def test_the_joint_that_moves_most_decides() -> None:
    q = np.column_stack([0.1 * np.sin(9 * TIME), swing(1.0, 11.0)])
    assert len(find_robot_cycles(TIME, q)) == 5


@pytest.mark.parametrize("q", [np.zeros((len(TIME), 1)), np.full((len(TIME), 2), np.nan)], ids=["at rest", "unknown"])
def test_no_movement_no_cycles(q: np.ndarray) -> None:
    assert find_robot_cycles(TIME, q) == ()


@pytest.mark.recordings
def test_the_simulated_robot(recordings: Path) -> None:
    arrays = np.load(recordings / "simulated" / "ur5-elbow-fast" / "truth.npz")
    found = find_robot_cycles(arrays["t"], arrays["q"])
    np.testing.assert_allclose([rep.start for rep in found], [1, 3, 5, 7, 9], atol=0.01)
    np.testing.assert_allclose([rep.end for rep in found], [3, 5, 7, 9, 11], atol=0.01)
