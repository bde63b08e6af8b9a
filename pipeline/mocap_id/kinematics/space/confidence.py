"""Confidence in the segments of a trial in space, from the evidence against them.

The method is as in the plane (:mod:`mocap_id.kinematics.confidence`). The weights were fitted to simulated arms with 1
to 2 times the usual soft tissue, and to simulated chains of balls, hinges and two-axis joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.kinematics.confidence import Confidence, log_shortfall, weigh_evidence
from mocap_id.kinematics.space.chain_search import SpatialBodyChain
from mocap_id.kinematics.space.division import Division

_BEST = 3.3  # log odds without evidence against the segments
_ONE_JOINT = 5.0  # largest reduction of the log odds
_SURE_DIVISION = 1.5  # evidence of the weakest division
_SURE_WHOLE = 0.85  # evidence for dividing a body that was not divided
_SURE_TIP = 0.45  # the same for the last body
_SURE_JOINT = 2.0  # ratio of the motion without a joint to the joint's residual
_SURE_BODY = 0.014  # m; residual of the markers of a segment
_SURE_BASE = 2.0  # ratio of the motions of tip and base
_SURE_SECOND = float(np.radians(16.0))  # arc of the second independent rotation of the joints


def assess_spatial_confidence(
    chain: SpatialBodyChain,
    made: Sequence[Division],
    refused: Sequence[Division],
    *,
    motion: float,
    second_arc: float,
    left_out: float,
) -> Confidence:
    """Return the confidence in a chain of rigid bodies in space.

    Evidence against the segments:

    - ``weakest``: two of the segments could nearly be one;
    - ``runner-up``: one of the segments could nearly be two;
    - ``hidden-tip``: the last segment may be two segments that hardly move relative to each other;
    - ``joint``: two neighbours hardly share a point;
    - ``base``: both ends of the chain move about equally far;
    - ``not-rigid``: the markers of a segment move relative to each other;
    - ``left-out``: markers are on no segment and on no branch of the chain;
    - ``one-joint``: all joints rotate as one, so that segments without relative motion in this trial may be merged.

    The confidence in a joint is 0.5 if its residual is half of the motion without the joint.

    Parameters
    ----------
    chain : SpatialBodyChain
    made, refused : sequences of Division
        Accepted divisions, and the best divisions of the bodies that were not divided.
    motion : float
        Motion of the tip divided by motion of the base.
    second_arc : float
        Arc of the second independent rotation of the joints, rad; 0 for a single joint.
    left_out : float
        Fraction of the markers that are neither on the chain nor on its branches.
    """
    tip = chain.bodies[-1].markers
    hidden = [each.evidence for each in refused if np.array_equal(each.whole.markers, tip)]
    whole = [each.evidence for each in refused if not np.array_equal(each.whole.markers, tip)]
    ratios = [joint.free / max(joint.residual, 1e-6) for joint in chain.joints]
    against = {
        "weakest": 12 * log_shortfall(min((each.evidence for each in made), default=np.inf), _SURE_DIVISION),
        "runner-up": 6 * log_shortfall(_SURE_WHOLE, max(whole, default=0.0)),
        "hidden-tip": 10 * log_shortfall(_SURE_TIP, max(hidden, default=0.0)),
        "joint": 4 * log_shortfall(min(ratios), _SURE_JOINT),
        "base": 3 * log_shortfall(motion, _SURE_BASE),
        "not-rigid": 8 * log_shortfall(_SURE_BODY, max(body.rms_residual for body in chain.bodies)),
        "left-out": 30 * log_shortfall(1 - left_out, 1.0),
        "one-joint": min(10 * log_shortfall(second_arc, _SURE_SECOND), _ONE_JOINT),
    }
    return weigh_evidence(_BEST, tuple(ratio / (ratio + _SURE_JOINT) for ratio in ratios), against)
