"""Uncertainty of joint centres on measured poses: of the joint fit, of gaps, and of a trunk that bends."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.kinematics.bending_trunk import LEFT
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies
from mocap_id.stages.identify_dim.trial_data import read_skeleton

_BENT = "hip"  # joint below a trunk that may bend
_OWN = 0.25  # least share of a centre's variance that is not due to the previous joint


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
    It cannot be larger than that of centre j + 1 relative to it, which contains it as well.
    """
    own = without_previous(np.einsum("jkk->j", read_skeleton(context).covariance) / 2)
    return np.asarray(np.sqrt(own + _of_motion(context, bodies, q)))


def without_previous(relative: FloatArray) -> FloatArray:
    """Return the variance (n,) of each joint's place, m², given those of centres relative to the previous joint."""
    own = np.zeros(len(relative))
    for joint, (variance, following) in enumerate(zip(relative, [*relative[1:], np.inf], strict=True)):
        own[joint] = min(max(variance - (own[joint - 1] if joint else 0.0), _OWN * variance), following)
    return own


def _of_motion(context: Context, bodies: MeasuredBodies, q: FloatArray) -> FloatArray:
    """Return the variance (n,) of each centre from its gap, and at the hip from a trunk that bends, m² per coordinate.

    Where the pelvis bends against the trunk, the joint fit finds a centre between hip and lumbar spine, and its
    residuals are small. But the marker next to the hip moves relative to the trunk. If the hip moves alike and in phase
    with its angle, the centre is wrong by this motion divided by that of the angle, of which the shift of the joint
    (:mod:`mocap_id.kinematics.bending_trunk`) leaves a part.
    """
    skeleton, chain = read_skeleton(context), context.tree("chain.h5")
    found, moved = np.zeros(q.shape[1]), chain.numbers("markers/residual")
    for joint, gap in bodies.gap.items():
        found[joint] = gap.centre_variance
        beyond = np.flatnonzero(skeleton.marker_segment == joint + 1)
        if skeleton.joints[joint] == _BENT and not gap.pinned:
            nearest = beyond[np.argmin(np.linalg.norm(skeleton.local[beyond], axis=1))]
            found[joint] += (LEFT * moved[nearest] / np.nanstd(q[:, joint])) ** 2
    return found
