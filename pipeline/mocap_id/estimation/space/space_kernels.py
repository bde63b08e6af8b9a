"""Inner loops of the filter in space, in one file because numba's cache does not follow dependencies between files.

The equations are in docs/concepts/rotations-in-the-filter.md. Matrices are updated row by row, because this compiles to
vector instructions.
"""

# ruff: noqa: PLR0917  arrays are passed one by one to compiled functions

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.compilation import compiled
from mocap_id.geometry.spatial_chain import LEAST_TWIST

_ROUNDS = 5  # iterations of an update from a frame's own pose
_MOST = 20  # iterations of Gauss–Newton
_CLOSE = 3e-3  # rad and m; a step smaller than this leaves an error of about its square
_LEAST_LEFT = 1e-10  # least share of a variance after smoothing
_FASTEST = 200.0  # rad/s or m/s; a joint with a faster motion, which is impossible, starts again
_STEADY = 0.5  # rad/s; largest standard deviation of a rate with which accelerometers are used
_ENOUGH = 3  # markers of a segment that show its pose
_WIDE = 3.0  # the gate around a frame's own pose, relative to the gate around the prediction
_LEAP = 0.2  # rad and m; largest step that is extrapolated


class ChainModel(NamedTuple):
    """A chain of n joints with d degrees of freedom and M markers."""

    ball: BoolArray  # (n,)
    freedom: IntArray  # (n,) degrees of freedom of each joint
    parent: IntArray  # (n,)
    first: IntArray  # (n + 1,) index of the first degree of freedom: 3 for the base's rotation, then for each joint
    centre: FloatArray  # (n, 3)
    first_axis: FloatArray  # (n, 3) in the parent's frame
    second_axis: FloatArray  # (n, 3) in the child's frame
    offset: FloatArray  # (n, 3, 3)
    glide: FloatArray  # (n, 3)
    rest: FloatArray  # (n, 3)
    long_axis: FloatArray  # (n, 3)
    segment: IntArray  # (M,)
    local: FloatArray  # (M, 3)
    on_glide: BoolArray  # (M,)


class Noise(NamedTuple):
    """Constants of the filter."""

    step: FloatArray  # (4,) dt^k / k!
    shape: FloatArray  # (4, 4) process noise of unit density
    density: FloatArray  # (d,)
    gap_density: FloatArray  # (d,) in frames whose markers do not determine a joint
    start: FloatArray  # (d, 4) initial variances
    variance: float  # m², white noise of a coordinate
    gate_variance: FloatArray  # (M,)
    weight: FloatArray  # (F, M) of each sample, relative to a sample with these variances
    gate: float
    patience: int  # frames
    anchor_limit: float  # rad², variance above which the update starts from the frame's own pose


class Pose(NamedTuple):
    """State of one frame, or of F frames with a leading axis F."""

    origin: FloatArray  # (3,) of the base
    turn: FloatArray  # (n + 1, 3, 3) rotation of the base, then of each joint
    angle: FloatArray  # (n, 2) coordinates of hinges and two-axis joints
    rate: FloatArray  # (3, d) velocity, acceleration, jerk


class Search(NamedTuple):
    """Constants of the search for the poses of single frames."""

    order: IntArray  # (T,) frames
    weight: FloatArray  # (M,) 1/m²
    limit: FloatArray  # (M,) m; markers farther away count little
    prior: FloatArray  # (d,) weak information on degrees of freedom that no marker determines


class Found(NamedTuple):
    """Output of the search."""

    track: Pose
    used: BoolArray  # (F, M) within the limit
    variance: FloatArray  # (F, d) of the pose, rad² or m²
    leverage: FloatArray  # (F, M) fraction of a marker's error that the pose follows


class Sensors(NamedTuple):
    """S inertial sensors at F frames, in the axes of their segments."""

    segment: IntArray  # (S,)
    place: FloatArray  # (S, 3) in the segment's frame, m
    lag: FloatArray  # (S,) fraction of the axial rotation that the skin under the sensor does not follow
    long_axis: FloatArray  # (S, 3) axis of the axial rotation
    parent: IntArray  # (S,) segment relative to which the segment rotates; itself for the base
    rest_axis: FloatArray  # (S, 3) direction of the long axis without swing, in the parent's frame
    gyro: FloatArray  # (F, S, 3) rad/s; NaN where missing
    force: FloatArray  # (F, S, 3) specific force, m/s²; NaN where missing
    variance: FloatArray  # (F, S, 2) of a component of each
    spread: FloatArray  # (S, 2) additional variance of a component in the gate
    gravity: float


class Motion(NamedTuple):
    """Rates of the segments in the axes of the trial; ``…_by``: derivatives by pose, velocity and acceleration."""

    omega: FloatArray  # (n + 1, 3)
    alpha: FloatArray  # (n + 1, 3)
    linear: FloatArray  # (n + 1, 3) acceleration of the origins
    own: FloatArray  # (n + 1, 3) angular velocity of the joint
    spin: FloatArray  # (n + 1, d, 3) derivative of the rotation by the pose
    omega_by: FloatArray  # (n + 1, 3, d, 3)
    alpha_by: FloatArray  # (n + 1, 3, d, 3)
    linear_by: FloatArray  # (n + 1, 3, d, 3)
    own_by: FloatArray  # (n + 1, 3, d, 3)


class Placed(NamedTuple):
    """Segments in the frame of the trial."""

    origin: FloatArray  # (n + 1, 3)
    turn: FloatArray  # (n + 1, 3, 3)
    axis: FloatArray  # (d, 3) axis of each rotation
    slope: FloatArray  # (d,) derivative of ``share``
    glide: FloatArray  # (n, 3) largest glide of each joint's centre, m
    share: FloatArray  # (n,) fraction of this glide in the present pose


