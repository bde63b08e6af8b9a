"""Hypotheses of a segmentation: chains of bodies, their costs, and the reasons for rejecting them."""

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
"""Resolution of camera systems, m; smaller residuals do not reduce a cost."""

_REPORTED = 0.05  # smaller differences in cost are not reported
_MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class SegmentationRules:
    """Limits that define a still marker, a joint and a rigid body."""

    still_limit: float = 0.015  # largest scatter of a base marker, m
    min_arc: float = float(np.radians(6.0))  # smallest arc of a joint, rad
    max_residual: float = 0.05  # largest rms distance between the two bodies' points at a joint, m
    max_body_residual: float = 0.015  # largest rms distance of a body's markers from their positions on it, m
    merge_tolerance: float = 3.0  # largest growth of the residual when bodies that hardly rotate are merged
    split_gain: float = 4.0  # least gain in summed log residual for one more segment
    count: int | None = None  # number of segments with the base, if known
    longest: int = 6  # largest number of segments with the base; the rest of a longer chain is left out as a branch

    def is_joint(self, joint: PairJoint) -> bool:
        """Return whether two bodies rotate far enough about a point that is fixed in both."""
        return joint.residual <= self.max_residual and joint.arc >= self.min_arc


@dataclass(frozen=True)
class SegmentationProblem:
    """Input of every hypothesis: markers, base, rules and constraints."""

    points: ComplexArray  # (F, M) trajectories in the plane, m; NaN where missing
    lateral: FloatArray  # (M,) mean out-of-plane coordinate, m
    base: Base  # still markers
    ground: RigidBody  # base as a rigid body
    moving: IntArray  # columns of the moving markers
    rules: SegmentationRules
    constraints: Constraints
    clusters: Clusters  # rigid bodies of the moving markers


@dataclass(frozen=True)
class Hypothesis:
    """One segmentation of the recording: bodies in order from base to tip, and its cost."""

    level: int  # level of detail: number of bodies requested from the clustering
    chain: tuple[RigidBody, ...]  # moving segments
    joints: tuple[PairJoint, ...]  # joint of each segment with the previous one
    left_out: tuple[RigidBody, ...]  # bodies of the level that are not on the chain
    predicted: FloatArray  # (M,) residual predicted through the joint, m; scatter of markers on no moving segment
    cost: float  # summed log of ``predicted`` + ``split_gain`` for each segment + ``cut``; lower is better
    best_of_level: bool  # whether this is the best chain of its level; only these can be chosen
    cut: float  # increase of the cost when the best chain of the level was shortened to the allowed length

    @property
    def markers(self) -> IntArray:
        """Columns of the markers on the moving segments, sorted."""
        return np.sort(np.concatenate([body.markers for body in self.chain]))

    def explain_cost(self, best: Hypothesis) -> str:
        """Return in words why the best hypothesis was chosen instead; ``chosen`` for the best one itself.

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
            f"includes {_format_count(len(extra), 'marker')} more": self._compare_residuals(best, extra),
            f"fits {'the other' if len(out) + len(extra) else 'the'} markers {'worse' if fit > 0 else 'better'}": fit,
            "a longer chain was better, and was shortened afterwards": self.cut,
        }
        more = len(self.chain) - len(best.chain)
        price = self.cost - best.cost - sum(terms.values())  # split_gain times the difference in the number of segments
        return _describe_cost(
            {f"has {_format_count(abs(more), 'segment')} {'more' if more > 0 else 'fewer'}": price, **terms}
        )

    def _compare_residuals(self, best: Hypothesis, markers: IntArray) -> float:
        """Return the summed log residual of some markers, minus the same sum in the best hypothesis."""
        return float(np.sum(np.log(self.predicted[markers] / best.predicted[markers])))


def _describe_cost(terms: Mapping[str, float]) -> str:
    """Return a difference in cost in words: first the terms that raise it, then the terms that reduce it."""
    reported = sorted((each for each in terms.items() if abs(each[1]) >= _REPORTED), key=lambda each: -abs(each[1]))
    against = ", ".join(f"{words} (+{value:.1f})" for words, value in reported if value > 0)
    in_favour = ", ".join(f"{words} ({_MINUS}{-value:.1f})" for words, value in reported if value < 0)
    text = f"costs {sum(terms.values()):.1f} more" + (f": {against}" if against else "")
    return f"{text}; but {in_favour}" if in_favour else text


def _format_count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
