"""Joints of an OpenSim model of a chain in space, and their coordinates over time.

A joint of OpenSim connects a frame on the parent body with a frame on the child body. The rotation of the child is

    free, ball   R = A Rx(q1) Ry(q2) Rz(q3)      A: mean rotation in the trial, so that q2 stays away from ±90°
    two-axis     R = exp(a q1) exp(O b q2) O
    hinge        R = A Rz(q1) Aᵀ O               A: a rotation whose z axis is the axis a

with the coordinates q and the symbols of :mod:`mocap_id.geometry.spatial_chain`. A shoulder whose centre glides has an
additional body, the girdle, between the parent and the ball joint. The girdle slides in the direction of the glide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialJoint
from mocap_id.store.spatial_views import SegmentPoses, SpatialSkeleton
from mocap_id.workflows.export.files import BASE, name_bodies, name_joints

_IDENTITY = np.eye(3)


@dataclass(frozen=True)
class ModelJoint:
    """One joint of the model with d coordinates at T times."""

    name: str
    element: str  # FreeJoint, BallJoint, PinJoint or CustomJoint
    parent: str  # name of the parent body; /ground for the ground
    child: str  # name of the child body
    at: FloatArray  # (3,) centre in the parent's frame, m
    parent_rotation: FloatArray  # (3, 3) frame of the joint on the parent
    child_rotation: FloatArray  # (3, 3) frame of the joint on the child
    coordinates: tuple[str, ...]  # d names
    values: FloatArray  # (T, d) coordinates over time, rad or m; NaN where unknown
    axes: tuple[FloatArray, ...] = ()  # d axes (3,) of a CustomJoint
    slides: bool = False  # the axes of a CustomJoint are directions of translation


def name_girdles(skeleton: SpatialSkeleton) -> tuple[str, ...]:
    """Return the name of the girdle of each joint, n in all; an empty text for a joint without a glide."""
    glides = [bool(np.any(joint.glide)) for joint in skeleton.chain.joints]
    return tuple(f"{name}_girdle" if has else "" for name, has in zip(name_joints(skeleton), glides, strict=True))


def model_joints(skeleton: SpatialSkeleton, poses: SegmentPoses) -> list[ModelJoint]:
    """Return the joints of the model, parents first."""
    segments, girdles = name_bodies(skeleton.segments), name_girdles(skeleton)
    joints = [_free(segments[0], poses)]
    for k, (name, joint) in enumerate(zip(name_joints(skeleton), skeleton.chain.joints, strict=True)):
        rotation = poses.compute_rotation(joint.parent, k + 1)
        parent, child = segments[joint.parent], segments[k + 1]
        if girdles[k]:
            joints.append(_glide(name, joint, rotation, (parent, girdles[k])))
            parent = girdles[k]
        make = {"ball": _ball, "two-axis": _two_axis, "hinge": _hinge}[joint.kind]
        joints.append(make(name, joint, rotation, (parent, child)))
    return joints


def _free(base: str, poses: SegmentPoses) -> ModelJoint:
    mean = _mean_rotation(poses.rotation[:, 0])
    angles = euler_angles(mean.T @ poses.rotation[:, 0])
    names = tuple(f"{BASE}_{each}" for each in ("rx", "ry", "rz", "tx", "ty", "tz"))
    values = np.column_stack([angles, poses.origin[:, 0] @ mean])
    return ModelJoint(BASE, "FreeJoint", "/ground", base, np.zeros(3), mean, _IDENTITY, names, values)


def _glide(name: str, joint: SpatialJoint, rotation: FloatArray, bodies: tuple[str, str]) -> ModelJoint:
    size = float(np.linalg.norm(joint.glide))
    along = joint.glide / size
    values = ((joint.origin(rotation) - joint.centre) @ along)[:, None]
    return ModelJoint(
        f"{name}_glide", "CustomJoint", *bodies, np.zeros(3), _IDENTITY, _IDENTITY, (f"{name}_glide_shift",), values,
        (along,), slides=True,
    )  # fmt: skip


def _ball(name: str, joint: SpatialJoint, rotation: FloatArray, bodies: tuple[str, str]) -> ModelJoint:
    mean = _mean_rotation(rotation)
    names = tuple(f"{name}_{each}" for each in ("rx", "ry", "rz"))
    values = euler_angles(mean.T @ rotation)
    return ModelJoint(name, "BallJoint", *bodies, joint.centre, mean, _IDENTITY, names, values)


def _two_axis(name: str, joint: SpatialJoint, rotation: FloatArray, bodies: tuple[str, str]) -> ModelJoint:
    first, second = joint.first_axis, joint.offset @ joint.second_axis
    turned = rotation @ joint.offset.T
    q1 = _angle(first, np.broadcast_to(second, turned.shape[:-1]), turned @ second)
    probe = so3.exp(np.pi / 2 * first) @ second
    rest = np.swapaxes(so3.exp(q1[:, None] * first), -1, -2) @ turned
    q2 = _angle(second, np.broadcast_to(probe, turned.shape[:-1]), rest @ probe)
    values = _unwrap(np.column_stack([q1, q2]))
    names = (f"{name}_angle_1", f"{name}_angle_2")
    return ModelJoint(
        name, "CustomJoint", *bodies, joint.centre, _IDENTITY, joint.offset.T, names, values, (first, second)
    )


def _hinge(name: str, joint: SpatialJoint, rotation: FloatArray, bodies: tuple[str, str]) -> ModelJoint:
    axis = joint.first_axis
    across = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    across /= np.linalg.norm(across)
    own = np.column_stack([across, np.cross(axis, across), axis])
    turned = rotation @ joint.offset.T
    values = _unwrap(_angle(axis, np.broadcast_to(across, turned.shape[:-1]), turned @ across)[:, None])
    return ModelJoint(name, "PinJoint", *bodies, joint.centre, own, joint.offset.T @ own, (f"{name}_angle",), values)


def _angle(axis: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the angles (T,), rad, about ``axis`` (3,) from directions ``before`` (T, 3) to directions ``after``."""
    sine = np.einsum("i,ti->t", axis, np.cross(before, after))
    along = np.einsum("i,ti->t", axis, before) * np.einsum("i,ti->t", axis, after)
    return np.asarray(np.arctan2(sine, np.einsum("ti,ti->t", before, after) - along))


