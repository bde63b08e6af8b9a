"""Corrections of markers for motion of the skin (axial rotation, clusters that slide on bones), and ``skin.h5``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray, as_complex, as_xy, chunks, interpolate_gaps
from mocap_id.estimation.space import SpatialStates
from mocap_id.estimation.space.frame_poses import remove_fast_part
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.kinematics.skin_slides import SkinModel
from mocap_id.kinematics.space.bodies import rigid_poses
from mocap_id.store import Tree
from mocap_id.store.provenance import SKIN


def make_skin_tree(skin: SkinModel, labels: Sequence[str], camera_sd: float | None, basis: str) -> Tree:
    """Return skin.h5 of a model of skin motion; ``basis`` names the data from which the variances were estimated.

    ``camera_sd`` is the standard deviation of the camera noise of a coordinate, m; None without cameras.
    """
    data = {
        "joints": {"centre": as_xy(skin.centres), "mean_angle": skin.mean},
        "markers": {
            "name": np.array(labels, dtype=object),
            "segment": skin.segment,
            "local": as_xy(skin.local),
            "seen": skin.weight,
            "variance": skin.size,
            "unshaped_variance": skin.rest,
            "spread": skin.spread,
        },
        "response": {"slides": skin.moved, "noise": skin.noise},
    }
    return Tree(SKIN, data, {"camera_sd_m": camera_sd, "basis": basis})


def read_skin_tree(tree: Tree) -> SkinModel:
    """Return the model of skin motion that skin.h5 contains."""
    return SkinModel(
        centres=as_complex(tree.array("joints/centre")),
        local=as_complex(tree.array("markers/local")),
        segment=tree.array("markers/segment"),
        weight=tree.array("markers/seen"),
        size=tree.array("markers/variance"),
        rest=tree.array("markers/unshaped_variance"),
        mean=tree.array("joints/mean_angle"),
        spread=tree.array("markers/spread"),
        moved=tree.array("response/slides"),
        noise=tree.array("response/noise"),
    )


_ROUNDS = 4  # number of rounds; each multiplies the error by the share of the rotation that the skin misses, about 0.2
_COMMON = 0.05  # standard deviation of the share of the axial rotation that the skin beside the next joint misses
# ratio of the share that all skin of a segment may miss to the share under its sensor, from simulated arms
_ALL_MISS = 0.5


def fit_cluster_poses(points: FloatArray, chain: SpatialChain) -> tuple[FloatArray, FloatArray]:
    """Fit the pose of each segment to its markers; return rotations (F, S, 3, 3) and origins (F, S, 3), m.

    ``points`` (F, M, 3) are the markers, m. A pose is NaN if its segment has too few markers with a position.
    """
    segments = range(len(chain.joints) + 1)
    rotations, origins = np.empty((len(points), len(segments), 3, 3)), np.empty((len(points), len(segments), 3))
    _fit_clusters(points, chain, segments, rotations, origins)
    return rotations, origins


def _fit_clusters(
    points: FloatArray, chain: SpatialChain, segments: Iterable[int], rotations: FloatArray, origins: FloatArray
) -> None:
    """Fit the poses of the given segments and write them into ``rotations`` and ``origins``."""
    for k in segments:
        here = (chain.segment == k) & ~chain.on_glide
        rotations[:, k], origins[:, k], _ = rigid_poses(points[:, here], chain.local[here])


def correct_axial_rotation(points: FloatArray, chain: SpatialChain) -> FloatArray:
    """Return the markers (F, M, 3) that the trial would have if the skin followed the axial rotation of the bones, m.

    When a segment rotates by τ about its long axis l, the skin under a marker misses the share s of this rotation: in
    the axes of the segment, the marker is at exp(-s τ l) x instead of x. The rotation follows from the poses of the
    segments, which have the same error; poses and rotation are therefore computed alternately. A corrected marker is
    NaN if the pose of its segment is unknown. ``chain`` contains the share that the skin under each marker misses.
    """
    if not np.any(chain.skin):
        return points
    rotations, origins = fit_cluster_poses(points, chain)
    segments = np.unique(chain.segment[chain.skin != 0]).tolist()
    for k in range(1, _ROUNDS + 1):
        # axial rotation of each moving segment, without jumps and interpolated where unknown
        angles = np.zeros((len(rotations), len(chain.joints)))
        for j, joint in enumerate(chain.joints):
            relative = np.swapaxes(rotations[:, joint.parent], 1, 2) @ rotations[:, j + 1]
            known = np.flatnonzero(np.isfinite(relative).all(axis=(1, 2)))
            if len(known):
                angle = np.unwrap(joint.twist(relative[known]))
                angle = angle - 2 * np.pi * np.round(np.median(angle) / (2 * np.pi))
                angles[:, j] = np.interp(np.arange(len(rotations)), known, angle)
        # each marker is turned back by the part that the skin misses
        corrected = points.copy()
        for part in chunks(len(points)):
            for j, joint in enumerate(chain.joints, start=1):
                here = np.flatnonzero((chain.segment == j) & (chain.skin != 0))
                own, origin = rotations[part, j], origins[part, j, None]
                seen = np.einsum("fji,fmj->fmi", own, points[part, here] - origin)
                turn = so3.exp(angles[part, j - 1, None, None] * chain.skin[here, None] * joint.long_axis)
                turned = np.einsum("fij,fmj->fmi", own, np.einsum("fmij,fmj->fmi", turn, seen))
                corrected[part, here] = turned + origin
        if k < _ROUNDS:
            _fit_clusters(corrected, chain, segments, rotations, origins)
    return corrected


def add_axial_rotation_errors(
    states: SpatialStates, chain: SpatialChain, *, common: float = _COMMON, missed: Mapping[int, float] | None = None
) -> SpatialStates:
    """Return the states with larger standard deviations, because the skin follows an uncertain share of axial rotation.

    If this share has the error c, the estimated rotation of the segment has the error c τ about its long axis, where τ
    is its axial rotation. This is an error of the joint before the segment and, with opposite sign, of those after it.
    ``common`` is the standard deviation of an error of the share that is the same for all markers of a segment.
    ``missed`` is the share that the skin under a segment's inertial sensor misses in comparison with the markers; the
    uncertainty of velocities and accelerations then follows from this share alone.
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
        error = (size[:, :, None] * axis).reshape(-1, 9)
        covariance[:, k - 1] += error[:, :, None] * error[:, None]
        for below, other in enumerate(chain.joints):
            if other.parent == k:
                axis_below = np.einsum("fji,j->fi", states.joint_rotations[:, below], axis)
                error = (size[:, :, None] * axis_below[:, None]).reshape(-1, 9)
                covariance[:, below] += error[:, :, None] * error[:, None]
        omega[:, k] = np.hypot(omega[:, k], np.abs(size[:, 1]) / np.sqrt(3))
        alpha[:, k] = np.hypot(alpha[:, k], np.abs(size[:, 2]) / np.sqrt(3))
    return replace(states, joint_covariance=covariance, sd_omega=omega, sd_alpha=alpha)


def correct_cluster_slides(points: FloatArray, chain: SpatialChain, rate: float) -> FloatArray:
    """Return the markers (F, M, 3) without slow slides of whole clusters of markers on the bones, m.

    Each cluster is shifted so that its joint centre agrees with the same centre in the cluster before it. Only the
    difference between two clusters is known, so the mean shift of all clusters is zero. Rotations do not change.
    """
    if not any(joint.slide_sd for joint in chain.joints):
        return points
    rotations, origins = fit_cluster_poses(points, chain)
    shifts = np.zeros_like(origins)
    for k, joint in enumerate(chain.joints, start=1):
        shifts[:, k] = shifts[:, joint.parent]
        if joint.slide_sd:
            base = rotations[:, joint.parent]
            centre = joint.origin(np.swapaxes(base, 1, 2) @ rotations[:, k])
            apart = origins[:, k] - origins[:, joint.parent] - np.einsum("fij,fj->fi", base, centre)
            shifts[:, k] += remove_fast_part(interpolate_gaps(apart), rate)
    shifts -= shifts.mean(axis=1, keepdims=True)
    return np.asarray(points - shifts[:, chain.segment])
