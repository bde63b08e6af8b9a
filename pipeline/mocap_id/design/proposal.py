"""Proposed movements and the objectives that they are compared by."""

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
    "intervals": "root mean square of the standard deviations by the parameters' sizes (A-optimal)",
    "volume": "geometric mean of the axes of their joint interval, by the parameters' sizes (D-optimal)",
    "condition": "condition number of the regressor in SI units",
    "condition-scaled": "condition number of the regressor with unit columns",
}

_QUICK_SAMPLES, _QUICK_RATE = 50, 20.0  # samples, and samples per second, while many movements are compared


@dataclass(frozen=True)
class Proposal:
    """A movement that could be recorded.

    Parameters
    ----------
    words : str
        Instructions.
    trajectory : Trajectory
    predicted : PredictedUncertainty
        Uncertainty of the parameters after this movement.
    value : float
        Value of the objective; smaller is better.
    designed : bool
        Found by the search; otherwise a simple change.
    own : bool
        The trial's own movement, faster or larger.
    standalone : bool
        A new movement that does not contain any part of the recorded one.
    """

    words: str
    trajectory: Trajectory
    predicted: PredictedUncertainty
    value: float
    designed: bool = False
    own: bool = False
    standalone: bool = False


def objective_value(objective: Objective, predicted: PredictedUncertainty, size: FloatArray) -> float:
    """Return the objective to minimise, without the variance that no movement changes: errors of plate and cameras.

    Parameters
    ----------
    objective : {"intervals", "volume", "condition", "condition-scaled"}
        See :data:`OBJECTIVES`.
    predicted : PredictedUncertainty
    size : (b,) array
        Size of each parameter, SI.
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
    if sign <= 0:  # the determinant of a nearly singular covariance is rounding
        return np.inf
    return float(np.exp(logarithm / (2 * len(size))))


@dataclass(frozen=True)
class MovementScorer:
    """Computes whether a movement is allowed, and the value of its objective.

    Parameters
    ----------
    predictor : CovariancePredictor
    limits : MovementLimits
    objective : {"intervals", "volume", "condition", "condition-scaled"}
    size : (b,) array
        Size of each parameter, SI.
    """

    predictor: CovariancePredictor
    limits: MovementLimits
    objective: Objective
    size: FloatArray

    @property
    def comparison_rate(self) -> float:
        """Samples per second while many movements are compared: the trial's own rate divided by a whole number."""
        rate = self.predictor.own.rate
        return rate / max(1, int(rate / _QUICK_RATE))

    def usage(self, movement: Trajectory) -> float:
        """Return the largest fraction of any limit that the movement uses; above 1 it is not allowed."""
        body = self.predictor.body
        sd = None if self.limits.support is None else body.moment_sd(movement)
        return self.limits.usage(movement, body.wrench(movement), sd)

    def quick_value(self, movement: Trajectory, seconds: float | None = None) -> float:
        """Return the objective from few samples; ``seconds`` as for :meth:`CovariancePredictor.predict`."""
        if self.objective == "condition":
            return self.predictor.conditions(movement)[0]
        if self.objective == "condition-scaled":
            return self.predictor.conditions(movement)[1]
        predicted = self.predictor.predict(movement, seconds, samples=_QUICK_SAMPLES, exactly=False)
        return objective_value(self.objective, predicted, self.size)

    def propose(self, words: str, movement: Trajectory, seconds: float | None = None) -> Proposal:
        """Return the movement as a proposal; ``seconds`` as for :meth:`CovariancePredictor.predict`."""
        predicted = self.predictor.predict(movement, seconds)
        return Proposal(words, movement, predicted, objective_value(self.objective, predicted, self.size))
