"""A movement that is proposed, what it is worth, and by what that is told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.course import Course
from mocap_id.dynamics.foresight import Foreseen, Foresight
from mocap_id.dynamics.limits import Limits

Objective: TypeAlias = Literal["intervals", "volume", "condition", "condition-scaled"]
OBJECTIVES: dict[Objective, str] = {
    "intervals": "root mean square of the standard deviations by the parameters' sizes (A-optimal)",
    "volume": "geometric mean of the axes of their joint interval, by the parameters' sizes (D-optimal)",
    "condition": "condition number of the regressor in SI units",
    "condition-scaled": "condition number of the regressor with unit columns",
}

_QUICK = 50  # samples of a movement while many are compared
_LOOKED = 20.0  # Hz, likewise


@dataclass(frozen=True)
class Proposal:
    """A movement that could be recorded.

    Parameters
    ----------
    words : str
        What to do.
    course : Course
        The movement.
    foreseen : Foreseen
    value : float
        Of the objective: smaller is better.
    designed : bool
        Found by the search, and no simple change.
    own : bool
        The trial's own movement, faster or larger.
    made : bool
        A whole movement of its own, without anything that was recorded.
    """

    words: str
    course: Course
    foreseen: Foreseen
    value: float
    designed: bool = False
    own: bool = False
    made: bool = False


def objective_value(objective: Objective, foreseen: Foreseen, size: FloatArray) -> float:
    """What is to be made small; the plate's zero, which no movement changes, does not count.

    Parameters
    ----------
    objective : {"intervals", "volume", "condition", "condition-scaled"}
        See :data:`OBJECTIVES`.
    foreseen : Foreseen
    size : (b,) array
        Of each parameter, SI.
    """
    if objective == "condition":
        return foreseen.condition
    if objective == "condition-scaled":
        return foreseen.condition_scaled
    if not np.isfinite(foreseen.covariance).all():
        return np.inf
    changing = foreseen.covariance - np.diag(foreseen.fixed)
    if objective == "intervals":
        return float(np.sqrt(np.mean(np.diag(changing) / size**2)))
    sign, logarithm = np.linalg.slogdet(changing / np.outer(size, size))
    if sign <= 0:  # no volume: rounding has the last word on what is hardly known
        return np.inf
    return float(np.exp(logarithm / (2 * len(size))))


@dataclass(frozen=True)
class Judge:
    """Whether a movement is allowed, and how good it is.

    Parameters
    ----------
    sight : Foresight
    limits : Limits
    objective : {"intervals", "volume", "condition", "condition-scaled"}
    size : (b,) array
        Of each parameter, SI.
    """

    sight: Foresight
    limits: Limits
    objective: Objective
    size: FloatArray

    @property
    def looked(self) -> float:
        """Samples a second while many movements are compared: the trial's own rate by a whole number."""
        rate = self.sight.own.rate
        return rate / max(1, int(rate / _LOOKED))

    def strain(self, course: Course) -> float:
        """How much of what is allowed it takes; more than 1 is too much."""
        body = self.sight.body
        sd = None if self.limits.support is None else body.moment_sd(course)
        return self.limits.strain(course, body.wrench(course), sd)

    def quickly(self, course: Course, seconds: float | None = None) -> float:
        """The objective, from few samples; ``seconds`` as for :meth:`Foresight.foresee`."""
        if self.objective == "condition":
            return self.sight.conditions(course)[0]
        if self.objective == "condition-scaled":
            return self.sight.conditions(course)[1]
        foreseen = self.sight.foresee(course, seconds, samples=_QUICK, exactly=False)
        return objective_value(self.objective, foreseen, self.size)

    def proposal(self, words: str, course: Course, seconds: float | None = None) -> Proposal:
        """The movement with all that is foreseen of it; ``seconds`` as for :meth:`Foresight.foresee`."""
        foreseen = self.sight.foresee(course, seconds)
        return Proposal(words, course, foreseen, objective_value(self.objective, foreseen, self.size))
