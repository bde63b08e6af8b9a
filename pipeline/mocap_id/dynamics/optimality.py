"""Whether a solution is the best: the Karush-Kuhn-Tucker conditions, checked without asking the solver.

Every set of bodies that is fitted here is a convex cone: masses at points, none negative. The cost is convex, so a
solution is a best one exactly when

- **primal feasibility**: it is in the cone;
- **stationarity**: the cost does not change to first order with the parameters that are free;
- **dual feasibility**: no mass at any point of the set would lower the cost. The cost's derivative by a mass is that
  mass's *price*; the multipliers of the constraints are the prices, and none may be negative;
- **complementarity**: what carries mass has the price zero.

The last three are given in the cost's own unit and relative to it: as what each leaves to gain. Their sum bounds how
far the cost is above the least one, because a convex function lies above its tangents. None can leave more to gain than
dropping the cone altogether would.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.solve import Compressed

PROVEN = 1e-6
"""Relative to the cost: a solution that leaves less to gain counts as the best."""
_INSIDE = 1e-9  # relative violation that is rounding
_HEAVIER = 2.0  # bodies up to so many times the mass are considered in the bound


class Bodies(Protocol):
    """A convex cone of bodies, described by v numbers that map linearly to the problem's first b parameters."""

    @property
    def mapping(self) -> FloatArray:
        """(b, v)."""

    def outside(self, body: FloatArray) -> float:
        """How far a body (v,) violates the cone's conditions, relative to its size; 0 inside."""

    def mass(self, body: FloatArray) -> float:
        """Total mass of a body (v,), kg."""

    def cheapest(self, prices: FloatArray) -> FloatArray:
        """Bodies (v, q) of 1 kg at one point each, the cheapest among them, given each number's price (v,)."""


@dataclass(frozen=True)
class Optimality:
    """How far a solution is from meeting each condition.

    Parameters
    ----------
    primal : float
        Violation of the cone, relative to the body.
    stationarity, dual, complementarity : float
        What free parameters, absent masses and present masses leave to gain, relative to the cost.
    """

    primal: float
    stationarity: float
    dual: float
    complementarity: float

    @property
    def excess(self) -> float:
        """Upper bound on how far the cost is above the least one, relative to it."""
        return self.stationarity + self.dual + self.complementarity

    @property
    def proven(self) -> bool:
        """All four conditions hold; false where any is not a number."""
        return self.primal <= _INSIDE and self.excess <= PROVEN


_UNKNOWN = Optimality(np.inf, np.inf, np.inf, np.inf)


@dataclass(frozen=True)
class Answer:
    """What one solver gives.

    Parameters
    ----------
    solver : str
    body : (v,) array
        NaN where the solver gives nothing.
    cost : float
    optimality : Optimality
    status : str
        The solver's own word.
    iterations : int
        0 where the solver does not tell.
    """

    solver: str
    body: FloatArray
    cost: float
    optimality: Optimality
    status: str
    iterations: int = 0


_NO_OTHERS: FloatArray = np.zeros(0)


def check(problem: Compressed, bodies: Bodies, body: FloatArray, others: FloatArray = _NO_OTHERS) -> Optimality:
    """Check the optimality conditions of min ‖R [mapping · body; others] - d‖² over bodies in a cone.

    Parameters
    ----------
    problem : Compressed
        b + k columns: those that the bodies map to, then k free parameters.
    bodies : Bodies
    body : (v,) array
    others : (k,) array
        None by default.

    Returns
    -------
    Optimality
        The bound holds against bodies of up to twice the mass.
    """
    if not (np.isfinite(body).all() and np.isfinite(others).all()):
        return _UNKNOWN
    mapped = problem.factor[:, : len(bodies.mapping)] @ bodies.mapping
    free = problem.factor[:, len(bodies.mapping) :]
    rest = mapped @ body + free @ others - problem.target
    cost = problem.floor(float(rest @ rest) + problem.rest)
    at_most = _gain(problem.factor, rest)
    prices = 2 * mapped.T @ rest
    points = bodies.cheapest(prices)
    absent = max(_bound(prices @ points, bodies.mass(body)), _best_single(mapped @ points, rest))
    return Optimality(
        primal=bodies.outside(body),
        stationarity=_gain(free, rest) / cost,
        dual=min(absent, at_most) / cost,
        complementarity=min(abs(float(prices @ body)), at_most) / cost,
    )


def _gain(columns: FloatArray, rest: FloatArray) -> float:
    """What the best change of free parameters takes off the cost: the residual's part in the columns' span."""
    if columns.shape[1] == 0:
        return 0.0
    step = np.linalg.lstsq(columns, rest, rcond=None)[0]
    return float(np.sum((columns @ step) ** 2))


def _bound(prices: FloatArray, mass: float) -> float:
    """What bodies of up to ``_HEAVIER`` times the mass could gain at most, all of it at the lowest price (q,)."""
    return _HEAVIER * mass * abs(float(prices.min(initial=0.0)))


def _best_single(columns: FloatArray, rest: FloatArray) -> float:
    """What the best mass at one point takes off the cost; it counts where the solution has no mass to compare with."""
    size = np.sum(columns**2, axis=0)
    downhill = np.maximum(-(columns.T @ rest), 0.0)
    gains = np.divide(downhill**2, size, out=np.zeros_like(size), where=size > 0.0)
    return float(gains.max(initial=0.0))
