"""Parameter transfer: inertial parameters of one trial in the frames of another trial of the same person.

Each trial has its own frames: the +Y axis of a segment points to the joint that was fitted in this trial, and the feet
may stand elsewhere on the plate. The mass, however, does not move relative to the markers of its segment. Each body's
frame is therefore registered to its frame in the other trial with the common markers (Procrustes), and m, (mx, my) and
Izz are transformed:

    m' = m,  c' = R c + m t,  Izz' = Izz + 2 t·R c + m |t|²,  c = (mx, my).

The full, consistent parameters are transferred, not the base parameters. A base parameter such as my2 + p3y (m3 + m4)
contains the joint position p3 of its own trial, whereas full parameters can be combined with the joint position of the
other trial. The contact wrench does not determine how a mass at a joint is divided between the two adjacent segments.
If the positions of the joint in the two trials differ by e, such a mass of μ kg causes an error of μ e g in the moment
and of μ e / M in the centre of pressure, where M is the mass of the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray

LEAST_MARKERS = 2  # least number of common markers with which a body is registered
LEAST_SPREAD = 0.02  # m: least rms distance of common markers from their centroid that determines the orientation


@dataclass(frozen=True)
class BodyFrames:
    """The joints and markers that define the frames of a trial's bodies."""

    segments: tuple[str, ...]  # names of the K bodies, base first
    centres: FloatArray  # (n, 2) centre of each joint in the frame of the body before it, m; NaN where unknown
    between: IntArray  # (n, 2) bodies before and after each joint; the body of arms and head has no joint
    markers: tuple[str, ...]  # labels of the markers
    segment: IntArray  # (M,) body of each marker
    local: FloatArray  # (M, 2) markers in the body's frame, m

    @property
    def jointed(self) -> IntArray:
        """Bodies beyond a joint: neither the base nor the body of arms and head, which is not rigid."""
        return np.unique(self.between[:, 1])


@dataclass(frozen=True)
class Registration:
    """Transformation of the frames of K bodies from one trial to another: a point c becomes R(angle) c + shift."""

    angle: FloatArray  # (K,) rotation, rad; 0 for the base, whose frame is the plane frame in both trials
    shift: FloatArray  # (K, 2) translation, m; for the base, the displacement of the feet
    markers: IntArray  # (K,) number of common markers
    residual: FloatArray  # (K,) rms distance of the common markers after registration, m; NaN without common markers
    mirrored: FloatArray  # (K,) residual for the mirrored body, m; close to `residual` if the markers are collinear
    spread: FloatArray  # (K,) rms distance of the common markers from their centroid, m
    # (n,) distance between the two trials' positions of each joint, relative to the markers of the body before it, m;
    # NaN where unknown
    joint: FloatArray


def register_bodies(there: BodyFrames, here: BodyFrames) -> Registration:
    """Return the registration of the bodies of the trial ``there`` to the same bodies of the trial ``here``.

    It is NaN for a body with fewer than two markers that both trials have, except for the base.
    """
    count = len(here.segments)
    angle, shift = np.zeros(count), np.zeros((count, 2))
    markers, residual = np.zeros(count, dtype=np.int64), np.full(count, np.nan)
    mirrored, spread = np.full(count, np.nan), np.zeros(count)
    for k in range(count):
        # coordinates (k, 2), m, of the markers that both trials have on the body, in each trial's frame
        old, new = ({name: i for i, name in enumerate(of.markers) if of.segment[i] == k} for of in (there, here))
        both = [name for name in old if name in new]
        before, after = there.local[[old[name] for name in both]], here.local[[new[name] for name in both]]
        markers[k] = len(before)
        if k == 0:
            # Markers of the base are on the feet or on the plate, where they do not move. A marker counts as on the
            # feet if its displacement is closer to that of the ankle than to zero. If none is, all markers are used.
            # The displacement of the feet affects only the mass of the foot.
            ankle, displaced = here.centres[0] - there.centres[0], after - before
            on_feet = np.linalg.norm(displaced - ankle, axis=1) <= np.linalg.norm(displaced, axis=1)
            used = displaced[on_feet if on_feet.any() else ~on_feet]
            shift[k] = np.median(used, axis=0) if both else ankle
            residual[k] = _compute_rms(used - shift[k])
            continue
        if len(before) < LEAST_MARKERS:
            angle[k], shift[k] = np.nan, np.nan
            continue
        angle[k], shift[k], residual[k] = _register(before, after)
        spread[k] = _compute_rms(before - before.mean(axis=0))
        mirrored[k] = _register(before * [-1.0, 1.0], after)[2]
    below = there.between[:, 0]
    moved = [_rotate(angle[k], centre) + shift[k] for k, centre in zip(below, there.centres, strict=True)]
    joint = np.linalg.norm(np.reshape(moved, (-1, 2)) - here.centres, axis=1)
    return Registration(angle, shift, markers, residual, mirrored, spread, joint)


def transfer_parameters(full: FloatArray, registration: Registration) -> FloatArray:
    """Return the full parameters (4K,), base first, in the frames of the other trial."""
    moved = []
    for block, angle, shift in zip(full.reshape(-1, 4), registration.angle, registration.shift, strict=True):
        mass, first = block[0], _rotate(angle, block[1:3])
        inertia = block[3] + 2 * float(shift @ first) + mass * float(shift @ shift)
        moved.append(np.array([mass, *(first + mass * shift), inertia]))
    return np.concatenate(moved)


def transfer_covariance(covariance: FloatArray, registration: Registration) -> FloatArray:
    """Return the covariance (4K, 4K) of the transferred parameters, without errors of the registration."""
    move = np.column_stack([transfer_parameters(unit, registration) for unit in np.eye(len(covariance))])
    return np.asarray(move @ covariance @ move.T)


def _register(before: FloatArray, after: FloatArray) -> tuple[float, FloatArray, float]:
    """Fit the rigid motion from points (k, 2) to other points (k, 2); return angle, shift (2,) and rms residual."""
    middle, goal = before.mean(axis=0), after.mean(axis=0)
    a, b = before - middle, after - goal
    angle = float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)))
    return angle, goal - _rotate(angle, middle), _compute_rms(_rotate(angle, a) - b)


def _rotate(angle: float, points: FloatArray) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def _compute_rms(distances: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(distances**2, axis=-1)))) if len(distances) else float("nan")
