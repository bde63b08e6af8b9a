"""Inner loops of the inverse kinematics and of the compiled filter engine, for chains in the plane.

They are in one file because numba's cache does not follow dependencies between files. The arrays are small and dense.
:mod:`mocap_id.estimation.filter_problem` explains the equations. States are ordered by derivative, then by joint
(:mod:`mocap_id.estimation.filter_problem`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.compilation import compiled

ENOUGH = 3
"""Least number of visible markers of a segment with which it is followed from the frame's own angles or pose."""


class FilterModel(NamedTuple):
    """Constants of a run of the filter, from :class:`mocap_id.estimation.filter_problem.FilterProblem`."""

    step: FloatArray  # (4,) dt^k / k!
    shape: FloatArray  # (4, 4) process noise of unit density
    density: FloatArray  # (n,)
    start: FloatArray  # (4,) initial variances of a joint
    anchor_limit: float  # variance of an angle above which the frame's own angles are the measurement
    centres: FloatArray  # (n, 2)
    segment: IntArray  # (M,)
    local: FloatArray  # (M, 2)
    variance: FloatArray  # (M,)
    gate_variance: FloatArray  # (M,)
    gate: float
    patience: int  # frames
    weights: tuple[float, float, float]  # of the mean point in the mean and in the covariance, and of every other point
    spread: float


class Measurements(NamedTuple):
    """Measured markers, and the angles of each frame from its own markers."""

    markers: FloatArray  # (F, M, 2), NaN where missing
    angles: FloatArray  # (F, n)
    angle_noise: FloatArray  # (F, n, n)
    angle_observed: BoolArray  # (F, n)
    angle_used: BoolArray  # (F, M)


class Inertial(NamedTuple):
    """Signals of K calibrated inertial sensors at the frames, in the axes of their segments; K may be 0."""

    segment: IntArray  # (K,) 0 = base
    place: FloatArray  # (K, 2) position in the segment's frame, m
    share: FloatArray  # (K, n) fraction of each joint's rotation by which the skin rotates under the sensor
    rest: FloatArray  # (n,) joint angles at which the skin is not rotated, rad
    signal: FloatArray  # (F, K, 3) angular velocity, rad/s, specific force along x and y, m/s²; NaN where missing
    variance: FloatArray  # (F, K, 2) of the angular velocity, and of one component of the force
    gravity: float  # m/s², along -y of the plane


