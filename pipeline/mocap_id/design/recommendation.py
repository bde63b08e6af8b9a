"""Recommended changes of the recorded movement: the change that reduces the standard deviation of a parameter most.

The standard deviation after a change is predicted from the same chain and the parameters identified so far
(:mod:`mocap_id.design.predicted_covariance`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.design.predicted_covariance import SAMPLES, CovariancePredictor, IdentifiedBody
from mocap_id.design.trajectory import Trajectory, concatenate, get_recorded_trajectory
from mocap_id.dynamics.excitation import Excitation
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.preparation import PreparedTrial

Change: TypeAlias = Literal["faster", "larger", "alone"]

FACTOR = 1.5
"""Factor by which a movement is made faster or larger."""
_HELPS = 0.8  # largest ratio of standard deviations: a smaller reduction is within the error of the prediction
_QUICK_SAMPLES, _QUICK_ERROR = 40, 1.1  # samples of a first estimate, and factor by which this estimate may be wrong
_RATE = 40.0  # Hz: rate of the samples; movements are below 3 Hz


@dataclass(frozen=True)
class Recommendation:
    """A change of the movement that would reduce a parameter's standard deviation."""

    # faster: 1.5 times as fast; larger: 1.5 times the range; alone: half of the time with the other joints at rest
    change: Change
    joint: int | None  # index of the joint whose movement changes, from 0; None for all joints
    ratio: float  # predicted standard deviation for a recording of the same duration, divided by the present one

    def describe(self, joints: Sequence[str]) -> str:
        """Return the change in words, with the names of the joints."""
        moved = "the whole movement" if self.joint is None else f"the {joints[self.joint]}'s movement"
        if self.change == "alone":
            return f"{moved} by itself for half of the time (the other joints at rest)"
        step = ", independently of the other joints," if self.change == "faster" and self.joint is not None else ""
        return f"{moved} {FACTOR:g} times {self.change}{step}"


Recommendations: TypeAlias = tuple[Recommendation | None, ...]
"""For each base parameter the best change; None if no change reduces its standard deviation by a fifth."""


def recommend_if_doubtful(prepared: PreparedTrial, result: Identification, excited: Excitation) -> Recommendations:
    """Return recommendations for the doubtful parameters; if no parameter is doubtful, return () without a search."""
    if not excited.doubtful:
        return ()
    return recommend_changes(prepared, result, np.array(excited.verdict) != "known")


def recommend_changes(
    prepared: PreparedTrial, result: Identification, wanted: BoolArray | None = None
) -> Recommendations:
    """Return for each parameter the change that reduces its standard deviation most; None if none helps enough.

    A change must reduce the standard deviation by a fifth. ``wanted`` (b,) marks the parameters to search for, by
    default all parameters; the result for the others is None.
    """
    wanted = np.ones(len(result.base), dtype=np.bool_) if wanted is None else wanted
    own = get_recorded_trajectory(prepared.recorded, result.fit.in_fit).thin(_RATE)
    predictor = CovariancePredictor(IdentifiedBody(prepared, result), own)
    best: list[Recommendation | None] = [None] * len(result.base)
    for change, joint in list_changes(len(prepared.recorded.centres)):
        movement = change_movement(predictor.own, change, joint)
        if np.min(_predict_ratios(predictor, movement, _QUICK_SAMPLES)[wanted]) > _QUICK_ERROR * _HELPS:
            continue
        ratios = _predict_ratios(predictor, movement, SAMPLES)
        for i in np.flatnonzero(wanted):
            present = best[i]
            if ratios[i] < (_HELPS if present is None else present.ratio):
                best[i] = Recommendation(change, joint, float(ratios[i]))
    return tuple(best)


def describe_recommendations(excited: Excitation, recommendations: Recommendations, joints: Sequence[str]) -> str:
    """Return the recommended movements for the doubtful parameters, one sentence for each movement."""
    best: dict[tuple[str, int | None], list[tuple[int, Recommendation]]] = {}
    beyond = []
    for i in excited.doubtful:
        each = recommendations[i]
        if each is None:
            beyond.append(excited.names[i])
        else:
            best.setdefault((each.change, each.joint), []).append((i, each))
    sentences = [
        f"{_capitalise(group[0][1].describe(joints))} would reduce the standard deviation of "
        + ", ".join(f"{excited.names[i]} to {100 * each.ratio * excited.relative_sd[i]:.0f} %" for i, each in group)
        + "."
        for group in best.values()
    ]
    if beyond:
        sentences.append(
            f"No faster or larger movement of these joints would determine {', '.join(beyond)} better, because the "
            "error of the plate's zero, of the joint centres or of the skin remains."
        )
    return " ".join(sentences)


def _capitalise(text: str) -> str:
    return text[0].upper() + text[1:]


def _predict_ratios(predictor: CovariancePredictor, movement: Trajectory, samples: int) -> FloatArray:
    """Return the predicted standard deviations (b,) divided by the present ones, for the same duration."""
    after = np.diag(predictor.covariance(movement, predictor.now.samples, samples))
    return np.asarray(np.sqrt(after) / np.maximum(predictor.now.sd, 1e-300))


def list_changes(joints: int) -> list[tuple[Change, int | None]]:
    """Return the changes to try, each with the index of its joint or None for all joints together."""
    each: list[tuple[Change, int | None]] = [("faster", None), ("larger", None)]
    if joints > 1:
        each += [(change, joint) for joint in range(joints) for change in ("faster", "larger", "alone")]
    return each


def change_movement(own: Trajectory, change: Change, joint: int | None) -> Trajectory:
    """Return the trajectory in which one joint, or all joints (``joint=None``), move faster, further or alone.

    For "alone", every second sample of the recording is replaced by a sample in which only this joint moves.
    """
    joints = own.q.shape[1]
    ones, chosen = np.ones(joints), np.arange(joints) == joint if joint is not None else np.ones(joints, bool)
    if change == "alone":
        assert own.fitted is not None
        half = np.arange(len(own.time)) % 2 == 0
        alone = own.scale(ones, np.where(chosen, 1.0, 0.0))
        return concatenate(replace(own, fitted=own.fitted & half), replace(alone, fitted=own.fitted & ~half))
    more = np.where(chosen, FACTOR, 1.0)
    return own.scale(more, ones) if change == "faster" else own.scale(ones, more)
