"""A person on a grid of point masses, and problems whose solution is a person."""

from __future__ import annotations

import numpy as np
from dynamics_cases import BODY, CENTRES

from mocap_id.dynamics.consistency import build_grid
from mocap_id.dynamics.regressor import CompressedProblem, structural_base

SEGMENT = np.repeat([0, 1, 2, 3], 4)
LOCAL = np.array(
    [
        *([-0.25, 0.02], [0.05, 0.03], [-0.2, 0.05], [-0.02, 0.08]),
        *([-0.06, 0.05], [0.06, 0.2], [-0.05, 0.4], [0.05, 0.35]),
        *([-0.08, 0.05], [0.08, 0.2], [-0.07, 0.38], [0.08, 0.3]),
        *([-0.12, 0.1], [0.12, 0.3], [-0.1, 0.5], [0.05, 0.85]),
    ]
)
GRID = build_grid(CENTRES, SEGMENT, LOCAL)
BASE = structural_base(CENTRES)
M = BASE.regrouping
B = M @ GRID.moments()
NO_REFERENCE = np.full(16, np.nan)


def problem(seed: int, noise: float, base: np.ndarray | None = None, nuisance: int = 0) -> CompressedProblem:
    """A well-posed least-squares problem around some base parameters; nuisance parameters are 3."""
    rng = np.random.default_rng(seed)
    truth = M @ BODY.ravel() if base is None else base
    rows = (
        rng.normal(size=(600, len(truth) + nuisance))
        * np.r_[10 ** rng.uniform(-0.5, 0.5, len(truth)), np.ones(nuisance)]
    )
    target = rows @ np.r_[truth, np.full(nuisance, 3.0)] + noise * rng.normal(size=600)
    return CompressedProblem.of(rows, target)


def impossible(seed: int) -> np.ndarray:
    """Improbable base parameters."""
    rng = np.random.default_rng(100 + seed)
    return M @ BODY.ravel() * rng.uniform(0.3, 1.7, len(M))
