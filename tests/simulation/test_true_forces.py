"""True forces, checked independently by momentum, energy and the regressor."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.dynamics.regressor import planar_regressor, structural_base
from mocap_id.geometry import inverse_dynamics, planar
from mocap_id_simulation import Options
from mocap_id_simulation.bodies import draw_person, draw_robot
from mocap_id_simulation.forces import UP
from mocap_id_simulation.scene import draw_scene, random_streams

KINDS = ["sit-to-stand", "robot"]
STEP = 1e-3


@pytest.fixture(params=KINDS, scope="module")
def scene(request):
    return draw_scene(request.param, Options(seed=11, repetitions=2), random_streams(11))


def times(scene):
    return np.linspace(1.0, scene.motion.duration - 1.0, 400)


def masses_and_places(scene, time):
    """Return centres of mass (T, L, 2) and angles (T, L) of every link."""
    q = scene.motion.at(time)[0]
    links = np.arange(len(scene.body.links))
    angle, _ = planar.segment_poses(q, scene.body.centres)
    return planar.marker_positions(q, scene.body.centres, links, scene.body.coms), angle


def momentum(scene, time):
    """Return linear momentum (T, 2) and angular momentum (T,) about the origin, by central differences."""
    before, turned_before = masses_and_places(scene, time - STEP)
    after, turned_after = masses_and_places(scene, time + STEP)
    now, _ = masses_and_places(scene, time)
    velocity, spin = (after - before) / (2 * STEP), (turned_after - turned_before) / (2 * STEP)
    mass = scene.body.masses
    own = np.array([link.inertia for link in scene.body.links])
    swept = now[..., 0] * velocity[..., 1] - now[..., 1] * velocity[..., 0]
    return np.einsum("l,tlx->tx", mass, velocity), swept @ mass + spin @ own


def test_the_total_wrench_is_the_rate_of_momentum_less_gravity(scene):
    time = times(scene)
    state = scene.at(time)
    (linear_before, turned_before), (linear_after, turned_after) = (momentum(scene, time + h) for h in (-STEP, STEP))
    force = (linear_after - linear_before) / (2 * STEP)
    force[:, 1] += 9.81 * scene.body.mass
    weight_arm = masses_and_places(scene, time)[0][..., 0] @ scene.body.masses
    moment = (turned_after - turned_before) / (2 * STEP) + 9.81 * weight_arm
    np.testing.assert_allclose(state.wrench_total[:, :2], force, atol=0.05)
    np.testing.assert_allclose(state.wrench_total[:, 2], moment, atol=0.05)


def test_ground_and_chair_add_up(scene):
    state = scene.at(times(scene))
    if scene.chair is None:
        np.testing.assert_array_equal(state.wrench, state.wrench_total)
        return
    point, force = state.chair_point, state.chair_force
    moment = point[:, 0] * force[:, 1] - point[:, 1] * force[:, 0]
    np.testing.assert_allclose(state.wrench + np.column_stack([force, moment]), state.wrench_total, atol=1e-9)


def test_work_of_torques_and_chair_is_the_change_of_energy(scene):
    time = np.linspace(1.0, scene.motion.duration - 1.0, 20001)
    state = scene.at(time)
    before, after = masses_and_places(scene, time - STEP), masses_and_places(scene, time + STEP)
    velocity, spin = (after[0] - before[0]) / (2 * STEP), (after[1] - before[1]) / (2 * STEP)
    own = np.array([link.inertia for link in scene.body.links])
    height = masses_and_places(scene, time)[0][..., 1]
    energy = 0.5 * (velocity**2).sum(axis=2) @ scene.body.masses + 0.5 * spin**2 @ own
    energy = energy + 9.81 * height @ scene.body.masses
    power = (state.tau * state.qd).sum(axis=1)
    if scene.chair is not None:
        power = power + (state.chair_force * np.gradient(state.chair_point, time, axis=0)).sum(axis=1)
    work = np.concatenate([[0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(time))])
    np.testing.assert_allclose(work, energy - energy[0], atol=0.02)


def test_the_chair_as_an_applied_wrench_gives_the_same_ground_and_torques():
    """The recursion with the seat's wrench on link 2 agrees with subtracting that wrench."""
    scene = draw_scene("sit-to-stand", Options(seed=12, repetitions=2), random_streams(12))
    state = scene.at(times(scene))
    angle, _ = planar.segment_poses(state.q, scene.body.centres)
    local = planar.rotate(-angle[:, 2], state.chair_force)
    x, y = scene.chair.point
    applied = np.zeros((len(state.time), 4, 6))
    applied[:, 2, :2] = local
    applied[:, 2, 5] = x * local[:, 1] - y * local[:, 0]
    chain = planar.spatial_chain(scene.body.centres)
    loads = inverse_dynamics(
        chain, scene.body.inertias, state.q, state.qd, state.qdd, base_acceleration=UP, applied=applied
    )
    np.testing.assert_allclose(loads.base_wrench[:, [0, 1, 5]], state.wrench, atol=1e-8)
    np.testing.assert_allclose(loads.effort, state.tau, atol=1e-8)


def test_the_regressor_of_the_identification_agrees(scene):
    state = scene.at(times(scene))
    full = [[link.mass, *(link.mass * np.array(link.com)), link.about_origin] for link in scene.body.links]
    regressor = planar_regressor(scene.body.centres, state.q, state.qd, state.qdd)
    np.testing.assert_allclose(regressor @ np.ravel(full), state.wrench_total, atol=1e-8)


@pytest.mark.parametrize("make", [draw_person, draw_robot])
def test_base_parameters_are_those_of_the_regrouping(make):
    body = make(np.random.default_rng(7))
    full = np.ravel([[link.mass, *(link.mass * np.array(link.com)), link.about_origin] for link in body.links])
    names, values = body.base_parameters()
    np.testing.assert_allclose(structural_base(body.centres).regrouping @ full, values, rtol=1e-9, atol=1e-12)
    assert len(names) == len(values) == 3 * len(body.links) - 1


@pytest.mark.parametrize("seed", range(8))
def test_bodies_keep_to_winter_within_a_tenth(seed):
    body = draw_person(np.random.default_rng(seed))
    told = body.description["subject"]
    used, winter = told["fractions_used"], told["winter_fractions"]
    for name, value in used.items():
        assert abs(value / winter[name] - 1) <= 0.1 + 1e-12
    assert sum(value for name, value in used.items() if name.startswith("m_")) == pytest.approx(1)
    assert body.mass == pytest.approx(told["mass_kg"])
