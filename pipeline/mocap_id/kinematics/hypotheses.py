"""Hypotheses of a segmentation: chains of bodies, their costs, and the reasons why they lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.clusters import Base, Clusters
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.joint import PairJoint
from mocap_id.kinematics.rigid_body import RigidBody

FLOOR = 3e-4
"""Resolution of camera systems, m; smaller residuals are no better."""

_REPORTED = 0.05  # smaller differences in cost are not reported
_MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class SegmentationRules:
    """Limits that define a still marker, a turning joint and a rigid body.

    Parameters
    ----------
    still_limit : float
        Largest scatter of a base marker, m.
    min_arc : float
        Smallest arc of a joint, rad.
    max_residual : float
        Largest rms distance between the two bodies' points at a joint, m.
    max_body_residual : float
        Largest rms distance of a body's markers from their places on it, m.
    merge_tolerance : float
        Two bodies that hardly turn are merged if the merged residual stays below this multiple of their own.
    split_gain : float
        Least gain in summed log residual for one more segment.
    count : int or None
        Number of segments with the base, if known.
    longest : int
        Largest number of segments with the base; the rest of a longer chain is left out as a branch.
    """

    still_limit: float = 0.015
    min_arc: float = float(np.radians(6.0))
    max_residual: float = 0.05
    max_body_residual: float = 0.015
    merge_tolerance: float = 3.0
    split_gain: float = 4.0
    count: int | None = None
    longest: int = 6

    def is_joint(self, joint: PairJoint) -> bool:
        """Return whether two bodies turn far enough about a point fixed in both."""
        return joint.residual <= self.max_residual and joint.arc >= self.min_arc


@dataclass(frozen=True)
class SegmentationProblem:
    """Input of every hypothesis: markers, base, rules and constraints.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where unseen.
    lateral : (M,) array
        Mean out-of-plane coordinate of every marker, m.
    base : Base
        The still markers.
    ground : RigidBody
        The base as a rigid body.
    moving : int array
        Columns of the moving markers.
    rules : SegmentationRules
    constraints : Constraints
    clusters : Clusters
        Rigid bodies of the moving markers.
    """

    points: ComplexArray
    lateral: FloatArray
    base: Base
    ground: RigidBody
    moving: IntArray
    rules: SegmentationRules
    constraints: Constraints
    clusters: Clusters


@dataclass(frozen=True)
class Hypothesis:
    """One segmentation of the recording: bodies in order from base to tip, and its cost.

    Parameters
    ----------
    level : int
        Level of detail: the number of bodies requested from the clustering.
    chain : tuple of RigidBody
        The moving segments.
    joints : tuple of PairJoint
        Each segment's joint with the segment before.
    left_out : tuple of RigidBody
        Bodies of the level that are not on the chain.
    predicted : (M,) array
        Residual of every marker predicted through its joint, m; its scatter if it is on no moving segment.
    cost : float
        Summed log of the moving markers' ``predicted``, plus ``split_gain`` per segment, plus ``cut``; lower is better.
    best_of_level : bool
        Whether this is the best chain of its level. Only these can be chosen.
    cut : float
        0 for the best chain of a level. For the others, the cost that the best chain gained when it was shortened
        to the longest length allowed: the full chain was better than they are.
    """

    level: int
    chain: tuple[RigidBody, ...]
    joints: tuple[PairJoint, ...]
    left_out: tuple[RigidBody, ...]
    predicted: FloatArray
    cost: float
    best_of_level: bool
    cut: float

    @property
    def markers(self) -> IntArray:
        """Return the columns of the markers on the moving segments, sorted."""
        return np.sort(np.concatenate([body.markers for body in self.chain]))

    def explain_cost(self, best: Hypothesis) -> str:
        """Return why the best hypothesis was chosen instead, or ``chosen`` for the best one itself.

        The terms add up to the difference in cost: markers only on the best chain, markers only on this chain, markers
        on both, the number of segments, and the shortening of the chain.
        """
        if self is best:
            return "chosen"
        own, other = self.markers, best.markers
        out, extra, both = np.setdiff1d(other, own), np.setdiff1d(own, other), np.intersect1d(own, other)
        fit = self._compare_residuals(best, both)
        terms = {
            f"leaves out {_format_count(len(out), 'marker')} of the chosen segments": self._compare_residuals(
                best, out
            ),
            f"carries {_format_count(len(extra), 'marker')} more": self._compare_residuals(best, extra),
            f"fits {'the others' if len(out) + len(extra) else 'the markers'} {'worse' if fit > 0 else 'better'}": fit,
            "lost to a longer chain that was shortened afterwards": self.cut,
        }
        more = len(self.chain) - len(best.chain)
        price = self.cost - best.cost - sum(terms.values())  # split_gain times the difference in the number of segments
        return _describe_cost(
            {f"has {_format_count(abs(more), 'segment')} {'more' if more > 0 else 'fewer'}": price, **terms}
        )

    def _compare_residuals(self, best: Hypothesis, markers: IntArray) -> float:
        """Return the difference in the summed log residual of some markers."""
        return float(np.sum(np.log(self.predicted[markers] / best.predicted[markers])))


def _describe_cost(terms: Mapping[str, float]) -> str:
    """Return a difference in cost in words: the terms against the costlier hypothesis, then those for it."""
    shown = sorted((each for each in terms.items() if abs(each[1]) >= _REPORTED), key=lambda each: -abs(each[1]))
    against = ", ".join(f"{words} (+{value:.1f})" for words, value in shown if value > 0)
    in_favour = ", ".join(f"{words} ({_MINUS}{-value:.1f})" for words, value in shown if value < 0)
    text = f"costs {sum(terms.values()):.1f} more" + (f": {against}" if against else "")
    return f"{text}; but {in_favour}" if in_favour else text


def _format_count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
