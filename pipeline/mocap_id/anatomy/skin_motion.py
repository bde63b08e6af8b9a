"""A model of soft-tissue motion: skin that slides with the joint angles and drifts slowly.

The dominant part of a marker's displacement is a slide, a smooth function of the angles of the two joints next to the
marker's link. A drift is added in three directions, with periods of 4 to 20 s.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray, IntArray

WANDER = 0.15  # size of the slow drift relative to the largest displacement
_PERIODS = (4.0, 20.0)  # s, of the drift


def draw_skin_motion(
    rng: np.random.Generator,
    link: IntArray,
    softness: FloatArray,
    q: FloatArray,
    time: FloatArray,
    *,
    wander: np.random.Generator,
    middle: FloatArray,
) -> FloatArray:
    """Return the displacement (T, M, 3) of every marker in its link's frame, m.

    ``rng`` draws the slides and ``wander`` the drifts. The joint with the number of a marker's ``link`` (M,) moves the
    next link. ``softness`` (M,) is the largest displacement of each marker, m, ``q`` (T, n) are the joint angles, rad,
    ``middle`` (n,) the angles at which the slide is near zero, and ``time`` (T,) is in s.
    """
    moved = np.zeros((len(time), len(link), 3))
    for i, (own, size) in enumerate(zip(link, softness, strict=True)):
        moved[:, i] = size * (draw_slide(rng, int(own), q, middle) + WANDER * draw_wander(wander, time))
    return moved


def draw_centred_skin_motion(
    rng: np.random.Generator, link: IntArray, softness: FloatArray, q: FloatArray, time: FloatArray
) -> FloatArray:
    """Return the displacement (T, M, 3) with a mean of zero, m; parameters as for :func:`draw_skin_motion`.

    The slide is near zero in the middle of each joint's range in this trial. The mean displacement over the trial is
    removed, so that a marker's position on its link is its mean position.
    """
    moved = draw_skin_motion(rng, link, softness, q, time, wander=rng, middle=mid_range(q))
    return np.asarray(moved - moved.mean(axis=0))


def mid_range(q: FloatArray) -> FloatArray:
    """Return the middle (n,) of the range of each joint angle (T, n), rad."""
    return np.asarray((q.max(axis=0) + q.min(axis=0)) / 2)


def draw_slide(rng: np.random.Generator, link: int, q: FloatArray, middle: FloatArray) -> FloatArray:
    """Return a slide (T, 3) with a length of about 1 at the ends of the motion."""
    total = np.zeros((len(q), 3))
    for joint, weight in ((link - 1, rng.uniform(0.3, 1.0)), (link, rng.uniform(0.3, 1.0))):
        direction = rng.normal(size=3)
        bend, shift = rng.uniform(0.8, 1.3), rng.uniform(-0.3, 0.3)
        if 0 <= joint < q.shape[1]:
            along = np.sin(bend * (q[:, joint] - middle[joint] + shift))
            total += weight * along[:, None] * direction / np.linalg.norm(direction)
    return total


def draw_wander(rng: np.random.Generator, time: FloatArray) -> FloatArray:
    """Return a drift (T, 3) of unit variance."""
    period = rng.uniform(*_PERIODS, (6, 3))
    phase = rng.uniform(0, 2 * np.pi, (6, 3))
    waves = np.sin(2 * np.pi * time[:, None, None] / period + phase)
    return np.asarray(waves.sum(axis=1) / np.sqrt(3))
