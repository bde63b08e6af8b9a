"""Motion of a chain's segments in space on a base at rest: the input of the regressor."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.regressor import bodies_regressor
from mocap_id.geometry import se3, so3
from mocap_id.geometry.joints import Ball
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint


@dataclass(frozen=True)
class SpatialMotion:
    """Poses of K bodies, their derivatives, and the N coordinates of the joints between them, in the trial's frame."""

    rotation: FloatArray  # (T, K, 3, 3) rotation from the frame of each body to the trial's frame
    # omega, alpha: (T, K, 3) angular velocity and acceleration, rad/s and rad/s²
    omega: FloatArray
    alpha: FloatArray
    # origin, acceleration: (T, K, 3) origin of each body's frame, m, and its acceleration without gravity, m/s²
    origin: FloatArray
    acceleration: FloatArray
    # joint, axis: (T, N, 3) centre of the joint, m, and unit direction of the torque, for each coordinate. For a ball
    # joint, the directions are the axes of the parent's frame.
    joint: FloatArray
    axis: FloatArray
    beyond: BoolArray  # (N, K) whether each body is distal to the joint of each coordinate

    @property
    def jacobian(self) -> FloatArray:
        """Unit twists (T, 6, N) of the coordinates: p × d, then d, with the centre p and the axis d of each."""
        return np.swapaxes(np.concatenate([np.cross(self.joint, self.axis), self.axis], axis=-1), 1, 2)

    def at(self, samples: IntArray) -> SpatialMotion:
        """Return the motion at some samples."""
        changed = {each.name: getattr(self, each.name)[samples] for each in fields(self) if each.name != "beyond"}
        return replace(self, **changed)

    def scale(self, factor: float) -> SpatialMotion:
        """Return the motion with all lengths multiplied by a factor."""
        return replace(
            self, origin=self.origin * factor, acceleration=self.acceleration * factor, joint=self.joint * factor
        )

    def rotate(self, rotation: FloatArray) -> SpatialMotion:
        """Return the motion after a rotation (3, 3) about the origin of the trial's frame; gravity is not rotated."""
        vectors = {
            name: getattr(self, name) @ rotation.T
            for name in ("omega", "alpha", "origin", "acceleration", "joint", "axis")
        }
        return replace(self, rotation=rotation @ self.rotation, **vectors)

    def in_frames(self, frames: FloatArray) -> SpatialMotion:
        """Return the motion of other frames on the same bodies, with poses ``frames`` (K, 4, 4) in the old frames."""
        arm = np.einsum("tkij,kj->tki", self.rotation, frames[:, :3, 3])
        return replace(
            self,
            rotation=self.rotation @ frames[:, :3, :3],
            origin=self.origin + arm,
            acceleration=self.acceleration + point_acceleration(arm, self.omega, self.alpha),
        )


def point_acceleration(arm: FloatArray, omega: FloatArray, alpha: FloatArray) -> FloatArray:
    """Return the acceleration (..., 3) of a point at ``arm`` (..., 3) in a rotating body, relative to its origin."""
    return np.asarray(np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm)))


def segment_regressor(motion: SpatialMotion, gravity: float = 9.81) -> FloatArray:
    """Return the regressor (T, 6, 10K) of the ground's wrench on K bodies in space (eq. 4.15 to 4.22).

    Rows: force and moment of the ground on the bodies about the origin of the trial's frame. Columns: ten parameters of
    every body (:data:`mocap_id.dynamics.regressor.LINK_PARAMETERS`). Gravity, m/s², is along -y. The wrench depends on
    the velocity of a body's origin only through the origin's acceleration, so this velocity is set to zero.
    """
    back = np.swapaxes(motion.rotation, -1, -2)

    def local(vectors: FloatArray) -> FloatArray:
        return np.asarray((back @ vectors[..., None])[..., 0])

    velocity = np.concatenate([np.zeros_like(motion.omega), local(motion.omega)], axis=-1)
    lifted = motion.acceleration + np.array([0.0, gravity, 0.0])
    acceleration = np.concatenate([local(lifted), local(motion.alpha)], axis=-1)
    return bodies_regressor(se3.pose(motion.rotation, motion.origin), velocity, acceleration)


