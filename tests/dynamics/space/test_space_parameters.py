"""Base parameters in space, changes of frame, and bodies that can exist."""

from __future__ import annotations

import numpy as np
import pytest
from space_cases import random_base, random_bodies, random_chain

from mocap_id.dynamics.regressor import CompressedProblem
from mocap_id.dynamics.space.consistency import (
    REACH,
    SemidefiniteBodies,
    body_parameters,
    change_of_frame,
    fit_semidefinite,
    point_mass,
    pseudo_inertia,
)
from mocap_id.dynamics.space.preparation import move_joints, segment_regressor, structural_base_in_space
from mocap_id.geometry import se3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint

seeds = pytest.mark.parametrize("seed", range(4))


@pytest.mark.parametrize(
    ("kinds", "count"), [(("hinge",), 8), (("hinge", "hinge"), 15), (("ball",), 12), (("ball", "two-axis"), 21)]
)
def test_the_base_parameters_determine_the_wrench_of_every_motion(kinds: tuple[str, ...], count: int) -> None:
    rng = np.random.default_rng(len(kinds))
    chain, base = random_chain(rng, kinds), random_base(rng)
    structure = structural_base_in_space(chain, base)
    assert len(structure.names) == len(structure.units) == len(set(structure.names)) == count
    size = sum(joint.dimension for joint in chain.joints)
    motion = move_joints(chain, base, *rng.normal(size=(3, 6, size)))
    minimal = segment_regressor(motion.in_frames(structure.frames))[:, :, structure.base.kept]
    np.testing.assert_allclose(minimal @ structure.mapping, segment_regressor(motion), atol=1e-11)
    rows = segment_regressor(move_joints(chain, base, *rng.normal(size=(3, 60, size))))
    assert np.linalg.matrix_rank(rows.reshape(-1, rows.shape[-1])) == count


def test_names_are_simple_for_a_robot_that_turns_about_the_vertical() -> None:
    joint = SpatialJoint("hinge", 0, np.array([0.0, 0.5, 0.0]), first_axis=np.array([0.0, 1.0, 0.0]))
    chain = SpatialChain((joint,), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.bool_))
    names = structural_base_in_space(chain, np.eye(4)).names
    assert names == ("m1+m2", "mx1", "mz1", "mx2", "my2", "Izz2", "Ixz2", "Iyz2")


@seeds
def test_the_wrench_does_not_depend_on_the_frame_of_the_parameters(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chain, base, bodies = random_chain(rng, ("ball", "hinge")), random_base(rng), random_bodies(rng, 3)
    motion = move_joints(chain, base, *rng.normal(size=(3, 3, 4)))
    frames = se3.exp_twist(rng.normal(size=(3, 6)))
    moved = np.stack([change_of_frame(se3.inverse(f)) @ body for f, body in zip(frames, bodies, strict=True)])
    here, there = (
        segment_regressor(motion) @ bodies.ravel(),
        segment_regressor(motion.in_frames(frames)) @ moved.ravel(),
    )
    np.testing.assert_allclose(there, here, atol=1e-10)


@seeds
def test_pseudo_inertia_and_parameters_are_inverse(seed: int) -> None:
    bodies = random_bodies(np.random.default_rng(seed), 3)
    np.testing.assert_allclose(body_parameters(pseudo_inertia(bodies)), bodies, atol=1e-14)
    assert np.linalg.eigvalsh(pseudo_inertia(bodies)).min() > 0


@seeds
def test_the_cheapest_point_is_the_cheapest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    prices = rng.normal(size=10) * 10 ** rng.uniform(-2, 2, 10) * (rng.random(10) < 0.8)
    (found,) = SemidefiniteBodies(np.eye(10)).find_cheapest(prices).T
    assert np.linalg.norm(found[1:4]) <= REACH * (1 + 1e-9)
    places = rng.normal(size=(400, 3))
    places *= REACH * rng.random((400, 1)) ** (1 / 3) / np.linalg.norm(places, axis=1)[:, None]
    assert prices @ found <= min(prices @ point_mass(place) for place in places) + 1e-9


def problem(rng: np.random.Generator, error: float) -> tuple[CompressedProblem, np.ndarray]:
    chain, base = random_chain(rng, ("hinge", "hinge")), random_base(rng)
    structure = structural_base_in_space(chain, base)
    motion = move_joints(chain, base, *rng.normal(size=(3, 80, 2)))
    rows = segment_regressor(motion.in_frames(structure.frames))[:, :, structure.base.kept].reshape(480, -1)
    target = rows @ structure.mapping @ random_bodies(rng, 3).ravel() + error * rng.normal(size=480)
    return CompressedProblem.of(rows, target), structure.mapping


@seeds
def test_possible_bodies_are_found_where_the_data_allow_them(seed: int) -> None:
    compressed, mapping = problem(np.random.default_rng(seed), 1e-3)
    found = fit_semidefinite(compressed, mapping)
    np.testing.assert_allclose(found.parameters, compressed.free_solution(), atol=1e-4)
    np.testing.assert_allclose(mapping @ found.full, found.parameters, atol=1e-6)
    assert SemidefiniteBodies(mapping).measure_violation(found.full) < 1e-6


@seeds
def test_the_best_possible_bodies_are_found_where_the_data_contradict_them(seed: int) -> None:
    compressed, mapping = problem(np.random.default_rng(seed), 30.0)
    found, bodies = fit_semidefinite(compressed, mapping), SemidefiniteBodies(mapping)
    assert found.price > 1e-4
    assert found.answer.optimality.excess < 1e-4
    assert bodies.measure_violation(found.answer.body) < 1e-9

    rng = np.random.default_rng(seed)
    for size in 10 ** rng.uniform(-3, 0, 60):
        other = bodies.settle(found.answer.body + size * rng.normal(size=30) * bodies.units)
        assert compressed.cost(mapping @ other) >= found.answer.cost * (1 - 1e-6)
