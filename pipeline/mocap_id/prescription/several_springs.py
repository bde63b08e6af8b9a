"""Springs that maximise the functional workspace of several joints (eq. 7.6, 7.10, 7.11).

The workspace is measured in cells of the plane: a cell counts if a sampled posture in it can be held with torques
within the person's limits. The search is a best-first branch and bound over boxes of stiffnesses and rest angles. For a
box, the torques of each posture are within intervals (products of intervals are exact at their corners), which gives an
upper bound of the cells for all springs of the box. The middle of a box gives a lower bound; if it is the best so far,
a pattern search improves it. The search ends if no box can improve the result by more than the tolerance, or after a
number of boxes. The gap is an upper bound of the possible improvement, for these postures.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.prescription.postures import Postures, SpringPlace, count_cells

BOXES = 20_000
"""Number of boxes after which the search ends."""
PENALTY = 1e-4
"""δ: fraction of the cells that justifies the largest allowed stiffness."""
_TOLERANCE = 0.005  # of the cells
_HELPS = 0.01  # of the cells: a smaller gain is no help
_SLACK = 1e-3  # of the largest allowed stiffness: a softer spring counts as none


@dataclass(frozen=True)
class Springs:
    """The best springs found.

    Parameters
    ----------
    stiffness, rest : (S,) arrays
        N·m/rad, rad; the rest angle of an unused spring is NaN.
    area, without, reachable : float
        Area of the functional workspace with the springs and without them, and of all that the joint limits allow, m².
    gap : float
        Upper bound of the gain in area by any other springs, m².
    boxes : int
        Number of boxes evaluated.
    helps : bool
        Whether the springs give a relevant gain.
    """

    stiffness: FloatArray
    rest: FloatArray
    area: float
    without: float
    reachable: float
    gap: float
    boxes: int
    helps: bool


class _Search:
    """Counts and bounds for springs (S, 2), each given by stiffness and rest angle."""

    def __init__(self, postures: Postures, places: Sequence[SpringPlace], torque: FloatArray, penalty: float) -> None:
        joints = postures.gravity.shape[1]
        self.postures, self.torque, self.penalty = postures, torque, penalty
        across = [[j in place.joints for j in range(joints)] for place in places]
        self.across: BoolArray = np.array(across, dtype=np.bool_).reshape(-1, joints)
        self.low = np.array([[0.0, place.rest[0]] for place in places]).reshape(-1, 2)
        self.high = np.array([[place.stiffest, place.rest[1]] for place in places]).reshape(-1, 2)
        self.boxes = 0

    def cells(self, low: FloatArray, high: FloatArray) -> int:
        """Return an upper bound of the cells for springs between two corners; -1 if a required point is not held."""
        p = self.postures
        return count_cells(p.gravity, p.stretch, p.cell, p.cells, p.required, self.across, self.torque, low, high)

    def price(self, springs: FloatArray) -> float:
        """Return the penalty of the stiffnesses, in cells."""
        return float(self.penalty * self.postures.cells * np.sum(springs[:, 0] / self.high[:, 0]))

    def worth(self, springs: FloatArray) -> float:
        """Return the objective of springs, cells minus penalty; -inf if a required point is not held."""
        count = self.cells(springs, springs)
        return -np.inf if count < 0 else count - self.price(springs)

    def promise(self, low: FloatArray, high: FloatArray) -> float:
        """Return an upper bound of the objective of all springs in a box."""
        self.boxes += 1
        count = self.cells(low, high)
        return -np.inf if count < 0 else count - self.price(low)

    def halves(self, low: FloatArray, high: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return the two halves of a box, cut across the side that contributes most to the torques' uncertainty."""
        width = high - low
        far = np.maximum(
            np.abs(self.postures.stretch.max(axis=0) - low[:, 1]),
            np.abs(self.postures.stretch.min(axis=0) - high[:, 1]),
        )
        doubt = np.stack([width[:, 0] * far, width[:, 1] * high[:, 0]], axis=1)
        side = np.unravel_index(int(doubt.argmax()), doubt.shape)
        middle = 0.5 * (low[side] + high[side])
        below, above = high.copy(), low.copy()
        below[side], above[side] = middle, middle
        return [(low, below), (above, high)]

    def improved(self, springs: FloatArray) -> FloatArray:
        """Improve springs by a pattern search, with steps along every side that are halved if none is better."""
        best, worth = springs.copy(), self.worth(springs)
        step = 0.1 * (self.high - self.low)
        for _ in range(12):
            before = worth
            for side in np.ndindex(best.shape):
                for sign in (1.0, -1.0):
                    trial = best.copy()
                    trial[side] = np.clip(trial[side] + sign * step[side], self.low[side], self.high[side])
                    other = self.worth(trial)
                    if other > worth:
                        best, worth = trial, other
            if worth == before:
                step = 0.5 * step
        return best