@compiled
def _copy(source: FloatArray, target: FloatArray) -> None:
    """Copy a matrix element by element, because numba takes seconds to compile array assignment."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@compiled
def _cholesky(a: FloatArray) -> bool:
    """Replace the lower triangle of ``a`` by its Cholesky factor; return false if ``a`` is not positive definite."""
    for j in range(len(a)):
        for i in range(j, len(a)):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            if i > j:
                a[i, j] = total / a[j, j]
            elif total > 0.0:
                a[j, j] = math.sqrt(total)
            else:
                return False
    return True


@compiled
def _solve(lower: FloatArray, b: FloatArray) -> None:
    """Replace every row of ``b`` by the solution x of L Lᵀ x = row, where L is ``lower``."""
    size = len(lower)
    for r in range(len(b)):
        for i in range(size):
            for k in range(i):
                b[r, i] -= lower[i, k] * b[r, k]
            b[r, i] /= lower[i, i]
        for i in range(size - 1, -1, -1):
            for k in range(i + 1, size):
                b[r, i] -= lower[k, i] * b[r, k]
            b[r, i] /= lower[i, i]


@compiled
def _sandwich(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray, total: FloatArray) -> None:
    """Set ``total`` to A B Aᵀ + C D Cᵀ; B and D must be symmetric."""
    for r in range(len(total)):
        for s in range(r + 1):
            total[r, s] = 0.0
    _add_sandwich(a, b, total)
    _add_sandwich(c, d, total)
    for r in range(len(total)):
        for s in range(r):
            total[s, r] = total[r, s]


@compiled
def _add_sandwich(a: FloatArray, b: FloatArray, total: FloatArray) -> None:
    """Add A B Aᵀ to the lower triangle of ``total``."""
    rows, inside = a.shape
    ab = np.empty(inside)
    for r in range(rows):
        for c in range(inside):
            ab[c] = 0.0
        for i in range(inside):
            for c in range(inside):
                ab[c] += a[r, i] * b[i, c]
        for s in range(r + 1):
            for i in range(inside):
                total[r, s] += ab[i] * a[s, i]


@compiled
def _times_transition(p: FloatArray, step: FloatArray) -> None:
    """Replace P by P Fᵀ, where F is the transition matrix of all joints with the powers ``step`` (4,)."""
    size = len(p)
    n = size // len(step)
    for r in range(size):
        for c in range(size):
            for e in range(1, (size - 1 - c) // n + 1):
                p[r, c] += step[e] * p[r, c + e * n]


@compiled
def _finish_prediction(x: FloatArray, p: FloatArray, step: FloatArray, shape: FloatArray, density: FloatArray) -> None:
    """Replace x by F x, and ``p``, which contains P Fᵀ, by F P Fᵀ + Q, with the transition F and process noise Q."""
    size, n = len(p), len(density)
    for r in range(size):
        for e in range(1, (size - 1 - r) // n + 1):
            x[r] += step[e] * x[r + e * n]
            for c in range(size):
                p[r, c] += step[e] * p[r + e * n, c]
    _add_noise(p, shape, density)


@compiled
def _add_noise(p: FloatArray, shape: FloatArray, density: FloatArray) -> None:
    """Add the process noise of all joints to P, in place: ``shape`` (4, 4) times the ``density`` of each joint."""
    n = len(density)
    for r in range(len(p)):
        for e in range(len(shape)):
            p[r, e * n + r % n] += density[r % n] * shape[r // n, e]


@compiled
def _reset_covariance(p: FloatArray, start: FloatArray, joint: int) -> None:
    """Set the variances of a joint to ``start`` (4,) and its covariances to zero, in place."""
    n = len(p) // len(start)
    for d in range(len(start)):
        for c in range(len(p)):
            p[d * n + joint, c] = 0.0
            p[c, d * n + joint] = 0.0
        p[d * n + joint, d * n + joint] = start[d]


@compiled
def _poses(q: FloatArray, centres: FloatArray, pose: FloatArray) -> None:
    """Fill ``pose`` (n + 1, 4) with cosine and sine of the rotation, and origin, of every segment (eq. 3.18)."""
    angle = 0.0
    pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3] = 1.0, 0.0, 0.0, 0.0
    for j in range(len(centres)):
        c, s, x, y = pose[j, 0], pose[j, 1], pose[j, 2], pose[j, 3]
        angle += q[j]
        pose[j + 1, 0], pose[j + 1, 1] = math.cos(angle), math.sin(angle)
        pose[j + 1, 2] = x + c * centres[j, 0] - s * centres[j, 1]
        pose[j + 1, 3] = y + s * centres[j, 0] + c * centres[j, 1]


@compiled
def _sigma_poses(x: FloatArray, lower: FloatArray, spread: float, centres: FloatArray) -> FloatArray:
    """Return the poses (2n + 1, n + 1, 4) of the mean, then of the n positive and n negative points in angle."""
    n = len(centres)
    poses, q = np.empty((2 * n + 1, n + 1, 4)), np.empty(n)
    for point in range(2 * n + 1):
        k = (point - 1) % n
        reach = 0.0 if point == 0 else math.sqrt(spread) * (1.0 if point <= n else -1.0)
        for j in range(n):
            q[j] = x[j] + (reach * lower[j, k] if j >= k else 0.0)
        _poses(q, centres, poses[point])
    return poses


@compiled
def _marker_rows(  # noqa: PLR0917
    model: FilterModel, m: int, poses: FloatArray, z: FloatArray, rows: FloatArray, y: FloatArray
) -> None:
    """Fill ``rows`` (2, 2n + 1) of H and the innovation ``y`` (2,) for marker m.

    The columns are in the order mean, sums, differences (:mod:`mocap_id.estimation.filter_problem`). Poses are indexed
    by single numbers, because an array view costs more than the computation.
    """
    n, segment = poses.shape[1] - 1, model.segment[m]
    centre, other = model.weights[1], model.weights[2]
    for axis in range(2):
        # cos a + sin b is the rotated coordinate
        a, b = model.local[m, axis], model.local[m, 1 - axis] * (2 * axis - 1)
        h = poses[0, segment, 2 + axis] + poses[0, segment, 0] * a + poses[0, segment, 1] * b
        shift = 0.0  # difference of the transformed mean from h
        for k in range(n):
            rows[axis, 1 + k] = 0.0
            rows[axis, 1 + n + k] = 0.0
            if k >= segment:  # columns beyond the segment's own joint do not displace it
                continue
            plus, minus = 1 + k, 1 + n + k
            up = poses[plus, segment, 2 + axis] + poses[plus, segment, 0] * a + poses[plus, segment, 1] * b - h
            down = poses[minus, segment, 2 + axis] + poses[minus, segment, 0] * a + poses[minus, segment, 1] * b - h
            rows[axis, 1 + k] = math.sqrt(0.5 * other) * (up + down)
            rows[axis, 1 + n + k] = math.sqrt(0.5 * other) * (up - down)
            shift += other * (up + down)
        for k in range(n):
            rows[axis, 1 + k] -= math.sqrt(2.0 * other) * shift
        rows[axis, 0] = -math.sqrt(centre + 6.0 * n * other) * shift  # the mean and the 6n points with the same angles
        y[axis] = z[m, axis] - h - shift


@compiled
def _distance(rows: FloatArray, y: FloatArray, variance: float) -> float:
    """Return the squared Mahalanobis distance of an innovation y (2,), for rows of H and a measurement variance."""
    xx, xy, yy = variance, 0.0, variance
    for c in range(rows.shape[1]):
        xx += rows[0, c] * rows[0, c]
        xy += rows[0, c] * rows[1, c]
        yy += rows[1, c] * rows[1, c]
    squared: float = (yy * y[0] ** 2 - 2.0 * xy * y[0] * y[1] + xx * y[1] ** 2) / (xx * yy - xy * xy)
    return squared


@compiled
def _update(x: FloatArray, p: FloatArray, z: FloatArray, used: BoolArray, model: FilterModel) -> tuple[bool, float]:
    """Update x, P and ``used`` (M,), in place, with the markers ``z`` (M, 2); return success and the log-likelihood."""
    if not _cholesky(p):
        return False, 0.0
    poses = _sigma_poses(x, p, model.spread, model.centres)
    columns = len(poses)
    a, g, u = np.zeros((columns, columns)), np.zeros(columns), np.empty((1, columns))
    rows, y = np.empty((2, columns)), np.empty(2)
    log_likelihood = 0.0
    for m in range(len(model.segment)):
        if math.isnan(z[m, 0] + z[m, 1]):
            continue
        _marker_rows(model, m, poses, z, rows, y)
        if _distance(rows, y, model.gate_variance[m]) > model.gate**2:
            continue
        used[m] = True
        r = model.variance[m]
        log_likelihood -= math.log(2.0 * math.pi * r) + 0.5 * (y[0] ** 2 + y[1] ** 2) / r
        for i in range(columns):
            g[i] += (rows[0, i] * y[0] + rows[1, i] * y[1]) / r
            for j in range(i + 1):
                a[i, j] += (rows[0, i] * rows[0, j] + rows[1, i] * rows[1, j]) / r
    for i in range(columns):
        a[i, i] += 1.0
        u[0, i] = g[i]
    if not _cholesky(a):
        return False, 0.0
    _solve(a, u)
    for i in range(columns):
        log_likelihood += 0.5 * g[i] * u[0, i] - math.log(a[i, i])
    _correct(x, p, a[columns // 2 + 1 :, columns // 2 + 1 :], u[0, columns // 2 + 1 :])
    return True, log_likelihood


@compiled
def _correct(x: FloatArray, p: FloatArray, c: FloatArray, u: FloatArray) -> None:
    """Replace x by x + L₁ u, and ``p``, which contains L = (L₁ L₂), by L₁ (C Cᵀ)⁻¹ L₁ᵀ + L₂ L₂ᵀ; L₁ has n columns."""
    n, size = len(u), len(x)
    for r in range(size):
        for k in range(min(r + 1, n)):
            x[r] += p[r, k] * u[k]
    root = np.zeros((size, size))  # L₁ C⁻ᵀ beside L₂
    for r in range(size):
        for k in range(r + 1):
            root[r, k] = p[r, k]
        for k in range(n):
            for i in range(k):
                root[r, k] -= c[k, i] * root[r, i]
            root[r, k] /= c[k, k]
    for r in range(size):
        for s in range(r + 1):
            total = 0.0
            for k in range(max(n, s + 1)):
                total += root[r, k] * root[s, k]
            p[r, s] = total
            p[s, r] = total


@compiled
def _anchor(x: FloatArray, p: FloatArray, angles: FloatArray, noise: FloatArray, gate: float) -> tuple[bool, bool]:
    """Update x and P, in place, with the angles (n,) of one frame, whose covariance is ``noise`` (n, n).

    Whole rotations are added to the angles to bring them near the state. The update is linear, in Joseph form. Return
    false if a matrix is not positive definite, and whether the angles passed the gate.
    """
    n, size = len(angles), len(x)
    s, gain = np.empty((n, n)), np.empty((size, n))
    y, u = np.empty(n), np.empty((1, n))
    for j in range(n):
        y[j] = angles[j] - x[j]
        y[j] -= 2.0 * math.pi * round(y[j] / (2.0 * math.pi))
        u[0, j] = y[j]
        for r in range(size):
            gain[r, j] = p[r, j]
            if r < n:
                s[r, j] = p[r, j] + noise[r, j]
    if not _cholesky(s):
        return False, False
    _solve(s, u)
    distance = 0.0
    for j in range(n):
        distance += y[j] * u[0, j]
    if distance > gate**2:
        return True, False
    _solve(s, gain)
    prior, keep = np.empty((size, size)), np.zeros((size, size))
    _copy(p, prior)
    for r in range(size):
        keep[r, r] += 1.0
        for j in range(n):
            x[r] += gain[r, j] * y[j]
            keep[r, j] -= gain[r, j]
    _sandwich(keep, prior, gain, noise, p)
    return True, True


@compiled
def _needs_anchor(p: FloatArray, z: FloatArray, segment: IntArray, n: int, limit: float) -> bool:
    """Return whether a measured marker depends on an angle with a variance above ``limit``."""
    first = n
    for j in range(n - 1, -1, -1):
        if p[j, j] > limit:
            first = j
    needed = False
    for m in range(len(segment)):
        needed = needed or (segment[m] > first and not math.isnan(z[m, 0] + z[m, 1]))
    return needed


@compiled
def _restart(x: FloatArray, p: FloatArray, joint: int, angle: float, start: FloatArray) -> None:
    """Set a joint to ``angle``, rad, and to rest, with its initial covariance, in place."""
    n = len(x) // len(start)
    _reset_covariance(p, start, joint)
    for d in range(len(start)):
        x[d * n + joint] = angle if d == 0 else 0.0


@compiled
def _count_failing(z: FloatArray, used: BoolArray, segment: IntArray, failing: IntArray) -> None:
    """Count successive frames in which over half of a segment's visible markers fail; skip frames that hide all."""
    for j in range(len(failing)):
        seen, passed = 0, 0
        for m in range(len(segment)):
            if segment[m] == j + 1 and not math.isnan(z[m, 0] + z[m, 1]):
                seen += 1
                passed += used[m]
        if seen > 0:
            failing[j] = failing[j] + 1 if 2 * passed < seen else 0


