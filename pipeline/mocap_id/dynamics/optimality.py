"""Proof that a solution is optimal: the Karush-Kuhn-Tucker conditions, checked independently of the solver.

Every set of bodies that is fitted here is a convex cone of non-negative point masses, and the cost is convex. A
solution is therefore optimal if and only if it meets four conditions:

- **primal feasibility**: the solution is in the cone;
- **stationarity**: the cost does not change to first order with the free parameters;
- **dual feasibility**: no additional mass at any point reduces the cost. The derivative of the cost with respect to a
  mass is the *price* of this mass, a multiplier of the constraints. No price may be negative;
- **complementarity**: points with mass have the price zero.

The violations of the last three are expressed as the decrease of the cost that is still possible, relative to the cost.
Their sum is an upper bound of the distance to the least cost, because a convex function is above its tangents.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.least_squares import CompressedProblem

PROVEN = 1e-6
"""Possible decrease of the cost, relative to the cost, below which a solution counts as optimal."""
_INSIDE = 1e-9  # relative violation that counts as rounding
_HEAVIER = 2.0  # the bound is valid for bodies of up to this multiple of the mass


class BodyCone(Protocol):
    """A convex cone of bodies; v numbers describe a body and map linearly to the first b parameters of a problem."""

    @property
    def mapping(self) -> FloatArray:
        """Matrix (b, v) from the numbers to the parameters."""

    def measure_violation(self, body: FloatArray) -> float:
        """Return how much a body (v,) violates the cone's conditions, relative to its size; 0 inside the cone."""

    def mass(self, body: FloatArray) -> float:
        """Return the total mass of a body (v,), kg."""

    def find_cheapest(self, prices: FloatArray) -> FloatArray:
        """Return q bodies (v, q) of 1 kg at single points; one of them has the lowest price for the prices (v,)."""


@dataclass(frozen=True)
class Optimality:
    """Deviation of a solution from each optimality condition."""

    primal: float  # violation of the cone, relative to the body
    # stationarity, dual, complementarity: decrease of the cost that is still possible by a change of the free
    # parameters, by additional masses and by a change of the present masses, relative to the cost
    stationarity: float
    dual: float
    complementarity: float

    @property
    def excess(self) -> float:
        """Upper bound of the cost's distance to the least cost, relative to the cost."""
        return self.stationarity + self.dual + self.complementarity

    @property
    def proven(self) -> bool:
        """Whether all four conditions hold within their tolerances; false if a value is NaN."""
        return self.primal <= _INSIDE and self.excess <= PROVEN


@dataclass(frozen=True)
class SolverAnswer:
    """The solution of a solver and its report."""

    solver: str  # name of the solver
    body: FloatArray  # (v,) numbers of the body; NaN if the solver found no solution
    cost: float  # cost of the body
    optimality: Optimality  # result of the check
    status: str  # the solver's own status text
    iterations: int = 0  # number of iterations; 0 if the solver does not report it


_NO_OTHERS: FloatArray = np.zeros(0)


def check_optimality(
    problem: CompressedProblem, bodies: BodyCone, body: FloatArray, others: FloatArray = _NO_OTHERS
) -> Optimality:
    """Check the optimality conditions of min ‖R [mapping · body; others] - d‖² over bodies in a cone.

    The bound ``excess`` of the result is valid for bodies of up to twice the mass.

    Parameters
    ----------
    problem : CompressedProblem
        Problem of b + k columns: the parameters to which the bodies map, then k free parameters.
    body : (v,) array
        The solution to check.
    others : (k,) array
        Values of the free parameters; by default there are none.
    """
    if not (np.isfinite(body).all() and np.isfinite(others).all()):
        return Optimality(np.inf, np.inf, np.inf, np.inf)
    mapped = problem.factor[:, : len(bodies.mapping)] @ bodies.mapping
    free = problem.factor[:, len(bodies.mapping) :]
    rest = mapped @ body + free @ others - problem.target
    cost = problem.floor(float(rest @ rest) + problem.rest)
    at_most = _estimate_gain(problem.factor, rest)
    prices = 2 * mapped.T @ rest
    points = bodies.find_cheapest(prices)
    # up to this additional mass, all at the lowest price
    heavier = _HEAVIER * bodies.mass(body) * abs(float((prices @ points).min(initial=0.0)))
    absent = max(heavier, _estimate_point_gain(mapped @ points, rest))
    return Optimality(
        primal=bodies.measure_violation(body),
        stationarity=_estimate_gain(free, rest) / cost,
        dual=min(absent, at_most) / cost,
        complementarity=min(abs(float(prices @ body)), at_most) / cost,
    )


def _estimate_gain(columns: FloatArray, rest: FloatArray) -> float:
    """Return the decrease of the cost by the best factors of the columns: the squared residual in their span."""
    if columns.shape[1] == 0:
        return 0.0
    step = np.linalg.lstsq(columns, rest, rcond=None)[0]
    return float(np.sum((columns @ step) ** 2))


def _estimate_point_gain(columns: FloatArray, rest: FloatArray) -> float:
    """Return the decrease of the cost by the best single point mass, which is also valid for solutions without mass."""
    size = np.sum(columns**2, axis=0)
    downhill = np.maximum(-(columns.T @ rest), 0.0)
    gains = np.divide(downhill**2, size, out=np.zeros_like(size), where=size > 0.0)
    return float(gains.max(initial=0.0))
