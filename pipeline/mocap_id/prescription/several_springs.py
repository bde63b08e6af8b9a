"""Springs that maximise the functional workspace of several joints (eq. 7.6, 7.10, 7.11).

The workspace is measured in cells of the plane: a cell counts if a sampled posture in it can be held with torques
within the person's limits. The search is a best-first branch and bound over boxes of stiffnesses and rest angles. For a
box, the torques of each posture are within intervals, which are exact at the corners of the box. They give an upper
bound of the cells for all springs of the box. The middle of a box gives a lower bound; if it is the best so far, a
pattern search improves it. The search ends if no box can improve the result by more than the tolerance, or after a
number of boxes. The gap is an upper bound of the possible improvement for these postures.
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
_TOLERANCE = 0.005  # fraction of the cells
_HELPS = 0.01  # least gain for which springs are prescribed, as a fraction of the cells
_SLACK = 1e-3  # fraction of the largest allowed stiffness: a softer spring counts as no spring


@dataclass(frozen=True)
class Springs:
    """The best of the S possible springs that the search found; a box is a range of stiffnesses and rest angles."""

    stiffness: FloatArray  # (S,) N·m/rad
    rest: FloatArray  # (S,) rad; NaN for an unused spring
    area: float  # area of the functional workspace with the springs, m²
    without: float  # area without springs, m²
    reachable: float  # area that the joint limits allow, m²
    gap: float  # upper bound of the further gain in area by any other springs, m²
    boxes: int  # number of evaluated boxes
    helps: bool  # whether the springs give a relevant gain


class _Search:
    """Numbers of cells and their bounds for springs (S, 2), given by stiffness and rest angle."""

    def __init__(self, postures: Postures, places: Sequence[SpringPlace], torque: FloatArray, penalty: float) -> None:
        joints = postures.gravity.shape[1]
        self.postures, self.torque, self.penalty = postures, torque, penalty
        across = [[j in place.joints for j in range(joints)] for place in places]
        self.across: BoolArray = np.array(across, dtype=np.bool_).reshape(-1, joints)
        self.low = np.array([[0.0, place.rest[0]] for place in places]).reshape(-1, 2)
        self.high = np.array([[place.stiffest, place.rest[1]] for place in places]).reshape(-1, 2)
        self.boxes = 0

    def count_cells(self, low: FloatArray, high: FloatArray) -> int:
        """Return an upper bound of the cells for the springs of a box; -1 if a required point cannot be held."""
        p = self.postures
        return count_cells(p.gravity, p.stretch, p.cell, p.cells, p.required, self.across, self.torque, low, high)

    def penalise(self, springs: FloatArray) -> float:
        """Return the penalty for the stiffnesses of springs (S, 2), as a number of cells."""
        return float(self.penalty * self.postures.cells * np.sum(springs[:, 0] / self.high[:, 0]))

    def objective(self, springs: FloatArray) -> float:
        """Return the number of held cells minus the penalty of the springs; -inf if a required point is not held."""
        count = self.count_cells(springs, springs)
        return -np.inf if count < 0 else count - self.penalise(springs)

    def bound_objective(self, low: FloatArray, high: FloatArray) -> float:
        """Return an upper bound of the objective of all springs in a box."""
        self.boxes += 1
        count = self.count_cells(low, high)
        return -np.inf if count < 0 else count - self.penalise(low)

    def split(self, low: FloatArray, high: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return the two halves of a box; the stiffness or rest angle with the largest effect on torques is divided."""
        width = high - low
        far = np.maximum(
            np.abs(self.postures.stretch.max(axis=0) - low[:, 1]),
            np.abs(self.postures.stretch.min(axis=0) - high[:, 1]),
        )
        effect = np.stack([width[:, 0] * far, width[:, 1] * high[:, 0]], axis=1)
        side = np.unravel_index(int(effect.argmax()), effect.shape)
        middle = 0.5 * (low[side] + high[side])
        below, above = high.copy(), low.copy()
        below[side], above[side] = middle, middle
        return [(low, below), (above, high)]

    def improve(self, springs: FloatArray) -> FloatArray:
        """Return springs improved by a pattern search in stiffness and rest angle; steps are halved if none helps."""
        best, worth = springs.copy(), self.objective(springs)
        step = 0.1 * (self.high - self.low)
        for _ in range(12):
            before = worth
            for side in np.ndindex(best.shape):
                for sign in (1.0, -1.0):
                    trial = best.copy()
                    trial[side] = np.clip(trial[side] + sign * step[side], self.low[side], self.high[side])
                    other = self.objective(trial)
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
    """Return the springs with which a person can hold the largest functional workspace of several joints.

    ``places`` are the possible springs; if there are none, the result describes the workspace without assistance.
    ``torque`` (n, 2) are the person's limits, N·m. The search ends after a number of boxes.

    ValueError is raised if the search found no springs that hold every required point.
    """
    search = _Search(postures, places, torque, penalty)
    nothing = np.stack([np.zeros(len(places)), 0.5 * (search.low + search.high)[:, 1]], axis=1)
    none = search.objective(nothing)
    best, worth, bound = _branch_and_bound(search, nothing, none, boxes) if places else (nothing, none, none)
    if worth == -np.inf:
        if bound > -np.inf:
            raise ValueError("the search found no springs that hold every required point")
        raise ValueError("no springs can hold every required point")
    size, cells = postures.size, postures.cells
    helps = worth > max(none, 0.0) + _HELPS * cells or none == -np.inf
    chosen = _remove_soft_springs(search, best) if helps else nothing
    stiffness = chosen[:, 0]
    return Springs(
        stiffness=stiffness,
        rest=np.where(stiffness > 0, chosen[:, 1], np.nan),
        area=size * search.count_cells(chosen, chosen),
        without=size * _count_free_cells(search, nothing),
        reachable=size * cells,
        gap=size * max(bound - (worth if helps else none), 0.0),
        boxes=search.boxes,
        helps=bool(helps),
    )


