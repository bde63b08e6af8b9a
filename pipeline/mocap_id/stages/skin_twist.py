"""Markers without the twist of the skin, which follows only a part of a limb's rotation about its long axis."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray, chunks
from mocap_id.estimation.space import SpatialStates
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.kinematics.space.rigid_body import rigid_poses

_TURNS = 4
"""Each turn reduces what is left by the mean share of the twist that the skin misses, about 0.2."""


def cluster_poses(points: FloatArray, chain: SpatialChain) -> tuple[FloatArray, FloatArray]:
    """Return the poses of all clusters in the frames of the chain, (F, S, 3, 3) and (F, S, 3), m; NaN where unknown."""
    segments = range(len(chain.joints) + 1)
    rotations, origins = np.empty((len(points), len(segments), 3, 3)), np.empty((len(points), len(segments), 3))
    _fit_clusters(points, chain, segments, rotations, origins)
    return rotations, origins


def _fit_clusters(
    points: FloatArray, chain: SpatialChain, segments: Iterable[int], rotations: FloatArray, origins: FloatArray
) -> None:
    """Write the poses of some clusters."""
    for k in segments:
        here = (chain.segment == k) & ~chain.on_glide
        rotations[:, k], origins[:, k], _ = rigid_poses(points[:, here], chain.local[here])


def without_skin_twist(points: FloatArray, chain: SpatialChain) -> FloatArray:
    """Return where the markers would be if the skin did not twist against the bones, (F, M, 3), m.

    The skin under marker m does not follow the share s of the twist τ of its segment about the long axis l: in the
    segment's frame the marker is at exp(-s τ l) x. The twist follows from the poses of the clusters, which the skin
    turns too; poses and twist are therefore computed in turns. A marker is NaN where the pose of its own cluster is
    unknown, since its correction is then unknown too.

    Parameters
    ----------
    points : (F, M, 3) array
        Measured markers, m; NaN where unseen.
    chain : SpatialChain
    """
    if not np.any(chain.skin):
        return points
    rotations, origins = cluster_poses(points, chain)
    soft = np.unique(chain.segment[chain.skin != 0]).tolist()
    for turn in range(1, _TURNS + 1):
        twists = _twists(rotations, chain)
        found = points.copy()
        for part in chunks(len(points)):
            _untwist(found[part], twists[part], rotations[part], origins[part], chain)
        if turn < _TURNS:
            _fit_clusters(found, chain, soft, rotations, origins)
    return found


def _twists(rotations: FloatArray, chain: SpatialChain) -> FloatArray:
    """Return the twist of every moving segment (F, n), rad: continuous, and interpolated where a pose is unknown."""
    found = np.zeros((len(rotations), len(chain.joints)))
    every = np.arange(len(rotations))
    for k, joint in enumerate(chain.joints):
        relative = np.swapaxes(rotations[:, joint.parent], 1, 2) @ rotations[:, k + 1]
        known = np.flatnonzero(np.isfinite(relative).all(axis=(1, 2)))
        if len(known):
            twist = np.unwrap(joint.twist(relative[known]))
            found[:, k] = np.interp(every, known, twist - 2 * np.pi * np.round(np.median(twist) / (2 * np.pi)))
    return found


def _untwist(
    points: FloatArray, twists: FloatArray, rotations: FloatArray, origins: FloatArray, chain: SpatialChain
) -> None:
    """Correct points (f, M, 3) in place."""
    for k, joint in enumerate(chain.joints, start=1):
        here = np.flatnonzero((chain.segment == k) & (chain.skin != 0))
        own, origin = rotations[:, k], origins[:, k, None]
        seen = np.einsum("fji,fmj->fmi", own, points[:, here] - origin)
        turn = so3.exp(twists[:, k - 1, None, None] * chain.skin[here, None] * joint.long_axis)
        points[:, here] = np.einsum("fij,fmj->fmi", own, np.einsum("fmij,fmj->fmi", turn, seen)) + origin


_COMMON = 0.05
"""Share of the twist that the skin beside the next joint may miss after all."""


_ALL_MISS = 0.5
"""Share of the twist that all skin may miss, relative to what the skin under the sensor misses; in simulated arms."""


def with_twist_errors(
    states: SpatialStates, chain: SpatialChain, *, common: float = _COMMON, missed: Mapping[int, float] | None = None
) -> SpatialStates:
    """Return the states with the uncertainty of the twist that no marker of a segment follows.

    An error c of this share turns the segment by c τ about its long axis, in every frame. It is an error of the joint
    above, and with the opposite sign of the joints below.

    Parameters
    ----------
    states : SpatialStates
    chain : SpatialChain
    common : float
        Possible size of this share.
    missed : mapping from int to float, optional
        Share that the skin under the sensor of a segment misses against the markers. It shows how much there is to
        miss, so the rates of these segments do not contain ``common`` and the share's deviation by the markers.
    """
    if not len(chain.skin_sd):
        return states
    covariance, omega, alpha = states.joint_covariance.copy(), states.sd_omega.copy(), states.sd_alpha.copy()
    for k, joint in enumerate(chain.joints, start=1):
        own = chain.skin_sd[(chain.segment == k) & np.isfinite(chain.skin_sd)]
        if not len(own) or not np.any(chain.skin[chain.segment == k]):
            continue
        sd = float(np.hypot(np.mean(own), common))
        of_rate = sd if missed is None or k not in missed else float(np.hypot(_COMMON, _ALL_MISS * missed[k]))
        axis, twisting = joint.long_axis, joint.twist_axis(states.joint_rotations[:, k - 1])
        size = np.stack(
            [
                sd * joint.twist(states.joint_rotations[:, k - 1]),
                of_rate * np.sum(states.velocity[:, k - 1] * twisting, axis=1),
                of_rate * np.sum(states.acceleration[:, k - 1] * twisting, axis=1),
            ],
            axis=1,
        )
        turn = (size[:, :, None] * axis).reshape(-1, 9)
        covariance[:, k - 1] += turn[:, :, None] * turn[:, None]
        for below, other in enumerate(chain.joints):
            if other.parent == k:
                carried = np.einsum("fji,j->fi", states.joint_rotations[:, below], axis)
                turn = (size[:, :, None] * carried[:, None]).reshape(-1, 9)
                covariance[:, below] += turn[:, :, None] * turn[:, None]
        omega[:, k] = np.hypot(omega[:, k], np.abs(size[:, 1]) / np.sqrt(3))
        alpha[:, k] = np.hypot(alpha[:, k], np.abs(size[:, 2]) / np.sqrt(3))
    return replace(states, joint_covariance=covariance, sd_omega=omega, sd_alpha=alpha)
