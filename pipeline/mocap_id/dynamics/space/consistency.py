"""Physical consistency in space: each segment's pseudo-inertia is positive semidefinite, and its mass is within a ball.

The ball is needed for segments whose second moments have no effect. Without it, their first moments would be arbitrary,
because a mass that tends to zero can have any first moment if it is far enough away. The masses of a segment are
therefore at most :data:`REACH` from its origin, so that tr(Σ) ≤ REACH² m. Point masses in this ball give exactly the
bodies that meet both conditions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import null_space
from scipy.optimize import brentq

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.consistency import (
    LENGTH,
    PROVEN,
    ConeKind,
    Solution,
    SolverAnswer,
    check_optimality,
    find_closest_step,
    solve_cones,
)
from mocap_id.dynamics.regressor import CompressedProblem
from mocap_id.errors import NumericalError

_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # matrix entries of Ixx, Iyy, Izz, Ixy, Ixz, Iyz


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """Return the pseudo-inertia (..., 4, 4) of ten parameters (..., 10), kg, kg·m and kg·m²."""
    inertia = np.zeros((*parameters.shape[:-1], 3, 3))
    for value, (i, j) in zip(np.moveaxis(parameters[..., 4:], -1, 0), _ENTRIES, strict=True):
        inertia[..., i, j] = inertia[..., j, i] = value
    matrix = np.zeros((*parameters.shape[:-1], 4, 4))
    trace = np.trace(inertia, axis1=-2, axis2=-1)[..., None, None]
    matrix[..., :3, :3] = trace / 2 * np.eye(3) - inertia
    matrix[..., :3, 3] = matrix[..., 3, :3] = parameters[..., 1:4]
    matrix[..., 3, 3] = parameters[..., 0]
    return matrix


def body_parameters(matrix: FloatArray) -> FloatArray:
    """Return the ten parameters (..., 10) of a pseudo-inertia (..., 4, 4); the inverse of :func:`pseudo_inertia`."""
    second = matrix[..., :3, :3]
    inertia = np.trace(second, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - second
    entries = np.stack([inertia[..., i, j] for i, j in _ENTRIES], axis=-1)
    return np.concatenate([matrix[..., 3:, 3], matrix[..., :3, 3], entries], axis=-1)


def point_mass(position: FloatArray) -> FloatArray:
    """Return the ten parameters (10,) of 1 kg at a point (3,), m."""
    at = np.append(position, 1.0)
    return body_parameters(np.outer(at, at))


def change_of_frame(pose: FloatArray) -> FloatArray:
    """Return the matrix (..., 10, 10) of a body's parameters in a frame in which its frame has ``pose`` (..., 4, 4)."""
    units = pseudo_inertia(np.eye(10))
    moved = pose[..., None, :, :] @ units @ np.swapaxes(pose, -1, -2)[..., None, :, :]
    return np.swapaxes(body_parameters(moved), -1, -2)


REACH = 2.0  # m: largest distance of a mass from the origin of its segment
_UNITS = np.array([1.0, *[LENGTH] * 3, *[LENGTH**2] * 6])
_ROWS, _COLUMNS = np.array([(row, column) for column in range(4) for row in range(column + 1)]).T
_WEIGHTS = np.where(_ROWS == _COLUMNS, 1.0, np.sqrt(2.0))  # weights of the entries of Clarabel's triangles
_ACCURACY = (1e-9, 1e-9, 1e-9, 1e-7)  # Clarabel's tolerance in each round
_REGULARIZATION = 1e-12  # Clarabel's default, 1e-8, hides parameters with little effect
_TOLERABLE = 0.1  # largest relative distance to the least cost with which a solution is accepted
_DEPENDENT = 1e-10  # fraction of the largest singular value
_ROUNDING = 1e-7  # relative violation of the cone that counts as rounding
_SPREAD = 0.1  # m: radius of gyration of the bodies to approach if the data do not determine the masses


