"""Preparation of a trial in space: motion of the segments, regressor, base parameters, filtered signals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, IntArray, find_complete_rows
from mocap_id.dynamics.preparation import (
    NO_CLOCK,
    CoarseClock,
    FitSettings,
    LowPass,
    SampledWrench,
    blank_incomplete,
    choose_cutoff,
    find_usable,
    undo_averaging,
)
from mocap_id.dynamics.priors import BodyPrior
from mocap_id.dynamics.regressor import LINK_PARAMETERS, BaseSet, BodyMotion, bodies_regressor, regroup_columns
from mocap_id.dynamics.space.consistency import change_of_frame
from mocap_id.geometry import se3, so3
from mocap_id.geometry.chain import Ball
from mocap_id.geometry.spatial_chain import SpatialChain


@dataclass(frozen=True)
class SpatialMotion(BodyMotion):
    """Motion of bodies in the trial's frame."""

    rotation: FloatArray  # (T, K, 3, 3) rotation from the frame of each body to the trial's frame
    # (T, N, 3) unit direction of the torque of each coordinate; for a ball joint, the axes of the parent's frame
    axis: FloatArray

    @property
    def jacobian(self) -> FloatArray:
        """Unit twists (T, 6, N): p × d, then d, with the centre p and the axis d of each coordinate."""
        return np.swapaxes(np.concatenate([np.cross(self.joint, self.axis), self.axis], axis=-1), 1, 2)

    def rotate(self, rotation: FloatArray) -> SpatialMotion:
        """Return the motion after a rotation (3, 3) about the origin of the trial's frame; gravity is not rotated."""
        names = ("omega", "alpha", "origin", "acceleration", "joint", "axis")
        vectors = {name: getattr(self, name) @ rotation.T for name in names}
        return replace(self, rotation=rotation @ self.rotation, **vectors)

    def in_frames(self, frames: FloatArray) -> SpatialMotion:
        """Return the motion of other frames on the same bodies, with poses ``frames`` (K, 4, 4) in the old frames."""
        arm = np.einsum("tkij,kj->tki", self.rotation, frames[:, :3, 3])
        return replace(
            self,
            rotation=self.rotation @ frames[:, :3, :3],
            origin=self.origin + arm,
            acceleration=self.acceleration + spatial_point_acceleration(arm, self.omega, self.alpha),
        )


def spatial_point_acceleration(arm: FloatArray, omega: FloatArray, alpha: FloatArray) -> FloatArray:
    """Return the acceleration (..., 3) of a point at ``arm`` (..., 3) in a rotating body, relative to its origin."""
    return np.asarray(np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm)))


def segment_regressor(motion: SpatialMotion, gravity: float = GRAVITY) -> FloatArray:
    """Return the regressor (T, 6, 10K) of the ground's wrench on K bodies in space (eq. 4.15 to 4.22).

    Rows: force and moment of the ground about the origin. Columns: the ten
    :data:`~mocap_id.dynamics.regressor.LINK_PARAMETERS` of every body. Gravity, m/s², is along -y. The wrench depends
    on the velocity of a body's origin only through the origin's acceleration, so this velocity is set to zero.
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

    ``base`` (4, 4) is the pose of the base, which is at rest, in the trial's frame, m. ``rotation`` (T, n, 3, 3),
    ``omega`` and ``alpha`` (T, n, 3) are those of the moving segments in the trial's axes, rad/s and rad/s².
    """
    count = len(rotation)
    rest = np.zeros((count, 1, 3))
    rotation = np.concatenate([np.broadcast_to(base[:3, :3], (count, 1, 3, 3)), rotation], axis=1)
    omega, alpha = np.concatenate([rest, omega], axis=1), np.concatenate([rest, alpha], axis=1)
    origin, acceleration = np.zeros_like(omega), np.zeros_like(omega)
    origin[:, 0] = base[:3, 3]
    centres, axes = [], []
    beyond = np.zeros((len(chain.joints), len(chain.joints) + 1), dtype=np.bool_)
    for k, joint in enumerate(chain.joints, start=1):
        p = joint.parent
        arm = rotation[:, p] @ joint.centre
        origin[:, k] = origin[:, p] + arm
        acceleration[:, k] = acceleration[:, p] + spatial_point_acceleration(arm, omega[:, p], alpha[:, p])
        centres += [origin[:, k]] * joint.dimension
        # directions (T, d, 3) of the torques of the joint's d coordinates, in the trial's frame
        if joint.kind == "ball":
            axes.append(np.swapaxes(rotation[:, p], 1, 2))
        else:
            own = [rotation[:, p] @ joint.first_axis]
            if joint.kind == "two-axis":
                own.append(rotation[:, k] @ joint.second_axis)
            axes.append(np.stack(own, axis=1))
        beyond[:, k] = beyond[:, p]  # the segment is distal to the same joints as its parent, and to its own
        beyond[k - 1, k] = True
    return SpatialMotion(
        rotation=rotation,
        omega=omega,
        alpha=alpha,
        origin=origin,
        acceleration=acceleration,
        joint=np.stack(centres, axis=1),
        axis=np.concatenate(axes, axis=1),
        beyond=np.repeat(beyond, [joint.dimension for joint in chain.joints], axis=0),
    )


