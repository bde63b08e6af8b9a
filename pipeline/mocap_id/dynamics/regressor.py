"""Motion of a body's segments, wrench and torques as linear maps of the parameters, base parameters (thesis 4.2.1).

A link has ten parameters, in the order of eq. 4.4: m, mx, my, mz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz, all about the origin of
the link's frame. Ixy is the element of the inertia matrix, -∫ x y dm. A planar link has four of these parameters: m,
mx, my, Izz. The columns are ordered from the base to the tip. Gravity is modelled as an upward acceleration of the
base.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np

from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, IntArray
from mocap_id.geometry import Chain, link_motion, planar, se3, so3, spatial_jacobian


@dataclass(frozen=True)
class BodyMotion(ABC):
    """Motion of K bodies and of the N coordinates of the joints between them, in the plane or in space."""

    # omega, alpha: angular velocity and acceleration, (T, K) in the plane, (T, K, 3) in space, rad/s and rad/s²
    omega: FloatArray
    alpha: FloatArray
    # origin, acceleration: (T, K, 2) or (T, K, 3) origin of each body's frame, m, and its acceleration without gravity,
    # m/s²
    origin: FloatArray
    acceleration: FloatArray
    # (T, N, 2) or (T, N, 3) centre of each coordinate's joint, m; NaN where both sides of a joint belong to one body
    joint: FloatArray
    beyond: BoolArray  # (N, K) whether each body is distal to the joint of each coordinate

    @property
    @abstractmethod
    def jacobian(self) -> FloatArray:
        """Unit twists of the coordinates, (T, 3, N) or (T, 6, N): times a wrench, the moments about the joints."""

    def at(self, samples: IntArray | slice) -> Self:
        chosen = {each.name: getattr(self, each.name)[samples] for each in fields(self) if each.name != "beyond"}
        return replace(self, **chosen)

    def scale(self, factor: float) -> Self:
        """Return the motion with all lengths multiplied by a factor."""
        lengths = {name: getattr(self, name) * factor for name in ("origin", "acceleration", "joint")}
        return replace(self, **lengths)


@dataclass(frozen=True)
class PlanarMotion(BodyMotion):
    """Motion of bodies in the plane frame."""

    angle: FloatArray  # (T, K) angle of each body's frame, rad

    @property
    def jacobian(self) -> FloatArray:
        """Unit twists (p_y, -p_x, 1) of the joints (T, 3, n)."""
        x, y = self.joint[..., 0], self.joint[..., 1]
        return np.stack([y, -x, np.ones_like(x)], axis=1)

    def tilt(self, angle: float) -> PlanarMotion:
        """Return the motion rotated about the origin of the plane frame by an angle, rad; gravity is not rotated."""
        rotation, names = np.asarray(angle), ("origin", "acceleration", "joint")
        vectors: dict[str, Any] = {name: planar.rotate(rotation, getattr(self, name)) for name in names}
        return replace(self, angle=self.angle + angle, **vectors)


def move_chain(centres: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> PlanarMotion:
    """Return the motion of a pinned chain on a fixed base; ``centres`` (n, 2) or (T, n, 2) may change over time."""
    angle, origin = planar.segment_poses(q, centres)  # (T, n + 1), (T, n + 1, 2)
    omega = np.concatenate([np.zeros_like(q[:, :1]), np.cumsum(dq, axis=1)], axis=1)
    alpha = np.concatenate([np.zeros_like(q[:, :1]), np.cumsum(ddq, axis=1)], axis=1)
    acceleration = np.zeros_like(origin)
    steps = point_acceleration(np.diff(origin, axis=1), omega[:, :-1], alpha[:, :-1])
    acceleration[:, 1:] = np.cumsum(steps, axis=1)
    joints = q.shape[1]
    beyond: BoolArray = np.arange(joints + 1) > np.arange(joints)[:, None]
    return PlanarMotion(omega, alpha, origin, acceleration, origin[:, 1:], beyond, angle)


def point_acceleration(arm: FloatArray, omega: FloatArray, alpha: FloatArray) -> FloatArray:
    """Return the acceleration (..., 2) of a point at ``arm`` (..., 2) in a rotating body, relative to its origin."""
    normal = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    return np.asarray(alpha[..., None] * normal - (omega**2)[..., None] * arm)


LINK_PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
PLANAR_PARAMETERS = ("m", "mx", "my", "Izz")
WRENCH_COMPONENTS = ("Fx", "Fy", "tauz")


def momentum_regressor(twist: FloatArray) -> FloatArray:
    """Return the regressor Y_V (..., 6, 10) of the momentum I V of one link (eq. 4.15).

    ``twist`` (..., 6) is V = (v, ω) in the link frame, or its time derivative for the regressor of eq. 4.16.
    """
    v, omega = twist[..., :3], twist[..., 3:]
    x, y, z = omega[..., 0], omega[..., 1], omega[..., 2]
    matrix = np.zeros((*twist.shape[:-1], 6, 10))
    matrix[..., :3, 0], matrix[..., :3, 1:4] = v, so3.hat(omega)
    matrix[..., 3:, 1:4] = -so3.hat(v)
    matrix[..., 3, 4], matrix[..., 4, 5], matrix[..., 5, 6] = x, y, z
    matrix[..., 3, 7], matrix[..., 4, 7] = y, x
    matrix[..., 3, 8], matrix[..., 5, 8] = z, x
    matrix[..., 4, 9], matrix[..., 5, 9] = z, y
    return matrix


def link_regressor(velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the regressor Y_i (..., 6, 10) of a link's wrench from its velocity and acceleration (eq. 4.17, 4.18)."""
    return momentum_regressor(acceleration) - np.swapaxes(se3.ad(velocity), -1, -2) @ momentum_regressor(velocity)