def prescribe_several(
    postures: Postures,
    places: Sequence[SpringPlace],
    torque: FloatArray,
    penalty: float = PENALTY,
    boxes: int = BOXES,
) -> Springs:
    """Find the best springs for several joints.

    Parameters
    ----------
    postures : Postures
    places : sequence of SpringPlace
        The possible springs; if there are none, the result describes the unassisted workspace.
    torque : (n, 2) array
        The person's limits, N·m.
    penalty : float
        δ.
    boxes : int
        Number of boxes after which the search ends.

    Raises
    ------
    ValueError
        No springs were found that hold every required point.
    """
    search = _Search(postures, places, torque, penalty)
    nothing = np.stack([np.zeros(len(places)), 0.5 * (search.low + search.high)[:, 1]], axis=1)
    none = search.worth(nothing)
    free = _free_cells(search, nothing)
    best, worth, bound = _branch(search, nothing, none, boxes) if places else (nothing, none, none)
    if worth == -np.inf:
        why = "were found that hold" if bound > -np.inf else "can hold"
        raise ValueError(f"no springs {why} every required point")
    size, cells = postures.size, postures.cells
    helps = worth > max(none, 0.0) + _HELPS * cells or none == -np.inf
    chosen = _without_slack_ones(search, best) if helps else nothing
    stiffness = chosen[:, 0]
    return Springs(
        stiffness=stiffness,
        rest=np.where(stiffness > 0, chosen[:, 1], np.nan),
        area=size * search.cells(chosen, chosen),
        without=size * free,
        reachable=size * cells,
        gap=size * max(bound - (worth if helps else none), 0.0),
        boxes=search.boxes,
        helps=bool(helps),
    )


def _without_slack_ones(search: _Search, springs: FloatArray) -> FloatArray:
    """Return the springs (S, 2) without very soft ones, unless fewer cells are held without them."""
    fewer = springs.copy()
    fewer[springs[:, 0] <= _SLACK * search.high[:, 0], 0] = 0.0
    return fewer if search.cells(fewer, fewer) >= search.cells(springs, springs) else springs


def _free_cells(search: _Search, nothing: FloatArray) -> int:
    """Return the cells held without springs, even if required points are not."""
    p = search.postures
    return count_cells(
        p.gravity, p.stretch, p.cell, p.cells + p.required, 0, search.across, search.torque, nothing, nothing
    )


def _branch(search: _Search, start: FloatArray, worth: float, boxes: int) -> tuple[FloatArray, float, float]:
    """Return the best springs, their objective, and an upper bound of the objective of all springs."""
    best, ticket = start, 0
    queue = [(-search.promise(search.low, search.high), ticket, search.low, search.high)]
    slack = _TOLERANCE * search.postures.cells
    while queue and search.boxes < boxes:
        if -queue[0][0] <= worth + slack:
            break
        _, _, low, high = heapq.heappop(queue)
        for one, other in search.halves(low, high):
            promise = search.promise(one, other)
            middle = 0.5 * (one + other)
            here = search.worth(middle)
            if here > worth:
                best = search.improved(middle)
                worth = search.worth(best)
            if promise > worth + slack:
                ticket += 1
                heapq.heappush(queue, (-promise, ticket, one, other))
    best = search.improved(best) if worth > -np.inf else best
    worth = search.worth(best) if worth > -np.inf else worth
    bound = max(worth + (slack if search.boxes > 1 else 0.0), -queue[0][0] if queue else -np.inf)
    return best, worth, bound


def holdable_postures(
    postures: Postures, places: Sequence[SpringPlace], torque: FloatArray, springs: Springs
) -> BoolArray:
    """Return whether each posture (N,) can be held with the springs."""
    needed = postures.gravity.copy()
    for s, place in enumerate(places):
        if springs.stiffness[s] > 0:
            pull = springs.stiffness[s] * (postures.stretch[:, s] - springs.rest[s])
            needed[:, list(place.joints)] += pull[:, None]
    return np.asarray(np.all((needed >= torque[:, 0]) & (needed <= torque[:, 1]), axis=1))
