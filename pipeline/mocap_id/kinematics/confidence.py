"""Confidence in the segments: the probability that they are right, from the evidence against them.

Each piece of evidence against the segments reduces the log odds; evidence in favour does not increase them. The weights
were fitted to simulated trials of every difficulty (skin motion of 0.5 to 8 times the usual, camera noise of 0.2 to 3
mm, 0 to 60 % of the markers removed). These trials do not test ``skipped`` and ``base``, whose weights come from real
trials. ``benchmarks/kinematic_sweep.py`` compares the confidences with fresh trials.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.kinematics.hypotheses import Hypothesis
from mocap_id.kinematics.link_fit import LinkFit

Evidence: TypeAlias = Literal["skipped", "left-out", "axis", "first-joint", "base", "runner-up", "links", "ankle"]
"""Names of the evidence against the segments."""

_BEST = 3.8  # log odds without evidence against the segments
_SURE_SKIPPED = 3.5  # growth of the residual without a segment; 4.0 for correct segments, 3.0 for wrong ones
_SURE_FIXED = 1.5  # growth of the residual with the last segment fixed to its parent: more than soft tissue causes
_SURE_AXIS = 2.0
_SURE_PIN = 8e-3  # m
_SURE_GAP = 2.0
_SURE_COST = 20.0
_SURE_ANKLE_ARC = float(np.radians(30))
_LEFT_OUT_OF_LINKS = 5.0  # reduction of the log odds
_LOOSE = 5.0  # reduction of the log odds


@dataclass(frozen=True)
class Confidence:
    """Probability that the number of segments and every assignment are right, and the evidence against it."""

    value: float  # probability, 0 … 1
    joints: tuple[float, ...]  # confidence in each joint, 0 … 1
    against: Mapping[str, float]  # reduction of the log odds, 0 or more, by each piece of evidence


def weigh_evidence(best: float, joints: tuple[float, ...], against: Mapping[str, float]) -> Confidence:
    """Return the confidence from the log odds ``best``, which the evidence ``against`` reduces."""
    return Confidence(float(1 / (1 + np.exp(sum(against.values()) - best))), joints, against)


def assess_confidence(
    considered: tuple[Hypothesis, ...], ratios: tuple[float, ...], explained: float, margin: float, gap: float
) -> Confidence:
    """Return the confidence in a chain of rigid bodies.

    Evidence against the segments:

    - ``skipped``: the segment of the weakest joint could be left out at little cost;
    - ``left-out``: moving markers are on no segment and on no limb at the side;
    - ``axis``: a still marker near joint 1 could also belong to the other of its two segments;
    - ``first-joint``: the two bodies' points at joint 1 are more than 8 mm (rms) apart;
    - ``base``: the still markers hardly differ from the moving ones;
    - ``runner-up``: another number of segments explains the trial nearly as well.

    The confidence in a joint is 0.5 if the residual without its segment is 3.5 times as large (last joint: 1.5 times).

    Parameters
    ----------
    considered : tuple of Hypothesis
        All hypotheses, best first.
    ratios : tuple of float
        For each joint, the residual without its segment divided by the residual with it.
    explained : float
        Fraction of the moving markers that are on the chain (:func:`explained_share`).
    margin : float
        Margin of the least certain decision about a marker on the first axis, 1 or more (``AxisMarkers.margin``).
    gap : float
        Scatter of the stillest moving marker divided by the largest scatter of a base marker.
    """
    best = considered[0]
    limits = [_SURE_SKIPPED] * (len(ratios) - 1) + [_SURE_FIXED]
    others = [h.cost - best.cost for h in considered if h.best_of_level and len(h.chain) != len(best.chain)]
    against = {
        "skipped": 2 * log_shortfall(min(ratio / limit for ratio, limit in zip(ratios, limits, strict=True)), 1.0),
        "left-out": 6 * log_shortfall(explained, 1.0),
        "axis": 4 * log_shortfall(margin, _SURE_AXIS),
        "first-joint": 6 * log_shortfall(1 / max(best.joints[0].residual, 1e-9), 1 / _SURE_PIN),
        "base": 2 * log_shortfall(gap, _SURE_GAP),
        "runner-up": 0.4 * log_shortfall(1 + min(others, default=np.inf), 1 + _SURE_COST),
    }
    joints = tuple(ratio / (ratio + limit) for ratio, limit in zip(ratios, limits, strict=True))
    return weigh_evidence(_BEST, joints, against)


def assess_links(links: LinkFit, explained: float, gap: float) -> Confidence:
    """Return the confidence in a chain with single-marker segments.

    Evidence against the segments, besides ``left-out`` and ``base`` of :func:`assess_confidence`:

    - ``links``: a segment has a single marker, and no marker is at either of its joints;
    - ``ankle``: joint 1 rotates little, and no marker is at it.
    """
    ankle_marked = any(pin.joint == 0 for pin in links.pins)
    against = {
        "left-out": _LEFT_OUT_OF_LINKS if explained < 1 else 0.0,
        "base": 0.0 if ankle_marked else 2 * log_shortfall(gap, _SURE_GAP),
        "links": _LOOSE if links.loose else 0.0,
        "ankle": 0.0 if ankle_marked else 4 * log_shortfall(float(links.arcs[0]), _SURE_ANKLE_ARC),
    }
    return weigh_evidence(_BEST, tuple(1.0 for _ in links.arcs), against)


def log_shortfall(value: float, enough: float) -> float:
    """Return ln(enough / value), at least 0."""
    return float(max(np.log(max(enough, 1e-3)) - np.log(max(value, 1e-3)), 0.0))


def explained_share(segment: IntArray, lateral: FloatArray, moving: IntArray) -> float:
    """Return the fraction of the moving markers that are on the chain; limbs beside the last segment do not count.

    ``segment`` (M,) is -1 for markers on no segment, ``lateral`` (M,) the mean out-of-plane coordinate, m, and
    ``moving`` the columns of the moving markers.
    """
    on_chain = moving[segment[moving] > 0]
    from_middle = np.abs(lateral - np.median(lateral[on_chain]))
    reach = from_middle[segment == segment.max()].max()
    left_out = moving[segment[moving] < 0]
    if len(left_out) > len(on_chain):  # limbs are never the larger part of a body
        return len(on_chain) / (len(on_chain) + len(left_out))
    unexplained = moving[(segment[moving] < 0) & (from_middle[moving] <= reach)]
    return len(on_chain) / (len(on_chain) + len(unexplained))
