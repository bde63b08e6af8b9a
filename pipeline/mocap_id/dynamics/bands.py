"""Which cut-offs suit a recording: those with which left-out repetitions are predicted best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap_id.dynamics.held_out import HeldOut
from mocap_id.dynamics.measured_motion import CUTOFFS, USUAL

Bands = tuple[float, float, float]
_ROUNDS = 2
_MATTERS = 1e-3  # of the sum of logarithms: less is no reason to leave the usual cut-offs


@dataclass(frozen=True)
class ChosenBands:
    """Cut-offs of x, y and angle, Hz, and why these.

    Parameters
    ----------
    bands : (x, y, angle)
    why : str
    cost : float
        Sum of the logarithms of the rms errors of Fx, Fy and tauz on left-out repetitions; infinite where none could
        be left out.
    """

    bands: Bands
    why: str
    cost: float


def choose_bands(predicted: Callable[[Bands], HeldOut | None]) -> ChosenBands:
    """Coordinate descent from the usual cut-offs, a step up or down the list at a time.

    Parameters
    ----------
    predicted : callable
        From cut-offs to predictions of left-out repetitions.
    """
    cost = {USUAL: held_out_cost(predicted(USUAL))}
    best = USUAL
    if not np.isfinite(cost[best]):
        return ChosenBands(best, "the usual ones: no repetition could be left out to compare others", cost[best])
    for _ in range(_ROUNDS):
        before = best
        for axis in range(3):
            for step in (-1, 1):
                best = _walk(predicted, cost, best, axis, step)
        if best == before:
            break
    return ChosenBands(best, "left-out repetitions are predicted best with these", cost[best])


def _walk(
    predicted: Callable[[Bands], HeldOut | None], cost: dict[Bands, float], best: Bands, axis: int, step: int
) -> Bands:
    """Go on in one direction while it gets better."""
    while 0 <= (k := CUTOFFS.index(best[axis]) + step) < len(CUTOFFS):
        values = list(best)
        values[axis] = CUTOFFS[k]
        tried: Bands = (values[0], values[1], values[2])
        if tried not in cost:
            cost[tried] = held_out_cost(predicted(tried))
        if not cost[tried] < cost[best] - _MATTERS:
            break
        best = tried
    return best


def held_out_cost(held: HeldOut | None) -> float:
    """Sum of the logarithms of the rms errors of Fx, Fy and tauz within the band; infinite without predictions."""
    if held is None:
        return float("inf")
    off = (held.filtered - held.filtered_measured)[held.samples]
    off = off[np.isfinite(off).all(axis=1)]
    return float(np.sum(np.log(np.sqrt(np.mean(off**2, axis=0)) + 1e-9))) if len(off) else float("inf")
