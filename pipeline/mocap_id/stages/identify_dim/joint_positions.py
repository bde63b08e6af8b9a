"""Uncertainty of joint centres on measured poses: from the joint fit, from gaps, and from a trunk that bends.

Each of the two bodies at a joint has its own centre of the joint, and the torques use the mean of both centres. Let
G(t) be the gap between the true centres, in the axes of the body before the joint. A joint fit estimates the centre in
the body before the joint with the error dn, and in the body after it with the error df. The measured gap is

    g(t) = G(t) - dn + R(θ(t)) df .

The fit minimises g, weighted with the information matrix of the poses. A gap that depends on the joint angle θ is
therefore hidden in dn and df; a gap in proportion to θ is hidden nearly completely. The hidden part is estimated from g
with a model of a smooth gap,

    G(t) = Σ_p a_p T_p(x(t)),   a_p ~ N(0, 4^(1-p) σ² I),   p = 1, 2,

where x is θ scaled to -1 … 1 and T_p are Chebyshev polynomials. The coefficients of each order are half as large as
those of the order before, as for a sine of the angle over one to two radians. σ² is estimated from the part of g that
this model can explain. The mean of the two centres has the error (dn + R df) / 2 from the fit, and the error g / 2,
because the joint may be at either centre.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import FloatArray, find_complete_rows
from mocap_id.dynamics.measured_motion import BodyPoses, differentiate_gaps
from mocap_id.geometry import planar
from mocap_id.kinematics.joint_corrections import REMAINING
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies
from mocap_id.stages.identify_dim.trial_data import read_skeleton

_BENT = "hip"  # joint before a trunk that may bend
_OWN = 0.25  # smallest share of the variance of a centre that does not come from the previous joint
_ORDERS = (1.0, 0.5)  # standard deviations of the coefficients of first and second order, relative to σ
_LARGEST = 0.01  # m/rad: largest σ divided by half the arc; people's hips shift by about a centimetre in two radians
_SHAPED = 1e-6  # smallest size of a measured shape, relative to the largest shape
_STILL = 1e-9  # rad, smallest half of an arc
_SAMPLES = 500  # approximate number of samples used


def compute_centre_covariance(context: Context, bodies: MeasuredBodies, q: FloatArray) -> FloatArray:
    """Return the covariance (n, 2, 2) of each joint centre relative to the previous joint, m².

    ``q`` (T, n) are the joint angles in the samples of the fit, rad.
    """
    return read_skeleton(context).covariance + _estimate_motion_variance(context, bodies, q)[:, None, None] * np.eye(2)


def compute_position_sd(context: Context, bodies: MeasuredBodies, q: FloatArray) -> FloatArray:
    """Return the standard deviation (n,) of each joint centre in one direction, relative to the markers around it, m.

    The covariance of a centre from the joint fit also contains the error of the previous centre, which is removed. The
    ankles of moving feet have the standard deviations of :mod:`mocap_id.kinematics.joint_corrections`.
    """
    own = remove_previous_errors(np.einsum("jkk->j", read_skeleton(context).covariance) / 2)
    for joint, sd in bodies.placed.items():
        own[joint] = sd**2
    return np.asarray(np.sqrt(own + _estimate_motion_variance(context, bodies, q)))


def remove_previous_errors(relative: FloatArray) -> FloatArray:
    """Return the variance (n,) of each joint centre, m², from its variance relative to the previous centre.

    The result for a centre is at most the relative variance of the next centre, because that includes it.
    """
    own = np.zeros(len(relative))
    for joint, (variance, following) in enumerate(zip(relative, [*relative[1:], np.inf], strict=True)):
        own[joint] = min(max(variance - (own[joint - 1] if joint else 0.0), _OWN * variance), following)
    return own


def estimate_hidden_gaps(poses: BodyPoses, loose: Sequence[int]) -> FloatArray:
    """Return the variance (n,) of each joint centre due to gaps that the joint fit hides, m² in each coordinate.

    ``loose`` are the joints, from 0, that may have a gap. Each gap also moves the centres of the neighbouring joints.
    """
    joints, variance = poses.joints, np.zeros(len(poses.centres))
    samples = np.flatnonzero(find_complete_rows(poses.angle))
    samples = samples[:: max(1, len(samples) // _SAMPLES)]
    if not len(samples) or not loose:
        return variance
    angle = poses.angle[samples]
    flat, spread = differentiate_gaps(poses, joints, angle)
    weight = np.linalg.inv(spread @ np.swapaxes(flat, 1, 2))  # (t, 2j, 2j) weight of the gaps
    before, after = (_make_rotations(angle[:, poses.body[[joint + side for joint in joints]]]) for side in (0, 1))
    design = np.zeros((len(samples), len(joints), 2, len(joints), 4))  # columns: dn and df of every joint
    for row in range(len(joints)):
        design[:, row, :, row] = np.concatenate([-before[:, row], after[:, row]], axis=-1)
    rows = design.reshape(len(samples), 2 * len(joints), -1)
    weighted = np.swapaxes(rows, 1, 2) @ weight
    normal = np.sum(weighted @ rows, axis=0)
    mean = np.stack([before, after], axis=-2).reshape(len(samples), len(joints), 2, 4) / 2  # mean of the two sides
    for row in (joints.index(joint) for joint in loose):
        shapes, size = _estimate_gap(
            np.einsum("tji,tj->ti", before[:, row], poses.measure_gap(joints[row])[samples]),
            np.einsum("tji,tjk->tik", before[:, row], after[:, row]),
            angle[:, poses.body[joints[row] + 1]] - angle[:, poses.body[joints[row]]],
        )
        gaps = weighted[:, :, 2 * row : 2 * row + 2] @ (before[:, row] @ shapes)
        moved = -size * np.linalg.solve(normal, np.sum(gaps, axis=0)).reshape(len(joints), 4, -1)
        variance[joints] += np.mean(np.sum((mean @ moved) ** 2, axis=(2, 3)), axis=0) / 2
    return variance


def _estimate_gap(gap: FloatArray, turned: FloatArray, angle: FloatArray) -> tuple[FloatArray, float]:
    """Return the S shapes (T, 2, S) of a gap for σ = 1, and σ, m, estimated from the measured gap.

    The measured gap (T, 2) and R(θ) (T, 2, 2) are in the axes of the body before the joint; ``angle`` (T,) is θ, rad.
    """
    half = max(float(np.ptp(angle)) / 2, _STILL)
    x = (angle - angle.min()) / half - 1
    orders = np.polynomial.chebyshev.chebvander(x, len(_ORDERS))[:, 1:] * _ORDERS
    shapes = (orders[:, None, None, :] * np.eye(2)[:, :, None]).reshape(len(angle), 2, -1)
    rows = np.concatenate([np.broadcast_to(-np.eye(2), turned.shape), turned], axis=-1).reshape(-1, 4)
    every = np.column_stack([shapes.reshape(len(rows), -1), gap.reshape(-1)])
    left = every - rows @ np.linalg.lstsq(rows, every)[0]
    basis, size, _ = np.linalg.svd(left[:, :-1], full_matrices=False)
    share = float(np.sum(size**2))
    if share <= 0.0:
        return shapes, 0.0
    seen = basis[:, size > _SHAPED * size[0]].T @ left[:, -1]
    return shapes, min(float(np.sqrt(np.sum(seen**2) / share)), _LARGEST * half)


def _make_rotations(angle: FloatArray) -> FloatArray:
    """Return the rotation matrices (..., 2, 2) of angles, rad."""
    return np.stack([planar.rotate(angle, axis) for axis in np.eye(2)], axis=-1)


def _estimate_motion_variance(context: Context, bodies: MeasuredBodies, q: FloatArray) -> FloatArray:
    """Return the variance (n,) of each joint centre due to motion between both sides of the joint, m² per coordinate.

    At the hip, it includes the effect of a bending trunk. If the pelvis rotates relative to the trunk, the joint fit
    estimates a centre between hip and lumbar spine, with small residuals, but the marker next to the hip moves relative
    to the trunk. If the hip moves in the same way and in phase with its angle, this motion divided by the change of the
    angle estimates the error of the centre. The shift of the joint (:mod:`mocap_id.kinematics.joint_corrections`)
    corrects a part of this error.
    """
    skeleton, residual = read_skeleton(context), context.tree("chain.h5").numbers("markers/residual")
    loose = {joint: gap for joint, gap in bodies.gap.items() if not gap.pinned}
    variance = np.zeros(q.shape[1]) + estimate_hidden_gaps(bodies.poses, [*loose])
    for joint, gap in loose.items():
        variance[joint] += gap.size**2 / 8
        own = np.flatnonzero(skeleton.marker_segment == joint + 1)
        if skeleton.joints[joint] == _BENT:
            nearest = own[np.argmin(np.linalg.norm(skeleton.local[own], axis=1))]
            variance[joint] += (REMAINING * residual[nearest] / np.nanstd(q[:, joint])) ** 2
    return variance
