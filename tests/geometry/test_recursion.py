"""Recursive velocities, accelerations and wrenches, compared with derivatives, energy and Newton-Euler."""

from __future__ import annotations

import numpy as np
from geometry_cases import laws, random_chain, random_masses, random_pose, seeds
from hypothesis import given
from hypothesis import strategies as st

from mocap_id.geometry import inverse_dynamics, link_motion, link_wrench, se3, so3, spatial_inertia, spatial_jacobian

STILL = np.zeros(6)


def random_case(seed: int, joints: int):
    rng = np.random.default_rng(seed)
    return rng, random_chain(rng, joints), *rng.normal(size=(3, joints))


@laws
@given(seeds, st.integers(1, 5))
def test_velocities_and_accelerations_are_derivatives_of_the_poses(seed, joints):
    """Eq. 2.50-2.53 along q(t) = q + q̇ t + q̈ t²/2, by central differences."""
    _, chain, q, dq, ddq = random_case(seed, joints)
    step = 1e-4
    times = np.array([-step, 0.0, step])[:, None]
    poses = chain.poses(q + dq * times + ddq * times**2 / 2)
    _, rates, changes = link_motion(chain, q + dq * times + ddq * times**2 / 2, dq + ddq * times, ddq, STILL)
    velocity = se3.vee_twist(se3.inverse(poses[1]) @ (poses[2] - poses[0]) / (2 * step))
    np.testing.assert_allclose(rates[1], velocity, atol=1e-4)
    acceleration = (rates[2] - rates[0]) / (2 * step)
    np.testing.assert_allclose(changes[1], acceleration, atol=1e-4)


@laws
@given(seeds, st.integers(1, 5))
def test_the_recursion_and_the_jacobian_give_one_velocity(seed, joints):
    _, chain, q, dq, ddq = random_case(seed, joints)
    tip = chain.poses(q)[-1]
    body = link_motion(chain, q, dq, ddq, STILL)[1][-1]
    np.testing.assert_allclose(se3.Ad(tip) @ body, spatial_jacobian(chain, q) @ dq, atol=1e-10)


@laws
@given(seeds)
def test_link_wrench_is_newton_and_euler(seed):
    """Eq. 2.55, 2.56: force m a_c, moment J ω̇ + ω × J ω about the centre, moved to the origin."""
    rng = np.random.default_rng(seed)
    mass, centre, inertia = (x[0] for x in random_masses(rng, 1))
    velocity, acceleration = rng.normal(size=(2, 6))
    v, w, dv, dw = *np.split(velocity, 2), *np.split(acceleration, 2)
    force = mass * (dv + np.cross(w, v) + np.cross(dw, centre) + np.cross(w, np.cross(w, centre)))
    moment = inertia @ dw + np.cross(w, inertia @ w) + np.cross(centre, force)
    found = link_wrench(spatial_inertia(mass, centre, inertia), velocity, acceleration)
    np.testing.assert_allclose(found, np.concatenate([force, moment]), atol=1e-10)


@laws
@given(seeds, st.integers(1, 5))
def test_power_of_the_joints_is_the_change_of_energy(seed, joints):
    """Torque times velocity equals the rate of kinetic plus potential energy."""
    rng, chain, q, dq, ddq = random_case(seed, joints)
    mass, centre, about = random_masses(rng, joints + 1)
    up = rng.normal(size=3)
    inertias = spatial_inertia(mass, centre, about)

    def energy(time):
        x, dx = q + dq * time + ddq * time**2 / 2, dq + ddq * time
        _, velocity, _ = link_motion(chain, x, dx, ddq, STILL)
        kinetic = 0.5 * np.einsum("li,lij,lj->", velocity, inertias, velocity)
        return kinetic + (mass * (se3.act(chain.poses(x), centre) @ up)).sum()

    step = 1e-5
    loads = inverse_dynamics(chain, inertias, q, dq, ddq, base_acceleration=np.concatenate([up, np.zeros(3)]))
    rate = (energy(step) - energy(-step)) / (2 * step)
    np.testing.assert_allclose(loads.effort @ dq, rate, rtol=1e-5, atol=1e-4)


@laws
@given(seeds, st.integers(1, 4))
def test_an_applied_wrench_reduces_the_ground_wrench(seed, joints):
    """The wrench of a seat on a link reduces the ground wrench (sign of Γ_E)."""
    rng, chain, q, dq, ddq = random_case(seed, joints)
    inertias = spatial_inertia(*random_masses(rng, joints + 1))
    applied = rng.normal(size=(joints + 1, 6))
    gravity = np.array([0, 9.81, 0, 0, 0, 0])
    free = inverse_dynamics(chain, inertias, q, dq, ddq, base_acceleration=gravity)
    pushed = inverse_dynamics(chain, inertias, q, dq, ddq, base_acceleration=gravity, applied=applied)
    in_world = se3.move_wrench(chain.poses(q), applied).sum(axis=0)
    np.testing.assert_allclose(free.base_wrench - pushed.base_wrench, in_world, atol=1e-9)


@laws
@given(seeds, st.integers(1, 4))
def test_turning_the_world_changes_nothing_inside_the_chain(seed, joints):
    rng, chain, q, dq, ddq = random_case(seed, joints)
    inertias = spatial_inertia(*random_masses(rng, joints + 1))
    turn = so3.exp(rng.normal(size=3))
    up = rng.normal(size=3)
    world = se3.pose(turn, np.zeros(3))
    turned = type(chain)(chain.joints, np.concatenate([world[None] @ chain.placements[:1], chain.placements[1:]]))
    gravity, turned_gravity = (np.concatenate([x, np.zeros(3)]) for x in (up, turn @ up))
    first = inverse_dynamics(chain, inertias, q, dq, ddq, base_acceleration=gravity)
    second = inverse_dynamics(turned, inertias, q, dq, ddq, base_acceleration=turned_gravity)
    np.testing.assert_allclose(first.joint_wrench, second.joint_wrench, atol=1e-9)


def test_standing_still_gives_the_weight():
    rng = np.random.default_rng(1)
    chain = random_chain(rng, 3)
    mass, centre, about = random_masses(rng, 4)
    q, zero = rng.normal(size=3), np.zeros(3)
    gravity = np.array([0, 9.81, 0, 0, 0, 0])
    loads = inverse_dynamics(chain, spatial_inertia(mass, centre, about), q, zero, zero, base_acceleration=gravity)
    np.testing.assert_allclose(loads.base_wrench[:3], [0, 9.81 * mass.sum(), 0], atol=1e-12)
    balance = np.cross((mass[:, None] * se3.act(chain.poses(q), centre)).sum(axis=0), [0, 9.81, 0])
    np.testing.assert_allclose(loads.base_wrench[3:], balance, atol=1e-12)


def test_leading_axes():
    rng = np.random.default_rng(2)
    chain, inertias = random_chain(rng, 3), spatial_inertia(*random_masses(rng, 4))
    q, dq, ddq = rng.normal(size=(3, 2, 5, 3))
    gravity = np.concatenate([random_pose(rng)[:3, 3], np.zeros(3)])
    whole = inverse_dynamics(chain, inertias, q, dq, ddq, base_acceleration=gravity)
    for index in np.ndindex(2, 5):
        part = inverse_dynamics(chain, inertias, q[index], dq[index], ddq[index], base_acceleration=gravity)
        np.testing.assert_allclose(whole.joint_wrench[index], part.joint_wrench, atol=1e-11)
        np.testing.assert_allclose(whole.effort[index], part.effort, atol=1e-11)
        np.testing.assert_allclose(whole.base_wrench[index], part.base_wrench, atol=1e-11)