@compiled
def _loses_segment(z: FloatArray, used: BoolArray, segment: IntArray, measured: Measurements, k: int) -> bool:
    """Return whether a segment fails the gate around the prediction although the markers of frame k show its angle.

    Over half of its visible markers, at least 3, fail the gate, and over half determine the angle of the frame. The
    frame's own angles must also fit more markers than the prediction, in all segments together.
    """
    more = 0
    for m in range(len(segment)):
        more += int(measured.angle_used[k, m]) - int(used[m])
    if more <= 0:
        return False
    for j in range(measured.angle_observed.shape[1]):
        seen, passed, fitting = 0, 0, 0
        for m in range(len(segment)):
            if segment[m] == j + 1 and not math.isnan(z[m, 0] + z[m, 1]):
                seen += 1
                passed += used[m]
                fitting += measured.angle_used[k, m]
        if measured.angle_observed[k, j] and seen >= ENOUGH and 2 * passed < seen < 2 * fitting:
            return True
    return False


@compiled
def _force_rows(inertial: Inertial, s: int, x: FloatArray, centres: FloatArray, rows: FloatArray) -> None:
    """Fill ``rows`` (2, 4n + 1) with the derivatives of the specific force at sensor s, and with the force, m/s².

    The force, in the last column, is e^(−1jφ) (Σ w_i v_i + 1j g). φ is the angle of the skin under the sensor, φ_i are
    the angles of the segments, v_i the vectors from joint to joint, and w_i = 1j φ_i'' − φ_i'².
    """
    n, segment = len(centres), inertial.segment[s]
    angle, skin, speed, turning = 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        angle += x[j] if j < segment else 0.0
        skin += inertial.share[s, j] * (x[j] - inertial.rest[j])
    angle += skin
    own = complex(math.cos(angle), -math.sin(angle))  # e^(−jφ)
    rows[:, :] = 0.0
    total, angle = inertial.gravity * 1j * own, 0.0
    for i in range(1, segment + 1):
        angle += x[i - 1]
        speed += x[n + i - 1]
        turning += x[2 * n + i - 1]
        if i < segment:
            vector = complex(centres[i, 0], centres[i, 1]) * complex(math.cos(angle), math.sin(angle)) * own
        else:
            vector = complex(inertial.place[s, 0], inertial.place[s, 1]) * complex(math.cos(skin), -math.sin(skin))
        weight = complex(-(speed**2), turning)
        total += weight * vector
        for j in range(i):  # every joint before it rotates the vector
            for d in range(3):
                slope = 1j * weight * vector if d == 0 else (-2.0 * speed * vector if d == 1 else 1j * vector)
                rows[0, d * n + j] += slope.real
                rows[1, d * n + j] += slope.imag
    for j in range(n):
        share = inertial.share[s, j] + (1.0 if j < segment else 0.0)
        rows[0, j] += share * total.imag  # −1j total: the axes rotate with every joint
        rows[1, j] -= share * total.real
    rows[0, 4 * n], rows[1, 4 * n] = total.real, total.imag