def _mean_rotation(rotations: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) nearest to the mean of the known rotations (T, 3, 3), or the identity without any."""
    known = rotations[np.isfinite(rotations).all(axis=(1, 2))]
    if not len(known):
        return np.eye(3)
    left, _, right = np.linalg.svd(known.mean(axis=0))
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def euler_angles(rotations: FloatArray) -> FloatArray:
    """Return the angles (T, 3), rad, of rotations (T, 3, 3) as in OpenSim: about the body's x, then y, then z axis.

    The angles have no jumps by 2π over time.

    Examples
    --------
    >>> turned = so3.exp(np.array([[0.3, 0.0, 0.0]])) @ so3.exp(np.array([[0.0, 0.0, -0.2]]))
    >>> euler_angles(turned).round(6)
    array([[ 0.3,  0. , -0.2]])
    """
    R = rotations
    x = np.arctan2(-R[..., 1, 2], R[..., 2, 2])
    y = np.arcsin(np.clip(R[..., 0, 2], -1.0, 1.0))
    z = np.arctan2(-R[..., 0, 1], R[..., 0, 0])
    return _unwrap(np.stack([x, y, z], axis=-1))


def _unwrap(angles: FloatArray) -> FloatArray:
    """Return angles (T, d), rad, without jumps by 2π, also across gaps."""
    out = angles.copy()
    for column in out.T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known])
    return out


def list_coordinates(joints: list[ModelJoint]) -> Iterator[tuple[str, FloatArray, bool]]:
    """Yield the name of each coordinate of a model, its values (T,), and whether it is an angle."""
    for joint in joints:
        for k, name in enumerate(joint.coordinates):
            lengths = joint.slides or (joint.element == "FreeJoint" and k >= 3)
            yield name, joint.values[:, k], not lengths
