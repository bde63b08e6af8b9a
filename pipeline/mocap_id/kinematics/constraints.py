"""Constraints of the user: markers on the same segment, and markers on different segments."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Constraints:
    """Markers that share a segment, and pairs of markers that do not."""

    unit: IntArray  # (M,) markers with the same number are assigned together
    barred: BoolArray  # (M, M) pairs that may not share a segment; symmetric, the same for all markers of a unit

    @classmethod
    def of(cls, count: int, together: Iterable[Sequence[int]] = (), apart: Iterable[Sequence[int]] = ()) -> Constraints:
        """Return constraints on ``count`` markers from groups of columns: ``together`` on one segment, or ``apart``."""
        unit = np.arange(count)
        for group in together:
            unit[np.isin(unit, unit[list(group)])] = unit[group[0]]
        barred = np.zeros((count, count), dtype=np.bool_)
        for group in apart:
            barred[np.ix_(list(group), list(group))] = True
        np.fill_diagonal(barred, val=False)
        same = unit[:, None] == unit
        barred = same @ barred @ same
        return cls(unit, barred)

    @property
    def contradictory(self) -> BoolArray:
        """Markers (M,) that the constraints require to be both together and apart."""
        return np.asarray(np.diagonal(self.barred))

    def allow(self, members: IntArray) -> bool:
        """Return whether the members may share a segment."""
        return not self.barred[np.ix_(members, members)].any()

    def constrained_variance(self, variance: FloatArray, members: IntArray) -> FloatArray:
        """Return variances of mutual distances (K, K), set to 0 within a unit and to a large value for barred pairs."""
        far = 10 * np.max(variance, initial=0.0) + 1.0
        shaped = np.where(self.barred[np.ix_(members, members)], far, variance)
        return np.where(self.unit[members][:, None] == self.unit[members], 0.0, shaped)

    def nearest_bodies(self, square: FloatArray, members: IntArray) -> IntArray:
        """Return the body (K,) that fits each member best. Units stay together and, if possible, barred pairs apart.

        ``square`` (B, K) is the mean squared distance of each member from its position on each of B bodies, m^2.
        """
        _, index = np.unique(self.unit[members], return_inverse=True)
        cost = np.zeros((len(square), index.max() + 1))
        np.add.at(cost.T, index, square.T)
        first = members[[int(np.argmax(index == u)) for u in range(cost.shape[1])]]
        barred = self.barred[np.ix_(first, first)]
        best = np.argmin(cost, axis=0)
        for u, v in np.argwhere(np.triu(barred)):
            if best[u] == best[v]:
                self._separate(cost, best, barred, (int(u), int(v)))
        return np.asarray(best[index])

    @staticmethod
    def _separate(cost: FloatArray, best: IntArray, barred: BoolArray, pair: tuple[int, int]) -> None:
        """Reassign, in ``best``, one of two units to its next best free body: the unit for which this costs less."""
        moves = []
        for unit in pair:
            taken = np.isin(np.arange(len(cost)), best[barred[unit]])
            elsewhere = np.where(taken, np.inf, cost[:, unit])
            body = int(np.argmin(elsewhere))
            moves.append((float(elsewhere[body] - cost[best[unit], unit]), unit, body))
        loss, unit, body = min(moves)
        if np.isfinite(loss):
            best[unit] = body
