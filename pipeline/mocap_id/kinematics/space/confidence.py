"""Confidence in the segments of a trial in space, from the evidence against them.

As in the plane (:mod:`mocap_id.kinematics.confidence`), each piece of evidence is subtracted from the log odds, and
good evidence subtracts nothing. The weights were fitted to simulated arms with 1 to 2 times the usual soft tissue and
to simulated chains of balls, hinges and two-axis joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.kinematics.space.chain_order import SpatialBodyChain
from mocap_id.kinematics.space.division import Division

SpatialEvidence: TypeAlias = Literal[
    "weakest", "runner-up", "hidden-tip", "joint", "base", "not-rigid", "left-out", "one-joint"
]

_BEST = 3.3  # log odds without evidence against
_ONE_JOINT = 5.0  # largest reduction of the log odds
_SURE_DIVISION = 1.5  # evidence of the weakest division
_SURE_WHOLE = 0.85  # evidence against a body that stayed whole
_SURE_TIP = 0.45  # the same for the last body, which may hide one more segment
_SURE_JOINT = 2.0  # motion without a joint over the joint's residual
_SURE_BODY = 0.014  # m; residual of the markers of a segment
_SURE_BASE = 2.0  # motion of the tip over that of the base
_SURE_SECOND = float(np.radians(16.0))  # arc of the second independent rotation of the joints


@dataclass(frozen=True)
class SpatialConfidence:
    """Probability that the number of segments and every assignment are right, and the evidence against it.

    Parameters
    ----------
    value : float
        Probability, 0 … 1.
    joints : tuple of float
        Confidence in each joint, 0 … 1: 0.5 if its residual is half of the motion without it.
    against : dict
        Reduction of the log odds, 0 or more, by each piece of evidence:

        ``weakest``
            two of the segments could nearly be one;
        ``runner-up``
            one of the segments could nearly be two;
        ``hidden-tip``
            the last segment may be two that hardly move against each other;
        ``joint``
            two neighbours hardly share a point;
        ``base``
            both ends of the chain move about as much;
        ``not-rigid``
            the markers of a segment move against each other;
        ``left-out``
            markers on no segment, and on no branch of the chain;
        ``one-joint``
            the joints hardly turn but in one way, as if only one turned: segments that did not move against each
            other in this trial are one.
    """

    value: float
    joints: tuple[float, ...]
    against: Mapping[SpatialEvidence, float]


def assess_spatial_confidence(
    chain: SpatialBodyChain,
    made: Sequence[Division],
    refused: Sequence[Division],
    *,
    motion: float,
    second_arc: float,
    left_out: float,
) -> SpatialConfidence:
    """Weigh the evidence.

    Parameters
    ----------
    chain : SpatialBodyChain
    made, refused : sequences of Division
        Accepted divisions, and the best divisions of the bodies that stayed whole.
    motion : float
        Motion of the tip over that of the base.
    second_arc : float
        Arc of the second independent rotation of the joints, rad; 0 for a single joint.
    left_out : float
        Share of the markers that are neither on the chain nor on its branches.
    """
    tip = chain.bodies[-1].markers
    hidden = [each.evidence for each in refused if np.array_equal(each.whole.markers, tip)]
    whole = [each.evidence for each in refused if not np.array_equal(each.whole.markers, tip)]
    ratios = [joint.free / max(joint.residual, 1e-6) for joint in chain.joints]
    against: dict[SpatialEvidence, float] = {
        "weakest": 12 * _short_of(min((each.evidence for each in made), default=np.inf), _SURE_DIVISION),
        "runner-up": 6 * _short_of(_SURE_WHOLE, max(whole, default=0.0)),
        "hidden-tip": 10 * _short_of(_SURE_TIP, max(hidden, default=0.0)),
        "joint": 4 * _short_of(min(ratios), _SURE_JOINT),
        "base": 3 * _short_of(motion, _SURE_BASE),
        "not-rigid": 8 * _short_of(_SURE_BODY, max(body.rms_residual for body in chain.bodies)),
        "left-out": 30 * _short_of(1 - left_out, 1.0),
        "one-joint": min(10 * _short_of(second_arc, _SURE_SECOND), _ONE_JOINT),
    }
    return SpatialConfidence(
        float(1 / (1 + np.exp(sum(against.values()) - _BEST))),
        tuple(ratio / (ratio + _SURE_JOINT) for ratio in ratios),
        against,
    )


def _short_of(value: float, enough: float) -> float:
    """Return ln(enough / value), at least 0."""
    return float(max(np.log(max(enough, 1e-3)) - np.log(max(value, 1e-3)), 0.0))
