"""Springs on several joints: weights against the identification's regressor, the search against trying everything."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.dynamics.regressor import planar_regressor, planar_torque_regressor
from mocap_id_assist.springs import (
    ChainMasses,
    SpringPlace,
    SubWorkspace,
    build_graph,
    find_held_postures,
    prescribe_several,
    sample_postures,
)
from mocap_id_assist.workspace import JointLimits, PlanarArm

CENTRES = np.array([[0.0, 1.5], [0.0, 0.31]])
MASSES = np.array([[2.0, 0.0, 0.27], [1.57, 0.0, 0.30]])
ARM, WEIGHTS = PlanarArm.exact(CENTRES, np.array([0.0, 0.28])), ChainMasses(CENTRES, MASSES)
LIMITS = JointLimits.given(np.radians([90.0, -130.0]), np.radians([270.0, 0.0]))
STRENGTH = np.array([[-4.0, 4.0], [-2.0, 2.0]])
NOWHERE = np.zeros((0, 2))


def test_gravity_is_that_of_the_identification() -> None:
    random = np.random.default_rng(3)
    centres, masses = random.normal(size=(3, 2)), random.normal(size=(3, 4))
    q = random.uniform(-3, 3, (20, 3))
    still = np.zeros_like(q)
    regressor = planar_torque_regressor(centres, q, planar_regressor(centres, q, still, still, 9.5))
    full = np.concatenate([np.zeros(4), masses.ravel()])
    ours = ChainMasses(centres, masses[:, :3], 9.5).torques(q)
    np.testing.assert_allclose(ours, regressor @ full, atol=1e-11)


def test_one_joint_of_a_chain_is_the_chain_with_the_others_kept() -> None:
    posture = np.array([2.0, -0.8])
    one = WEIGHTS.one_joint(0, posture, (0.0, 3.0), (-1.0, 1.0))
    angle = np.linspace(0, 3, 11)
    q = np.tile(posture, (11, 1))
    q[:, 0] = angle
    np.testing.assert_allclose(one.gravity(angle), WEIGHTS.torques(q)[:, 0], atol=1e-12)


def test_a_search_in_two_numbers_finds_what_trying_everything_finds() -> None:
    places = [SpringPlace((0,), 8.0)]
    sampled = sample_postures(ARM, WEIGHTS, LIMITS, places, NOWHERE, count=1024)
    found = prescribe_several(sampled, places, STRENGTH)
    most = 0
    for stiffness in np.linspace(0, 8, 41):
        for rest in np.linspace(-2 * np.pi, 2 * np.pi, 91):
            needed = sampled.gravity.copy()
            needed[:, 0] += stiffness * (sampled.stretch[:, 0] - rest)
            held = np.all(np.abs(needed) <= STRENGTH[:, 1], axis=1)
            most = max(most, len(np.unique(sampled.cell[held])))
    assert found.helps
    assert found.area >= (most - 0.005 * sampled.cells - 1) * sampled.size
    assert found.area <= most * sampled.size + found.gap + 0.01 * found.reachable


def test_the_area_is_counted_from_what_the_springs_hold() -> None:
    places = [SpringPlace((0,), 15.0), SpringPlace((1,), 6.0)]
    sampled = sample_postures(ARM, WEIGHTS, LIMITS, places, NOWHERE, count=1024)
    found = prescribe_several(sampled, places, STRENGTH, boxes=3000)
    held = find_held_postures(sampled, places, STRENGTH, found)
    assert found.area == pytest.approx(len(np.unique(sampled.cell[held])) * sampled.size, rel=1e-12)
    assert found.without < found.area <= found.reachable
    assert found.area + found.gap <= found.reachable + 0.01
    assert found.gap >= 0


def test_a_spring_that_is_soft_beside_the_stiffest_allowed_is_told_and_counted() -> None:
    places = [SpringPlace((0,), 8000.0)]
    sampled = sample_postures(ARM, WEIGHTS, LIMITS, places, NOWHERE, count=512)
    found = prescribe_several(sampled, places, STRENGTH, boxes=8000)
    held = find_held_postures(sampled, places, STRENGTH, found)
    assert found.helps
    assert 0 < found.stiffness[0] < 8.0
    assert np.isfinite(found.rest).all()
    assert found.area == pytest.approx(len(np.unique(sampled.cell[held])) * sampled.size, rel=1e-12)


def test_two_springs_are_worth_at_least_as_much_as_one() -> None:
    one, two = [SpringPlace((0,), 8.0)], [SpringPlace((0,), 8.0), SpringPlace((0, 1), 4.0)]
    areas = []
    for places in (one, two):
        sampled = sample_postures(ARM, WEIGHTS, LIMITS, places, NOWHERE, count=1024)
        areas.append(prescribe_several(sampled, places, STRENGTH, boxes=4000).area)
    assert areas[1] >= areas[0]


def test_the_strong_need_no_springs() -> None:
    places = [SpringPlace((0,), 15.0), SpringPlace((1,), 6.0)]
    sampled = sample_postures(ARM, WEIGHTS, LIMITS, places, NOWHERE, count=512)
    found = prescribe_several(sampled, places, 50 * STRENGTH)
    assert not found.helps
    assert found.area == pytest.approx(found.reachable)
    assert not found.stiffness.any()


def test_a_required_point_is_held_or_refused() -> None:
    places, point = [SpringPlace((0,), 15.0), SpringPlace((1,), 6.0)], np.array([[-0.45, 1.3]])
    sampled = sample_postures(ARM, WEIGHTS, LIMITS, places, point, count=1024)
    there = sampled.cell >= sampled.cells
    np.testing.assert_allclose(sampled.tips[there], np.tile(point, (there.sum(), 1)), atol=2e-4)
    found = prescribe_several(sampled, places, STRENGTH, boxes=4000)
    assert find_held_postures(sampled, places, STRENGTH, found)[there].any()
    with pytest.raises(ValueError, match="no springs"):
        prescribe_several(sampled, places, 1e-3 * STRENGTH, boxes=200)
    with pytest.raises(ValueError, match="cannot be reached"):
        sample_postures(ARM, WEIGHTS, LIMITS, places, np.array([[2.0, 1.0]]))


def test_masses_that_cannot_be() -> None:
    with pytest.raises(ValueError, match="zero"):
        ChainMasses(CENTRES, np.zeros((2, 3)))
    with pytest.raises(ValueError, match="not finite"):
        ChainMasses(CENTRES, np.full((2, 3), np.nan))


def test_ways_go_through_overlaps_alone() -> None:
    angle = np.linspace(0, 1, 101)[:, None]

    def node(name: str, low: float, high: float) -> SubWorkspace:
        held = (angle[:, 0] >= low) & (angle[:, 0] <= high)
        return SubWorkspace(name, (name,), np.ones(1), np.zeros(1), held)

    found = build_graph([node("a", 0, 0.4), node("b", 0.3, 0.7), node("c", 0.6, 0.8), node("d", 0.9, 1.0)], angle)
    assert {between for between, _, _ in found.switches} == {(0, 1), (1, 2)}
    assert angle[found.switches[0][2], 0] == pytest.approx(0.35, abs=0.011)
    assert found.find_path(0, 2) == (0, 1, 2)
    assert found.find_path(0, 3) is None