def move_segments(
    chain: SpatialChain, base: FloatArray, rotation: FloatArray, omega: FloatArray, alpha: FloatArray
) -> SpatialMotion:
    """Return the motion of a chain from the rotations of its segments; in the joints, segments do not move apart.

    Parameters
    ----------
    chain : SpatialChain
        Chain of n joints.
    base : (4, 4) array
        Pose of the base, which is at rest, in the trial's frame, m.
    rotation : (T, n, 3, 3) array
        Rotation from the frame of each moving segment to the trial's frame.
    omega, alpha : (T, n, 3) arrays
        Angular velocity and acceleration of the moving segments in the trial's axes, rad/s and rad/s².
    """
    count = len(rotation)
    rest = np.zeros((count, 1, 3))
    rotation = np.concatenate([np.broadcast_to(base[:3, :3], (count, 1, 3, 3)), rotation], axis=1)
    omega, alpha = np.concatenate([rest, omega], axis=1), np.concatenate([rest, alpha], axis=1)
    origin, acceleration = np.zeros_like(omega), np.zeros_like(omega)
    origin[:, 0] = base[:3, 3]
    centres, axes = [], []
    for k, joint in enumerate(chain.joints, start=1):
        p = joint.parent
        arm = rotation[:, p] @ joint.centre
        origin[:, k] = origin[:, p] + arm
        acceleration[:, k] = acceleration[:, p] + point_acceleration(arm, omega[:, p], alpha[:, p])
        centres += [origin[:, k]] * joint.dimension
        axes.append(_find_directions(joint, rotation[:, p], rotation[:, k]))
    return SpatialMotion(
        rotation=rotation,
        omega=omega,
        alpha=alpha,
        origin=origin,
        acceleration=acceleration,
        joint=np.stack(centres, axis=1),
        axis=np.concatenate(axes, axis=1),
        beyond=np.repeat(_find_distal(chain), [joint.dimension for joint in chain.joints], axis=0),
    )


def move_joints(chain: SpatialChain, base: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> SpatialMotion:
    """Return the motion of a chain from the coordinates (T, N) of its joints and their time derivatives.

    The coordinates are in the order of the joints (:meth:`SpatialJoint.rotation`). ``base`` (4, 4) is the pose of the
    base, which is at rest, in the trial's frame, m.
    """
    rotation = [np.broadcast_to(base[:3, :3], (len(q), 3, 3))]
    omega, alpha = [np.zeros((len(q), 3))], [np.zeros((len(q), 3))]
    start = 0
    for joint in chain.joints:
        own, p = slice(start, start + joint.dimension), joint.parent
        start = own.stop
        rotated, speed, change = (rotation[p] @ each for each in _move_child(joint, q[:, own], dq[:, own], ddq[:, own]))
        rotation.append(rotated)
        omega.append(omega[p] + speed[..., 0])
        alpha.append(alpha[p] + change[..., 0] + np.cross(omega[p], speed[..., 0]))
    return move_segments(
        chain, base, np.stack(rotation[1:], axis=1), np.stack(omega[1:], axis=1), np.stack(alpha[1:], axis=1)
    )


def _move_child(
    joint: SpatialJoint, q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rotation (T, 3, 3), angular velocity and angular acceleration (T, 3, 1) of a child relative to its parent.

    All are in the parent's frame.
    """
    rotation = joint.rotation(q)
    if joint.kind == "ball":
        subspace = Ball().subspace(q)[..., 3:, :]
        rate = Ball().subspace_rate(q, dq)[..., 3:, :]
        return (
            rotation,
            rotation @ subspace @ dq[..., None],
            rotation @ (subspace @ ddq[..., None] + rate @ dq[..., None]),
        )
    axes = [np.broadcast_to(joint.first_axis, (len(q), 3))]
    omega, alpha = axes[0] * dq[:, :1], axes[0] * ddq[:, :1]
    if joint.kind == "two-axis":
        second = rotation @ joint.second_axis
        alpha = alpha + second * ddq[:, 1:] + np.cross(omega, second) * dq[:, 1:]
        omega = omega + second * dq[:, 1:]
    return rotation, omega[..., None], alpha[..., None]


def _find_directions(joint: SpatialJoint, parent: FloatArray, child: FloatArray) -> FloatArray:
    """Return the directions (T, d, 3) of the torques of a joint's d coordinates, in the trial's frame."""
    if joint.kind == "ball":
        return np.swapaxes(parent, 1, 2)
    axes = [parent @ joint.first_axis]
    return np.stack(axes if joint.kind == "hinge" else [*axes, child @ joint.second_axis], axis=1)


def _find_distal(chain: SpatialChain) -> BoolArray:
    """Return a mask (n, n + 1) of the segments that are distal to each joint."""
    distal = np.zeros((len(chain.joints), len(chain.joints) + 1), dtype=np.bool_)
    for k, joint in enumerate(chain.joints):
        distal[:, k + 1] = distal[:, joint.parent]
        distal[k, k + 1] = True
    return distal


def rotate_z_to(vector: FloatArray) -> FloatArray:
    """Return the smallest rotation (3, 3) from the z axis to a unit vector (3,)."""
    axis = np.cross([0.0, 0.0, 1.0], vector)
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return np.diag([1.0, np.sign(vector[2]), np.sign(vector[2])])
    return so3.exp(axis / length * np.arctan2(length, vector[2]))
