"""Postures that fill a box evenly, and its faces, which is where the edge of the workspace comes from."""

from __future__ import annotations

import warnings
from itertools import combinations, product

import numpy as np
from scipy.stats import qmc

from mocap_id.arrays import FloatArray

ON_FACES = 5
"""Every such sample lies on a face of the box."""


def sobol(count: int, dimension: int, seed: int) -> FloatArray:
    """A scrambled Sobol' sequence, (count, dimension) in [0, 1); the first half is a sequence too.

    Parameters
    ----------
    count : int
    dimension : int
    seed : int
        Of the scrambling: another seed gives other points of the same evenness.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The balance properties", category=UserWarning)
        return np.asarray(qmc.Sobol(dimension, rng=seed).random(count))


def sample_box(lower: FloatArray, upper: FloatArray, count: int, seed: int, onto: int) -> FloatArray:
    """Low-discrepancy samples of a box and its faces.

    The edge of the set that a box is mapped onto in ``onto`` dimensions comes from faces of the box of at least
    ``onto - 1`` dimensions (the map folds within the others). Inner samples pile up at folds by themselves, but
    hardly ever lie on a face; therefore one in :data:`ON_FACES` does, the same number on each.

    Parameters
    ----------
    lower, upper : (n,) arrays
        The box.
    count : int
    seed : int
    onto : int
        Dimension of the space that the samples will be mapped to.

    Returns
    -------
    (count, n) array
        In an order such that the first N samples, for any N, are spread in the same way.
    """
    n = len(lower)
    faces = _faces(n, onto - 1)
    unit = np.empty((count, n))
    on_face = np.arange(count) % ON_FACES == ON_FACES - 1
    unit[~on_face] = sobol(int((~on_face).sum()), n, seed)
    turn = np.flatnonzero(on_face)
    for k, (joints, sides) in enumerate(faces):  # each its own sequence: a part of one is not evenly spread
        rows = turn[k :: len(faces)]
        unit[rows] = sobol(len(rows), n, seed + 1 + k)
        for joint, side in zip(joints, sides, strict=True):
            unit[rows, joint] = side
    return np.asarray((1 - unit) * lower + unit * upper)


def _faces(n: int, least: int) -> list[tuple[list[int], list[float]]]:
    """Faces of an n-box of ``least`` to n - 1 dimensions: the joints that are at a limit, and at which (0 or 1)."""
    return [
        (list(fixed), [float(side) for side in sides])
        for count in range(1, n - max(least, 0) + 1)
        for fixed in combinations(range(n), count)
        for sides in product((0, 1), repeat=count)
    ]