@compiled
def _sense(  # noqa: PLR0917
    x: FloatArray, p: FloatArray, inertial: Inertial, frame: int, centres: FloatArray, gate: float
) -> None:
    """Update x and P with the sensors of a frame, in place: all gyroscopes, then the accelerometers, linearised."""
    n, size = len(centres), len(x)
    rows, gain = np.zeros((2, size + 1)), np.empty(size)
    for c in range(3):
        for s in range(len(inertial.segment)):
            z = inertial.signal[frame, s, c]
            if math.isnan(z):
                continue
            if c == 0:
                rows[:, :] = 0.0
                for j in range(n):
                    rows[0, n + j] = inertial.share[s, j] + (1.0 if j < inertial.segment[s] else 0.0)
                    rows[0, size] += rows[0, n + j] * x[n + j]
            else:
                _force_rows(inertial, s, x, centres, rows)
            row, r = max(c - 1, 0), inertial.variance[frame, s, min(c, 1)]
            total = r
            for i in range(size):
                gain[i] = 0.0
                for j in range(size):
                    gain[i] += p[i, j] * rows[row, j]
                total += rows[row, i] * gain[i]
            y = z - rows[row, size]
            if y**2 > gate**2 * total:
                continue
            for i in range(size):
                x[i] += gain[i] * y / total
                for j in range(i + 1):
                    p[i, j] -= gain[i] * gain[j] / total
                    p[j, i] = p[i, j]


