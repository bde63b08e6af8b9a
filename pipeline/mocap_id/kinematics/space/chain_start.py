"""First guess of a chain in space: marker clusters as rigid bodies, and the points that they share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.kinematics.space.rigid_body import fit_shape, rigid_poses

_FAR = 0.3  # m; a joint is hardly farther from its clusters
_SOFT = 0.01  # m; motion of the shared point that is usual


@dataclass(frozen=True)
class Clusters:
    """Marker clusters as rigid bodies, whose axes are those of the trial in a reference frame.

    Parameters
    ----------
    local : (M, 3) array
        Marker coordinates about the centroid of their cluster, m.
    rotation, origin : (F, n + 1, 3, 3) and (F, n + 1, 3) arrays
        Poses; NaN where unknown.
    noise : (n + 1,) array
        rms rotation about the worst direction that the residuals explain, rad.
    sd : (n + 1,) array
        Standard deviation of one coordinate of a marker about its cluster, m.
    """

    local: FloatArray
    rotation: FloatArray
    origin: FloatArray
    noise: FloatArray
    sd: FloatArray

    def median_position(self, segment: int, track: FloatArray) -> FloatArray:
        """Return the median place (3,) of a trajectory (F, 3) in the frame of a cluster, m."""
        local = np.einsum("fji,fj->fi", self.rotation[:, segment], track - self.origin[:, segment])
        return np.asarray(np.nanmedian(local, axis=0))

    def relative_rotation(self, parent: int, child: int) -> FloatArray:
        """Return the rotation of a child in its parent (F, 3, 3)."""
        return np.asarray(np.swapaxes(self.rotation[:, parent], 1, 2) @ self.rotation[:, child])


def fit_clusters(points: FloatArray, segment: IntArray, reference: int) -> Clusters:
    """Fit a rigid body to the markers of every segment.

    Parameters
    ----------
    points : (F, M, 3) array
        Markers, m; NaN where unseen.
    segment : (M,) int array
    reference : int
        Frame in which the axes of all bodies are those of the trial.
    """
    local = np.full((points.shape[1], 3), np.nan)
    rotations, origins, noise, variances = [], [], [], []
    for k in range(int(segment.max()) + 1):
        here = np.flatnonzero(segment == k)
        start = points[reference, here] - np.nanmean(points[reference, here], axis=0)
        shape = local[here] = fit_shape(points[:, here], start)
        rotation, origin, _ = rigid_poses(points[:, here], shape)
        off = points[:, here] - origin[:, None] - np.einsum("fij,mj->fmi", rotation, shape)
        known = shape[np.isfinite(shape).all(axis=1)]
        variance = np.nanmean(off**2) * len(known) / max(len(known) - 2, 1)
        inertia = np.linalg.eigvalsh(np.sum(known**2) * np.eye(3) - known.T @ known)
        rotations.append(rotation)
        origins.append(origin)
        noise.append(float(np.sqrt(variance / inertia[0])))
        variances.append(variance)
    turns, places = np.stack(rotations, axis=1), np.stack(origins, axis=1)
    return Clusters(local, turns, places, np.array(noise), np.sqrt(np.array(variances)))


def fit_shared_point(clusters: Clusters, parent: int, child: int) -> tuple[FloatArray, FloatArray]:
    """Return the point that moves least between two bodies, in the frames of both (3,), m.

    This is the symmetrical centre of rotation (SCoRE, Ehrig et al. 2006), with a weak pull to the middle between the
    bodies, which decides what the motion does not show.
    """
    own, other = clusters.rotation[:, parent], clusters.rotation[:, child]
    apart = clusters.origin[:, child] - clusters.origin[:, parent]
    rows = np.concatenate([own, -other], axis=2).reshape(-1, 6)
    likely = np.concatenate(
        [np.einsum("fji,fj->fi", own, apart).mean(axis=0), -np.einsum("fji,fj->fi", other, apart).mean(axis=0)]
    )
    pull = (_SOFT / _FAR) ** 2 * len(own)
    inverse = np.linalg.inv(rows.T @ rows + pull * np.eye(6))
    point = inverse @ (rows.T @ apart.reshape(-1) + pull * likely / 2)
    return point[:3], point[3:]