@dataclass(frozen=True)
class SemidefiniteBodies:
    """Possible segments, described by ten full parameters each (:class:`~mocap_id.dynamics.consistency.BodyCone`)."""

    mapping: FloatArray  # (b, 10K) matrix from full parameters to the parameters of the problem

    @property
    def segments(self) -> int:
        return int(self.mapping.shape[1] // 10)

    @property
    def units(self) -> FloatArray:
        return np.tile(_UNITS, self.segments)

    def sides(self) -> tuple[FloatArray, tuple[tuple[ConeKind, int], ...]]:
        """Return rows (r, 10K) whose products with a body, kg, must be in cones, and the kind and size of each cone.

        The first rows give the triangles of the pseudo-inertias, the last K rows the limit :data:`REACH` of the masses.
        """
        triangle = _scale_inertia(np.eye(10))[:, _ROWS, _COLUMNS].T * _WEIGHTS[:, None]
        every = np.eye(self.segments)
        cones: list[tuple[ConeKind, int]] = [("semidefinite", 4)] * self.segments
        rows = np.concatenate([np.kron(every, triangle), np.kron(every, _measure_margin(np.eye(10)))])
        return rows, (*cones, ("flat", self.segments))

    def measure_violation(self, body: FloatArray) -> float:
        """Return the largest violation of any condition, kg, divided by the total mass."""
        links = body.reshape(-1, 10)
        least = min(float(np.linalg.eigvalsh(_scale_inertia(links)).min()), float(_measure_margin(links).min()))
        return max(0.0, -least) / max(self.mass(body), 1e-300)

    def mass(self, body: FloatArray) -> float:
        return float(np.abs(body[::10]).sum())

    def settle(self, body: FloatArray) -> FloatArray:
        """Return the body with negative eigenvalues set to 0 and masses increased as needed (rounding errors)."""
        if not np.isfinite(body).all():
            return body
        size, vectors = np.linalg.eigh(_scale_inertia(body.reshape(-1, 10)))
        matrix = (vectors * np.maximum(size, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        links = body_parameters(matrix)
        links[:, 0] += np.maximum(-_measure_margin(links * _UNITS), 0.0) * (LENGTH / REACH) ** 2
        return np.asarray((links * _UNITS).reshape(-1))

    def find_cheapest(self, prices: FloatArray) -> FloatArray:
        """Return 1 kg at the point of each segment with the least price, as columns (10K, K)."""
        columns = np.zeros((len(prices), self.segments))
        for k in range(self.segments):
            own = slice(10 * k, 10 * k + 10)
            columns[own, k] = point_mass(_find_cheapest_point(prices[own]))
        return columns


def fit_semidefinite(problem: CompressedProblem, mapping: FloatArray) -> Solution:
    """Minimise ‖R [M φ; c] - d‖² over possible bodies φ and free parameters c.

    The problem has b + k columns, and M is ``mapping`` (b, 10K), from full parameters to the first b parameters.
    ``full`` of the result is the body closest to equal masses at the joints. NumericalError is raised if Clarabel's
    solution is not close enough to the least cost.
    """
    small, bodies = problem.eliminate_others(len(mapping)), SemidefiniteBodies(mapping)
    units, (sides, cones) = bodies.units, bodies.sides()
    # several rounds; each corrects the best solution so far
    rows = small.factor @ (mapping * units)
    body, answer, iterations = np.zeros(len(units)), None, 0
    for accuracy in _ACCURACY:
        rest = small.target - small.factor @ mapping @ body
        size = max(float(np.linalg.norm(rest)), 1e-200)
        step, status, used = solve_cones(
            quadratic=sparse.csc_matrix(rows.T @ rows / size**2),
            linear=-rows.T @ rest / size**2,
            matrix=-sides * units,
            bound=sides @ body,
            cones=cones,
            accuracy=accuracy,
            regularization=_REGULARIZATION,
        )
        iterations += used
        moved = bodies.settle(body + step * units)
        optimality = check_optimality(small, bodies, moved)
        if answer is None or optimality.excess < answer.optimality.excess:
            answer = SolverAnswer("clarabel", moved, small.cost(mapping @ moved), optimality, status, iterations)
        if answer.optimality.excess <= PROVEN:
            break
        body = answer.body if np.isfinite(answer.body).all() else np.zeros(len(units))
    assert answer is not None
    if not answer.optimality.excess <= _TOLERABLE:
        raise NumericalError(
            f"the fit of physically consistent parameters did not converge: the solver Clarabel reports "
            f"{answer.status!r}, and the cost may be {answer.optimality.excess:.1e} above the least cost (limit "
            f"{_TOLERABLE:.0e}). Check the chain for two joints at the same position, or for wrong units"
        )
    # the closest body with the same base parameters
    share = bodies.mass(answer.body) / bodies.segments
    sphere = np.array([1.0, 0.0, 0.0, 0.0, *[2 / 3 * _SPREAD**2] * 3, 0.0, 0.0, 0.0])
    aim, scale = np.tile(share * sphere, bodies.segments), share * units
    directions = null_space(mapping * units, rcond=_DEPENDENT) * units[:, None]
    distance = (aim - answer.body) / scale
    full = answer.body + directions @ find_closest_step(bodies, answer.body, directions, distance, scale)
    possible = np.isfinite(full).all() and bodies.measure_violation(full) <= _ROUNDING
    free = problem.cost(problem.free_solution())
    return Solution(
        parameters=problem.complete(mapping @ answer.body),
        full=full if possible else answer.body,
        answer=answer,
        price=max(answer.cost - free, 0.0) / problem.floor(free),
    )


def _scale_inertia(links: FloatArray) -> FloatArray:
    """Return the pseudo-inertias (K, 4, 4) of parameters (K, 10), with all entries converted to kg."""
    return pseudo_inertia(links / _UNITS)


def _measure_margin(links: FloatArray) -> FloatArray:
    """Return REACH² m - tr(Σ) (K,) of parameters (K, 10), converted to kg; negative if masses are too far away."""
    return np.asarray((REACH**2 * links[:, 0] - links[:, 4:7].sum(axis=1) / 2) / LENGTH**2)


def _find_cheapest_point(prices: FloatArray) -> FloatArray:
    """Return the point (3,) within :data:`REACH` of the origin with the least price of 1 kg, for prices (10,).

    The price is a quadratic function of the position x. In a ball, its minimum is the point at which the gradient of
    the price plus λ |x|² is zero, with the least λ ≥ 0 for which this sum is convex and the point is in the ball.
    """
    linear, (xx, yy, zz, xy, xz, yz) = prices[1:4], prices[4:]
    square = np.array([[yy + zz, -xy / 2, -xz / 2], [-xy / 2, xx + zz, -yz / 2], [-xz / 2, -yz / 2, xx + yy]])
    size, vectors = np.linalg.eigh(square)
    half = -(vectors.T @ linear) / 2
    tiny = 1e-14 * max(float(np.abs(size).max()), float(np.abs(half).max()), 1e-300)

    def position(weight: float) -> FloatArray:
        return half / np.maximum(size + weight, tiny)

    low = max(0.0, -float(size[0]))
    if np.linalg.norm(position(low)) > REACH:
        high = low + 2 * float(np.linalg.norm(half)) / REACH
        low = float(brentq(lambda weight: np.linalg.norm(position(weight)) - REACH, low, high, xtol=tiny))
    inside = position(low)
    if size[0] < 0.0:  # the minimum lies on the surface
        inside[0] += np.copysign(np.sqrt(max(REACH**2 - float(inside @ inside), 0.0)), inside[0])
    return np.asarray(vectors @ inside * min(1.0, REACH / max(float(np.linalg.norm(inside)), 1e-300)))