@compiled
def run_filter(  # noqa: PLR0917
    model: FilterModel,
    measured: Measurements,
    inertial: Inertial,
    mean: FloatArray,
    covariance: FloatArray,
    used: BoolArray,
    restarted: BoolArray,
) -> tuple[int, float]:
    """Run the filter and fill the last four arrays; return the frame that failed (−1 if none) and the log-likelihood.

    They are states (F, 4n), covariances (F, 4n, 4n), and flags (F, M) and (F, n), which must be false before. A frame
    fails if a matrix is not positive definite. The loop carries over the state, its covariance, each joint's angle when
    last observed, and the number of successive frames in which over half of its segment's markers failed.
    """
    n, log_likelihood = len(model.density), 0.0
    x, p = np.zeros(4 * n), np.zeros((4 * n, 4 * n))
    prior, kept = np.empty(4 * n), np.empty((4 * n, 4 * n))
    last_angle, failing = np.empty(n), np.empty(n, dtype=np.int64)
    for j in range(n):
        last_angle[j], failing[j] = measured.angles[0, j], model.patience + 1  # every joint starts at once
    for k in range(len(mean)):
        z = measured.markers[k]
        _times_transition(p, model.step)
        _finish_prediction(x, p, model.step, model.shape, model.density)
        diverged = False
        for j in range(n):
            diverged = diverged or failing[j] > model.patience
        for j in range(n):
            if p[j, j] > model.start[0] or (diverged and failing[j] > 0):
                restarted[k, j] = True
                failing[j] = 0
                _restart(x, p, j, last_angle[j], model.start)
        fine, any_angle = True, False
        for j in range(n):
            any_angle = any_angle or measured.angle_observed[k, j]
        if not _needs_anchor(p, z, model.segment, n, model.anchor_limit):
            for r in range(len(x)):
                prior[r] = x[r]
            _copy(p, kept)
            fine, gained = _update(x, p, z, used[k], model)
            if fine and _loses_segment(z, used[k], model.segment, measured, k):
                for r in range(len(x)):
                    x[r] = prior[r]
                _copy(kept, p)
                gained = 0.0
                fine, _ = _anchor(x, p, measured.angles[k], measured.angle_noise[k], math.inf)
                for m in range(len(model.segment)):
                    used[k, m] = measured.angle_used[k, m]
            log_likelihood += gained
        elif any_angle:
            fine, taken = _anchor(x, p, measured.angles[k], measured.angle_noise[k], model.gate)
            for m in range(len(model.segment)):
                used[k, m] = taken and measured.angle_used[k, m]
        if not fine:
            return k, log_likelihood
        if len(inertial.segment) > 0:
            _sense(x, p, inertial, k, model.centres, model.gate)
        _count_failing(z, used[k], model.segment, failing)
        for j in range(n):
            if measured.angle_observed[k, j] and failing[j] == 0:
                last_angle[j] = x[j]
        for r in range(len(x)):
            mean[k, r] = x[r]
        _copy(p, covariance[k])
    return -1, log_likelihood


