"""A planar chain with markers, simulated without any code under test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray


@dataclass(frozen=True)
class Truth:
    """Simulated trajectories (F, M), m, and their true parameters."""

    points: NDArray[np.complex128]
    lateral: NDArray[np.float64]
    segment: NDArray[np.int64]
    centres: NDArray[np.complex128]
    relative: NDArray[np.float64]


def make_chain(
    seed: int, *, joints: int = 3, markers: int = 5, frames: int = 400, noise: float = 0.0, missing: float = 0.0
) -> Truth:
    """Return a chain with joints that swing by 30 to 90 degrees and four still base markers."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2 * np.pi, frames)
    swing = np.radians(rng.uniform(15, 45, joints))
    speed = rng.permutation(np.arange(1, joints + 1)) + rng.uniform(0, 0.3, joints)
    relative = rng.uniform(-0.5, 0.5, joints) + swing * np.sin(t[:, None] * speed + rng.uniform(0, 6, joints))
    angle = np.cumsum(relative, axis=1)
    centres = np.concatenate([[complex(*rng.uniform(-0.1, 0.1, 2))], 1j * rng.uniform(0.3, 0.5, joints - 1)])
    arms = np.concatenate([np.full((frames, 1), centres[0]), np.exp(1j * angle[:, :-1]) * centres[1:]], axis=1)
    origin = np.cumsum(arms, axis=1)
    columns, segment = [], []
    for _ in range(4):
        columns.append(np.full(frames, complex(*rng.uniform(-0.3, 0.3, 2))))
        segment.append(0)
    for k in range(joints):
        for _ in range(markers):
            local = complex(rng.uniform(-0.1, 0.1), rng.uniform(0.05, 0.35))
            columns.append(origin[:, k] + np.exp(1j * angle[:, k]) * local)
            segment.append(k + 1)
    points = np.stack(columns, axis=1)
    points = points + noise * (rng.standard_normal(points.shape) + 1j * rng.standard_normal(points.shape))
    points[rng.uniform(size=points.shape) < missing] = np.nan
    return Truth(points, rng.uniform(-0.04, 0.04, points.shape[1]), np.array(segment), centres, relative)


@pytest.fixture(scope="session")
def chain():
    """Return the function that simulates a chain."""
    return make_chain
