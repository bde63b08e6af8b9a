"""Random rotations, twists and chains, with many angles near the singularities of formulas."""

from __future__ import annotations

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocap_id.geometry import Chain, Revolute, se3, so3

Array = NDArray[np.float64]
laws = settings(deadline=None, max_examples=100)

angles = st.one_of(
    st.just(0.0),
    st.floats(1e-300, 1e-9),
    st.floats(1e-9, 2e-2),
    st.floats(2e-2, 3.0),
    st.floats(1e-9, 1e-2).map(lambda x: np.pi - x),
)


def directions() -> st.SearchStrategy[Array]:
    def unit(azimuth: float, height: float) -> Array:
        radius = np.sqrt(1 - height**2)
        return np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])

    return st.builds(unit, st.floats(-np.pi, np.pi), st.floats(-1, 1))


def rotation_vectors() -> st.SearchStrategy[Array]:
    return st.builds(lambda angle, axis: angle * axis, angles, directions())


def vectors(size: int, bound: float = 3.0) -> st.SearchStrategy[Array]:
    return st.lists(st.floats(-bound, bound), min_size=size, max_size=size).map(np.array)


def twists() -> st.SearchStrategy[Array]:
    return st.builds(lambda v, w: np.concatenate([v, w]), vectors(3), rotation_vectors())


def poses() -> st.SearchStrategy[Array]:
    return twists().map(se3.exp_twist)


seeds = st.integers(0, 2**32 - 1)


def random_pose(rng: np.random.Generator) -> Array:
    return se3.pose(so3.exp(rng.normal(size=3)), rng.normal(size=3))


def random_chain(rng: np.random.Generator, joints: int) -> Chain:
    axes = rng.normal(size=(joints, 3))
    placements = np.stack([random_pose(rng) for _ in range(joints)])
    return Chain(tuple(Revolute(tuple(axis)) for axis in axes), placements)


def random_masses(rng: np.random.Generator, links: int) -> tuple[Array, Array, Array]:
    """Return masses (L,), centres (L, 3) and physically possible inertias about them (L, 3, 3)."""
    points = rng.normal(size=(links, 5, 3))  # five equal point masses a link
    mass = rng.uniform(0.2, 5.0, links)
    centre = points.mean(axis=1)
    arm = so3.hat(points - centre[:, None])
    return mass, centre, -(mass[:, None, None] / 5) * (arm @ arm).sum(axis=1)
