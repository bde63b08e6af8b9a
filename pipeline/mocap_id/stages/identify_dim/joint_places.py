"""Uncertainty of joint centres on measured poses: of the joint fit, of gaps, and of a trunk that bends.

Both sides of a joint show its place, and the torques use the mean of the two. With the gap G(t) between the true
centres of the two sides, in the frame of the body before the joint, a joint fit finds the centres n and f in the two
bodies, with errors dn and df, and leaves the gap

    g(t) = G(t) - dn + R(θ(t)) df .

It minimises g, weighted with the information of the poses, so it takes for a place what it can of a gap that follows
the joint angle θ, nearly all of a gap in proportion to θ. What it leaves shows how much that was, if G is smooth:

    G(t) = Σ_p a_p T_p(x(t)),   a_p ~ N(0, 4^(1-p) σ² I),   p = 1, 2,

where x is θ scaled to -1 … 1 and T_p are Chebyshev polynomials. Each order is half of the one before, as for a sine of
the angle over one to two radians. σ² follows from the measured share of g that has the shapes of this model. The mean
of the two sides has the error (dn + R df) / 2 from the fit, and g / 2 because the joint may be on either side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.lowpass import known
from mocap_id.dynamics.measured_motion import BodyPoses, differentiate_gaps
from mocap_id.geometry import planar
from mocap_id.kinematics.joint_corrections import REMAINING
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies
from mocap_id.stages.identify_dim.trial_data import read_skeleton

_BENT = "hip"  # joint below a trunk that may bend
_OWN = 0.25  # least share of a centre's variance that is not due to the previous joint
_ORDERS = (1.0, 0.5)  # size of the first and the second order of a gap in the joint angle, relative to σ
_LARGEST = 0.01  # m/rad: largest σ over half the joint's arc; people's hips shift by about a centimetre in two radians
_SHAPED = 1e-6  # least size of a shape, relative to the largest, that a joint fit leaves
_STILL = 1e-9  # rad
_SAMPLES = 500  # samples used


def centre_covariance(context: Context, bodies: MeasuredBodies, q: FloatArray) -> FloatArray:
    """Return the covariance (n, 2, 2) of each joint centre relative to the previous joint, m².

    Parameters
    ----------
    context : Context
    bodies : MeasuredBodies
    q : (T, n) array
        Joint angles over the samples of the fit, rad.
    """
    return read_skeleton(context).covariance + _of_motion(context, bodies, q)[:, None, None] * np.eye(2)


def place_sd(context: Context, bodies: MeasuredBodies, q: FloatArray) -> FloatArray:
    """Return the standard deviation (n,) of each joint centre in one direction, relative to the markers around it, m.

    The joint fit's covariance of centre j is relative to centre j - 1, in the body between them, so it contains the
    errors of both. The markers of this body place each of them, so the part of the previous one is subtracted.
    It cannot be larger than that of centre j + 1 relative to it, which contains it as well. An ankle between feet that
    move has a place and a standard deviation of its own (:func:`mocap_id.kinematics.joint_corrections.locate_ankle`).
    """
    own = without_previous(np.einsum("jkk->j", read_skeleton(context).covariance) / 2)
    for joint, sd in bodies.placed.items():
        own[joint] = sd**2
    return np.asarray(np.sqrt(own + _of_motion(context, bodies, q)))


def without_previous(relative: FloatArray) -> FloatArray:
    """Return the variance (n,) of each joint's place, m², given those of centres relative to the previous joint."""
    own = np.zeros(len(relative))
    for joint, (variance, following) in enumerate(zip(relative, [*relative[1:], np.inf], strict=True)):
        own[joint] = min(max(variance - (own[joint - 1] if joint else 0.0), _OWN * variance), following)
    return own


