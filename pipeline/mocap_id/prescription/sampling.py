"""Low-discrepancy samples of a box of postures and of its faces, which map to the edge of the workspace."""

from __future__ import annotations

import warnings
from itertools import combinations, product

import numpy as np
from scipy.stats import qmc

from mocap_id.arrays import FloatArray

ON_FACES = 5
"""One of this number of samples is on a face of the box."""


def sobol(count: int, dimension: int, seed: int) -> FloatArray:
    """Return a scrambled Sobol' sequence (count, dimension) in [0, 1); its first half is also a Sobol' sequence."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The balance properties", category=UserWarning)
        return np.asarray(qmc.Sobol(dimension, rng=seed).random(count))


def sample_box(lower: FloatArray, upper: FloatArray, count: int, seed: int, onto: int) -> FloatArray:
    """Return low-discrepancy samples (count, n) of a box and its faces.

    The samples are later mapped to a space with ``onto`` dimensions. The edge of the result comes from folds of the map
    and from faces of the box with at least ``onto - 1`` dimensions. Inner samples accumulate at folds, but are almost
    never on a face. Therefore one of :data:`ON_FACES` samples is on a face, with the same number on each face. For any
    N, the first N samples have the same distribution.
    """
    n = len(lower)
    faces = _faces(n, onto - 1)
    unit = np.empty((count, n))
    on_face = np.arange(count) % ON_FACES == ON_FACES - 1
    unit[~on_face] = sobol(int((~on_face).sum()), n, seed)
    face_rows = np.flatnonzero(on_face)
    for k, (joints, sides) in enumerate(faces):  # one sequence for each, because part of a sequence is not even
        rows = face_rows[k :: len(faces)]
        unit[rows] = sobol(len(rows), n, seed + 1 + k)
        for joint, side in zip(joints, sides, strict=True):
            unit[rows, joint] = side
    return np.asarray((1 - unit) * lower + unit * upper)


def _faces(n: int, least: int) -> list[tuple[list[int], list[float]]]:
    """Return the faces of an n-box with ``least`` to n - 1 dimensions: joints at a limit, and the limit (0 or 1)."""
    return [
        (list(fixed), [float(side) for side in sides])
        for count in range(1, n - max(least, 0) + 1)
        for fixed in combinations(range(n), count)
        for sides in product((0, 1), repeat=count)
    ]
