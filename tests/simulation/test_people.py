"""A person of several bodies: true forces compared with momentum, the regressor and the pinned chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap_id.errors import ConfigError
from mocap_id.geometry import planar
from mocap_id_simulation import Options, PersonOptions, generate
from mocap_id_simulation.bodies import draw_person
from mocap_id_simulation.forces import compute_state, divide_body
from mocap_id_simulation.scene import draw_scene, random_streams

ALL = PersonOptions(hip_gap_mm=14, lumbar_deg=15, arm_swing_deg=40, heel_lift_mm=10, held_mass_kg=2)
ONE_EACH = {name: replace(PersonOptions(), **{name: value}) for name, value in vars(ALL).items()}
STEP = 1e-3
UP = np.array([0.0, 9.81])


def drawn(people: PersonOptions, seed: int = 11, **more):
    return draw_scene("sit-to-stand", Options(seed=seed, repetitions=2, people=people, **more), random_streams(seed))


@pytest.fixture(scope="module", params=["all", *ONE_EACH])
def scene(request):
    return drawn({"all": ALL, **ONE_EACH}[request.param])


def times(scene):
    return np.linspace(1.0, scene.motion.duration - 1.0, 400)


def rates(scene, time):
    """Return velocity and acceleration (T, B, 3) of the bodies' centres of mass and angles, by differences."""
    coms = np.array([part.com for part in scene.divided[0].parts])

    def centres(now):
        pose = scene.at(now).bodies.pose
        return np.concatenate([pose[..., :2] + planar.rotate(pose[..., 2], coms), pose[..., 2:]], axis=-1)

    before, now, after = (centres(time + h) for h in (-STEP, 0.0, STEP))
    return now, (after - 2 * now + before) / STEP**2


def needed(scene, time):
    """Return the force (T, B, 2) and the moment about the plane's origin (T, B) that each body requires."""
    mass = np.array([part.mass for part in scene.divided[0].parts])
    inertia = np.array([part.inertia for part in scene.divided[0].parts])
    place, change = rates(scene, time)
    force = mass[:, None] * (change[..., :2] + UP)
    return force, place[..., 0] * force[..., 1] - place[..., 1] * force[..., 0] + inertia * change[..., 2]


def test_the_total_wrench_is_the_rate_of_momentum_of_all_bodies(scene):
    time = times(scene)
    force, moment = needed(scene, time)
    state = scene.at(time)
    np.testing.assert_allclose(state.wrench_total[:, :2], force.sum(axis=1), atol=0.05)
    np.testing.assert_allclose(state.wrench_total[:, 2], moment.sum(axis=1), atol=0.05)


def test_torques_are_moments_of_all_that_is_beyond_the_joint(scene):
    time = times(scene)
    force, moment = needed(scene, time)
    state = scene.at(time)
    parts, pose = scene.divided[0].parts, state.bodies.pose
    for j in range(5):
        nearer = pose[:, j]
        place = nearer[:, :2] + planar.rotate(nearer[:, 2], np.array(parts[j + 1].centre))
        beyond = force[:, j + 1 :].sum(axis=1)
        about = moment[:, j + 1 :].sum(axis=1) - place[:, 0] * beyond[:, 1] + place[:, 1] * beyond[:, 0]
        if j < 2:  # the chair pushes on the thigh
            arm, push = state.chair_point - place, state.chair_force
            about -= arm[:, 0] * push[:, 1] - arm[:, 1] * push[:, 0]
            np.testing.assert_allclose(state.joint_xy[:, j], place, atol=1e-12)
        np.testing.assert_allclose(state.bodies.tau[:, j], about, atol=0.05)
    np.testing.assert_array_equal(state.tau, state.bodies.tau[:, :3])


def test_velocities_and_accelerations_are_those_of_the_poses(scene):
    time = times(scene)
    before, now, after = (scene.at(time + h).bodies for h in (-STEP, 0.0, STEP))
    np.testing.assert_allclose(now.velocity, (after.pose - before.pose) / (2 * STEP), atol=1e-3)
    np.testing.assert_allclose(now.acceleration, (after.velocity - before.velocity) / (2 * STEP), atol=1e-3)