def taken_for_places(poses: BodyPoses, loose: Sequence[int]) -> FloatArray:
    """Return the variance (n,) of each joint's place from gaps that the joint fit takes for a place, m² per coordinate.

    Parameters
    ----------
    poses : BodyPoses
    loose : sequence of int
        Joints, from 0, that may have a gap. Each gap also moves the centres of the neighbouring joints.
    """
    joints, found = poses.joints, np.zeros(len(poses.centres))
    samples = np.flatnonzero(known(poses.angle))
    samples = samples[:: max(1, len(samples) // _SAMPLES)]
    if not len(samples) or not loose:
        return found
    angle = poses.angle[samples]
    flat, spread = differentiate_gaps(poses, joints, angle)
    weight = np.linalg.inv(spread @ np.swapaxes(flat, 1, 2))  # (t, 2j, 2j) of the gaps
    before, after = (_turns(angle[:, poses.body[[joint + side for joint in joints]]]) for side in (0, 1))
    design = np.zeros((len(samples), len(joints), 2, len(joints), 4))  # of dn, df of every joint
    for row in range(len(joints)):
        design[:, row, :, row] = np.concatenate([-before[:, row], after[:, row]], axis=-1)
    rows = design.reshape(len(samples), 2 * len(joints), -1)
    weighted = np.swapaxes(rows, 1, 2) @ weight
    normal = np.sum(weighted @ rows, axis=0)
    mean = np.stack([before, after], axis=-2).reshape(len(samples), len(joints), 2, 4) / 2  # of the two sides
    for row in (joints.index(joint) for joint in loose):
        shapes, size = _giving_way(
            np.einsum("tji,tj->ti", before[:, row], poses.measure_gap(joints[row])[samples]),
            np.einsum("tji,tjk->tik", before[:, row], after[:, row]),
            angle[:, poses.body[joints[row] + 1]] - angle[:, poses.body[joints[row]]],
        )
        gaps = weighted[:, :, 2 * row : 2 * row + 2] @ (before[:, row] @ shapes)
        moved = -size * np.linalg.solve(normal, np.sum(gaps, axis=0)).reshape(len(joints), 4, -1)
        found[joints] += np.mean(np.sum((mean @ moved) ** 2, axis=(2, 3)), axis=0) / 2
    return found


def _giving_way(gap: FloatArray, turned: FloatArray, angle: FloatArray) -> tuple[FloatArray, float]:
    """Return the shapes (T, 2, S) of a gap with σ = 1, and σ, m, by what the joint fit leaves of them in a gap.

    Gap (T, 2) and R(θ) (T, 2, 2) are in the frame of the body before the joint; ``angle`` (T,) is θ.
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


def _turns(angle: FloatArray) -> FloatArray:
    """Return rotation matrices (..., 2, 2) by angles, rad."""
    return np.stack([planar.rotate(angle, axis) for axis in np.eye(2)], axis=-1)


def _of_motion(context: Context, bodies: MeasuredBodies, q: FloatArray) -> FloatArray:
    """Return the variance (n,) of each centre from its gap, and at the hip from a trunk that bends, m² per coordinate.

    Where the pelvis bends against the trunk, the joint fit finds a centre between hip and lumbar spine, and its
    residuals are small. But the marker next to the hip moves relative to the trunk. If the hip moves alike and in phase
    with its angle, the centre is wrong by this motion divided by that of the angle, of which the shift of the joint
    (:mod:`mocap_id.kinematics.joint_corrections`) leaves a part.
    """
    skeleton, chain = read_skeleton(context), context.tree("chain.h5")
    found, moved = np.zeros(q.shape[1]), chain.numbers("markers/residual")
    loose = {joint: gap for joint, gap in bodies.gap.items() if not gap.pinned}
    found += taken_for_places(bodies.poses, [*loose])
    for joint, gap in loose.items():
        found[joint] += gap.size**2 / 8
        beyond = np.flatnonzero(skeleton.marker_segment == joint + 1)
        if skeleton.joints[joint] == _BENT:
            nearest = beyond[np.argmin(np.linalg.norm(skeleton.local[beyond], axis=1))]
            found[joint] += (REMAINING * moved[nearest] / np.nanstd(q[:, joint])) ** 2
    return found
