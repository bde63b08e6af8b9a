"""The plane of motion (3.2.3): the vertical plane in which the markers move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

_REWEIGHTINGS = 10


@dataclass(frozen=True)
class PlaneFit:
    """The plane of motion.

    Parameters
    ----------
    yaw : float
        Angle of the line of motion about the vertical from the lab's X, rad, in (-pi/2, pi/2]. The direction in
        which the subject faces is not decided here.
    planarity : float
        Share of the motion (vertical included) out of the plane: 0 for planar motion, 1/3 for isotropic motion.
    """

    yaw: float
    planarity: float


def fit_plane(positions: FloatArray) -> PlaneFit:
    """Fit the vertical plane of motion to marker trajectories.

    Every marker is centred on its own mean (3.7), so that its place on the body does not matter. The horizontal
    displacements are then fitted by a weighted principal axis; reweighting reduces the influence of bursts and of
    limbs that leave the plane.

    Parameters
    ----------
    positions : (F, M, 3) array
        Lab coordinates with Z up, m; NaN where unseen.

    Returns
    -------
    PlaneFit
        Yaw and planarity are 0 if nothing moves.

    Examples
    --------
    >>> t = np.linspace(0, 6, 100)[:, None]
    >>> path = np.stack([np.cos(0.3) * np.sin(t), np.sin(0.3) * np.sin(t), np.cos(t)], axis=-1)
    >>> round(fit_plane(path).yaw, 6)
    0.3
    """
    displacements = _displacements(positions)
    horizontal = displacements[:, :2]
    if not len(horizontal) or not np.any(horizontal):
        return PlaneFit(0.0, 0.0)
    weights = np.ones(len(horizontal))
    axis = _principal_axis(horizontal, weights)
    for _ in range(_REWEIGHTINGS):
        off_axis = horizontal @ np.array([-axis[1], axis[0]])
        scale = 1.4826 * np.median(np.abs(off_axis))
        if scale == 0:
            break
        weights = 1 / (1 + (off_axis / (3 * scale)) ** 2)
        axis = _principal_axis(horizontal, weights)
    off_plane = horizontal @ np.array([-axis[1], axis[0]])
    yaw = float(np.arctan2(axis[1], axis[0]))
    return PlaneFit(_half_turn(yaw), float(np.sum(off_plane**2) / np.sum(displacements**2)))


def _displacements(positions: FloatArray) -> FloatArray:
    """Return the seen displacements (K, 3) of every marker from its own mean."""
    seen: BoolArray = np.asarray(np.isfinite(positions).all(axis=2))
    counts = np.maximum(seen.sum(axis=0), 1)
    means = np.where(seen[..., None], positions, 0.0).sum(axis=0) / counts[:, None]
    return np.asarray((positions - means)[seen])


def _principal_axis(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the unit vector (2,) of the largest weighted second moment about the origin."""
    _, vectors = np.linalg.eigh((points * weights[:, None]).T @ points)
    return np.asarray(vectors[:, 1])


def _half_turn(angle: float) -> float:
    return float(np.pi / 2 - (np.pi / 2 - angle) % np.pi)
