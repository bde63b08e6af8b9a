"""Limits of a movement, proposed movements, their objectives, and recommended changes of the recorded one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.design.predicted_covariance import (
    SAMPLES,
    CovariancePredictor,
    IdentifiedBody,
    PredictedUncertainty,
    Trajectory,
    concatenate,
    get_recorded_trajectory,
)
from mocap_id.dynamics.cautions import Excitation
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.geometry import planar

_TINY = 1e-9
_FASTER = 1.5  # allowed speed, relative to the largest observed speed
_UPRIGHT = 0.9  # quantile of the highest joint's height above which the body is upright
_INSIDE = 0.01  # m: least distance of the resting posture's centre of pressure from the edge of the support


@dataclass(frozen=True)
class MovementLimits:
    """Bounds of a movement."""

    low: FloatArray  # (n,) lowest joint angles, rad
    high: FloatArray  # (n,) highest joint angles, rad
    speed: FloatArray  # (n,) largest speed of each joint, rad/s
    acceleration: FloatArray  # (n,) largest acceleration of each joint, rad/s²
    support: tuple[float, float] | None  # range of the centre of pressure, m; None for a base that is bolted down

    def clip(self, posture: FloatArray) -> FloatArray:
        """Return the allowed posture (n,) that is nearest to the given one, rad."""
        room = np.minimum(_TINY, (self.high - self.low) / 2)
        return np.asarray(np.clip(posture, self.low + room, self.high - room))

    def usage(self, movement: Trajectory, wrench: FloatArray, moment_sd: FloatArray | None = None) -> float:
        """Return the largest fraction of any limit that a movement uses; above 1 the movement is not allowed.

        If ``movement.fitted`` is given, only these samples count. ``wrench`` (T, 3) is the wrench of the ground, N and
        N·m. ``moment_sd`` (T,) is the standard deviation of its moment, N·m, by which the centre of pressure is
        uncertain. The result is infinite if the body leaves the ground, if there is no sample to check, or, without
        ``movement.fitted``, if any sample is missing.
        """
        counted = movement.known if movement.fitted is None else movement.fitted & movement.known
        if not counted.any() or (movement.fitted is None and not counted.all()):
            return np.inf
        middle, half = (self.low + self.high) / 2, np.maximum((self.high - self.low) / 2, _TINY)
        parts = [
            np.abs(movement.q[counted] - middle) / half,
            np.abs(movement.dq[counted]) / self.speed,
            np.abs(movement.ddq[counted]) / self.acceleration,
        ]
        worst = max(float(np.max(part)) for part in parts)
        if self.support is None:
            return worst
        sd = np.zeros(len(wrench)) if moment_sd is None else moment_sd
        force, moment, sd = wrench[counted, 1], wrench[counted, 2], sd[counted]
        if np.any(force <= 0.0):
            return np.inf
        low, high = self.support
        off = np.abs(moment / force - (low + high) / 2) + sd / force
        return max(worst, float(np.max(off)) / max((high - low) / 2, _TINY))


def derive_limits(
    movement: Trajectory,
    wrench: FloatArray,
    rest: FloatArray,
    *,
    widened: float,
    speed: tuple[float, float],
    acceleration: tuple[float, float],
    slack: float | None,
    at_rest: float,
) -> MovementLimits:
    """Return limits that are derived from a recorded movement.

    Parameters
    ----------
    movement : Trajectory
        The trial's movement, with its fitted samples.
    wrench : (T, 3) array
        Wrench of the ground, N and N·m.
    rest : (n,) array
        Posture that is always allowed, rad.
    widened : float
        Angle by which every joint may exceed its observed range at both ends, rad.
    speed, acceleration : (float, float)
        Lower and upper bound of the limits, rad/s and rad/s². Between these bounds, the limit is 1.5 (speed) or 2.25
        (acceleration) times the largest observed value. Observed values are always allowed.
    slack : float or None
        Distance by which the centre of pressure may exceed its observed range, m; None for a base that is bolted down.
    at_rest : float
        Centre of pressure in the resting posture, m.
    """
    known = movement.known
    loaded = (known if movement.fitted is None else known & movement.fitted) & (wrench[:, 1] > 0.0)
    pressure = wrench[loaded, 2] / wrench[loaded, 1]
    support = None
    if slack is not None:
        support = (
            float(min(pressure.min() - slack, at_rest - _INSIDE)),
            float(max(pressure.max() + slack, at_rest + _INSIDE)),
        )
    fastest, hardest = (np.abs(values[known]).max(axis=0) for values in (movement.dq, movement.ddq))
    return MovementLimits(
        low=np.minimum(movement.q[known].min(axis=0) - widened, rest),
        high=np.maximum(movement.q[known].max(axis=0) + widened, rest),
        speed=np.maximum(fastest, np.clip(_FASTER * fastest, *speed)),
        acceleration=np.maximum(hardest, np.clip(_FASTER**2 * hardest, *acceleration)),
        support=support,
    )


def find_resting_posture(movement: Trajectory, centres: FloatArray, upright: bool) -> FloatArray:
    """Return the posture (n,) in which a movement starts, rad: the median of the trial's fitted samples.

    With ``upright``, it is the median of only the tenth of these samples in which the highest joint is highest.
    """
    q = movement.q[movement.known if movement.fitted is None else movement.known & movement.fitted]
    if upright:
        height = planar.segment_poses(q, centres)[1][:, -1, 1]
        q = q[height >= np.quantile(height, _UPRIGHT)]
    return np.asarray(np.median(q, axis=0))


Objective: TypeAlias = Literal["intervals", "volume", "condition", "condition-scaled"]
OBJECTIVES: dict[Objective, str] = {
    "intervals": "root mean square of the standard deviations, each divided by the parameter's size (A-optimal)",
    "volume": "geometric mean of the axes of the confidence ellipsoid of these quotients (D-optimal)",
    "condition": "condition number of the regressor in SI units",
    "condition-scaled": "condition number of the regressor with unit columns",
}


@dataclass(frozen=True)
class Proposal:
    """A movement that could be recorded."""

    words: str  # instructions for the person or the robot
    trajectory: Trajectory  # the movement
    predicted: PredictedUncertainty  # uncertainty of the parameters after this movement
    value: float  # value of the objective; smaller is better
    designed: bool = False  # whether the search found it; otherwise it is a simple change
    own: bool = False  # whether it is the trial's own movement, faster or larger
    standalone: bool = False  # whether it contains no part of the recorded movement


def compute_objective(objective: Objective, predicted: PredictedUncertainty, size: FloatArray) -> float:
    """Return the value of the objective; a smaller value is better.

    ``size`` (b,) is the size of each parameter, SI. The variance from errors of plate and cameras is not included,
    because no movement changes it. The value is infinite if the movement does not determine the parameters.
    """
    if objective == "condition":
        return predicted.condition
    if objective == "condition-scaled":
        return predicted.condition_scaled
    if not np.isfinite(predicted.covariance).all():
        return np.inf
    changing = predicted.covariance - np.diag(predicted.fixed)
    if objective == "intervals":
        return float(np.sqrt(np.mean(np.diag(changing) / size**2)))
    sign, logarithm = np.linalg.slogdet(changing / np.outer(size, size))
    if sign <= 0:  # rounding: the covariance is nearly singular
        return np.inf
    return float(np.exp(logarithm / (2 * len(size))))


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

    def predict_ratios(movement: Trajectory, samples: int) -> FloatArray:
        """Return the predicted standard deviations (b,) divided by the present ones, for the same duration."""
        after = np.diag(predictor.covariance(movement, predictor.now.samples, samples))
        return np.asarray(np.sqrt(after) / np.maximum(predictor.now.sd, 1e-300))

    best: list[Recommendation | None] = [None] * len(result.base)
    for change, joint in list_changes(len(prepared.recorded.centres)):
        movement = change_movement(predictor.own, change, joint)
        if np.min(predict_ratios(movement, _QUICK_SAMPLES)[wanted]) > _QUICK_ERROR * _HELPS:
            continue
        ratios = predict_ratios(movement, SAMPLES)
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
    sentences = []
    for group in best.values():
        words = group[0][1].describe(joints)
        falls = ", ".join(
            f"{excited.names[i]} to {100 * each.ratio * excited.relative_sd[i]:.0f} %" for i, each in group
        )
        sentences.append(f"{words[0].upper()}{words[1:]} would reduce the standard deviation of {falls}.")
    if beyond:
        sentences.append(
            f"No faster or larger movement of these joints would determine {', '.join(beyond)} better, because the "
            "error of the plate's zero, of the joint centres or of the skin remains."
        )
    return " ".join(sentences)


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
