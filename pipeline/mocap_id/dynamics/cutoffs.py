"""Choice of the cut-offs with which left-out repetitions are predicted best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap_id.dynamics.cross_validation import LeftOutPrediction
from mocap_id.dynamics.measured_motion import CUTOFFS, USUAL

Cutoffs = tuple[float, float, float]
_ROUNDS = 2
_MATTERS = 1e-3  # least decrease of the cost for which the cut-offs are changed


@dataclass(frozen=True)
class ChosenCutoffs:
    """The chosen cut-offs of x, y and angle, Hz, and the reason.

    Parameters
    ----------
    bands : (x, y, angle)
    why : str
    cost : float
        Sum of the logarithms of the rms errors of Fx, Fy and tauz on left-out repetitions; infinite if none could be
        left out.
    """

    bands: Cutoffs
    why: str
    cost: float


def choose_cutoffs(predicted: Callable[[Cutoffs], LeftOutPrediction | None]) -> ChosenCutoffs:
    """Choose the cut-offs by coordinate descent from the default ones, in steps along the list.

    Parameters
    ----------
    predicted : callable
        From cut-offs to predictions of left-out repetitions.
    """
    cost = {USUAL: left_out_cost(predicted(USUAL))}
    best = USUAL
    if not np.isfinite(cost[best]):
        return ChosenCutoffs(best, "the usual ones: no repetition could be left out to compare others", cost[best])
    for _ in range(_ROUNDS):
        before = best
        for axis in range(3):
            for step in (-1, 1):
                best = _walk(predicted, cost, best, axis, step)
        if best == before:
            break
    return ChosenCutoffs(best, "left-out repetitions are predicted best with these", cost[best])


def _walk(
    predicted: Callable[[Cutoffs], LeftOutPrediction | None],
    cost: dict[Cutoffs, float],
    best: Cutoffs,
    axis: int,
    step: int,
) -> Cutoffs:
    """Return the best cut-offs after steps in one direction, taken as long as the cost decreases."""
    while 0 <= (k := CUTOFFS.index(best[axis]) + step) < len(CUTOFFS):
        values = list(best)
        values[axis] = CUTOFFS[k]
        tried: Cutoffs = (values[0], values[1], values[2])
        if tried not in cost:
            cost[tried] = left_out_cost(predicted(tried))
        if not cost[tried] < cost[best] - _MATTERS:
            break
        best = tried
    return best


def left_out_cost(held: LeftOutPrediction | None) -> float:
    """Return the sum of the logarithms of the filtered rms errors of Fx, Fy and tauz; infinite without predictions."""
    if held is None:
        return float("inf")
    off = (held.filtered - held.filtered_measured)[held.samples]
    off = off[np.isfinite(off).all(axis=1)]
    return float(np.sum(np.log(np.sqrt(np.mean(off**2, axis=0)) + 1e-9))) if len(off) else float("inf")
