"""A chain with cylinders: torques, depth and pressures, and the controller over its sub-workspaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.cylinder import Cylinder, PressureLimits, Setting
from mocap_id_assist.controllers import (
    CHAIN_STEP,
    Actuator,
    AssistedChain,
    Node,
    Rules,
    Tour,
    compute_node_depths,
    find_pressures,
    find_unsafe_changes,
    simulate_chain_tour,
)
from mocap_id_assist.devices import find_held_angles, find_task_setting
from mocap_id_assist.springs import OneJoint

CYLINDER = Cylinder(0.03, 2.835e-4, 2.552e-4, 0.09, 0.09, 0.08, np.radians(140), 1.2, 0.2, 0.02)
JOINT = OneJoint(4.336, 0.0, 0.0, np.radians(140), -2.2, 2.2)
LIMITS = PressureLimits(101_325.0, 7e5)
ACTUATOR = Actuator(CYLINDER, LIMITS, (0,), np.full(2, 0.2), np.full(2, 0.4), 293.15)
ONE = AssistedChain(JOINT.gravity, np.array([[-2.2, 2.2]]), np.zeros(1), np.radians([140.0]), (ACTUATOR,))
RULES = Rules(np.radians(2.0), np.radians(3.0), np.radians(60.0), 1.0)


def two_joints(strength: float) -> AssistedChain:
    """The same joint twice, which do not act on each other."""

    def gravity(q: FloatArray) -> FloatArray:
        return np.asarray(JOINT.gravity(q))

    torque = np.array([[-strength, strength]] * 2)
    actuators = (ACTUATOR, replace(ACTUATOR, joints=(1,)))
    return AssistedChain(gravity, torque, np.zeros(2), np.full(2, JOINT.upper), actuators)


def test_a_chain_of_one_joint_is_the_joint() -> None:
    low, high = np.radians([60.0, 130.0])
    angle = np.linspace(low, high, 41)
    one = find_task_setting(JOINT, CYLINDER, LIMITS, [(low, high)])
    found = find_pressures(ONE, angle[:, None])
    assert one is not None
    assert found is not None
    np.testing.assert_allclose(found[0][0], one[0].pressures(), rtol=1e-6)
    assert found[1] * (0.1 * 2.2 + CYLINDER.coulomb) == pytest.approx(one[1], rel=1e-6)
    grid = np.linspace(0.0, JOINT.upper, 500)
    depth = ONE.depth(grid[:, None], found[0])
    np.testing.assert_array_equal(depth > 1e-4, find_held_angles(JOINT, CYLINDER, one[0], grid) & (depth > 1e-4))
    held = find_held_angles(JOINT, CYLINDER, one[0], grid)
    edge = grid[np.flatnonzero(np.diff(held.astype(int)))[0]]
    near = np.flatnonzero(np.abs(grid - edge) < 0.05)
    np.testing.assert_allclose(np.abs(depth[near]), np.abs(grid[near] - edge), atol=0.01)
    assert find_pressures(ONE, np.radians([[150.0]])) is None


def test_a_device_across_two_joints_pulls_both() -> None:
    both = replace(two_joints(2.2), actuators=(replace(ACTUATOR, joints=(0, 1)),))
    q, gas = np.array([[0.4, 0.7]]), np.array([[[3e5, 1.5e5]]])
    pull = CYLINDER.torque(np.array([1.1]), Setting(3e5, 1.5e5))
    np.testing.assert_allclose(both.holding_torques(q, gas), JOINT.gravity(q) - pull[:, None], rtol=1e-12)


def tour(lag: float, speed: float = 60.0) -> tuple[AssistedChain, list[Node], FloatArray, Tour]:
    chain = two_joints(2.2)
    slow = tuple(replace(one, fill=np.full(2, lag), vent=np.full(2, lag)) for one in chain.actuators)
    chain = replace(chain, actuators=slow)
    stops = np.radians([[15.0, 15.0], [120.0, 110.0]])
    meeting = np.radians([[33.0, 33.0], [45.0, 45.0]])
    nodes = []
    for name, stop in zip(("down", "up"), stops, strict=True):
        found = find_pressures(chain, np.concatenate([stop[None], meeting]))
        assert found is not None
        assert found[1] > 0
        nodes.append(Node(name, found[0]))
    grid = np.stack(np.meshgrid(*[np.linspace(0, JOINT.upper, 33)] * 2), axis=-1).reshape(-1, 2)
    moved, visits, no_path = simulate_chain_tour(chain, nodes, stops, grid, replace(RULES, speed=np.radians(speed)))
    assert [stop for stop, _, _ in visits] == [0, 1, 0]
    assert not no_path
    return chain, nodes, grid, moved


def test_the_controller_changes_in_the_overlap_and_every_posture_is_held() -> None:
    chain, nodes, grid, moved = tour(0.05, speed=40.0)
    assert [(before, after) for _, before, after in moved.switches] == [(0, 1), (1, 0)]
    assert moved.excess.max() == 0
    assert np.abs(np.diff(moved.q, axis=0)).max() <= np.radians(40.0) * CHAIN_STEP + 1e-9
    depth = compute_node_depths(chain, nodes, moved.q)
    for k, before, after in moved.switches:
        assert depth[before, k] < RULES.margin
        assert depth[after, k] > RULES.margin + RULES.hysteresis
    both = (compute_node_depths(chain, nodes, grid) > 0).all(axis=0)
    assert both.any()
    assert not find_unsafe_changes(chain, *nodes, grid[both], 1e-3)[0].any()


def test_pressures_that_settle_slowly_are_seen() -> None:
    assert tour(2.0)[3].excess.max() > 0.2


def test_a_side_that_lags_makes_a_change_unsafe() -> None:
    chain = replace(ONE, actuators=(replace(ACTUATOR, fill=np.array([0.02, 1.0])),))
    low, high = (Node(name, np.array([[p, 0.8 * p]])) for name, p in (("low", 2e5), ("high", 6e5)))
    q = np.linspace(0.2, 2.2, 200)[:, None]
    held = (compute_node_depths(chain, [low, high], q) > 0).all(axis=0)
    assert held.any()
    assert find_unsafe_changes(chain, low, high, q[held], 1e-3)[0].any()
    assert not find_unsafe_changes(ONE, low, high, q[held], 1e-3)[0].any()
