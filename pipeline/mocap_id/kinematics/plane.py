"""Plane of motion (3.2.3): the plane in which the markers move, vertical unless their motion clearly leans."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray

_REWEIGHTINGS = 10
_LEANS = (np.radians(2.5), np.radians(20.0))  # smaller leans have no effect; larger ones are out-of-plane movements
_EXPLAINED = 0.5  # largest ratio of the motion out of a leaning plane to the motion out of the vertical plane
_LOW_M = 0.15  # markers of the feet are at most this much higher than the lowest one


@dataclass(frozen=True)
class PlaneFit:
    """Plane of motion. The direction in which the subject faces is not decided here."""

    yaw: float  # angle about the vertical from the lab's X to the line of motion, rad, in (-pi/2, pi/2]
    planarity: float  # squared motion out of the plane / total squared motion: 0 if planar, 1/3 if isotropic
    lean: float = 0.0  # angle between the plane and the vertical, rad; 0 unless the motion clearly leans

    def straighten(self, positions: FloatArray, feet: FloatArray) -> FloatArray:
        """Return positions (F, M, 3), m, rotated about the line of motion through ``feet`` (3,) to a vertical plane."""
        across = np.array([np.sin(self.yaw), -np.cos(self.yaw), 0.0])
        away = positions - feet
        c, s, z = np.cos(self.lean), np.sin(self.lean), away @ across
        turned = away + ((c - 1) * z - s * away[..., 2])[..., None] * across
        turned[..., 2] = s * z + c * away[..., 2]
        return np.asarray(turned + feet)


def fit_plane(positions: FloatArray) -> PlaneFit:
    """Fit the plane of motion to marker trajectories: a vertical plane, or a leaning one if it fits far better.

    Each marker's mean is subtracted (3.7), so that its position on the body has no effect. A weighted principal axis is
    then fitted to the horizontal displacements. Reweighting reduces the influence of bursts and of limbs that leave the
    plane. Yaw and planarity are 0 if nothing moves.

    Parameters
    ----------
    positions : (F, M, 3) array
        Lab coordinates with Z up, m; NaN where missing.

    Examples
    --------
    >>> t = np.linspace(0, 6, 100)[:, None]
    >>> path = np.stack([np.cos(0.3) * np.sin(t), np.sin(0.3) * np.sin(t), np.cos(t)], axis=-1)
    >>> round(fit_plane(path).yaw, 6)
    0.3
    """
    seen: BoolArray = np.asarray(np.isfinite(positions).all(axis=2))
    counts = np.maximum(seen.sum(axis=0), 1)
    means = np.where(seen[..., None], positions, 0.0).sum(axis=0) / counts[:, None]
    displacements = np.asarray((positions - means)[seen])
    horizontal = displacements[:, :2]
    if not len(horizontal) or not np.any(horizontal):
        return PlaneFit(0.0, 0.0)
    total = np.sum(displacements**2)

    def fit(vectors: FloatArray, find_normal: Callable[[FloatArray], FloatArray]) -> tuple[FloatArray, float]:
        """Return the normal of the plane, from the principal axes of weighted vectors, and the planarity."""
        weights = np.ones(len(vectors))
        for _ in range(_REWEIGHTINGS + 1):
            normal = find_normal(np.linalg.eigh((vectors * weights[:, None]).T @ vectors)[1])
            off_plane = vectors @ normal
            scale = 1.4826 * np.median(np.abs(off_plane))
            if scale == 0:
                break
            weights = 1 / (1 + (off_plane / (3 * scale)) ** 2)
        return normal, float(np.sum(off_plane**2) / total)

    # a vertical plane, along the largest weighted second moment of the horizontal displacements, or one with any normal
    (x, y), planarity = fit(horizontal, lambda axes: np.array([-axes[1, 1], axes[0, 1]]))
    vertical = PlaneFit(_wrap_half_circle(float(np.arctan2(-x, y))), planarity)
    (x, y, z), planarity = fit(displacements, lambda axes: axes[:, 0])
    yaw = _wrap_half_circle(float(np.arctan2(x, -y)))
    if x * np.sin(yaw) - y * np.cos(yaw) < 0:  # the normal points along z of the plane frame
        z = -z
    leaning = PlaneFit(yaw, planarity, -float(np.arcsin(np.clip(z, -1, 1))))
    clear = _LEANS[0] <= abs(leaning.lean) <= _LEANS[1] and leaning.planarity < _EXPLAINED * vertical.planarity
    return leaning if clear else vertical


def find_feet(positions: FloatArray) -> FloatArray:
    """Return the mean position (3,) of the lowest markers, m, from trajectories (F, M, 3)."""
    seen = np.isfinite(positions).all(axis=2).any(axis=0)
    means = np.nanmean(positions[:, seen], axis=0)
    return np.asarray(means[means[:, 2] <= means[:, 2].min() + _LOW_M].mean(axis=0))


def _wrap_half_circle(angle: float) -> float:
    """Return an angle wrapped to (-pi/2, pi/2]."""
    return float(np.pi / 2 - (np.pi / 2 - angle) % np.pi)
