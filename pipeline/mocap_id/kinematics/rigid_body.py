"""Rigid bodies in the plane: markers with constant mutual distances.

Points of the plane are complex numbers: rotation by phi and translation is ``z = p + exp(i phi) q``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray

_ITERATIONS = 50
_TOLERANCE = 1e-7  # m
_SAME_PLACE = 0.03  # m


@dataclass(frozen=True)
class RigidBody:
    """Markers that move as one rigid body."""

    markers: IntArray  # (k,) columns of the trajectories
    template: ComplexArray  # (k,) marker coordinates in the body's frame, whose origin is their centroid, m
    rotation: ComplexArray  # (F,) ``exp(i phi)`` of the body; NaN with fewer than two visible markers
    position: ComplexArray  # (F,) origin of the body's frame, m
    residual: float  # rms distance of the markers from their positions on the body, m

    @property
    def angle_noise(self) -> float:
        """Standard deviation of the angle of ``rotation``, rad, if the residual were white noise.

        The pose absorbs three of a frame's 2 k coordinates, so the residual is smaller than the noise. The result is
        infinite with fewer than two markers, or if all are at one point.
        """
        spread, coordinates = float(np.sqrt(np.sum(np.abs(self.template) ** 2))), 2 * len(self.markers)
        if spread == 0 or coordinates <= 3:
            return np.inf
        return float(self.residual * np.sqrt(coordinates / (coordinates - 3) / 2) / spread)

    def local(self, points: ComplexArray) -> ComplexArray:
        """Return trajectories (F, ...) in the body's frame."""
        shape = (-1,) + (1,) * (points.ndim - 1)
        return np.asarray(np.conj(self.rotation).reshape(shape) * (points - self.position.reshape(shape)))


def fit_body(points: ComplexArray, markers: Sequence[int] | IntArray) -> RigidBody:
    """Fit a rigid body to markers by least squares (generalised Procrustes analysis over the frames, ignoring gaps).

    ``markers`` are at least two columns of the trajectories (F, M), m, NaN where missing.
    """
    columns = np.asarray(markers, dtype=np.int64)
    seen = np.isfinite(points[:, columns])
    z = np.where(seen, points[:, columns], 0)
    weight = seen.astype(np.float64)
    template = z[int(np.argmax(seen.sum(axis=1)))]
    for _ in range(_ITERATIONS):
        rotation, position = rigid_poses(z, weight, template)
        back = np.conj(rotation)
        updated = (back @ z - (back * position) @ weight) / np.maximum(weight.sum(axis=0), 1)
        updated -= updated.mean()
        moved = float(np.max(np.abs(updated - template)))
        template = updated
        if moved < _TOLERANCE:
            break
    rotation, position = rigid_poses(z, weight, template)
    enough = seen.sum(axis=1) >= 2
    off = np.abs(z - position[:, None] - rotation[:, None] * template)[seen & enough[:, None]]
    residual = float(np.sqrt(np.mean(off**2))) if off.size else np.inf
    unknown = np.where(enough, 1.0, np.nan)
    return RigidBody(columns, template, rotation * unknown, position * unknown, residual)


def still_body(points: ComplexArray, markers: Sequence[int] | IntArray) -> RigidBody:
    """Return the fixed base as a rigid body whose frame is the plane frame."""
    columns = np.asarray(markers, dtype=np.int64)
    template = np.nanmean(points[:, columns], axis=0)
    frames = len(points)
    off = np.abs(points[:, columns] - template)
    return RigidBody(
        columns,
        template,
        np.ones(frames, dtype=np.complex128),
        np.zeros(frames, dtype=np.complex128),
        float(np.sqrt(np.nanmean(off**2))),
    )


def marker_residuals(body: RigidBody, points: ComplexArray) -> FloatArray:
    """Return the rms distance (M,) of markers from their mean positions on a body, m; inf if hardly visible."""
    square, counts = variance_over_time(body.local(points))
    return np.where(counts > 1, np.sqrt(square), np.inf)


def variance_over_time(values: FloatArray | ComplexArray) -> tuple[FloatArray, IntArray]:
    """Return the variance (M,) of each column (F, M), ignoring NaN, and the number of its values (M,)."""
    seen = np.isfinite(values)
    counts = seen.sum(axis=0)
    filled = np.where(seen, values, 0)
    mean = filled.sum(axis=0) / np.maximum(counts, 1)
    return np.where(seen, np.abs(filled - mean) ** 2, 0).sum(axis=0) / np.maximum(counts, 1), counts


def count_positions(local: ComplexArray) -> int:
    """Return the number of distinct positions among ``local`` (K,), m; those within 30 mm count once."""
    kept: list[complex] = []
    for each in local:
        if all(abs(each - other) > _SAME_PLACE for other in kept):
            kept.append(complex(each))
    return len(kept)


def rigid_poses(
    z: ComplexArray, seen: BoolArray | FloatArray, template: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return the rotation and position (F,) that fit a template to each frame (closed form in the plane).

    The markers z (F, k), m, are 0 where missing, ``seen`` (F, k) is 1 where they are visible, and ``template`` (k,) are
    their coordinates in the body's frame, m.
    """
    counts = np.maximum(seen.sum(axis=1), 1)
    centroid = z.sum(axis=1) / counts
    template_centroid = seen @ template / counts
    moment = z @ np.conj(template) - counts * centroid * np.conj(template_centroid)
    size = np.abs(moment)
    rotation = np.where(size > 0, moment / np.where(size > 0, size, 1), 1)
    return rotation, centroid - rotation * template_centroid