@compiled
def run_smoother(model: FilterModel, restarted: BoolArray, mean: FloatArray, covariance: FloatArray) -> int:
    """Smooth mean and covariance, in place, from the last frame to the first; return the failed frame, −1 if none."""
    n, size = len(model.density), mean.shape[1]
    xp, pp = np.empty(size), np.empty((size, size))
    gain, keep, beyond = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    for k in range(len(mean) - 2, -1, -1):
        for r in range(size):
            xp[r] = mean[k, r]
        _copy(covariance[k], gain)
        _times_transition(gain, model.step)
        _copy(gain, pp)
        _finish_prediction(xp, pp, model.step, model.shape, model.density)
        for j in range(n):
            if restarted[k + 1, j]:
                _reset_covariance(pp, model.start, j)
                for r in range(size):
                    for d in range(len(model.step)):
                        gain[r, d * n + j] = 0.0
        if not _cholesky(pp):
            return k
        _solve(pp, gain)
        for r in range(size):
            for c in range(size):
                mean[k, r] += gain[r, c] * (mean[k + 1, c] - xp[c])
        _copy(covariance[k + 1], beyond)
        _add_noise(beyond, model.shape, model.density)
        for r in range(size):  # I − K F
            for c in range(size):
                keep[r, c] = 1.0 if r == c else 0.0
                for e in range(c // n + 1):
                    keep[r, c] -= gain[r, c - e * n] * model.step[e]
        _copy(covariance[k], pp)
        _sandwich(keep, pp, gain, beyond, covariance[k])
    return -1


@compiled
def refine(  # noqa: PLR0917
    markers: FloatArray,
    used: BoolArray,
    angles: FloatArray,
    centres: FloatArray,
    segment: IntArray,
    local: FloatArray,
    damping: float,
    converged: float,
    iterations: int,
    normal: FloatArray,
) -> None:
    """Run Gauss–Newton for the angles of single frames, in place, until no angle changes by more than ``converged``.

    ``markers`` (F, M, 2), m, are used where ``used`` (F, M). ``angles`` (F, n), rad, are the start and the result, and
    ``normal`` (F, n, n) becomes Jᵀ J at the last linearisation, m^2/rad^2. ``damping`` is added to its diagonal. The
    chain is as in :class:`mocap_id.estimation.filter_problem.MarkerChain`. With ``iterations`` = 0 only ``normal``
    is computed: one function for both tasks saves time of compilation.
    """
    n = angles.shape[1]
    damped, gradient = np.empty((n, n)), np.empty((1, n))
    poses, lever = np.empty((n + 1, 4)), np.empty((n, 2))
    for f in range(len(angles)):
        for iteration in range(iterations + 1):
            _poses(angles[f], centres, poses)
            for j in range(n):
                gradient[0, j] = 0.0
                for k in range(j + 1):
                    damped[j, k] = 0.0
            for m in range(len(segment)):
                if not used[f, m]:
                    continue
                own = segment[m]
                c, s = poses[own, 0], poses[own, 1]
                x = poses[own, 2] + c * local[m, 0] - s * local[m, 1]
                y = poses[own, 3] + s * local[m, 0] + c * local[m, 1]
                for j in range(own):  # a column of J is z × (marker − joint), with z normal to the plane
                    lever[j, 0], lever[j, 1] = poses[j + 1, 3] - y, x - poses[j + 1, 2]
                    gradient[0, j] += lever[j, 0] * (markers[f, m, 0] - x) + lever[j, 1] * (markers[f, m, 1] - y)
                    for k in range(j + 1):
                        damped[j, k] += lever[j, 0] * lever[k, 0] + lever[j, 1] * lever[k, 1]
            for j in range(n):
                for k in range(j + 1):
                    normal[f, j, k] = normal[f, k, j] = damped[j, k]
                damped[j, j] += damping
            if iteration == iterations:
                break
            _cholesky(damped)
            _solve(damped, gradient)
            largest = 0.0
            for j in range(n):
                angles[f, j] += gradient[0, j]
                largest = max(largest, abs(gradient[0, j]))
            if largest <= converged:
                break
