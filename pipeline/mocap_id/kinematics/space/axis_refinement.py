"""Axes of a calibrated chain, corrected with another trial of the same person and markers.

Skin slides with the joints, so an axis fitted to one motion is wrong by a few degrees for another motion. A wrong axis
of the elbow changes its flexion into axial rotation of the shoulder. The angle between two axes a and b is constant: a
· Q b = κ for every rotation Q of the joint. The trial corrects a, b and κ as far as its motion determines them; the
calibration is the prior.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint
from mocap_id.kinematics.space.bundle_model import tangents
from mocap_id.kinematics.space.chain_result import align_offset

_LASTING = np.radians(0.6)  # rms change of the angle between the axes by skin that slides with the joint
_OTHER_ANGLE = np.radians(5)  # typical change of this angle by a constant displacement of the skin
_ITERATIONS = 8
_SHOWN = 0.85  # largest ratio of the standard deviations of the first axis after and before the correction


def refine_axes(chain: SpatialChain, rotations: FloatArray) -> tuple[SpatialChain, tuple[int, ...]]:
    """Return the calibrated chain with corrected axes of two-axis joints, and the numbers of these joints, from 0.

    Only joints whose axes become clearly more certain are corrected.

    ``rotations`` (F, n + 1, 3, 3) are the rotations of the clusters in the new trial, NaN where unknown.
    """
    joints, refined = list(chain.joints), []
    for k, joint in enumerate(chain.joints):
        turn = np.swapaxes(rotations[:, joint.parent], 1, 2) @ rotations[:, k + 1]
        turn = turn[np.isfinite(turn).all(axis=(1, 2))]
        if not has_known_axes(joint) or not len(turn):
            continue
        refined_joint = _refine_joint(joint, turn)
        if np.trace(refined_joint.axes_covariance[0]) < _SHOWN**2 * np.trace(joint.axes_covariance[0]):
            joints[k] = refined_joint
            refined.append(k)
    return replace(chain, joints=tuple(joints)), tuple(refined)


def has_known_axes(joint: SpatialJoint) -> bool:
    """Return whether a joint has two axes with known covariances."""
    return joint.kind == "two-axis" and bool(np.isfinite(joint.axes_covariance).all())


def _refine_joint(joint: SpatialJoint, turn: FloatArray) -> SpatialJoint:
    """Return the joint with axes and κ refined by Gauss-Newton; the error of the skin is the same in all frames."""
    axis, pin = joint.first_axis, joint.second_axis
    before = cosine = float(axis @ joint.offset @ pin)
    bases = tangents(axis), tangents(pin)
    known = [
        np.linalg.inv(basis.T @ covariance @ basis)
        for basis, covariance in zip(bases, joint.axes_covariance, strict=True)
    ]
    weight = 1 / (_LASTING**2 * len(turn))
    for _ in range(_ITERATIONS):
        along, across = tangents(axis), tangents(pin)
        rotated_pin = turn @ pin
        rows = np.column_stack([rotated_pin @ along, (axis @ turn) @ across, -np.ones(len(turn))])
        matrix = weight * rows.T @ rows
        vector = weight * rows.T @ (rotated_pin @ axis - cosine)
        places = (slice(0, 2), axis, joint.first_axis, along), (slice(2, 4), pin, joint.second_axis, across)
        for (at, now, start, by), basis, inverse in zip(places, bases, known, strict=True):
            turned = basis.T @ by
            matrix[at, at] += turned.T @ inverse @ turned
            vector[at] += turned.T @ inverse @ basis.T @ (now - start)
        matrix[4, 4] += 1 / _OTHER_ANGLE**2
        vector[4] += (cosine - before) / _OTHER_ANGLE**2
        step = -np.linalg.solve(matrix, vector)
        axis, pin, cosine = axis + along @ step[:2], pin + across @ step[2:4], cosine + float(step[4])
        axis, pin = axis / np.linalg.norm(axis), pin / np.linalg.norm(pin)
    spread = np.linalg.inv(matrix)
    along, across = tangents(axis), tangents(pin)
    return replace(
        joint,
        first_axis=axis,
        second_axis=pin,
        axes_covariance=np.stack([along @ spread[:2, :2] @ along.T, across @ spread[2:4, 2:4] @ across.T]),
        offset=align_offset(joint.offset, axis, pin, cosine),
    )
