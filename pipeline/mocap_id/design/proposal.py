"""Proposed movements and the objectives that compare them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.design.movement_limits import MovementLimits
from mocap_id.design.predicted_covariance import CovariancePredictor, PredictedUncertainty
from mocap_id.design.trajectory import Trajectory

Objective: TypeAlias = Literal["intervals", "volume", "condition", "condition-scaled"]
OBJECTIVES: dict[Objective, str] = {
    "intervals": "root mean square of the standard deviations, each divided by the parameter's size (A-optimal)",
    "volume": "geometric mean of the axes of the confidence ellipsoid of these quotients (D-optimal)",
    "condition": "condition number of the regressor in SI units",
    "condition-scaled": "condition number of the regressor with unit columns",
}

_QUICK_SAMPLES, _QUICK_RATE = 50, 20.0  # samples, and samples per second, while many movements are compared


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


@dataclass(frozen=True)
class MovementScorer:
    """Evaluation of movements: whether the limits allow them, and the value of the objective."""

    predictor: CovariancePredictor  # predictor of the trial
    limits: MovementLimits  # limits of the movements
    objective: Objective  # name of the objective, see `OBJECTIVES`
    size: FloatArray  # (b,) size of each parameter, SI

    @property
    def comparison_rate(self) -> float:
        """Rate at which many movements are compared: the trial's own rate divided by a whole number."""
        rate = self.predictor.own.rate
        return rate / max(1, int(rate / _QUICK_RATE))

    def usage(self, movement: Trajectory) -> float:
        """Return the largest fraction of any limit that the movement uses; above 1 the movement is not allowed."""
        body = self.predictor.body
        sd = None if self.limits.support is None else body.moment_sd(movement)
        return self.limits.usage(movement, body.wrench(movement), sd)

    def quick_value(self, movement: Trajectory, seconds: float | None = None) -> float:
        """Return the objective, computed from few samples; ``seconds`` as for :meth:`CovariancePredictor.predict`."""
        if self.objective.startswith("condition"):
            return self.predictor.conditions(movement)[self.objective == "condition-scaled"]
        predicted = self.predictor.predict(movement, seconds, samples=_QUICK_SAMPLES, exactly=False)
        return compute_objective(self.objective, predicted, self.size)

    def propose(self, words: str, movement: Trajectory, seconds: float | None = None) -> Proposal:
        """Return the movement as a proposal; ``seconds`` as for :meth:`CovariancePredictor.predict`."""
        predicted = self.predictor.predict(movement, seconds)
        return Proposal(words, movement, predicted, compute_objective(self.objective, predicted, self.size))
