"""Inertial parameters of one trial in the frames of another trial of the same person.

Every trial has frames of its own. A segment's +Y points to the joint that this trial found, the last segment's to the
centroid of the markers that were seen, and the plane frame stays with the plate while the feet stand elsewhere. The
body is the same: mass stays where it is among the markers of its segment. So each body's frame is laid onto that of
the other trial by the markers that both know (Procrustes), and m, (mx, my), Izz are turned and shifted with it:

    m' = m,  c' = R c + m t,  Izz' = Izz + 2 t·R c + m |t|²,  c = (mx, my).

The full, consistent parameters are carried, not the base parameters. A base parameter such as my2 + p3y (m3 + m4) holds
the joint's place p3 that its trial found; the full ones know which part of it is the joint's and meet the other
trial's own p3. The contact wrench leaves open how a mass at a joint is shared between the two segments that meet
there. Where both trials place the joint alike among the markers that does not matter: the mass comes to the same
place. Where they differ by e, an unknown share of μ kg makes a moment of μ e g, at the centre of pressure μ e / M.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray

LEAST_MARKERS = 2
LEAST_SPREAD = 0.02
"""m, rms distance of the common markers from their centroid: closer markers do not show how a body is turned."""


@dataclass(frozen=True)
class Skeleton:
    """What the frames of a trial's bodies are known by.

    Parameters
    ----------
    segments : tuple of str
        Names of the K bodies, base first.
    centres : (n, 2) array
        Joint centres in the body before, m; NaN where unknown.
    between : (n, 2) int array
        The bodies before and after each joint. A body of arms and head has no joint.
    markers : tuple of str
        Labels.
    segment : (M,) int array
        Body of each marker.
    local : (M, 2) array
        In the body's frame, m.
    """

    segments: tuple[str, ...]
    centres: FloatArray
    between: IntArray
    markers: tuple[str, ...]
    segment: IntArray
    local: FloatArray

    @property
    def jointed(self) -> IntArray:
        """Bodies beyond a joint: neither the base nor arms and head, which change their shape."""
        return np.unique(self.between[:, 1])


@dataclass(frozen=True)
class Registration:
    """How the frames of one trial's K bodies lie in another's: a point c there is at R(angle) c + shift here.

    Parameters
    ----------
    angle : (K,) array
        rad; 0 for the base, whose frame is the plane frame in both.
    shift : (K, 2) array
        m; of the base: how far the feet stand from where they stood.
    markers : (K,) int array
        Common markers that tell it.
    residual : (K,) array
        Their rms distance after registration, m; NaN without any.
    mirrored : (K,) array
        The same after the best registration that turns the body over, m: near ``residual`` where they lie in a line.
    spread : (K,) array
        Their rms distance from their centroid, m.
    joint : (n,) array
        How far apart the two trials place each joint among the markers of the body before it, m; NaN where unknown.
    """

    angle: FloatArray
    shift: FloatArray
    markers: IntArray
    residual: FloatArray
    mirrored: FloatArray
    spread: FloatArray
    joint: FloatArray


def register(there: Skeleton, here: Skeleton) -> Registration:
    """Lay the bodies of one trial onto those of another.

    Parameters
    ----------
    there, here : Skeleton
        With the same bodies and joints. A marker counts where both have it on the same body.

    Returns
    -------
    Registration
        From ``there`` to ``here``. A body with fewer than two common markers is NaN; the caller decides.
    """
    count = len(here.segments)
    angle, shift = np.zeros(count), np.zeros((count, 2))
    markers, residual = np.zeros(count, dtype=np.int64), np.full(count, np.nan)
    mirrored, spread = np.full(count, np.nan), np.zeros(count)
    for k in range(count):
        before, after = _common(there, here, k)
        markers[k] = len(before)
        if k == 0:
            shift[k], used = _feet(before, after, here.centres[0] - there.centres[0])
            residual[k] = _rms(after[used] - before[used] - shift[k])
            continue
        if len(before) < LEAST_MARKERS:
            angle[k], shift[k] = np.nan, np.nan
            continue
        angle[k], shift[k], residual[k] = _procrustes(before, after)
        spread[k] = _rms(before - before.mean(axis=0))
        mirrored[k] = _procrustes(before * [-1.0, 1.0], after)[2]
    below = there.between[:, 0]
    moved = [_turned(angle[k], centre) + shift[k] for k, centre in zip(below, there.centres, strict=True)]
    joint = np.linalg.norm(np.reshape(moved, (-1, 2)) - here.centres, axis=1)
    return Registration(angle, shift, markers, residual, mirrored, spread, joint)


def carry(full: FloatArray, registration: Registration) -> FloatArray:
    """Full parameters (4K,), base first, of the same body in the frames that it was registered to."""
    out = [
        _moved(block, angle, shift)
        for block, angle, shift in zip(full.reshape(-1, 4), registration.angle, registration.shift, strict=True)
    ]
    return np.concatenate(out)


def carry_covariance(covariance: FloatArray, registration: Registration) -> FloatArray:
    """Covariance (4K, 4K) of the parameters that :func:`carry` gives; the registration counts as known."""
    move = np.column_stack([carry(unit, registration) for unit in np.eye(len(covariance))])
    return np.asarray(move @ covariance @ move.T)


def _common(there: Skeleton, here: Skeleton, segment: int) -> tuple[FloatArray, FloatArray]:
    """Local coordinates (k, 2) of the markers that both trials have on this body."""
    before, after = (
        {label: i for i, label in enumerate(of.markers) if of.segment[i] == segment} for of in (there, here)
    )
    both = [label for label in before if label in after]
    indices = np.array([(before[label], after[label]) for label in both], dtype=np.int64).reshape(-1, 2)
    return there.local[indices[:, 0]], here.local[indices[:, 1]]


def _feet(before: FloatArray, after: FloatArray, ankle: FloatArray) -> tuple[FloatArray, BoolArray]:
    """How far the feet stand from where they stood (2,), m, and the markers (k,) that say so.

    Markers of the base are on the feet or on the plate, and those on the plate stay. On the feet are those that moved
    rather as the ankle did than not at all; where there are none, all of them stayed together. The joints beyond are
    placed by the trial's own ankle: this moves the foot's own mass alone.
    """
    if not len(before):
        return ankle, np.zeros(0, dtype=bool)
    moved = after - before
    on_feet = np.linalg.norm(moved - ankle, axis=1) <= np.linalg.norm(moved, axis=1)
    used = on_feet if on_feet.any() else ~on_feet
    return np.median(moved[used], axis=0), used


def _procrustes(before: FloatArray, after: FloatArray) -> tuple[float, FloatArray, float]:
    """Angle, shift (2,) and rms residual of the rigid motion that takes points (k, 2) nearest to others (k, 2)."""
    middle, goal = before.mean(axis=0), after.mean(axis=0)
    a, b = before - middle, after - goal
    angle = float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)))
    return angle, goal - _turned(angle, middle), _rms(_turned(angle, a) - b)


def _turned(angle: float, points: FloatArray) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def _rms(distances: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(distances**2, axis=-1)))) if len(distances) else float("nan")


def _moved(block: FloatArray, angle: float, shift: FloatArray) -> FloatArray:
    """m, mx, my, Izz after the frame's motion."""
    mass, first = block[0], _turned(angle, block[1:3])
    inertia = block[3] + 2 * float(shift @ first) + mass * float(shift @ shift)
    return np.array([mass, *(first + mass * shift), inertia])