@compiled
def _dot(a: FloatArray, b: FloatArray) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def _cross(a: FloatArray, b: FloatArray, c: FloatArray) -> None:
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def _multiply(a: FloatArray, b: FloatArray, c: FloatArray) -> None:
    for i in range(3):
        for j in range(3):
            c[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled
def _exp(v: FloatArray, scale: float, r: FloatArray) -> None:
    """Set ``r`` (3, 3) to the rotation by the rotation vector ``scale`` v, rad."""
    x, y, z = scale * v[0], scale * v[1], scale * v[2]
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    if angle < 1e-4:
        s, c = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        s, c = math.sin(angle) / angle, 2.0 * (math.sin(0.5 * angle) / angle) ** 2
    r[0, 0], r[0, 1], r[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    r[1, 0], r[1, 1], r[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    r[2, 0], r[2, 1], r[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)


@compiled
def _log_between(a: FloatArray, b: FloatArray, v: FloatArray) -> None:
    """Set ``v`` (3,) to the rotation vector of aᵀ b, computed from its quaternion."""
    r = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            r[i, j] = a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j]
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    v[0], v[1], v[2] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    if trace > -0.9:
        half = math.sqrt(max(1.0 + trace, 0.0)) / 2.0  # cos of half the angle
        for i in range(3):
            v[i] /= 4.0 * half
    else:
        i = 0
        if r[1, 1] > r[0, 0]:
            i = 1
        if r[2, 2] > r[i, i]:
            i = 2
        j, k = (i + 1) % 3, (i + 2) % 3
        root = math.sqrt(max(1.0 + r[i, i] - r[j, j] - r[k, k], 0.0))
        half = v[i] / (2.0 * root)
        v[i], v[j], v[k] = root / 2.0, (r[j, i] + r[i, j]) / (2.0 * root), (r[k, i] + r[i, k]) / (2.0 * root)
        if half < 0.0:
            half, v[0], v[1], v[2] = -half, -v[0], -v[1], -v[2]
    length = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    scale = 2.0 * math.atan2(length, half) / length if length > 1e-12 else 2.0
    for i in range(3):
        v[i] *= scale


@compiled
def _rotate_by_angles(model: ChainModel, pose: Pose, k: int) -> None:
    """Set the rotation of joint k, a hinge or two-axis joint, from its coordinates, in place."""
    first, both = np.empty((3, 3)), np.empty((3, 3))
    _exp(model.first_axis[k], pose.angle[k, 0], first)
    if model.freedom[k] == 1:
        _multiply(first, model.offset[k], pose.turn[k + 1])
        return
    _multiply(first, model.offset[k], both)
    _exp(model.second_axis[k], pose.angle[k, 1], first)
    _multiply(both, first, pose.turn[k + 1])


@compiled
def _rotate_right(r: FloatArray, v: FloatArray) -> None:
    """Replace the rotation R by R exp(v)."""
    by, product = np.empty((3, 3)), np.empty((3, 3))
    _exp(v, 1.0, by)
    _multiply(r, by, product)
    for i in range(3):
        for j in range(3):
            r[i, j] = product[i, j]


@compiled
def _move(model: ChainModel, pose: Pose, by: FloatArray) -> None:
    """Change a pose by a tangent vector (d,), in place: rotations are multiplied on the right, the rest is added."""
    for i in range(3):
        pose.origin[i] += by[i]
    _rotate_right(pose.turn[0], by[3:6])
    for k in range(len(model.ball)):
        at = model.first[k + 1]
        if model.ball[k]:
            _rotate_right(pose.turn[k + 1], by[at : at + 3])
        else:
            for c in range(model.freedom[k]):
                pose.angle[k, c] += by[at + c]
            _rotate_by_angles(model, pose, k)


@compiled
def _subtract_poses(model: ChainModel, start: Pose, end: Pose, by: FloatArray) -> None:
    """Set ``by`` to the tangent vector (d,) that changes ``start`` into ``end``."""
    for i in range(3):
        by[i] = end.origin[i] - start.origin[i]
    _log_between(start.turn[0], end.turn[0], by[3:6])
    for k in range(len(model.ball)):
        at = model.first[k + 1]
        if model.ball[k]:
            _log_between(start.turn[k + 1], end.turn[k + 1], by[at : at + 3])
        else:
            for c in range(model.freedom[k]):
                by[at + c] = end.angle[k, c] - start.angle[k, c]


@compiled
def _copy_pose(source: Pose, target: Pose) -> None:
    for i in range(3):
        target.origin[i] = source.origin[i]
    for k in range(source.turn.shape[0]):
        _copy(source.turn[k], target.turn[k])
    _copy(source.angle, target.angle)
    _copy(source.rate, target.rate)


@compiled
def _copy(source: FloatArray, target: FloatArray) -> None:
    """Copy a matrix element by element, because numba takes seconds to compile array assignment."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@compiled
def _view_frame(track: Pose, k: int) -> Pose:
    return Pose(track.origin[k], track.turn[k], track.angle[k], track.rate[k])


@compiled
def _new_pose(model: ChainModel) -> Pose:
    n, d = len(model.ball), model.first[-1] + (model.freedom[-1] if len(model.ball) > 0 else 3)
    return Pose(np.zeros(3), np.zeros((n + 1, 3, 3)), np.zeros((n, 2)), np.zeros((3, d)))


@compiled
def _new_placed(n: int, d: int) -> Placed:
    return Placed(
        np.zeros((n + 1, 3)), np.zeros((n + 1, 3, 3)), np.zeros((d, 3)), np.zeros(d), np.zeros((n, 3)), np.zeros(n)
    )


@compiled
def _place(model: ChainModel, pose: Pose, placed: Placed) -> None:
    """Fill ``placed`` with the poses of all segments, the axes of all rotations, and the glides."""
    back, child = np.empty(3), np.empty(3)
    for i in range(3):
        placed.origin[0, i] = pose.origin[i]
        for j in range(3):
            placed.turn[0, i, j] = pose.turn[0, i, j]
            placed.axis[3 + j, i] = pose.turn[0, i, j]
    for k in range(len(model.ball)):
        up, own, joint = placed.turn[model.parent[k]], placed.turn[k + 1], pose.turn[k + 1]
        _multiply(up, joint, own)
        cosine = 0.0
        for j in range(3):
            back[j] = joint[0, j] * model.rest[k, 0] + joint[1, j] * model.rest[k, 1] + joint[2, j] * model.rest[k, 2]
            cosine += back[j] * model.long_axis[k, j]
        placed.share[k] = 0.5 * (1.0 - cosine)
        for i in range(3):
            placed.glide[k, i] = 0.0
            placed.origin[k + 1, i] = placed.origin[model.parent[k], i]
            for j in range(3):
                placed.glide[k, i] += up[i, j] * model.glide[k, j]
                placed.origin[k + 1, i] += up[i, j] * model.centre[k, j]
            placed.origin[k + 1, i] += placed.share[k] * placed.glide[k, i]
        slope = np.empty(3)
        _cross(back, model.long_axis[k], slope)
        for c in range(model.freedom[k]):
            at = model.first[k + 1] + c
            for j in range(3):
                if model.ball[k]:
                    child[j] = 1.0 if j == c else 0.0
                elif c == 1:
                    child[j] = model.second_axis[k, j]
                else:
                    child[j] = (
                        joint[0, j] * model.first_axis[k, 0]
                        + joint[1, j] * model.first_axis[k, 1]
                        + joint[2, j] * model.first_axis[k, 2]
                    )
            placed.slope[at] = 0.5 * (slope[0] * child[0] + slope[1] * child[1] + slope[2] * child[2])
            for i in range(3):
                placed.axis[at, i] = own[i, 0] * child[0] + own[i, 1] * child[1] + own[i, 2] * child[2]


@compiled
def _locate(model: ChainModel, placed: Placed, m: int, x: FloatArray, rows: FloatArray, columns: IntArray) -> int:
    """Compute the position ``x`` (3,) of marker m and ``rows`` (d, 3), its derivatives; return the number of rows.

    ``columns`` (d,) receives the degree of freedom of each row. The rows beyond this number are not used.
    """
    segment = model.segment[m]
    for i in range(3):
        x[i] = placed.origin[segment, i]
        for j in range(3):
            x[i] += placed.turn[segment, i, j] * model.local[m, j]
    count, arm = 0, np.empty(3)
    if model.on_glide[m]:
        for i in range(3):
            x[i] += placed.share[0] * placed.glide[0, i]
        for c in range(model.first[1], model.first[1] + model.freedom[0]):
            columns[count] = c
            for i in range(3):
                rows[count, i] = placed.glide[0, i] * placed.slope[c]
            count += 1
    k = segment
    while k >= 0:
        first, last = 3, 6
        if k > 0:
            first, last = model.first[k], model.first[k] + model.freedom[k - 1]
        for i in range(3):
            arm[i] = x[i] - placed.origin[k, i]
        for c in range(first, last):
            columns[count] = c
            _cross(placed.axis[c], arm, rows[count])
            if k > 0:
                for i in range(3):
                    rows[count, i] += placed.glide[k - 1, i] * placed.slope[c]
            count += 1
        k = model.parent[k - 1] if k > 0 else -1
    for c in range(3):
        columns[count] = c
        for i in range(3):
            rows[count, i] = 1.0 if i == c else 0.0
        count += 1
    return count


@compiled
def locate_markers(model: ChainModel, track: Pose, positions: FloatArray, jacobian: FloatArray) -> None:
    """Fill positions (F, M, 3) and, if it has frames, the entries of ``jacobian`` (F, M, 3, d) that are not zero."""
    n, d = len(model.ball), track.rate.shape[2]
    placed, rows, columns = _new_placed(n, d), np.empty((d, 3)), np.empty(d, dtype=np.int64)
    for f in range(positions.shape[0]):
        _place(model, _view_frame(track, f), placed)
        for m in range(positions.shape[1]):
            count = _locate(model, placed, m, positions[f, m], rows, columns)
            if jacobian.shape[0] > 0:
                for c in range(count):
                    for i in range(3):
                        jacobian[f, m, i, columns[c]] = rows[c, i]


@compiled
def _factor(a: FloatArray) -> bool:
    """Replace the upper triangle of A by U, where A = Uᵀ U; return false if A is not positive definite."""
    size = len(a)
    for k in range(size):
        if not a[k, k] > 0.0:
            return False
        root = math.sqrt(a[k, k])
        for c in range(k, size):
            a[k, c] /= root
        for i in range(k + 1, size):
            factor = a[k, i]
            if factor != 0.0:
                for c in range(i, size):
                    a[i, c] -= factor * a[k, c]
    return True


@compiled
def _solve(upper: FloatArray, b: FloatArray) -> None:
    """Replace B by the solution X of Uᵀ U X = B, where U is ``upper``."""
    size, width = len(upper), b.shape[1]
    for k in range(size):
        inverse = 1.0 / upper[k, k]
        for c in range(width):
            b[k, c] *= inverse
        for i in range(k + 1, size):
            factor = upper[k, i]
            if factor != 0.0:
                for c in range(width):
                    b[i, c] -= factor * b[k, c]
    for k in range(size - 1, -1, -1):
        inverse = 1.0 / upper[k, k]
        for c in range(width):
            b[k, c] *= inverse
        for i in range(k):
            factor = upper[i, k]
            if factor != 0.0:
                for c in range(width):
                    b[i, c] -= factor * b[k, c]


@compiled
def _add_marker(
    a: FloatArray, g: FloatArray, rows: FloatArray, columns: IntArray, count: int, y: FloatArray, weight: float
) -> None:
    """Add Jᵀ J to the upper triangle of A, and Jᵀ y to g, both times ``weight``, for a marker with the Jacobian J."""
    for i in range(count):
        r0, r1, r2, at = weight * rows[i, 0], weight * rows[i, 1], weight * rows[i, 2], columns[i]
        g[at] += r0 * y[0] + r1 * y[1] + r2 * y[2]
        for j in range(count):
            if columns[j] >= at:
                a[at, columns[j]] += r0 * rows[j, 0] + r1 * rows[j, 1] + r2 * rows[j, 2]


@compiled
def _passes(
    p: FloatArray, rows: FloatArray, columns: IntArray, count: int, y: FloatArray, variance: float, limit: float
) -> bool:
    """Return whether an innovation ``y`` (3,) is within ``limit`` standard deviations (Mahalanobis)."""
    if y[0] ** 2 + y[1] ** 2 + y[2] ** 2 <= limit**2 * variance:
        return True
    s, u = np.zeros((3, 3)), np.empty((3, 1))
    for i in range(count):
        for j in range(count):
            value = p[columns[i], columns[j]]
            for r in range(3):
                for c in range(r, 3):
                    s[r, c] += rows[i, r] * value * rows[j, c]
    for r in range(3):
        s[r, r] += variance
        u[r, 0] = y[r]
    if not _factor(s):
        return False
    _solve(s, u)
    squared: float = y[0] * u[0, 0] + y[1] * u[1, 0] + y[2] * u[2, 0]
    return squared <= limit**2


@compiled
def _advance(model: ChainModel, noise: Noise, pose: Pose, turned: FloatArray) -> None:
    """Advance a pose by one time step, in place; ``turned`` (d,) receives the change of each degree of freedom.

    The rotation vector includes the second term of the Magnus series, dt³/12 ω × α.
    """
    d = len(turned)
    for c in range(d):
        v, a, j = pose.rate[0, c], pose.rate[1, c], pose.rate[2, c]
        turned[c] = noise.step[1] * v + noise.step[2] * a + noise.step[3] * j
    cross = np.empty(3)
    for k in range(len(model.ball) + 1):
        if k == 0 or model.ball[k - 1]:
            at = model.first[k]
            _cross(pose.rate[0, at : at + 3], pose.rate[1, at : at + 3], cross)
            for i in range(3):
                turned[at + i] += 0.5 * noise.step[3] * cross[i]
    _move(model, pose, turned)
    for c in range(d):
        pose.rate[0, c] += noise.step[1] * pose.rate[1, c] + noise.step[2] * pose.rate[2, c]
        pose.rate[1, c] += noise.step[1] * pose.rate[2, c]


@compiled
def _times_transition(model: ChainModel, step: FloatArray, turned: FloatArray, x: FloatArray) -> None:
    """Replace X (4 d, any) by F X, where F is the transition matrix for the change ``turned`` of :func:`_advance`."""
    d, width = len(turned), x.shape[1]
    moved, slip, back, sums = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, width))
    for k in range(len(model.ball) + 1):
        if k > 0 and not model.ball[k - 1]:
            continue
        at = model.first[k]
        _exp(turned[at : at + 3], -1.0, moved)
        _right_jacobian(turned[at : at + 3], slip)
        for i in range(3):
            for c in range(width):
                sums[i, c] = (
                    step[1] * x[d + at + i, c] + step[2] * x[2 * d + at + i, c] + step[3] * x[3 * d + at + i, c]
                )
        for c in range(width):
            for i in range(3):
                back[i, 0] = 0.0
                for j in range(3):
                    back[i, 0] += moved[i, j] * x[at + j, c] + slip[i, j] * sums[j, c]
            for i in range(3):
                x[at + i, c] = back[i, 0]
    for r in range(d):
        k = 0
        while k < len(model.ball) and r >= model.first[k + 1]:
            k += 1
        if r < 3 or (k > 0 and not model.ball[k - 1]):
            for c in range(width):
                x[r, c] += step[1] * x[d + r, c] + step[2] * x[2 * d + r, c] + step[3] * x[3 * d + r, c]
        for c in range(width):
            x[d + r, c] += step[1] * x[2 * d + r, c] + step[2] * x[3 * d + r, c]
            x[2 * d + r, c] += step[1] * x[3 * d + r, c]


@compiled
def _right_jacobian(v: FloatArray, j: FloatArray) -> None:
    """Set ``j`` (3, 3) to the right Jacobian of a small rotation vector v, up to the second order."""
    square = v[0] ** 2 + v[1] ** 2 + v[2] ** 2
    for i in range(3):
        for k in range(3):
            j[i, k] = v[i] * v[k] / 6.0
        j[i, i] += 1.0 - square / 6.0
    j[0, 1] += 0.5 * v[2]
    j[1, 0] -= 0.5 * v[2]
    j[0, 2] -= 0.5 * v[1]
    j[2, 0] += 0.5 * v[1]
    j[1, 2] += 0.5 * v[0]
    j[2, 1] -= 0.5 * v[0]


@compiled
def _predict(model: ChainModel, noise: Noise, pose: Pose, p: FloatArray, moved: FloatArray, found: BoolArray) -> None:
    """Advance pose and P by one step, in place, with the noise of gaps if not ``found`` (n + 1,); set ``moved`` to F P.

    F is the transition matrix, as in :func:`_times_transition`.
    """
    d = len(noise.density)
    turned = np.empty(d)
    _advance(model, noise, pose, turned)
    _copy(p, moved)
    _times_transition(model, noise.step, turned, moved)
    for r in range(len(p)):
        for c in range(len(p)):
            p[r, c] = moved[c, r]
    _times_transition(model, noise.step, turned, p)
    group = 0
    for c in range(d):
        while group < len(model.ball) and c >= model.first[group + 1]:
            group += 1
        density = noise.density[c] if found[group] else noise.gap_density[c]
        for i in range(4):
            for j in range(4):
                p[i * d + c, j * d + c] += density * noise.shape[i, j]


@compiled
def _reset(noise: Noise, p: FloatArray, first: int, last: int) -> None:
    """Set the covariance of the degrees of freedom ``first`` to ``last`` − 1 to its initial value, in place."""
    d = len(noise.density)
    for e in range(4):
        for r in range(e * d + first, e * d + last):
            for c in range(len(p)):
                p[r, c] = 0.0
                p[c, r] = 0.0
            p[r, r] = noise.start[r - e * d, e]


@compiled
def _restart(model: ChainModel, pose: Pose, k: int, last: Pose, first: int, end: int) -> None:
    """Set the base (k = 0) or joint k − 1 to its pose in ``last``, and its rates ``first`` to ``end`` − 1 to zero."""
    if k == 0:
        for i in range(3):
            pose.origin[i] = last.origin[i]
    else:
        for c in range(2):
            pose.angle[k - 1, c] = last.angle[k - 1, c]
    _copy(last.turn[k], pose.turn[k])
    for e in range(3):
        for c in range(first, end):
            pose.rate[e, c] = 0.0


@compiled
def _correct(model: ChainModel, pose: Pose, p: FloatArray, a: FloatArray, h: FloatArray, change: FloatArray) -> bool:
    """Update P, in place, with the information matrix A and information vector h of the pose; return false if it fails.

    With P_pose = Uᵀ U, T = P_(all, pose) U⁻¹ and B = I + U A Uᵀ, the change of the state, T B⁻¹ U h, is added to
    ``change`` (4 d,), and P becomes P − T (I − B⁻¹) Tᵀ. Its part for the pose is T B⁻¹ U, which has no cancellation.
    """
    d, size = len(h), len(p)
    u, t = np.zeros((d, d)), np.empty((d, size))
    for r in range(d):
        for c in range(r, d):
            u[r, c] = p[r, c]
        for c in range(size):
            t[r, c] = p[r, c]
    if not _factor(u):
        return False
    for k in range(d):  # U⁻ᵀ P_(pose, all)
        for c in range(size):
            t[k, c] /= u[k, k]
        for i in range(k + 1, d):
            factor = u[k, i]
            for c in range(size):
                t[i, c] -= factor * t[k, c]
    ua, b, inverse = np.zeros((d, d)), np.zeros((d, d)), np.zeros((d, d))
    for r in range(d):
        inverse[r, r] = 1.0
        for k in range(r, d):
            for c in range(d):
                ua[r, c] += u[r, k] * a[k, c]
    for r in range(d):
        b[r, r] = 1.0
        for c in range(r, d):
            for k in range(c, d):
                b[r, c] += ua[r, k] * u[c, k]
    if not _factor(b):
        return False
    _solve(b, inverse)
    z = np.zeros((d, size))  # B⁻¹ Tᵀ
    for r in range(d):
        for k in range(d):
            factor = inverse[r, k]
            for c in range(size):
                z[r, c] += factor * t[k, c]
    for r in range(d):
        uh = 0.0
        for c in range(r, d):
            uh += u[r, c] * h[c]
        for c in range(size):
            change[c] += z[r, c] * uh
    for k in range(d):
        for r in range(d, size):
            left, right = t[k, r], z[k, r]
            for c in range(d, r + 1):
                p[r, c] -= left * t[k, c]
                p[r, c] += right * t[k, c]
    for r in range(d):
        for c in range(size):
            p[r, c] = 0.0
        for k in range(r + 1):
            factor = u[k, r]
            for c in range(size):
                p[r, c] += factor * z[k, c]
    for r in range(size):
        for c in range(min(r, d)):
            p[r, c] = p[c, r]
    for r in range(d, size):
        for c in range(d, r):
            p[c, r] = p[r, c]
    return True


@compiled
def _update(
    model: ChainModel,
    noise: Noise,
    pose: Pose,
    p: FloatArray,
    z: FloatArray,
    used: BoolArray,
    weight: FloatArray,
    anchor: Pose,
    anchored: bool,
    limit: float,
) -> bool:
    """Update pose and P with the markers ``z`` (M, 3) of a frame, in place; return false if the update fails.

    ``used`` (M,) receives the markers within the gate. If ``anchored``, the update starts from the frame's own pose
    ``anchor``, is iterated, and has a gate around this pose in place of the prediction: ``limit`` standard deviations.
    """
    n, d = len(model.ball), len(noise.density)
    placed, rows, columns = _new_placed(n, d), np.empty((d, 3)), np.empty(d, dtype=np.int64)
    x, y, at, change = np.empty(3), np.empty(3), _new_pose(model), np.zeros(4 * d)
    prior = np.empty((4 * d, 4 * d))
    _copy_pose(pose, at)
    if anchored:
        _copy(p, prior)
        _copy_pose(anchor, at)
    shift = np.zeros(d)
    for turn in range(_ROUNDS if anchored else 1):
        if anchored:
            _subtract_poses(model, pose, at, shift)
            if turn > 0:
                _copy(prior, p)
        _place(model, at, placed)
        a, h = np.zeros((d, d)), np.zeros(d)
        for m in range(len(model.segment)):
            if turn == 0:
                used[m] = not math.isnan(z[m, 0] + z[m, 1] + z[m, 2])
            if not used[m]:
                continue
            count = _locate(model, placed, m, x, rows, columns)
            for i in range(3):
                y[i] = z[m, i] - x[i]
            if turn == 0:
                variance = noise.gate_variance[m] / weight[m]
                if anchored:
                    used[m] = y[0] ** 2 + y[1] ** 2 + y[2] ** 2 <= limit**2 * variance
                else:
                    used[m] = _passes(p, rows, columns, count, y, variance, limit)
            if used[m]:
                _add_marker(a, h, rows, columns, count, y, weight[m] / noise.variance)
        for r in range(d):
            for c in range(r, d):
                a[c, r] = a[r, c]
        for r in range(d):
            for c in range(d):
                h[r] += a[r, c] * shift[c]
        for r in range(4 * d):
            change[r] = 0.0
        if not _correct(model, pose, p, a, h, change):
            return False
        _copy_pose(pose, at)
        _move(model, at, change[:d])
    for e in range(3):
        for c in range(d):
            at.rate[e, c] = pose.rate[e, c] + change[(e + 1) * d + c]
    _copy_pose(at, pose)
    return True


@compiled
def _new_motion(n: int, d: int) -> Motion:
    shape = (n + 1, 3, d, 3)
    omega, alpha, linear, own = np.zeros((n + 1, 3)), np.zeros((n + 1, 3)), np.zeros((n + 1, 3)), np.zeros((n + 1, 3))
    omega_by, alpha_by, linear_by, own_by = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    return Motion(omega, alpha, linear, own, np.zeros((n + 1, d, 3)), omega_by, alpha_by, linear_by, own_by)


@compiled
def _add_cross(a: FloatArray, b: FloatArray, c: FloatArray) -> None:
    """Add a × b to c."""
    c[0] += a[1] * b[2] - a[2] * b[1]
    c[1] += a[2] * b[0] - a[0] * b[2]
    c[2] += a[0] * b[1] - a[1] * b[0]


@compiled
def _add_change(
    motion: Motion, k: int, c: int, order: int, arm: FloatArray, moved: FloatArray, into: FloatArray
) -> None:
    """Add to ``into`` the derivative of α × arm + ω × (ω × arm) by state c of an order; ``moved``: that of the arm."""
    omega, by = motion.omega[k], motion.omega_by[k, order, c]
    round_arm, inner = np.empty(3), np.empty(3)
    _add_cross(motion.alpha_by[k, order, c], arm, into)
    _cross(omega, arm, round_arm)
    _add_cross(by, round_arm, into)
    _cross(by, arm, inner)
    if order == 0:
        _add_cross(motion.alpha[k], moved, into)
        _add_cross(omega, moved, inner)
    _add_cross(omega, inner, into)


@compiled
def _move_base(placed: Placed, pose: Pose, motion: Motion) -> None:
    omega, alpha = motion.omega[0], motion.alpha[0]
    for i in range(3):
        motion.linear[0, i] = pose.rate[1, i]
        motion.linear_by[0, 2, i, i] = 1.0
        omega[i], alpha[i] = 0.0, 0.0
        for c in range(3, 6):
            omega[i] += placed.axis[c, i] * pose.rate[0, c]
            alpha[i] += placed.axis[c, i] * pose.rate[1, c]
            motion.spin[0, c, i] = placed.axis[c, i]
            motion.omega_by[0, 1, c, i] = placed.axis[c, i]
            motion.alpha_by[0, 2, c, i] = placed.axis[c, i]
    for c in range(3, 6):
        _cross(placed.axis[c], omega, motion.omega_by[0, 0, c])
        _cross(placed.axis[c], alpha, motion.alpha_by[0, 0, c])


@compiled
def _accelerate_glide(
    model: ChainModel, placed: Placed, pose: Pose, k: int, turning: FloatArray, more: FloatArray
) -> None:
    """Set ``more`` to a joint centre's acceleration by its glide, in a parent with the angular velocity ``turning``."""
    first, w = model.first[k + 1], pose.rate[0]
    speed, gain = 0.0, 0.0
    for c in range(first, first + model.freedom[k]):
        speed += placed.slope[c] * w[c]
        gain += placed.slope[c] * pose.rate[1, c]
    if model.ball[k]:
        back, turned, product = np.zeros(3), np.zeros(3), np.zeros(3)
        for i in range(3):
            for j in range(3):
                back[i] += pose.turn[k + 1, j, i] * model.rest[k, j]
        _cross(back, w[first : first + 3], turned)
        _cross(turned, model.long_axis[k], product)
        for i in range(3):
            gain += 0.5 * product[i] * w[first + i]
    _cross(turning, placed.glide[k], more)
    for i in range(3):
        more[i] = 2.0 * speed * more[i] + gain * placed.glide[k, i]


@compiled
def _move_joint(model: ChainModel, placed: Placed, pose: Pose, k: int, motion: Motion) -> None:
    """Set rates and derivatives of segment k + 1 from its parent's, in place; derivatives of glides are approximate."""
    p, s, first, d = model.parent[k], k + 1, model.first[k + 1], motion.spin.shape[1]
    last = first + model.freedom[k]
    second = first + 1 if model.freedom[k] == 2 else -1
    own, gain, bend, arm, part, moved = motion.own[s], np.zeros(3), np.zeros(3), np.empty(3), np.empty(3), np.empty(3)
    if second >= 0:
        _cross(placed.axis[first], placed.axis[second], bend)
    for i in range(3):
        own[i] = 0.0
        for c in range(first, last):
            own[i] += placed.axis[c, i] * pose.rate[0, c]
            gain[i] += placed.axis[c, i] * pose.rate[1, c]
        if second >= 0:
            gain[i] += bend[i] * pose.rate[0, first] * pose.rate[0, second]
        arm[i] = placed.origin[s, i] - placed.origin[p, i]
    _accelerate_glide(model, placed, pose, k, motion.omega[p], moved)
    for i in range(3):
        motion.omega[s, i] = motion.omega[p, i] + own[i]
        motion.alpha[s, i] = motion.alpha[p, i] + gain[i]
        motion.linear[s, i] = motion.linear[p, i] + moved[i]
    _add_cross(motion.omega[p], own, motion.alpha[s])
    _add_cross(motion.alpha[p], arm, motion.linear[s])
    _cross(motion.omega[p], arm, part)
    _add_cross(motion.omega[p], part, motion.linear[s])
    for c in range(d):
        mine = first <= c < last
        for i in range(3):
            motion.spin[s, c, i] = placed.axis[c, i] if mine else motion.spin[p, c, i]
            moved[i] = placed.glide[k, i] * placed.slope[c] if mine else 0.0
        _add_cross(motion.spin[p, c], arm, moved)
        for order in range(3):
            own_by, omega_by = motion.own_by[s, order, c], motion.omega_by[s, order, c]
            alpha_by, linear_by = motion.alpha_by[s, order, c], motion.linear_by[s, order, c]
            for i in range(3):
                own_by[i], alpha_by[i] = 0.0, motion.alpha_by[p, order, c, i]
                linear_by[i] = motion.linear_by[p, order, c, i]
                if mine and order == 1:
                    own_by[i] = placed.axis[c, i]
                    if second >= 0:
                        alpha_by[i] += bend[i] * pose.rate[0, first if c == second else second]
                if mine and order == 2:
                    alpha_by[i] += placed.axis[c, i]
                    linear_by[i] += placed.glide[k, i] * placed.slope[c]
            if order == 0 and c != second:
                _cross(motion.spin[s, c], own, own_by)
                _add_cross(motion.spin[s, c], gain, alpha_by)
            _add_cross(motion.omega_by[p, order, c], own, alpha_by)
            _add_cross(motion.omega[p], own_by, alpha_by)
            for i in range(3):
                omega_by[i] = motion.omega_by[p, order, c, i] + own_by[i]
            _add_change(motion, p, c, order, arm, moved, linear_by)


@compiled
def _rotate_back(turn: FloatArray, v: FloatArray, out: FloatArray) -> None:
    """Set ``out`` (3,) to Rᵀ v, where R is ``turn``."""
    for i in range(3):
        out[i] = turn[0, i] * v[0] + turn[1, i] * v[1] + turn[2, i] * v[2]


@compiled
def _predict_sensor(
    sensors: Sensors, j: int, placed: Placed, motion: Motion, gyro: FloatArray, force: FloatArray, rows: FloatArray
) -> None:
    """Compute the expected signals (3,) of sensor j, and their derivatives ``rows`` (6, 3 d) by pose and rates."""
    s, d = sensors.segment[j], motion.spin.shape[1]
    turn, along = placed.turn[s], sensors.long_axis[j]
    arm, world, part, change, own = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(3):
        for c in range(3):
            arm[i] += turn[i, c] * sensors.place[j, c]
        world[i] = motion.linear[s, i]
    world[1] += sensors.gravity
    _add_cross(motion.alpha[s], arm, world)
    _cross(motion.omega[s], arm, part)
    _add_cross(motion.omega[s], part, world)
    _rotate_back(turn, motion.omega[s], gyro)
    _rotate_back(turn, world, force)
    axis, rest, both = np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(3):
        for c in range(3):
            axis[i] += turn[i, c] * along[c]
            rest[i] += placed.turn[sensors.parent[j], i, c] * sensors.rest_axis[j, c]
        both[i] = axis[i] + rest[i]
    swing = 1.0 + _dot(axis, rest)
    size = max(swing, LEAST_TWIST)
    twist = _dot(both, motion.own[s]) / size
    for i in range(3):
        gyro[i] -= sensors.lag[j] * twist * along[i]
    for order in range(3):
        for c in range(d):
            at = order * d + c
            for i in range(3):
                change[i] = motion.omega_by[s, order, c, i]
            more = _dot(both, motion.own_by[s, order, c])
            if order == 0:
                _add_cross(motion.omega[s], motion.spin[s, c], change)
                _cross(motion.spin[s, c], axis, own)
                more += _dot(own, motion.own[s])
                away = _dot(own, rest)
                _cross(motion.spin[sensors.parent[j], c], rest, own)
                more += _dot(own, motion.own[s])
                away += _dot(own, axis)
                if swing > LEAST_TWIST:
                    more -= twist * away
            _rotate_back(turn, change, part)
            for i in range(3):
                rows[i, at] = part[i] - sensors.lag[j] * more / size * along[i]
                change[i] = motion.linear_by[s, order, c, i]
            _cross(motion.spin[s, c], arm, own)
            _add_change(motion, s, c, order, arm, own, change)
            if order == 0:
                _add_cross(world, motion.spin[s, c], change)
            _rotate_back(turn, change, part)
            for i in range(3):
                rows[3 + i, at] = part[i]


@compiled
def predict_sensors(
    model: ChainModel, track: Pose, sensors: Sensors, gyro: FloatArray, force: FloatArray, jacobian: FloatArray
) -> None:
    """Fill the expected signals (F, S, 3), and ``jacobian`` (F, S, 6, 3 d) unless this array has no frames."""
    n, d = len(model.ball), track.rate.shape[2]
    placed, motion, rows = _new_placed(n, d), _new_motion(n, d), np.empty((6, 3 * d))
    for f in range(len(gyro)):
        here = _view_frame(track, f)
        _place(model, here, placed)
        _move_base(placed, here, motion)
        for k in range(n):
            _move_joint(model, placed, here, k, motion)
        for j in range(len(sensors.segment)):
            _predict_sensor(sensors, j, placed, motion, gyro[f, j], force[f, j], rows)
            if jacobian.shape[0] > 0:
                _copy(rows, jacobian[f, j])


@compiled
def _fuse(
    p: FloatArray, rows: FloatArray, y: FloatArray, change: FloatArray, variance: float, spread: float, gate: float
) -> bool:
    """Update P and ``change`` by a residual ``y`` (3,) with derivatives ``rows`` (3, m); return whether it passes."""
    size, known = len(p), rows.shape[1]
    w, u, left, total = np.zeros((3, size)), np.zeros((3, 3)), np.empty(3), 0.0
    for i in range(3):
        left[i] = y[i]
        for r in range(known):
            factor = rows[i, r]
            if factor != 0.0:
                left[i] -= factor * change[r]
                for c in range(size):
                    w[i, c] += factor * p[r, c]
    for i in range(3):
        for j in range(i, 3):
            for r in range(known):
                u[i, j] += rows[i, r] * w[j, r]
        u[i, i] += variance
        total += u[i, i] + spread
    if left[0] ** 2 + left[1] ** 2 + left[2] ** 2 > gate**2 * total or not _factor(u):
        return False
    for k in range(3):
        left[k] /= u[k, k]
        for c in range(size):
            w[k, c] /= u[k, k]
        for i in range(k + 1, 3):
            left[i] -= u[k, i] * left[k]
            for c in range(size):
                w[i, c] -= u[k, i] * w[k, c]
    for k in range(3):
        for r in range(size):
            change[r] += w[k, r] * left[k]
            factor = w[k, r]
            for c in range(size):
                p[r, c] -= factor * w[k, c]
    return True


@compiled
def _update_inertial(
    model: ChainModel, sensors: Sensors, k: int, gate: float, pose: Pose, p: FloatArray, used: BoolArray
) -> None:
    """Update pose and P with all sensors of frame k, in place; ``used`` (S, 2) receives which signals pass the gate."""
    n, d = len(model.ball), pose.rate.shape[1]
    seen = False
    for j in range(len(sensors.segment)):
        seen = seen or not math.isnan(sensors.gyro[k, j, 0]) or not math.isnan(sensors.force[k, j, 0])
    if not seen:
        return
    placed, motion = _new_placed(n, d), _new_motion(n, d)
    gyro, force, rows, change = np.empty(3), np.empty(3), np.empty((6, 3 * d)), np.zeros(4 * d)
    _place(model, pose, placed)
    _move_base(placed, pose, motion)
    for joint in range(n):
        _move_joint(model, placed, pose, joint, motion)
    steady = True  # the acceleration is not linear in uncertain rates
    for c in range(3, d):
        steady = steady and p[d + c, d + c] < _STEADY**2
    for j in range(len(sensors.segment)):
        _predict_sensor(sensors, j, placed, motion, gyro, force, rows)
        for i in range(3):
            gyro[i] = sensors.gyro[k, j, i] - gyro[i]
            force[i] = sensors.force[k, j, i] - force[i]
        if not math.isnan(gyro[0]):
            used[j, 0] = _fuse(p, rows[:3], gyro, change, sensors.variance[k, j, 0], sensors.spread[j, 0], gate)
        if steady and not math.isnan(force[0]):
            used[j, 1] = _fuse(p, rows[3:], force, change, sensors.variance[k, j, 1], sensors.spread[j, 1], gate)
    _move(model, pose, change[:d])
    for e in range(3):
        for c in range(d):
            pose.rate[e, c] += change[(e + 1) * d + c]


@compiled
def _count_failing(model: ChainModel, z: FloatArray, used: BoolArray, failing: IntArray) -> None:
    """Count successive frames in which over half of a segment's visible markers fail; skip frames that hide all."""
    for k in range(len(failing)):
        seen, passed = 0, 0
        for m in range(len(model.segment)):
            if model.segment[m] == k and not math.isnan(z[m, 0] + z[m, 1] + z[m, 2]):
                seen += 1
                passed += used[m]
        if seen > 0:
            failing[k] = failing[k] + 1 if 2 * passed < seen else 0


@compiled
def _loses_segment(
    model: ChainModel, noise: Noise, z: FloatArray, used: BoolArray, weight: FloatArray, found: BoolArray, own: Pose
) -> bool:
    """Return whether a segment fails the gate around the prediction but not the gate around the frame's pose ``own``.

    Over half of its visible markers, at least 3, fail the first, and over half pass the second, which is wider.
    """
    n, d = len(model.ball), len(noise.density)
    placed, rows, columns, x = _new_placed(n, d), np.empty((d, 3)), np.empty(d, dtype=np.int64), np.empty(3)
    ready = False
    for k in range(n + 1):
        seen, passed = 0, 0
        for m in range(len(model.segment)):
            if model.segment[m] == k and not math.isnan(z[m, 0] + z[m, 1] + z[m, 2]):
                seen += 1
                passed += used[m]
        if not found[k] or seen < _ENOUGH or 2 * passed >= seen:
            continue
        if not ready:
            _place(model, own, placed)
            ready = True
        fitting = 0
        for m in range(len(model.segment)):
            if model.segment[m] == k and not math.isnan(z[m, 0] + z[m, 1] + z[m, 2]):
                _locate(model, placed, m, x, rows, columns)
                off = (z[m, 0] - x[0]) ** 2 + (z[m, 1] - x[1]) ** 2 + (z[m, 2] - x[2]) ** 2
                fitting += off <= (_WIDE * noise.gate) ** 2 * noise.gate_variance[m] / weight[m]
        if 2 * fitting > seen:
            return True
    return False


@compiled
def run_filter_in_space(
    model: ChainModel,
    noise: Noise,
    z: FloatArray,
    anchors: Pose,
    found: BoolArray,
    followed: BoolArray,
    sensors: Sensors,
    track: Pose,
    covariance: FloatArray,
    used: BoolArray,
    sensed: BoolArray,
    restarted: BoolArray,
) -> int:
    """Fill the track, its covariance (F, 4 d, 4 d), and the flags; return the frame that failed, −1 if none.

    ``z`` (F, M, 3) are the markers without lasting displacements; NaN where the poses of single frames, ``anchors``, do
    not use them. Markers of a frame determine the base or joint if ``found``, markers or sensors do if ``followed``.
    """
    n, d = len(model.ball), len(noise.density)
    pose, last, start, kept = _new_pose(model), _new_pose(model), _new_pose(model), _new_pose(model)
    p, moved = np.zeros((4 * d, 4 * d)), np.empty((4 * d, 4 * d))
    failing = np.zeros(n + 1, dtype=np.int64)
    _copy_pose(_view_frame(anchors, 0), pose)
    _copy_pose(pose, last)
    for k in range(len(z)):
        if k > 0:
            _predict(model, noise, pose, p, moved, followed[k])
        anchored, any_found = False, False
        for j in range(n + 1):
            first, end = 0 if j == 0 else model.first[j], model.first[j] + (3 if j == 0 else model.freedom[j - 1])
            lost = k == 0 or failing[j] > noise.patience
            for c in range(first, end):
                lost = lost or (c >= 3 and p[c, c] > noise.start[c, 0]) or not abs(pose.rate[0, c]) < _FASTEST
            if lost:
                restarted[k, j] = True
                failing[j] = 0
                _restart(model, pose, j, last, first, end)
                _reset(noise, p, first, end)
            for c in range(max(first, 3), end):
                anchored = anchored or p[c, c] > noise.anchor_limit
            any_found = any_found or found[k, j]
        if any_found:
            _copy_pose(pose, start)
            for j in range(n + 1):
                if found[k, j]:
                    _restart(model, start, j, _view_frame(anchors, k), 0, 0)
        if anchored and any_found:
            fine = _update(model, noise, pose, p, z[k], used[k], noise.weight[k], start, True, math.inf)
        else:
            _copy_pose(pose, kept)
            _copy(p, moved)
            fine = _update(model, noise, pose, p, z[k], used[k], noise.weight[k], pose, False, noise.gate)
            if fine and any_found and _loses_segment(model, noise, z[k], used[k], noise.weight[k], found[k], start):
                _copy_pose(kept, pose)
                _copy(moved, p)
                fine = _update(model, noise, pose, p, z[k], used[k], noise.weight[k], start, True, _WIDE * noise.gate)
        if not fine:
            return k
        _update_inertial(model, sensors, k, noise.gate, pose, p, sensed[k])
        _count_failing(model, z[k], used[k], failing)
        for j in range(n + 1):
            if found[k, j] and failing[j] == 0:
                _restart(model, last, j, pose, 0, 0)
        _copy_pose(pose, _view_frame(track, k))
        _copy(p, covariance[k])
    return -1


@compiled
def run_smoother_in_space(
    model: ChainModel, noise: Noise, followed: BoolArray, restarted: BoolArray, track: Pose, covariance: FloatArray
) -> int:
    """Smooth track and covariance, in place, from the last frame to the first; return the failed frame, −1 if none."""
    n, d = len(model.ball), len(noise.density)
    size = 4 * d
    ahead, error, change = _new_pose(model), np.empty(size), np.empty(size)
    pp, gain = np.empty((size, size)), np.empty((size, size))
    beyond, product = np.empty((size, size)), np.empty((size, size))
    for k in range(len(covariance) - 2, -1, -1):
        here, after = _view_frame(track, k), _view_frame(track, k + 1)
        _copy_pose(here, ahead)
        _copy(covariance[k], pp)
        _predict(model, noise, ahead, pp, gain, followed[k + 1])
        _subtract_poses(model, ahead, after, error[:d])
        for e in range(3):
            for c in range(d):
                error[(e + 1) * d + c] = after.rate[e, c] - ahead.rate[e, c]
        for j in range(n + 1):
            if restarted[k + 1, j]:
                first, end = 0 if j == 0 else model.first[j], model.first[j] + (3 if j == 0 else model.freedom[j - 1])
                _reset(noise, pp, first, end)
                for e in range(4):
                    for r in range(e * d + first, e * d + end):
                        for c in range(size):
                            gain[r, c] = 0.0
        for r in range(size):
            for c in range(size):
                beyond[r, c] = covariance[k + 1, r, c] - pp[r, c]
        if not _factor(pp):
            return k
        _solve(pp, gain)
        for c in range(size):
            change[c] = 0.0
        for r in range(size):
            for c in range(size):
                change[c] += gain[r, c] * error[r]
        _move(model, here, change[:d])
        for e in range(3):
            for c in range(d):
                here.rate[e, c] += change[(e + 1) * d + c]
        _add_sandwich(gain, beyond, product, covariance[k])
    return -1


@compiled
def _add_sandwich(gain: FloatArray, middle: FloatArray, product: FloatArray, total: FloatArray) -> None:
    """Add Gᵀ M G to a covariance ``total``, and keep its diagonal positive in spite of rounding."""
    size = len(total)
    before = np.empty(size)
    for r in range(size):
        before[r] = total[r, r]
    for r in range(size):
        for c in range(size):
            product[r, c] = 0.0
        for k in range(size):
            factor = middle[r, k]
            for c in range(size):
                product[r, c] += factor * gain[k, c]
    for k in range(size):
        for r in range(size):
            factor = gain[k, r]
            if factor != 0.0:
                for c in range(r + 1):
                    total[r, c] += factor * product[k, c]
    for r in range(size):
        total[r, r] = max(total[r, r], _LEAST_LEFT * before[r])
        for c in range(r):
            total[c, r] = total[r, c]


@compiled
def find_poses(
    model: ChainModel, search: Search, z: FloatArray, slip: FloatArray, start: Pose, started: BoolArray, found: Found
) -> None:
    """Fill ``found`` with the pose of each frame in ``search.order``, by Gauss–Newton from its own markers.

    A hidden marker contributes its assumed displacement ``slip`` (F, M, 3), in its segment's frame. The iteration
    starts from ``start`` where ``started`` (F, n + 1) is true, otherwise from the poses of the frames before.
    """
    n, d, order = len(model.ball), len(search.prior), search.order
    placed, pose, before = _new_placed(n, d), _new_pose(model), _new_pose(model)
    a, g, step, change = np.zeros((d, d)), np.zeros(d), np.zeros((d, 1)), np.zeros(d)
    inverse, y = np.zeros((d, d)), np.empty(3)
    rows, columns, x = np.empty((d, 3)), np.empty(d, dtype=np.int64), np.empty(3)
    _copy_pose(_view_frame(start, order[0]), pose)
    for index in range(len(order)):
        k = order[index]
        if index > 1 and abs(order[index] - order[index - 1]) == 1:
            _subtract_poses(model, before, pose, change)
            _copy_pose(pose, before)
            for c in range(d):
                change[c] = min(max(change[c], -_LEAP), _LEAP)
            _move(model, pose, change)
        else:
            if index > 0 and order[index - 1] > order[0] > k:  # back to the first frame
                _copy_pose(_view_frame(found.track, order[0]), pose)
            _copy_pose(pose, before)
        for j in range(n + 1):
            if started[k, j]:
                _restart(model, pose, j, _view_frame(start, k), 0, 0)
        for turn in range(_MOST):
            _place(model, pose, placed)
            # upper triangle of A, and g, for a step A⁻¹ g; distant markers have a reduced weight after the first step
            for r in range(d):
                g[r] = 0.0
                for c in range(d):
                    a[r, c] = 0.0
                a[r, r] = search.prior[r]
            robust = False
            for m in range(len(model.segment)):
                found.used[k, m] = False
                count = _locate(model, placed, m, x, rows, columns)
                weight = search.weight[m]
                if math.isnan(z[k, m, 0] + z[k, m, 1] + z[k, m, 2]):
                    own, away = placed.turn[model.segment[m]], slip[k, m]
                    if away[0] != 0.0 or away[1] != 0.0 or away[2] != 0.0:
                        for i in range(3):
                            push = weight * (own[i, 0] * away[0] + own[i, 1] * away[1] + own[i, 2] * away[2])
                            for c in range(count):
                                g[columns[c]] += push * rows[c, i]
                    continue
                for i in range(3):
                    y[i] = z[k, m, i] - x[i]
                ratio = (y[0] ** 2 + y[1] ** 2 + y[2] ** 2) / search.limit[m] ** 2
                found.used[k, m] = ratio < 1.0
                if turn > 0 and ratio > 0.5:
                    robust = True
                    weight /= (1.0 + ratio) ** 4
                _add_marker(a, g, rows, columns, count, y, weight)
            for r in range(d):
                step[r, 0] = g[r]
            if not _factor(a):
                break
            _solve(a, step)
            largest = 0.0
            for c in range(d):
                change[c] = min(max(step[c, 0], -0.5), 0.5)
                largest = max(largest, abs(change[c]))
            _move(model, pose, change)
            if largest < _CLOSE and (turn > 1 or not robust):
                break
        for r in range(d):
            for c in range(d):
                inverse[r, c] = 1.0 if r == c else 0.0
        _solve(a, inverse)
        for c in range(d):
            found.variance[k, c] = inverse[c, c]
        _place(model, pose, placed)
        for m in range(len(model.segment)):
            found.leverage[k, m] = 0.0
            if not found.used[k, m]:
                continue
            count = _locate(model, placed, m, x, rows, columns)
            for i in range(count):
                for j in range(count):
                    value = inverse[columns[i], columns[j]] * search.weight[m] / 3.0
                    inner = rows[i, 0] * rows[j, 0] + rows[i, 1] * rows[j, 1] + rows[i, 2] * rows[j, 2]
                    found.leverage[k, m] += value * inner
        if index == 0:
            _copy_pose(pose, before)
        _copy_pose(pose, _view_frame(found.track, k))
