"""Kind of every joint, chosen by the rotation between two clusters that each kind leaves unexplained.

With soft tissue, every joint looks like a ball joint. A kind is good enough if the rotation that it cannot explain is
not much larger than the noise of the clusters. The simplest of these kinds is chosen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import JointKind
from mocap_id.kinematics.space.bundle_equations import tangents
from mocap_id.kinematics.space.rigid_body import mean_rotation

_EXPLAINED: dict[JointKind, float] = {"hinge": 1.15, "two-axis": 3.4, "ball": np.inf}
"""Largest unexplained rotation of a kind, relative to the noise of the clusters. Soft tissue affects two axes more."""
_PIN_EXPLAINED = 6.0  # the same for a likely second axis; a wrong axis leaves far more
SHOWN = float(np.radians(10))
"""Least arc, rad, that determines the kind of a joint."""
_LEAST_NOISE = np.radians(0.15)
PARALLEL = 0.75
"""Largest cosine of the angle between the axes of a two-axis joint."""
_UPRIGHT = 0.05  # weight of a right angle between two axes during the search, relative to the motion
_TURNS = 40
_STARTS = 12


@dataclass(frozen=True)
class JointEvidence:
    """Evidence from the motion for the kind of a joint."""

    kind: JointKind  # kind in use
    likely: JointKind  # simplest kind that explains the rotation; a ball if the joint hardly rotates
    ratio: dict[JointKind, float]  # rms rotation left unexplained, relative to the noise of the clusters
    arc: float  # 2.5 to 97.5 % range of the rotation about its main direction, rad


@dataclass(frozen=True)
class JointAxes:
    """Axes of a joint."""

    first: FloatArray  # in the parent's frame
    second: FloatArray  # in the child's frame
    cosine: float  # cosine of the angle between them


def weigh_kinds(turn: FloatArray, noise: FloatArray, arc: float, kind: JointKind | None = None) -> JointEvidence:
    """Return the evidence for the kind of a joint; ``kind`` is the kind that the user has chosen, if any.

    ``turn`` (F, 3, 3) is the rotation of the child in the parent, and ``noise`` (3, 3) the covariance of its error at
    one time, in the parent's axes, rad². ``arc`` is the range of the rotation between the clusters, rad.
    """
    noise = noise + _LEAST_NOISE**2 * np.eye(3)
    hinge, pair = fit_hinge(turn), fit_two_axes(turn)
    tilt = np.cross(hinge.first, turn @ hinge.second) @ tangents(hinge.first)
    noise_across = tangents(hinge.first).T @ noise @ tangents(hinge.first)
    over = np.linalg.eigvals(np.linalg.solve(noise_across, tilt.T @ tilt / len(turn))).real.max()
    gap, size = _measure_gap(turn, pair, noise)
    ratio: dict[JointKind, float] = {
        "hinge": float(np.sqrt(over)),
        "two-axis": float(np.sqrt(np.mean(gap**2 / size))),
        "ball": 0.0,
    }
    fits: list[JointKind] = [each for each in ratio if ratio[each] <= _EXPLAINED[each]]
    likely: JointKind = fits[0] if arc >= SHOWN else "ball"
    return JointEvidence(kind or likely, likely, ratio, arc)


def _measure_gap(turn: FloatArray, pair: JointAxes, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the angle that two axes leave unexplained (F,), rad, and the variance of its noise, rad²."""
    rotated = turn @ pair.second
    normal = np.cross(pair.first, rotated)
    gap = (rotated @ pair.first - pair.cosine) / np.sqrt(max(1 - pair.cosine**2, 1e-6))
    return gap, np.einsum("fi,ij,fj->f", normal, noise, normal) / np.maximum((normal**2).sum(axis=1), 1e-9)


def fit_pin_axes(turn: FloatArray, noise: FloatArray, pin: FloatArray) -> JointAxes | None:
    """Return two axes of which the second is ``pin`` (3,); None if these do not explain the rotation."""
    middle = turn.mean(axis=0)
    rotated = turn @ pin
    spread = rotated - middle @ pin
    pull = _UPRIGHT * np.sum(spread**2) / len(turn)
    first = _smallest_eigenvectors(spread.T @ spread / len(turn) + pull * np.outer(middle @ pin, middle @ pin))
    pair = JointAxes(first, pin, float(first @ middle @ pin))
    gap, size = _measure_gap(turn, pair, noise + _LEAST_NOISE**2 * np.eye(3))
    return pair if np.sqrt(np.mean(gap**2 / size)) <= _PIN_EXPLAINED else None


def rotation_arc(turn: FloatArray) -> float:
    """Return the 2.5 to 97.5 % range of rotations (F, 3, 3) about their main direction, rad."""
    vectors = so3.log(np.swapaxes(mean_rotation(turn), 0, 1) @ turn)
    vectors = vectors - vectors.mean(axis=0)
    main = np.linalg.eigh(vectors.T @ vectors)[1][:, -1]
    low, high = np.quantile(vectors @ main, [0.025, 0.975])
    return float(high - low)


def fit_hinge(turn: FloatArray) -> JointAxes:
    """Return the axis that best keeps its direction in both bodies."""
    left, _, right = np.linalg.svd(turn.mean(axis=0))
    return JointAxes(left[:, 0], right[0], 1.0)


def fit_two_axes(turn: FloatArray) -> JointAxes:
    """Return the two axes, one in each body, whose angle changes least.

    The cosine of the angle is a · Q b. Its variance is a quadratic form in each axis, so the axes are improved
    alternately.
    """
    middle = turn.mean(axis=0)
    spread = (turn - middle).reshape(len(turn), 9)
    form = (spread.T @ spread / len(turn)).reshape(3, 3, 3, 3)
    size = float(np.trace(spread.T @ spread)) / len(turn)
    at = np.arange(_STARTS) + 0.5  # starts are spread over a half sphere
    height, around = at / _STARTS, np.pi * (1 + np.sqrt(5)) * at
    flat = np.sqrt(1 - height**2)
    second = np.stack([flat * np.cos(around), flat * np.sin(around), height], axis=1)
    for pull in (*[_UPRIGHT * size] * _TURNS, *[1e-3 * size] * _TURNS):
        rotated = second @ middle.T
        upright = pull * (rotated[:, :, None] * rotated[:, None, :])
        first = _smallest_eigenvectors(np.einsum("ijkl,sj,sl->sik", form, second, second) + upright)
        rotated = first @ middle
        upright = pull * (rotated[:, :, None] * rotated[:, None, :])
        second = _smallest_eigenvectors(np.einsum("ijkl,si,sk->sjl", form, first, first) + upright)
    cosine = np.einsum("si,ij,sj->s", first, middle, second)
    value = np.einsum("ijkl,si,sj,sk,sl->s", form, first, second, first, second) / np.maximum(1 - cosine**2, 1e-6)
    best = int(np.argmin(value + (np.abs(cosine) > PARALLEL) * size))
    return JointAxes(first[best], second[best], float(cosine[best]))


def _smallest_eigenvectors(form: FloatArray) -> FloatArray:
    """Return the eigenvectors (..., 3) of the smallest eigenvalues of forms (..., 3, 3)."""
    return np.asarray(np.linalg.eigh(form)[1][..., 0])
