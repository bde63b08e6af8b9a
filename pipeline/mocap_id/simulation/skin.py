"""Soft-tissue motion: skin that slides with the joint angles and drifts slowly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation.markers import MarkerSet

WANDER = 0.15  # size of the slow drift relative to the largest displacement
WANDER_PERIODS = (4.0, 20.0)  # s
MIDDLE = np.array([0.35, -1.12, 1.10])  # rad, mid-range of ankle, knee and hip in sit-to-stands


def draw_trial_skin_motion(rng: np.random.Generator, markers: MarkerSet, q: FloatArray, time: FloatArray) -> FloatArray:
    """Return the displacement (T, M, 3) of every marker in a trial without a subject, m.

    The slide is near zero in the middle of each joint's range in this trial. The mean displacement over the trial is
    removed, so that a marker's position on its link is its mean position. Parameters as for :func:`draw_skin_motion`.
    """
    moved = draw_skin_motion(rng, markers, q, time, wander=rng, middle=_mid_range(q))
    return np.asarray(moved - moved.mean(axis=0))


def draw_subject_skin_motion(
    rng: np.random.Generator, wander: np.random.Generator, markers: MarkerSet, q: FloatArray, time: FloatArray
) -> tuple[FloatArray, MarkerSet]:
    """Return the displacement (T, M, 3) of a subject's markers, m, and the markers at their mean positions.

    The slide is the same function of the angles in all trials of the person; the drift differs. The mean displacement
    over the trial is added to the markers' positions instead. Parameters as for :func:`draw_skin_motion`.
    """
    moved = draw_skin_motion(rng, markers, q, time, wander=wander, middle=MIDDLE)
    mean = moved.mean(axis=0)
    return moved - mean, replace(markers, local=markers.local + mean)


def draw_skin_motion(
    rng: np.random.Generator,
    markers: MarkerSet,
    q: FloatArray,
    time: FloatArray,
    *,
    wander: np.random.Generator,
    middle: FloatArray,
) -> FloatArray:
    """Return the displacement (T, M, 3) of every marker in its link's frame, m.

    The dominant part is a slide, a smooth function of the angles of the two joints next to the marker's link. A drift
    is added in three directions, with periods of 4 to 20 s.

    Parameters
    ----------
    rng, wander : Generator
        Generators of the slide and of the drift.
    markers : MarkerSet
        Markers, with ``softness`` already scaled.
    q : (T, n) array
        Joint angles, rad.
    time : (T,) array
        Times, s.
    middle : (n,) array
        Joint angles at which the slide is near zero, rad.
    """
    moved = np.zeros((len(time), len(markers.labels), 3))
    for i, (link, size) in enumerate(zip(markers.link, markers.softness, strict=True)):
        moved[:, i] = size * (_draw_slide(rng, int(link), q, middle) + WANDER * _draw_wander(wander, time))
    return moved


def draw_skin_rotation(  # noqa: PLR0917
    rng: np.random.Generator,
    link: int,
    size: float,
    q: FloatArray,
    time: FloatArray,
    person: np.random.Generator | None = None,
) -> FloatArray:
    """Return the rotation vectors (T, 3) of the skin on a link, rad, of about ``size`` at the ends of the motion.

    With the generator ``person``, the rotation is the same function of the angles in all trials of a person, and
    ``rng`` only adds a drift.
    """
    if person is not None:
        return np.asarray(size * (_draw_slide(person, link, q, MIDDLE) + WANDER * _draw_wander(rng, time)))
    moved = _draw_slide(rng, link, q, _mid_range(q)) + WANDER * _draw_wander(rng, time)
    return np.asarray(size * (moved - moved.mean(axis=0)))


def _mid_range(q: FloatArray) -> FloatArray:
    """Return the middle (n,) of the range of each joint angle, rad."""
    return np.asarray((q.max(axis=0) + q.min(axis=0)) / 2)


def _draw_slide(rng: np.random.Generator, link: int, q: FloatArray, middle: FloatArray) -> FloatArray:
    """Return a slide (T, 3) with a length of about 1 at the ends of the motion."""
    total = np.zeros((len(q), 3))
    for joint, weight in ((link - 1, rng.uniform(0.3, 1.0)), (link, rng.uniform(0.3, 1.0))):
        direction = rng.normal(size=3)
        bend, shift = rng.uniform(0.8, 1.3), rng.uniform(-0.3, 0.3)
        if 0 <= joint < q.shape[1]:
            along = np.sin(bend * (q[:, joint] - middle[joint] + shift))
            total += weight * along[:, None] * direction / np.linalg.norm(direction)
    return total


def _draw_wander(rng: np.random.Generator, time: FloatArray) -> FloatArray:
    """Return a drift (T, 3) of unit variance."""
    period = rng.uniform(*WANDER_PERIODS, (6, 3))
    phase = rng.uniform(0, 2 * np.pi, (6, 3))
    waves = np.sin(2 * np.pi * time[:, None, None] / period + phase)
    return np.asarray(waves.sum(axis=1) / np.sqrt(3))
