"""Soft tissue: skin that slides with the joints and wanders slowly, so that its error is anything but white."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.workflows.simulate.markers import MarkerSet

WANDER = 0.15  # size of the slow wander against the largest displacement
WANDER_PERIODS = (4.0, 20.0)  # s


def displacement(rng: np.random.Generator, markers: MarkerSet, q: FloatArray, time: FloatArray) -> FloatArray:
    """Displacement of every marker in its link's frame.

    Each marker slides along a direction of its own as a smooth function of the two joints next to its link, which
    dominates, and drifts along three more by sines of 4 to 20 s. The mean over the trial is taken out, so that a
    marker's place on its link means the place it has on average.

    Parameters
    ----------
    rng : Generator
    markers : MarkerSet
        With ``softness`` scaled as wanted.
    q : (T, n) array
        Joint angles, rad.
    time : (T,) array
        s.

    Returns
    -------
    (T, M, 3) array
        m.
    """
    moved = np.zeros((len(time), len(markers.labels), 3))
    for i, (link, size) in enumerate(zip(markers.link, markers.softness, strict=True)):
        moved[:, i] = size * (_sliding(rng, int(link), q) + WANDER * _wander(rng, time))
    centred: FloatArray = moved - moved.mean(axis=0)
    return centred


def _sliding(rng: np.random.Generator, link: int, q: FloatArray) -> FloatArray:
    """(T, 3), about 1 long at the ends of the motion."""
    total = np.zeros((len(q), 3))
    for joint, weight in ((link - 1, rng.uniform(0.3, 1.0)), (link, rng.uniform(0.3, 1.0))):
        direction = rng.normal(size=3)
        bend, shift = rng.uniform(0.8, 1.3), rng.uniform(-0.3, 0.3)
        if 0 <= joint < q.shape[1]:
            middle = (q[:, joint].max() + q[:, joint].min()) / 2
            along = np.sin(bend * (q[:, joint] - middle + shift))
            total += weight * along[:, None] * direction / np.linalg.norm(direction)
    return total


def _wander(rng: np.random.Generator, time: FloatArray) -> FloatArray:
    """(T, 3) of unit variance."""
    period = rng.uniform(*WANDER_PERIODS, (6, 3))
    phase = rng.uniform(0, 2 * np.pi, (6, 3))
    waves = np.sin(2 * np.pi * time[:, None, None] / period + phase)
    total: FloatArray = waves.sum(axis=1) / np.sqrt(3)
    return total