def spatial_regressor(
    chain: Chain, q: FloatArray, dq: FloatArray, ddq: FloatArray, base_acceleration: FloatArray
) -> FloatArray:
    """Return the regressor Y (..., 6, 10(n + 1)) of the ground's wrench on the whole chain (eq. 4.19-4.22).

    The product of Y with the full parameters, base first, is the wrench (F, τ) of the ground on the chain about the
    origin of the world frame, in world axes. ``q``, ``dq`` and ``ddq`` (..., N) are the joint coordinates and their
    derivatives; ``base_acceleration`` (6,) is ``(g·up, 0)`` for gravity.
    """
    _, velocity, acceleration = link_motion(chain, q, dq, ddq, base_acceleration)
    return bodies_regressor(chain.poses(q), velocity, acceleration)


def bodies_regressor(poses: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the regressor (..., 6, 10K) of the wrench on K bodies about the origin of the world frame (eq. 4.19).

    Poses (..., K, 4, 4) are in the world frame, velocities and accelerations (..., K, 6) in the bodies' frames.
    """
    to_world = np.swapaxes(se3.Ad(se3.inverse(poses)), -1, -2)  # (..., K, 6, 6)
    blocks = to_world @ link_regressor(velocity, acceleration)
    return np.moveaxis(blocks, -3, -2).reshape(*poses.shape[:-3], 6, -1)


def project_on_joints(jacobian: FloatArray, joint: IntArray, wrenches: FloatArray, segment: IntArray) -> FloatArray:
    """Return the joint torques (..., N, P) due to P wrenches (..., c, P) on single segments, in space or in the plane.

    The wrench through joint j is the sum of the wrenches on the segments beyond it. The product of this wrench with the
    joint's spatial twist, a column of the spatial Jacobian (..., c, N) (eq. 2.47), is the torque. The wrenches are
    columns of a regressor or external wrenches, about the frame's origin. ``segment`` (P,), from 0, is where each acts,
    and ``joint`` (N,), from 1, is the joint of each coordinate.
    """
    torque = np.swapaxes(jacobian, -1, -2) @ wrenches
    return np.where(segment >= joint[:, None], torque, 0.0)


def spatial_torque_regressor(chain: Chain, q: FloatArray, regressor: FloatArray) -> FloatArray:
    """Return the regressor (..., N, 10(n + 1)) of the joint torques, given that of the wrench (..., 6, 10(n + 1))."""
    segment = np.repeat(np.arange(len(chain.joints) + 1), len(LINK_PARAMETERS))
    return project_on_joints(spatial_jacobian(chain, q), number_joints(chain), regressor, segment)


def number_joints(chain: Chain) -> IntArray:
    """Return the joint, from 1, to which each of the N coordinates of a chain belongs."""
    return np.repeat(np.arange(1, len(chain.joints) + 1), [joint.dimension for joint in chain.joints])


def wrench_regressor(motion: PlanarMotion, gravity: float = GRAVITY) -> FloatArray:
    """Return the regressor (T, 3, 4K) of the ground's wrench on K bodies in the plane (eq. 4.15 to 4.22).

    Rows: Fx, Fy, tauz of the ground on the bodies about the origin of the plane frame. Columns: m, mx, my, Izz of every
    body about the origin of its frame. Gravity, m/s², is along -y.
    """
    acceleration = motion.acceleration.copy()
    acceleration[..., 1] += gravity
    blocks = np.zeros((*motion.angle.shape, 3, 4))  # (T, K, 3, 4)
    blocks[..., :2, 0] = acceleration
    for column, axis in ((1, np.array([1.0, 0.0])), (2, np.array([0.0, 1.0]))):
        unit = planar.rotate(motion.angle, axis)  # the body's x, then y, in the plane frame
        blocks[..., :2, column] = point_acceleration(unit, motion.omega, motion.alpha)
        blocks[..., 2, column] = _cross_product(unit, acceleration)
    blocks[..., 2, 3] = motion.alpha
    blocks[..., 2, :3] += _cross_product(motion.origin[..., None, :], np.swapaxes(blocks[..., :2, :3], -1, -2))
    return np.moveaxis(blocks, 1, 2).reshape(len(motion.angle), 3, -1)


def torque_regressor(motion: BodyMotion, regressor: FloatArray) -> FloatArray:
    """Return the regressor (T, N, p K) of the joint torques from that of the wrench (T, c, p K); NaN without centre."""
    torque = np.swapaxes(motion.jacobian, -1, -2) @ regressor
    distal = np.repeat(motion.beyond, regressor.shape[-1] // motion.beyond.shape[1], axis=1)
    return np.where(distal, torque, np.where(np.isnan(torque), np.nan, 0.0))


def planar_regressor(
    centres: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray, gravity: float = GRAVITY
) -> FloatArray:
    """Return the regressor (T, 3, 4(n + 1)) of the ground's wrench on a planar chain, with the segments base first.

    It equals :func:`spatial_regressor` for the same chain and is eighty times faster; a test compares the two.
    ``centres`` (n, 2) or (T, n, 2) are as for :func:`move_chain`; gravity, m/s², is along -y.
    """
    return wrench_regressor(move_chain(centres, q, dq, ddq), gravity)


def planar_torque_regressor(centres: FloatArray, q: FloatArray, regressor: FloatArray) -> FloatArray:
    """Return the regressor (T, n, 4(n + 1)) of the joint torques of a planar chain, given that of the wrench."""
    joints = np.arange(q.shape[1] + 1)
    jacobian = planar.joint_twists(q, centres)
    return project_on_joints(jacobian, joints[1:], regressor, np.repeat(joints, len(PLANAR_PARAMETERS)))


def _cross_product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the z component of a × b for plane vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def composite_inertia(
    q: FloatArray, centres: FloatArray, mass: FloatArray, first: FloatArray, second: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the ground's wrench (T, 3, n) and of the torques (T, n, n) by the joint accelerations.

    They are the wrench (Fx, Fy, tauz) about the origin of the plane frame and the torques for a unit acceleration of
    each joint, N and N·m per rad/s²; the derivative of the torques is the mass matrix, kg·m². ``mass`` (n + 1,), kg,
    ``first`` (n + 1, 2) moments, kg·m, and ``second`` (n + 1,) moments, kg·m², are about the origins of the segments'
    frames, base first; no joint moves the base. Missing angles give NaN.
    """
    size, joints = q.shape
    angle, origin = planar.segment_poses(q, centres)
    wrench, torque = np.empty((size, 3, joints)), np.empty((size, joints, joints))
    total, moment, spread = 0.0, np.zeros((size, 2)), np.zeros(size)  # of all segments beyond the joint
    step = np.zeros((size, 2))
    for k in range(joints, 0, -1):
        spread = second[k] + spread + _dot(2.0 * moment + total * step, step)
        moment = planar.rotate(angle[:, k], first[k]) + moment + total * step
        total = total + float(mass[k])
        wrench[:, 0, k - 1], wrench[:, 1, k - 1] = -moment[:, 1], moment[:, 0]
        wrench[:, 2, k - 1] = spread + _dot(moment, origin[:, k])
        for j in range(1, k + 1):
            torque[:, j - 1, k - 1] = spread + _dot(moment, origin[:, k] - origin[:, j])
            torque[:, k - 1, j - 1] = torque[:, j - 1, k - 1]
        step = origin[:, k] - origin[:, k - 1]
    return wrench, torque


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the scalar products of plane vectors (T, 2)."""
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])


SEAT = "seat"  # name of the chair's wrench, if a separate force plate measures it


@dataclass(frozen=True)
class ExternalWrench:
    """A measured wrench of the surroundings on one segment, other than the ground's wrench."""

    name: str  # name of the object that exerts the wrench
    segment: int  # segment on which it acts; 0 is the base
    # (T, 3) (Fx, Fy, tauz) of the surroundings on the body about the origin of the plane frame, N and N·m; NaN where
    # missing
    wrench: FloatArray
    # whether the samples follow the clock of the ground's plates; otherwise they follow the clock of the cameras
    by_plates: bool


def sum_external(
    jacobian: FloatArray, joint: IntArray, wrenches: FloatArray, segment: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return how much wrenches (..., c, K) on ``segment`` (K,) reduce the ground's wrench and the joint torques."""
    return wrenches.sum(axis=-1), project_on_joints(jacobian, joint, wrenches, segment).sum(axis=-1)


_UNITS = ("kg", "kg*m", "kg*m", "kg*m^2")
_OUTSIDE = 1e-6  # fraction of the largest entry: larger distances from the span are not due to rounding
_ENOUGH = 1000  # number of rows that are tested; in nearly every posture, the answer is the same


@dataclass(frozen=True)
class BaseSet:
    """The identifiable combinations of the full parameters."""

    kept: IntArray  # (b,) linearly independent columns of the full regressor
    # (b, p) matrix M of eq. 4.24: base parameters = M · full parameters, and Y[:, kept] · M = Y.
    regrouping: FloatArray

    def columns(self, regressor: FloatArray) -> FloatArray:
        """Return the kept columns (..., b) of a regressor (..., p), without a copy if all are kept."""
        return regressor if len(self.kept) == regressor.shape[-1] else regressor[..., self.kept]

    def expand(self, base: FloatArray) -> FloatArray:
        """Return the full parameters (p,) with these base parameters (b,) that are zero in all columns not kept."""
        full = np.zeros(self.regrouping.shape[1])
        full[self.kept] = base
        return full


def triangularise(rows: FloatArray) -> FloatArray:
    """Return R (min(r, p), p) of the QR decomposition of rows (r, p), which is all that least squares needs."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)


def regroup_columns(regressor: FloatArray) -> BaseSet:
    """Find the independent columns of a stacked regressor (r, p) and regroup the other columns (eq. 4.8, 4.9, 4.24).

    An unpivoted QR compresses the rows. The columns of its R are then orthogonalised in turn, and dependent columns are
    left out. The diagonal of R alone is not sufficient, because a dependent column leaves an arbitrary direction in Q,
    which can make a later column look dependent.
    """
    factor = triangularise(regressor)
    directions: list[FloatArray] = []
    remainders = np.zeros(factor.shape[1])
    kept: list[int] = []
    # norm below which the independent part of a column counts as zero (eq. 4.8)
    largest_diagonal = float(np.max(np.abs(np.diagonal(factor)), initial=0.0))
    zero = len(regressor) * float(np.finfo(np.float64).eps) * largest_diagonal
    for column in np.flatnonzero(np.any(factor != 0.0, axis=0)):
        rest = factor[:, column]
        for _ in range(2):  # two passes give orthogonality up to rounding errors
            rest = rest - sum((np.dot(d, rest) * d for d in directions), start=np.zeros_like(rest))
        remainders[column] = float(np.linalg.norm(rest))
        if remainders[column] >= zero:
            directions.append(rest / remainders[column])
            kept.append(int(column))
    index = np.array(kept, dtype=np.int64)
    regrouping = np.asarray(np.linalg.lstsq(factor[:, index], factor, rcond=None)[0], dtype=np.float64)
    regrouping[:, index] = np.eye(len(index))
    largest = np.max(np.abs(regrouping), axis=0)
    regrouping[np.abs(regrouping) <= 1e-9 * np.maximum(largest, 1.0)] = 0.0
    return BaseSet(index, regrouping)


def determines_rows(rows: FloatArray, base: BaseSet) -> bool:
    """Return whether base parameters determine what rows (r, p) of a full regressor predict; NaN is missing."""
    known = rows[np.isfinite(rows).all(axis=1)]
    known = known[:: max(1, len(known) // _ENOUGH)]
    # a row outside the span of the rows that gave the base set depends on other parameters too
    off = known[:, base.kept] @ base.regrouping - known
    return float(np.max(np.abs(off), initial=0.0)) <= _OUTSIDE * float(np.max(np.abs(known), initial=0.0))


def structural_base(centres: FloatArray, components: tuple[int, ...] = (0, 1, 2)) -> BaseSet:
    """Return the base set of a planar chain in which every joint moves; no trial can determine more parameters."""
    states = np.random.default_rng(0).normal(size=(3, 50, len(centres)))
    regressor = planar_regressor(centres, *states)[:, list(components), :]
    return regroup_columns(regressor.reshape(-1, regressor.shape[-1]))


def name_parameters(segments: int) -> tuple[str, ...]:
    """Return the names of the full parameters, numbered from 1 for the base as in the thesis: m1, mx1, my1, I1, m2 …"""
    return tuple(f"{symbol}{k}" for k in range(1, segments + 1) for symbol in ("m", "mx", "my", "I"))


def list_base_units(base: BaseSet) -> tuple[str, ...]:
    """Return the SI unit of each base parameter."""
    return tuple(_UNITS[column % len(PLANAR_PARAMETERS)] for column in base.kept)


def base_names(base: BaseSet, centres: FloatArray) -> tuple[str, ...]:
    """Return the names of the base parameters as symbols, as in eq. 6.1.

    Let a mass m_j be regrouped into a parameter of segment k, and let p_{k+1} be the joint at the end of segment k. The
    coefficient is written as 1, p_{k+1,x}, p_{k+1,y} or |p_{k+1}|² if it has this value, otherwise as a number.
    """
    symbols, names = name_parameters(len(centres) + 1), []
    for row, column in zip(base.regrouping, base.kept.tolist(), strict=True):
        segment, kind = divmod(column, len(PLANAR_PARAMETERS))
        terms: dict[str, list[str]] = {}  # regrouped parameters by their common coefficient
        for other in np.setdiff1d(np.arange(len(row)), base.kept).tolist():
            beyond, other_kind = divmod(other, len(PLANAR_PARAMETERS))
            structural = other_kind == 0 and beyond > segment and segment < len(centres)
            value, symbol = 0.0, ""
            if structural:  # value and symbol of the factor of the mass in this kind of parameter
                (x, y), joint = centres[segment].tolist(), segment + 2
                value = (1.0, x, y, x * x + y * y)[kind]
                symbol = ("", f"p{joint}x*", f"p{joint}y*", f"(p{joint}x^2+p{joint}y^2)*")[kind]
            if structural and np.isclose(row[other], value, rtol=1e-6, atol=1e-9):
                terms.setdefault(symbol, []).append(symbols[other])
            elif row[other] != 0.0:
                terms.setdefault(f"{row[other]:.4g}*", []).append(symbols[other])
        name = symbols[column]
        for symbol, masses in terms.items():
            total = "+".join(masses)
            name += f"+{symbol}({total})" if symbol and len(masses) > 1 else f"+{symbol}{total}"
        names.append(name)
    return tuple(names)


@dataclass(frozen=True)
class CompressedProblem:
    """A least-squares problem after a QR decomposition, with the cost ‖R x - d‖² + rest of parameters x."""

    factor: FloatArray  # (b, b) triangular factor R
    target: FloatArray  # (b,) right-hand side d, which is Qᵀ times the original right-hand side
    rest: float  # part of the squared residual that no parameters can remove

    @classmethod
    def of(cls, rows: FloatArray, target: FloatArray, rest: float = 0.0) -> CompressedProblem:
        """Compress any number of rows (r, b) and their right-hand side (r,); ``rest`` is added to the cost."""
        columns = rows.shape[1]
        filled = np.zeros((max(len(rows), columns + 1), columns + 1))
        filled[: len(rows), :columns], filled[: len(rows), -1] = rows, target
        factor = triangularise(filled)
        return cls(factor[:columns, :columns], factor[:columns, -1], float(factor[columns, -1] ** 2) + rest)

    def free_solution(self) -> FloatArray:
        """Return the unconstrained solution (b,); if there are several, the shortest."""
        return np.asarray(np.linalg.lstsq(self.factor, self.target, rcond=None)[0], dtype=np.float64)

    def cost(self, parameters: FloatArray) -> float:
        return float(np.sum((self.factor @ parameters - self.target) ** 2)) + self.rest

    def floor(self, cost: float) -> float:
        """Return the cost, but at least the size of rounding errors, so that it can be a divisor."""
        return max(cost, 1e-9 * float(self.target @ self.target), 1e-300)

    def eliminate_others(self, kept: int) -> CompressedProblem:
        """Return the problem in the first ``kept`` parameters, with the others eliminated at their optimal values."""
        others = self.factor[:, kept:]
        if others.shape[1] == 0:
            return self
        basis, size, _ = np.linalg.svd(others, full_matrices=False)
        basis = basis[:, size > len(others) * np.finfo(np.float64).eps * max(float(size.max()), 1e-300)]
        rows = self.factor[:, :kept] - basis @ (basis.T @ self.factor[:, :kept])
        return CompressedProblem.of(rows, self.target - basis @ (basis.T @ self.target), self.rest)

    def complete(self, parameters: FloatArray) -> FloatArray:
        """Return all parameters (b,): the given first ones, then the optimal values of the remaining ones."""
        rest = self.target - self.factor[:, : len(parameters)] @ parameters
        others = np.linalg.lstsq(self.factor[:, len(parameters) :], rest, rcond=None)[0]
        return np.concatenate([parameters, others])


def number_blocks(time: FloatArray, length: float) -> IntArray:
    """Return the number (R,), from 0, of the block, ``length`` s long, of each time (R,), s; empty blocks get none."""
    _, block = np.unique(np.floor((time - time[0]) / length), return_inverse=True)
    return block.astype(np.int64)


def estimate_covariance(
    design: FloatArray,
    residual: FloatArray,
    block: IntArray,
    prior: FloatArray | None = None,
    spread: FloatArray | float = 1.0,
) -> FloatArray:
    """Return the covariance (b, b) of least-squares parameters from residuals that are correlated within blocks.

    ``design`` (R, c, b) and ``residual`` (R, c) are weighted; ``block`` (R,) is the block of each sample, 0 … G - 1.

    The covariance is the sandwich (XᵀX)⁻¹ (Σ_g X_gᵀ r_g r_gᵀ X_g) (XᵀX)⁻¹ over blocks g, to which a block bootstrap
    converges. Residuals may be correlated and heteroscedastic within a block. Blocks count as independent, so they must
    be longer than the correlation time of the residuals. The factor G/(G - 1) · (r - 1)/(r - b) corrects for few
    blocks, where r = R c.

    If a prior with the rows P (p, b), in standard deviations, is part of the fit, the covariance is (XᵀX + PᵀP)⁻¹ (Σ_g
    X_gᵀ r_g r_gᵀ X_g + PᵀS²P) (XᵀX + PᵀP)⁻¹. The diagonal ``spread`` of S contains the standard deviations of the
    prior's errors, divided by those in P; below 1 for a prior that is wider than its errors.
    """
    from scipy.linalg import solve_triangular  # noqa: PLC0415  what uses the regressor alone needs no scipy

    columns = design.shape[-1]
    rows = design.reshape(-1, columns)
    factor = triangularise(rows if prior is None else np.concatenate([rows, prior]))
    scores = np.einsum("rcb,rc->rb", design, residual)
    count = int(block.max()) + 1
    sums = np.zeros((count, columns))
    np.add.at(sums, block, scores)
    half = solve_triangular(factor, solve_triangular(factor, sums.T, trans="T"))  # (XᵀX)⁻¹ per block, (b, G)
    correction = count / max(count - 1, 1) * (residual.size - 1) / max(residual.size - columns, 1)
    covariance: FloatArray = correction * (half @ half.T)
    if prior is None:
        return covariance
    rest = solve_triangular(factor, solve_triangular(factor, prior.T * spread, trans="T"))
    return np.asarray(covariance + rest @ rest.T)


def unit_covariance(rows: FloatArray) -> FloatArray:
    """Return (XᵀX)⁻¹ (p, p) of rows X (r, p). The columns are scaled internally, so that the result is accurate."""
    length = np.linalg.norm(rows, axis=0)
    length = np.where(length > 0.0, length, 1.0)
    _, size, right = np.linalg.svd(triangularise(rows / length))
    half = right / (np.maximum(size, 1e-12 * size[0])[:, None] * length)
    return np.asarray(half.T @ half)


def variance(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the variance (...) of the products of rows (..., b) and parameters with the given covariance (b, b)."""
    return np.asarray(np.maximum(np.einsum("...b,...b->...", rows @ covariance, rows), 0.0))