def _remove_soft_springs(search: _Search, springs: FloatArray) -> FloatArray:
    """Return the springs (S, 2) without very soft springs, unless this reduces the number of cells."""
    fewer = springs.copy()
    fewer[springs[:, 0] <= _SLACK * search.high[:, 0], 0] = 0.0
    return fewer if search.count_cells(fewer, fewer) >= search.count_cells(springs, springs) else springs


def _count_free_cells(search: _Search, nothing: FloatArray) -> int:
    """Return the number of cells held without springs, even if required points are not held."""
    p = search.postures
    return count_cells(
        p.gravity, p.stretch, p.cell, p.cells + p.required, 0, search.across, search.torque, nothing, nothing
    )


def _branch_and_bound(search: _Search, start: FloatArray, worth: float, boxes: int) -> tuple[FloatArray, float, float]:
    """Return the best springs, their objective, and an upper bound of the objective of all springs."""
    best, ticket = start, 0
    queue = [(-search.bound_objective(search.low, search.high), ticket, search.low, search.high)]
    slack = _TOLERANCE * search.postures.cells
    while queue and search.boxes < boxes:
        if -queue[0][0] <= worth + slack:
            break
        _, _, low, high = heapq.heappop(queue)
        for one, other in search.split(low, high):
            promise = search.bound_objective(one, other)
            middle = 0.5 * (one + other)
            here = search.objective(middle)
            if here > worth:
                best = search.improve(middle)
                worth = search.objective(best)
            if promise > worth + slack:
                ticket += 1
                heapq.heappush(queue, (-promise, ticket, one, other))
    best = search.improve(best) if worth > -np.inf else best
    worth = search.objective(best) if worth > -np.inf else worth
    bound = max(worth + (slack if search.boxes > 1 else 0.0), -queue[0][0] if queue else -np.inf)
    return best, worth, bound


def find_holdable(postures: Postures, places: Sequence[SpringPlace], torque: FloatArray, springs: Springs) -> BoolArray:
    """Return whether each posture (N,) can be held with the springs."""
    needed = postures.gravity.copy()
    for s, place in enumerate(places):
        if springs.stiffness[s] > 0:
            pull = springs.stiffness[s] * (postures.stretch[:, s] - springs.rest[s])
            needed[:, list(place.joints)] += pull[:, None]
    return np.asarray(np.all((needed >= torque[:, 0]) & (needed <= torque[:, 1]), axis=1))
