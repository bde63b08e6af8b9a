"""Loose prior of every body's parameters: a reference table with wide standard deviations.

The contact wrench hardly determines how the mass is divided between bodies with similar motion. A fit without a prior
predicts the wrench equally well, but gives feet without mass and torques that are wrong by 5 to 7 N·m. The standard
deviations are 50 % for a mass (25 % for the arms), 10 cm for a centre of mass, and 100 % for a moment of inertia. They
are 2.8 times the spread of published tables. The foot rests, so the data contain no information about it, and the
error of its mean is taken as the spread of the tables. docs/dynamics.md gives the reasons ("The fit").
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from mocap_id.arrays import FloatArray

OTHERS_SHARE = 0.1
"""Mass of both arms, as a fraction of the body's mass. Most markers that are on no segment are on the arms."""
_FOOT_SPREAD = 1 / 2.8
_MASS, _CENTRE, _INERTIA = 0.5, 0.10, 1.0
_ARMS_MASS = 0.25
_FOOT_MASS, _FOOT_CENTRE = 0.3, 0.05
_GYRATION = 0.15  # m: radius of gyration of a body that no table describes
_UNKNOWN_MASS, _UNKNOWN_CENTRE, _UNKNOWN_INERTIA = 1.0, 0.15, 5.0
_LEAST = 1e-3  # kg: least mass


@dataclass(frozen=True)
class BodyPrior:
    """Normal distribution of the full parameters of K bodies."""

    mean: FloatArray  # (4K,) full parameters
    covariance: FloatArray  # (4K, 4K) covariance of the full parameters
    source: str  # source of the mean, in words
    # (r, 2) first and last time of every repetition, s; errors of the poses recur in each repetition
    spans: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    # standard deviation of the errors of the first body's mean, as a fraction of the prior's standard deviation
    foot_spread: float = 1.0

    @property
    def spread(self) -> FloatArray:
        """Standard deviations (4K,) of the errors of the rows of :meth:`rows`; 1, except for the foot."""
        return np.concatenate([np.full(4, self.foot_spread), np.ones(len(self.mean) - 4)])

    def rows(self, columns: int) -> tuple[FloatArray, FloatArray]:
        """Return least-squares rows (4K, columns) and right-hand side (4K,); columns after the first 4K are zero."""
        root = np.linalg.cholesky(self.covariance)
        own = solve_triangular(root, np.eye(len(self.mean)), lower=True)
        return np.pad(own, ((0, 0), (0, columns - len(self.mean)))), own @ self.mean


def build_table_prior(mean: FloatArray, source: str, others: bool = False) -> BodyPrior:
    """Return the prior whose mean (4K,) are the bodies of a reference table, foot first.

    ``source`` is the table's name. With ``others``, the last body is that of the markers on no segment (arms, head).
    """
    spread = [(_FOOT_MASS, _FOOT_CENTRE, _INERTIA), *[(_MASS, _CENTRE, _INERTIA)] * (len(mean) // 4 - 1)]
    if others:
        spread[-1] = (_ARMS_MASS, _CENTRE, _INERTIA)
    blocks = [_compute_covariance(body, *sd) for body, sd in zip(mean.reshape(-1, 4), spread, strict=True)]
    return BodyPrior(mean, block_diag(*blocks), source, foot_spread=_FOOT_SPREAD)


def build_even_prior(mass: float, centroid: FloatArray) -> BodyPrior:
    """Return the prior if no table applies: equal parts of ``mass``, kg, at the markers' centroids (K, 2), m."""
    own = mass / len(centroid)
    inertia = own * (_GYRATION**2 + np.sum(centroid**2, axis=1))
    mean = np.column_stack([np.full(len(centroid), own), own * centroid, inertia])
    blocks = [_compute_covariance(body, _UNKNOWN_MASS, _UNKNOWN_CENTRE, _UNKNOWN_INERTIA) for body in mean]
    return BodyPrior(mean.reshape(-1), block_diag(*blocks), "an even division of the mass")


def split_torso(torso: FloatArray, angle: FloatArray, shift: FloatArray, mass: float) -> tuple[FloatArray, FloatArray]:
    """Split a table's head, arms and trunk into the torso (4,) and the body (4,) of the markers on no segment.

    On average over the samples, the two bodies together equal the given body.

    Parameters
    ----------
    torso : (4,) array
        Parameters of head, arms and trunk together, in the torso's frame.
    angle, shift : (T,) and (T, 2) arrays
        Angle, rad, and origin, m, of the second body's frame in the torso's frame. The origin is the centroid of the
        markers on no segment.
    mass : float
        Mass of the whole body, kg.
    """
    own = min(OTHERS_SHARE * mass, 0.5 * torso[0])
    others = np.array([own, 0.0, 0.0, own * _GYRATION**2])
    rest = torso - average_transform(angle, shift) @ others
    centre = rest[1:3] / rest[0]
    floor = rest[0] * (float(centre @ centre) + _GYRATION**2)
    return np.array([*rest[:3], max(rest[3], floor)]), others


def average_transform(angle: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the mean over samples of the matrix (4, 4) that transforms a body's parameters into another frame.

    ``angle`` (T,), rad, and ``shift`` (T, 2), m, are the angle and the origin of the body's frame in the other frame.
    """
    c, s, (x, y) = np.cos(angle), np.sin(angle), shift.T
    move = np.zeros((len(angle), 4, 4))
    move[:, 0, 0] = move[:, 3, 3] = 1.0
    move[:, 1, 0], move[:, 1, 1], move[:, 1, 2] = x, c, -s
    move[:, 2, 0], move[:, 2, 1], move[:, 2, 2] = y, s, c
    move[:, 3, 0] = x * x + y * y
    move[:, 3, 1], move[:, 3, 2] = 2 * (x * c + y * s), 2 * (y * c - x * s)
    return np.asarray(move.mean(axis=0))


def _compute_covariance(body: FloatArray, mass_sd: float, centre_sd: float, inertia_sd: float) -> FloatArray:
    """Return the covariance (4, 4) of m, mx, my, Izz for independent errors of mass, centre and central moment."""
    mass = max(float(body[0]), _LEAST)
    x, y = body[1:3] / mass
    own = max(float(body[3]) - mass * (x * x + y * y), mass * (0.2 * _GYRATION) ** 2)
    gain = np.array(
        [
            [1.0, 0.0, 0.0, 0.0],
            [x, mass, 0.0, 0.0],
            [y, 0.0, mass, 0.0],
            [x * x + y * y, 2 * mass * x, 2 * mass * y, 1.0],
        ]
    )
    sd = np.array([mass_sd * mass, centre_sd, centre_sd, inertia_sd * own])
    return np.asarray((gain * sd) @ (gain * sd).T)
