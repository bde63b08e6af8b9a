"""Markers exchanged between neighbouring bodies of a chain in space."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.arrays import IntArray
from mocap_id.kinematics.clusters import Constraints
from mocap_id.kinematics.space.bodies import SpatialBodies, exchange_markers
from mocap_id_simulation import simulate_chain

TRIAL = simulate_chain(5, kinds="SS", duration=5)
COUNT = len(TRIAL.names)


def exchanged(assignment: IntArray, constraints: Constraints) -> list[list[int]]:
    sorter = SpatialBodies(TRIAL.positions[::5], np.arange(COUNT), constraints)
    bodies = [sorter.body(np.flatnonzero(assignment == k)) for k in range(3)]
    return [body.markers.tolist() for body in exchange_markers(sorter, bodies)]


def truth() -> list[list[int]]:
    return [np.flatnonzero(TRIAL.assignment == k).tolist() for k in range(3)]


@pytest.mark.parametrize("swapped", [[(4, 8)], [(0, 5)]])
def test_two_markers_on_the_wrong_sides_go_back(swapped: list[tuple[int, int]]) -> None:
    wrong = TRIAL.assignment.copy()
    for a, b in swapped:
        wrong[[a, b]] = wrong[[b, a]]
    assert exchanged(wrong, Constraints.of(COUNT)) == truth()


def test_right_bodies_stay_as_they_are() -> None:
    assert exchanged(TRIAL.assignment, Constraints.of(COUNT)) == truth()


def test_what_the_user_wants_together_stays_together() -> None:
    wrong = TRIAL.assignment.copy()
    wrong[4] = 2
    found = exchanged(wrong, Constraints.of(COUNT, together=[[4, 8]]))
    assert any({4, 8} <= set(body) for body in found)