def test_parameters_and_accelerations_give_the_wrench_by_the_regressor(scene):
    """Uses each body separately, with the motion of its frame: columns for m, mx, my and Izz."""
    state = scene.at(times(scene))
    pose, change, rate = state.bodies.pose, state.bodies.acceleration, state.bodies.velocity
    total = np.zeros((len(pose), 3))
    for i, part in enumerate(scene.divided[0].parts):
        p, lift = pose[:, i, :2], change[:, i, :2] + UP
        r = planar.rotate(pose[:, i, 2], np.array(part.com))
        turned = np.stack([-r[:, 1], r[:, 0]], axis=1)
        bent = change[:, i, 2:] * turned - rate[:, i, 2:] ** 2 * r
        cross = lambda a, b: a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]  # noqa: E731
        total[:, :2] += part.mass * (lift + bent)
        total[:, 2] += part.mass * (cross(p, lift) + cross(p, bent) + cross(r, lift))
        total[:, 2] += part.about_origin * change[:, i, 2]
    np.testing.assert_allclose(total, state.wrench_total, atol=1e-8)


@pytest.mark.parametrize("seed", range(12))
def test_the_bodies_together_are_the_pinned_one(seed):
    whole = draw_person(np.random.default_rng(seed))
    apart, held = divide_body(np.random.default_rng(seed), whole, 2.0)
    assert held.mass == pytest.approx(whole.mass + 2.0)
    names = apart.names
    assert names == ("foot", "shank", "thigh", "pelvis", "trunk", "arms", "weight")
    assert apart.parts[names.index("arms")].mass == pytest.approx(0.1 * whole.mass, rel=0.11)
    assert all(part.mass > 0.4 and part.inertia > 0 for part in apart.parts)
    for link, parts in ((whole.links[3], apart.parts[3:6]), (held.links[3], apart.parts[3:])):
        mass = np.array([part.mass for part in parts])
        com = np.array([part.com for part in parts]) + apart.in_segment[3 : 3 + len(parts)]
        assert mass.sum() == pytest.approx(link.mass)
        np.testing.assert_allclose(mass @ com / link.mass, link.com, atol=1e-12)
        about = sum(part.inertia for part in parts) + mass @ (com**2).sum(axis=1)
        assert about == pytest.approx(link.about_origin)


def test_a_trace_of_everything_is_the_pinned_chain():
    scene = drawn(PersonOptions(1e-6, 1e-6, 1e-6, 1e-6, 1e-6))
    free, pinned = scene.at(times(scene)), compute_state(scene.body, scene.motion, scene.chair, times(scene))
    for name in ("q", "qd", "qdd", "joint_xy", "com", "wrench_total", "wrench", "tau", "chair_force", "chair_point"):
        np.testing.assert_allclose(getattr(free, name), getattr(pinned, name), atol=1e-4, err_msg=name)
    plain = drawn(PersonOptions())
    assert plain.divided is None
    np.testing.assert_allclose(free.tau, plain.at(times(scene)).tau, atol=1e-3)


def test_a_weight_alone_leaves_the_chain_on_its_pins():
    scene = drawn(ONE_EACH["held_mass_kg"])
    free, pinned = scene.at(times(scene)), compute_state(scene.body, scene.motion, scene.chair, times(scene))
    np.testing.assert_allclose(free.tau, pinned.tau, atol=1e-6)
    np.testing.assert_allclose(free.wrench, pinned.wrench, atol=1e-6)
    assert scene.body.mass == pytest.approx(drawn(PersonOptions()).body.mass + 2)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["normal", "dynamic", "stable"])
@pytest.mark.parametrize("seed", range(3))
def test_the_centre_of_pressure_stays_inside_the_foot(seed, strategy):
    scene = drawn(ALL, seed, strategy=strategy)
    state = scene.at(np.arange(0, scene.motion.duration, 0.01))
    low, high = scene.body.support
    assert low + 0.02 < state.cop_x.min()
    assert state.cop_x.max() < high - 0.02
    assert state.wrench[:, 1].min() > 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_ranges_are_about_what_was_asked_for(seed):
    scene = drawn(ALL, seed)
    moves = scene.divided[1].at(np.arange(0, scene.motion.duration, 0.01))[0]
    foot, _, _, x, y, _, bend, swing = np.ptp(moves, axis=0)
    low, high = scene.body.support
    assert 1e3 * max(x, y) == pytest.approx(14, rel=0.4)
    assert np.degrees(bend) == pytest.approx(15, rel=0.3)
    assert np.degrees(swing) == pytest.approx(40, rel=0.3)
    assert 1e3 * np.sin(foot) * (high - low) == pytest.approx(10, rel=0.25)


def test_a_given_motion_has_no_room_for_people():
    options, motion = Options(people=ALL), drawn(PersonOptions()).motion
    with pytest.raises(ConfigError, match="`people` is set and a motion is given"):
        generate("sit-to-stand", options, motion)


@pytest.mark.parametrize("name", vars(ALL))
def test_a_value_out_of_range_is_named(name):
    for value in (-1.0, 1e4, float("nan")):
        with pytest.raises(ConfigError, match=f"simulate: `people`: `{name}` is .* expected 0"):
            PersonOptions(**{name: value})
