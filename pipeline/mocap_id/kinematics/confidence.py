"""How sure the segments are: a chance of being right from what speaks against them.

Every piece of evidence takes something off the logarithm of the odds, nothing when it is good. The weights were fitted
to simulated trials of every difficulty (skin 0.5 to 8 times the usual, 0.2 to 3 mm of camera noise, 0 to 60 % of the
markers taken away), except for ``skipped`` and ``base``, on which those trials have no bearing and which stand for what
real trials have shown. ``benchmarks/kinematic_sweep.py`` holds stated confidences against fresh trials.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.kinematics.hypotheses import Hypothesis

Evidence: TypeAlias = Literal["skipped", "left-out", "axis", "first-joint", "base", "runner-up"]

_BEST = 3.8  # log odds with nothing against them
_SURE_SKIPPED = 3.5  # skipping a segment fits this much worse: between what right (4.0) and wrong ones (3.0) show
_SURE_FIXED = 1.5  # fixing the last segment to its parent fits this much worse: beyond what soft tissue makes of one
_SURE_AXIS = 2.0
_SURE_PIN = 8e-3  # m
_SURE_GAP = 2.0
_SURE_COST = 20.0


@dataclass(frozen=True)
class Confidence:
    """The chance that count and assignment are right, and why it is no better.

    Parameters
    ----------
    value : float
        0 … 1.
    joints : tuple of float
        0 … 1 for each joint, from its ratio: 0.5 where leaving its segment out fits 3.5 times worse, the last 1.5.
    against : dict
        What each piece of evidence takes off the log odds, 0 or more:

        ``skipped``
            the weakest joint's segment could be left out at little cost;
        ``left-out``
            moving markers that are on no segment and no limb at the side;
        ``axis``
            a still marker near joint 1 that might as well be on the other side of it;
        ``first-joint``
            joint 1 is no point of both bodies to within 8 mm;
        ``base``
            the still markers hardly stand out;
        ``runner-up``
            another number of segments explains the trial about as well.
    """

    value: float
    joints: tuple[float, ...]
    against: Mapping[Evidence, float]


def judge(
    considered: tuple[Hypothesis, ...], ratios: tuple[float, ...], explained: float, margin: float, gap: float
) -> Confidence:
    """Weigh the evidence.

    Parameters
    ----------
    considered : tuple of Hypothesis
        Best first.
    ratios : tuple of float
        For each joint, how much worse the trial is explained without its segment.
    explained : float
        Share of the moving markers that the chain carries (:func:`explained_share`).
    margin : float
        Of the closest decision about a marker on the first axis, 1 or more.
    gap : float
        Scatter of the first moving marker over that of the last still one.
    """
    best = considered[0]
    limits = [_SURE_SKIPPED] * (len(ratios) - 1) + [_SURE_FIXED]
    others = [h.cost - best.cost for h in considered if h.best_of_level and len(h.chain) != len(best.chain)]
    against: dict[Evidence, float] = {
        "skipped": 2 * _short_of(min(ratio / limit for ratio, limit in zip(ratios, limits, strict=True)), 1.0),
        "left-out": 6 * _short_of(explained, 1.0),
        "axis": 4 * _short_of(margin, _SURE_AXIS),
        "first-joint": 6 * _short_of(1 / max(best.joints[0].residual, 1e-9), 1 / _SURE_PIN),
        "base": 2 * _short_of(gap, _SURE_GAP),
        "runner-up": 0.4 * _short_of(1 + min(others, default=np.inf), 1 + _SURE_COST),
    }
    return Confidence(
        float(1 / (1 + np.exp(sum(against.values()) - _BEST))),
        tuple(ratio / (ratio + limit) for ratio, limit in zip(ratios, limits, strict=True)),
        against,
    )


def _short_of(value: float, enough: float) -> float:
    """ln(enough / value), not below 0."""
    return float(max(np.log(enough) - np.log(max(value, 1e-3)), 0.0))


def explained_share(segment: IntArray, lateral: FloatArray, moving: IntArray) -> float:
    """Share of the moving markers that are on the chain, limbs that hang at the side of the last segment left aside.

    Parameters
    ----------
    segment : (M,) int array
        -1 for none.
    lateral : (M,) array
        Mean out-of-plane coordinate, m.
    moving : int array
        Columns of the moving markers.
    """
    on_chain = moving[segment[moving] > 0]
    from_middle = np.abs(lateral - np.median(lateral[on_chain]))
    reach = from_middle[segment == segment.max()].max()
    unexplained = moving[(segment[moving] < 0) & (from_middle[moving] <= reach)]
    return len(on_chain) / (len(on_chain) + len(unexplained))
