"""Choice of the cut-offs that predict left-out repetitions best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap_id.dynamics.cross_validation import LeftOutPrediction
from mocap_id.dynamics.measured_motion import CUTOFFS, USUAL

Cutoffs = tuple[float, float, float]
_ROUNDS = 2
_LEAST_GAIN = 1e-3  # least decrease of the cost for which the cut-offs are changed


@dataclass(frozen=True)
class ChosenCutoffs:
    """The chosen cut-offs and the reason for the choice."""

    bands: Cutoffs  # cut-offs of x, y and angle, Hz
    why: str  # reason for the choice
    # sum of the logarithms of the rms errors of Fx, Fy and tauz in left-out repetitions; infinite if none was left out
    cost: float


def choose_cutoffs(predict: Callable[[Cutoffs], LeftOutPrediction | None]) -> ChosenCutoffs:
    """Search among :data:`CUTOFFS` for the best cut-offs; ``predict`` returns predictions of left-out repetitions."""
    cost = {USUAL: score_left_out(predict(USUAL))}
    best = USUAL
    if not np.isfinite(cost[best]):
        return ChosenCutoffs(best, "the default: no repetition could be left out to compare other cut-offs", cost[best])
    for _ in range(_ROUNDS):
        before = best
        for axis in range(3):
            for step in (-1, 1):
                best = _walk(predict, cost, best, axis, step)
        if best == before:
            break
    return ChosenCutoffs(best, "left-out repetitions are predicted best with these", cost[best])


def _walk(
    predict: Callable[[Cutoffs], LeftOutPrediction | None],
    cost: dict[Cutoffs, float],
    best: Cutoffs,
    axis: int,
    step: int,
) -> Cutoffs:
    """Change one cut-off in one direction as long as the cost decreases; return the best and add costs to ``cost``."""
    while 0 <= (k := CUTOFFS.index(best[axis]) + step) < len(CUTOFFS):
        values = list(best)
        values[axis] = CUTOFFS[k]
        tried: Cutoffs = (values[0], values[1], values[2])
        if tried not in cost:
            cost[tried] = score_left_out(predict(tried))
        if not cost[tried] < cost[best] - _LEAST_GAIN:
            break
        best = tried
    return best


def score_left_out(prediction: LeftOutPrediction | None) -> float:
    """Return the sum of the logarithms of the rms errors of the filtered Fx, Fy and tauz; infinite if None is given."""
    if prediction is None:
        return float("inf")
    off = (prediction.filtered - prediction.filtered_measured)[prediction.samples]
    off = off[np.isfinite(off).all(axis=1)]
    return float(np.sum(np.log(np.sqrt(np.mean(off**2, axis=0)) + 1e-9))) if len(off) else float("inf")