def move_joints(chain: SpatialChain, base: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> SpatialMotion:
    """Return the motion of a chain from its coordinates (T, N), in the order of the joints, and their derivatives."""
    rotation = [np.broadcast_to(base[:3, :3], (len(q), 3, 3))]
    omega, alpha = [np.zeros((len(q), 3))], [np.zeros((len(q), 3))]
    start = 0
    for joint in chain.joints:
        own, p = slice(start, start + joint.dimension), joint.parent
        start = own.stop
        angles, rates, changes = q[:, own], dq[:, own], ddq[:, own]
        # rotation (T, 3, 3) of the segment relative to its parent, and its angular velocity and acceleration (T, 3, 1)
        child = joint.rotation(angles)
        if joint.kind == "ball":
            subspace = Ball().subspace(angles)[..., 3:, :]
            subspace_rate = Ball().subspace_rate(angles, rates)[..., 3:, :]
            speed = child @ subspace @ rates[..., None]
            change = child @ (subspace @ changes[..., None] + subspace_rate @ rates[..., None])
        else:
            first = np.broadcast_to(joint.first_axis, (len(q), 3))
            turning, rising = first * rates[:, :1], first * changes[:, :1]
            if joint.kind == "two-axis":
                second = child @ joint.second_axis
                rising = rising + second * changes[:, 1:] + np.cross(turning, second) * rates[:, 1:]
                turning = turning + second * rates[:, 1:]
            speed, change = turning[..., None], rising[..., None]
        child, speed, change = (rotation[p] @ each for each in (child, speed, change))
        rotation.append(child)
        omega.append(omega[p] + speed[..., 0])
        alpha.append(alpha[p] + change[..., 0] + np.cross(omega[p], speed[..., 0]))
    return move_segments(
        chain, base, np.stack(rotation[1:], axis=1), np.stack(omega[1:], axis=1), np.stack(alpha[1:], axis=1)
    )


def rotate_z_to(vector: FloatArray) -> FloatArray:
    """Return the smallest rotation (3, 3) from the z axis to a unit vector (3,)."""
    axis = np.cross([0.0, 0.0, 1.0], vector)
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return np.diag([1.0, np.sign(vector[2]), np.sign(vector[2])])
    return so3.exp(axis / length * np.arctan2(length, vector[2]))


_UNITS = ("kg", *["kg*m"] * 3, *["kg*m^2"] * 6)
_STATES = 60  # number of random states from which the base parameters are determined
_WRITTEN = 3  # largest number of regrouped parameters that a name lists


@dataclass(frozen=True)
class SpatialBase:
    """Base parameters of a chain in space."""

    base: BaseSet  # base parameters in the simple frames
    frames: FloatArray  # (K, 4, 4) pose of each simple frame in the frame of its segment

    @property
    def mapping(self) -> FloatArray:
        """Matrix (b, 10K) from the full parameters in the segments' frames to the base parameters."""
        return np.asarray(self.base.regrouping @ block_diag(*change_of_frame(se3.inverse(self.frames))))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters as symbols; "…" replaces regrouped parameters if there are more than three."""
        symbols, names = name_parameters_in_space(len(self.frames)), []
        for row, column in zip(self.base.regrouping, self.base.kept, strict=True):
            name = symbols[int(column)]
            others = [int(k) for k in np.setdiff1d(np.flatnonzero(row), self.base.kept)]
            if len(others) > _WRITTEN and not np.allclose(row[others], 1.0):
                name, others = f"{name}+…", []
            for k in others:
                sign, size = ("-" if row[k] < 0 else "+"), abs(row[k])
                name += f"{sign}{symbols[k]}" if np.isclose(size, 1.0) else f"{sign}{size:.4g}*{symbols[k]}"
            names.append(name)
        return tuple(names)

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(_UNITS[column % 10] for column in self.base.kept)


def name_parameters_in_space(segments: int) -> tuple[str, ...]:
    """Return the names of the full parameters, numbered from 1 for the base: m1, mx1, my1, mz1, Ixx1 … Iyz1, m2 …"""
    return tuple(f"{symbol}{k}" for k in range(1, segments + 1) for symbol in LINK_PARAMETERS)


def structural_base_in_space(chain: SpatialChain, base: FloatArray) -> SpatialBase:
    """Return the base parameters of a chain in which every joint moves, on a base at rest in a pose (4, 4), m."""
    size = sum(joint.dimension for joint in chain.joints)
    states = np.random.default_rng(0).normal(size=(3, _STATES, size))
    # simple frames: the axis of a hinge, or the second of two axes, is along z; the base's frame has the trial's axes
    poses = [se3.pose(base[:3, :3].T, np.zeros(3))]
    for joint in chain.joints:
        axis = joint.second_axis if joint.kind == "two-axis" else np.array([0.0, 0.0, 1.0])
        if joint.kind == "hinge":
            axis = joint.offset.T @ joint.first_axis
        poses.append(se3.pose(rotate_z_to(axis), np.zeros(3)))
    frames = np.stack(poses)
    motion = move_joints(chain, base, *states).in_frames(frames)
    rows = segment_regressor(motion)
    columns = np.abs(rows).max(axis=(0, 1))
    rows = np.where(columns > 1e-9 * columns.max(), rows, 0.0)  # rounding errors of the rotated axes
    return SpatialBase(regroup_columns(rows.reshape(-1, rows.shape[-1])), frames)


COMPONENTS = ("Fx", "Fy", "Fz", "taux", "tauy", "tauz")
_FAST = 1 / 3  # fraction of the fastest coordinate's velocity above which a coordinate is fast
_FREE = (0, 2, 4)  # gravity along -y causes no constant Fx, Fz and tauy


@dataclass(frozen=True)
class SpatialRecord:
    """Measured motion and wrench of a trial in space, sample by sample, in the trial's frame (y up)."""

    time: FloatArray  # (T,) sample times with constant step, s
    chain: SpatialChain  # chain of n joints
    base: FloatArray  # (4, 4) pose of the base, which is at rest, m
    # (T, n, 3, 3) rotation from the frame of each moving segment to the trial's frame; NaN where missing
    rotation: FloatArray
    # omega, alpha: (T, n, 3) angular velocity and acceleration of the moving segments in the trial's axes, rad/s and
    # rad/s²
    omega: FloatArray
    alpha: FloatArray
    alpha_sd: FloatArray  # (T, n) standard deviation of the acceleration about each axis, rad/s²
    observed: BoolArray  # (T,) whether every segment is measured by markers
    # (T, 6) force and moment of the ground on the body about the origin of the trial's frame, N and N·m, at ``time`` on
    # the plate's clock; NaN where missing
    wrench: FloatArray
    averaged: float = 0.0  # time over which each plate sample is averaged, s; 0 for instantaneous samples
    # (3,) centre of the plate's surface, m; None for the origin of the base. A wrong zero of Fx causes no moment about
    # this centre.
    plate: FloatArray | None = None
    clock: CoarseClock = NO_CLOCK  # coarse clock offset of the plate

    @property
    def rate(self) -> float:
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def centred(self) -> FloatArray:
        """Pose (4, 4) of the base in the frame of the dynamics: axes of the trial's frame, origin of the base."""
        return se3.pose(self.base[:3, :3], np.zeros(3))

    @property
    def reference(self) -> FloatArray:
        """Reference point (3,) of the moments in the fit, m: the centre of the plate."""
        return self.base[:3, 3] if self.plate is None else self.plate

    @property
    def plate_wrench(self) -> FloatArray:
        """Wrench (T, 6) about the plate's centre, NaN in all components if any is missing."""
        return blank_incomplete(self.wrench @ shift_wrench(-self.reference).T)

    def regressor(self, motion: SpatialMotion, frames: FloatArray, gravity: float) -> FloatArray:
        """Return the regressor (T, 6, 10K) of the wrench about the plate, for parameters in ``frames`` (K, 4, 4)."""
        return shift_wrench(self.base[:3, 3] - self.reference) @ segment_regressor(motion.in_frames(frames), gravity)

    @cached_property
    def motion(self) -> SpatialMotion:
        return move_segments(self.chain, self.centred, self.rotation, self.omega, self.alpha)


@dataclass(frozen=True)
class SpatialTrial:
    """A trial in space prepared for identification; moments are about the plate's centre."""

    recorded: SpatialRecord  # measured motion and wrench
    settings: FitSettings  # settings of the identification
    lowpass: LowPass  # filter of regressor and wrench
    structure: SpatialBase  # base parameters of the chain
    # (T, 6, 10K) full regressor in the simple frames (`structure`), without filtering; NaN where a pose is NaN
    regressor: FloatArray
    filtered: FloatArray  # (T, 6, b) base columns after the low-pass
    filtered_wrench: SampledWrench  # filtered wrench, at times of the plate's clock
    usable: BoolArray  # (T,) samples with filtered regressor, and with filtered wrench at every offset within the limit
    prior: BodyPrior | None = None  # always None, because there is no prior in space

    @property
    def base(self) -> BaseSet:
        return self.structure.base

    @property
    def rows(self) -> FloatArray:
        return self.regressor[:, :, self.base.kept]

    @property
    def constants(self) -> tuple[int, ...]:
        """Components whose constant error is estimated: Fx, Fz and tauy, which gravity does not affect."""
        return _FREE if self.settings.plate_bias else ()

    def filtered_measured(self, samples: IntArray, stamped: FloatArray) -> FloatArray:
        """Return the filtered wrench (..., R, 6) at times (..., R) on the plates' clock, s; ``samples`` is not used."""
        return self.filtered_wrench(stamped)

    def measured(self, offset: float) -> FloatArray:
        """Return the wrench (T, 6) about the plate's centre at the cameras' times, for a plate's clock offset, s."""
        sampled = SampledWrench(self.recorded.time, self.recorded.plate_wrench)
        return sampled(self.recorded.time - offset)

    def build_rows(self, motion: SpatialMotion, gravity: float) -> FloatArray:
        """Return the minimal regressor (T, 6, b) for any motion of the segments."""
        return self.recorded.regressor(motion, self.structure.frames, gravity)[:, :, self.base.kept]


def prepare_in_space(recorded: SpatialRecord, settings: FitSettings) -> SpatialTrial:
    """Build the regressor, find the base parameters, filter regressor and wrench, and mark the usable samples."""
    structure = structural_base_in_space(recorded.chain, recorded.centred)
    regressor = recorded.regressor(recorded.motion, structure.frames, settings.gravity)
    cutoff = settings.cutoff
    if not cutoff:
        # velocities of the fast coordinates, rad/s; the spectrum of slow ones contains only noise
        motion, joints = recorded.motion, recorded.chain.joints
        relative = motion.omega[:, 1:] - motion.omega[:, [joint.parent for joint in joints]]
        each = np.repeat(relative, [joint.dimension for joint in joints], axis=1)
        speeds = np.sum(each * motion.axis, axis=2)
        size = np.nanstd(speeds, axis=0)
        cutoff = choose_cutoff(speeds[:, size >= _FAST * size.max()], recorded.rate)
    lowpass = LowPass(cutoff, recorded.rate)
    filtered_wrench = undo_averaging(lowpass(recorded.plate_wrench), recorded.averaged * recorded.rate)
    observed = find_complete_rows(regressor) & recorded.observed
    return SpatialTrial(
        recorded=recorded,
        settings=settings,
        lowpass=lowpass,
        structure=structure,
        regressor=regressor,
        filtered=lowpass(regressor[:, :, structure.base.kept]),
        filtered_wrench=SampledWrench(recorded.time, filtered_wrench),
        usable=find_usable(lowpass, observed, filtered_wrench, settings.offset_limit),
    )


def shift_wrench(arm: FloatArray) -> FloatArray:
    """Return the matrix (6, 6) that adds arm × force to the moment of a wrench, for an arm (3,), m."""
    matrix = np.eye(6)
    matrix[3:, :3] = so3.hat(arm)
    return matrix
