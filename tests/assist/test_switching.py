"""The controller over sub-workspaces: depth, hysteresis, limited torque, and changes that are unsafe."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap_id.dynamics.cylinder import Cylinder, PressureLimits, Setting
from mocap_id_assist.controllers import (
    JOINT_STEP,
    Actuator,
    AssistedJoint,
    JointController,
    Node,
    ReferenceMotion,
    Rules,
    compute_depths,
    map_change,
    plan_tour,
    simulate_joint_tour,
)
from mocap_id_assist.devices import find_held_angles, find_held_range, find_task_setting, find_widest_setting
from mocap_id_assist.springs import OneJoint

CYLINDER = Cylinder(0.03, 2.835e-4, 2.552e-4, 0.09, 0.09, 0.08, np.radians(140), 1.2, 0.2, 0.02)
JOINT = OneJoint(4.336, 0.0, 0.0, np.radians(140), -2.2, 2.2)
LIMITS = PressureLimits(101_325.0, 7e5)
TASKS = (("low", *np.radians([5.0, 44.0])), ("high", *np.radians([34.0, 135.0])))
ACTUATOR = Actuator(CYLINDER, LIMITS, (0,), np.full(2, 0.2), np.full(2, 0.4), 293.15)
PERSON = AssistedJoint(JOINT, 0.11, ACTUATOR)
RULES = Rules(np.radians(2.0), np.radians(3.0), np.radians(60.0), 0.5)
ANGLE = np.linspace(0.0, JOINT.upper, 721)


def controller(settings: dict[str, Setting], rules: Rules = RULES) -> JointController:
    nodes = [Node(name, setting.pressures()[None]) for name, setting in settings.items()]
    held = [find_held_angles(JOINT, CYLINDER, setting, ANGLE) for setting in settings.values()]
    return JointController(tuple(nodes), ANGLE, np.array([compute_depths(each, ANGLE) for each in held]), rules)


def for_tasks(rules: Rules = RULES) -> JointController:
    settings = {}
    for name, low, high in TASKS:
        found = find_task_setting(JOINT, CYLINDER, LIMITS, [(low, high)])
        assert found is not None
        settings[name] = found[0]
    return controller(settings, rules)


def test_depth_is_the_distance_from_the_boundary() -> None:
    angle = np.linspace(0.0, 1.0, 11)
    held = (angle > 0.25) & (angle < 0.75)
    np.testing.assert_allclose(
        compute_depths(held, angle), [-0.3, -0.2, -0.1, 0.1, 0.2, 0.3, 0.2, 0.1, -0.1, -0.2, -0.3]
    )
    assert (compute_depths(angle > -1, angle) == 1.0).all()
    assert compute_depths(angle < 0.45, angle)[0] == pytest.approx(0.5)  # the end of the grid is no boundary


def test_tasks_are_held_with_the_largest_margin() -> None:
    grid = np.linspace(LIMITS.lowest, LIMITS.supply, 61).tolist()
    weak = replace(JOINT, torque_low=-1.0, torque_high=1.0)  # no reserve is left: the margin is the largest
    low, high = np.radians([60.0, 130.0])
    found = find_task_setting(weak, CYLINDER, LIMITS, [(low, high)])
    assert found is not None
    angle = np.linspace(low, high, 41)

    def margin(setting: Setting) -> float:
        needed = [JOINT.gravity(angle) - CYLINDER.at_exponent(n).torque(angle, setting) for n in (1.0, 1.4)]
        return 1.0 - float(np.abs(needed).max())

    assert found[1] == pytest.approx(margin(found[0]), abs=1e-6)
    assert found[1] >= max(margin(Setting(a, b)) for a in grid for b in grid) - 1e-9
    assert find_task_setting(JOINT, CYLINDER, LIMITS, [(low, np.radians(150))]) is None


@pytest.mark.parametrize("required", [(), (0.3, 0.6)])
def test_no_pressures_of_a_grid_hold_more(required: tuple[float, ...]) -> None:
    start = Setting(1.5e5, 1.1e5)
    found = find_widest_setting(JOINT, CYLINDER, LIMITS, start, required)
    best = find_held_range(JOINT, CYLINDER, found, required)
    assert best is not None
    assert find_held_angles(JOINT, CYLINDER, found, np.linspace(*best, 500)).all()
    grid = np.linspace(LIMITS.lowest, LIMITS.supply, 13).tolist()
    parts = [find_held_range(JOINT, CYLINDER, Setting(a, b), required) for a in grid for b in grid]
    assert best[1] - best[0] >= max(part[1] - part[0] for part in parts if part) - np.radians(0.3)
    assert all(best[0] - 0.01 <= at <= best[1] + 0.01 for at in required)


def test_a_tour_is_held_within_the_strength_and_pressures_lag() -> None:
    rules, reference = for_tasks(), plan_tour(TASKS, RULES, np.radians(0.2))
    assert np.abs(reference.velocity).max() < 1.3 * RULES.speed
    tour = simulate_joint_tour(PERSON, rules, reference, 0)
    assert tour.excess.max() == 0.0
    assert tour.torque is not None
    assert np.abs(tour.torque).max() <= 2.2
    assert np.degrees(np.abs(tour.q[:, 0] - reference.angle)[-1]) < 1.0
    (k, before, after), *_ = tour.switches
    assert (before, after) == (0, 1)
    assert rules.may_change(0, 1, tour.q[k, 0])
    target = rules.nodes[1].pressures[0, 0]
    lag = int(ACTUATOR.fill[0] / JOINT_STEP)
    left = (target - tour.pressures[k + lag, 0, 0]) / (target - tour.pressures[k, 0, 0])
    assert left == pytest.approx(np.exp(-1), rel=0.01)


def test_hysteresis_stops_chattering() -> None:
    """A joint that hovers at the boundary by less than the hysteresis changes once; without hysteresis, often."""
    rules = for_tasks()
    ends = [np.degrees(rules.angle[depth > 0][end]) for depth, end in zip(rules.depths, (-1, 0), strict=True)]
    time = JOINT_STEP * np.arange(3000)
    wide = replace(RULES, margin=np.radians(0.5 * (ends[0] - ends[1])), hysteresis=0)
    middle, free = np.radians(ends[0] - 2.0), replace(rules, rules=wide)
    counts = []
    for each, centre in ((rules, middle), (free, np.radians(np.mean(ends)))):
        angle = centre + np.radians(0.7) * np.sin(2 * np.pi * time)
        velocity = np.gradient(angle, JOINT_STEP)
        reference = ReferenceMotion(time, angle, velocity, np.gradient(velocity, JOINT_STEP), ())
        counts.append(len(simulate_joint_tour(PERSON, each, reference, 0).switches))
    assert counts[0] == 1
    assert counts[1] > 5


def test_a_change_at_rest_is_unsafe_only_if_one_side_lags() -> None:
    """Sides that settle together keep the torque between those of both settings; a side that lags loses the arm."""
    settings = {"soft": Setting(3.2e5, 1.1e5), "stiff": Setting(5.8e5, 4.0e5)}
    rules = controller(settings, replace(RULES, margin=0.03, hysteresis=0.05))
    together = replace(PERSON, actuator=replace(ACTUATOR, vent=np.full(2, 0.2)))
    apart = replace(PERSON, actuator=replace(ACTUATOR, fill=np.array([0.05, 0.5]), vent=np.array([0.5, 0.05])))
    for before, after in ((0, 1), (1, 0)):
        one, other = (map_change(each, rules, before, after, 1.0, (21, 11)) for each in (together, apart))
        assert one is not None
        assert other is not None
        still = np.abs(one.states[:, 1]) < 1e-9
        assert still.sum() == 21
        assert not one.unsafe[still].any()
        assert one.missing[still].max() == 0
        assert other.unsafe[still].any()
        assert other.missing.max() > 0.1


def test_a_free_swing_keeps_its_energy() -> None:
    """Without strength and friction: kinetic energy, gravity, gas and atmosphere."""
    cylinder = replace(CYLINDER, coulomb=0.0, viscous=0.0)
    weak, actuator = replace(JOINT, torque_low=-1e-12, torque_high=1e-12), replace(ACTUATOR, cylinder=cylinder)
    person = AssistedJoint(weak, 0.11, actuator)
    setting, n = Setting(4e5, 2e5), cylinder.exponent

    def energy(angle: np.ndarray, velocity: np.ndarray) -> float:
        stored = setting.pressures() * cylinder.compression(angle) * cylinder.volumes(angle) / (n - 1)
        pushed = cylinder.atmosphere * cylinder.volumes(angle)
        weight = -JOINT.sine * np.cos(angle)
        return float((0.5 * 0.11 * velocity**2 + weight + (stored + pushed).sum(axis=-1))[0])

    angle, velocity, seen = np.array([1.5]), np.zeros(1), []
    for _ in range(1500):
        seen.append((energy(angle, velocity), float(angle[0])))
        needed = person.holding_torque(angle, setting.pressures()[None])
        angle, velocity, _torque = person.step(angle, velocity, needed, np.zeros(1))
    energies, angles = np.array(seen).T
    assert np.ptp(angles) > 0.3
    assert not np.isin(angles, person.limits).any()
    assert np.ptp(energies) < 0.02 * JOINT.sine
