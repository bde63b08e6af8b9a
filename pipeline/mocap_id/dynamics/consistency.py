"""Physically consistent parameters: fits over possible bodies, which are point masses on a grid or the exact cone.

Non-negative least squares solves the fit on the grid (eq. 4.12, 4.25), and Clarabel that in the cone. Every solution is
checked for optimality (:func:`check_optimality`), which needs no second solver. OSQP is run only if the solution on the
grid does not pass the check.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias

import numpy as np
from scipy import sparse
from scipy.linalg import null_space
from scipy.optimize import nnls

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.priors import compute_reference_sd
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS, CompressedProblem
from mocap_id.errors import NumericalError

if TYPE_CHECKING:
    from mocap_id.dynamics.space.consistency import SemidefiniteBodies

PROVEN = 1e-6  # possible decrease of the cost, relative to the cost, below which a solution counts as optimal
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
    """Solution of a solver and its report."""

    solver: str  # name of the solver
    body: FloatArray  # (v,) numbers of the body; NaN if the solver found no solution
    cost: float  # cost of the body
    optimality: Optimality  # result of the check
    status: str  # the solver's own status text
    iterations: int = 0  # number of iterations; 0 if the solver does not report it


Consistency = Literal["grid", "cone", "bounded-cone"]
"""Set of possible bodies: masses on the grid, masses anywhere, or masses anywhere within the outlines of the grid."""
_NO_OTHERS: FloatArray = np.zeros(0)


@dataclass(frozen=True)
class Solution:
    """Consistent parameters and the solver's report."""

    parameters: FloatArray  # (b + k,) parameters of the problem: first those of the bodies, then the free ones
    # full parameters of one of many bodies with these parameters, 4(n + 1) or in space 10K. In the plane, it is the
    # body closest to the reference, or of evenly spread point masses; an Izz that bodies only approach is NaN.
    full: FloatArray
    answer: SolverAnswer  # solution used, checked on the whole problem
    price: float  # relative increase of the cost over that of unconstrained parameters
    # requested, consistency: the requested set of bodies, and the set used: `grid` if the solution in the cone was
    # not proven to be optimal
    requested: Consistency = "cone"
    consistency: Consistency = "cone"
    # (p,) point masses with the full parameters, kg; NaN for the cone, whose bodies need not be on the grid
    masses: FloatArray = field(default_factory=lambda: np.zeros(0))


def check_optimality(
    problem: CompressedProblem, bodies: BodyCone, body: FloatArray, others: FloatArray = _NO_OTHERS
) -> Optimality:
    """Check the optimality conditions of min ‖R [mapping · body; others] - d‖² over bodies in a cone.

    ``others`` (k,) are the free parameters after those of the ``body`` (v,). The bound ``excess`` of the result is
    valid for bodies of up to twice the mass.
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
    # decrease of the cost by the best single point mass, which is also valid for solutions without mass
    columns = mapped @ points
    size = np.sum(columns**2, axis=0)
    downhill = np.maximum(-(columns.T @ rest), 0.0)
    gains = np.divide(downhill**2, size, out=np.zeros_like(size), where=size > 0.0)
    absent = max(heavier, float(gains.max(initial=0.0)))
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


LENGTH = 0.3  # m: unit of length with which the parameters of a segment have similar magnitudes
UNITS = np.array([1.0, LENGTH, LENGTH, LENGTH**2])  # divisors of a link's m, mx, my and Izz that convert all to kg
FAR = 10.0  # m: distance up to which masses are searched without a box
ConeKind: TypeAlias = Literal["round", "flat", "semidefinite"]


@dataclass(frozen=True)
class ConeBodies:
    """Possible links, given by their full parameters (a :class:`BodyCone`)."""

    mapping: FloatArray  # (b, 4(n + 1)) matrix M of eq. 4.24, from full parameters to the parameters of the problem.
    # (n + 1, 2, 2) lowest and highest corner of each link in its frame, m; None for masses anywhere
    boxes: FloatArray | None = None

    @property
    def links(self) -> int:
        return int(self.mapping.shape[1] // 4)

    @property
    def units(self) -> FloatArray:
        return np.tile(UNITS, self.links)

    def sides(self) -> tuple[FloatArray, tuple[tuple[ConeKind, int], ...]]:
        """Return rows (r, 4(n + 1)) whose products with a body are in cones, and kind and size of the cones."""
        round_, flat = self.round_sides(), self.flat_sides()
        cones: list[tuple[ConeKind, int]] = [("round", 4) for _ in round_]
        return np.vstack([*round_, flat]), (*cones, ("flat", len(flat)))

    def is_limited(self, link: int) -> bool:
        """Return whether the cone limits the link's first moments: the link has a box, or its Izz has an effect."""
        return self.boxes is not None or bool(self.mapping[:, 4 * link + 3].any())

    def round_sides(self) -> FloatArray:
        """Return four rows, (l, 4, 4(n + 1)), for each of the l links that the cone limits.

        Their products with a body, (m + J, m - J, 2 mx / L, 2 my / L), kg, are in a second-order cone; J is Izz / L².
        """
        limited = [link for link in range(self.links) if self.is_limited(link)]
        rows = np.zeros((len(limited), 4, 4 * self.links))
        for row, link in zip(rows, limited, strict=True):
            own = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 2, 0, 0], [0, 0, 2, 0]])
            row[:, 4 * link : 4 * link + 4] = own / UNITS
        return rows

    def flat_sides(self) -> FloatArray:
        """Return rows (r, 4(n + 1)) whose products, kg, must not be negative: masses, and conditions of the boxes."""
        rows = np.zeros((self.links, 6, 4 * self.links))
        for link, row in enumerate(rows):
            own = slice(4 * link, 4 * link + 4)
            row[0, 4 * link] = 1.0
            if self.boxes is not None:
                (x0, y0), (x1, y1) = self.boxes[link] / LENGTH
                walls = [[-x0, 1, 0, 0], [x1, -1, 0, 0], [-y0, 0, 1, 0], [y1, 0, -1, 0]]
                row[1:, own] = np.array([*walls, [-(x0 * x1 + y0 * y1), x0 + x1, y0 + y1, -1]]) / UNITS
        used = rows if self.boxes is not None else rows[:, :1]
        return used.reshape(-1, 4 * self.links)

    def measure_violation(self, body: FloatArray) -> float:
        """Return the largest violation of any condition, kg, divided by the total mass."""
        sides = self.round_sides() @ body
        short = [*(np.linalg.norm(sides[:, 1:], axis=1) - sides[:, 0]), *(-(self.flat_sides() @ body))]
        return float(np.max([0.0, *short])) / max(self.mass(body), 1e-300)

    def mass(self, body: FloatArray) -> float:
        return float(np.abs(body[::4]).sum())

    def find_cheapest(self, prices: FloatArray) -> FloatArray:
        """Return the parameters of 1 kg where each link costs least, as columns (4(n + 1), n + 1)."""
        columns = np.zeros((len(prices), self.links))
        for link in range(self.links):
            _, mx, my, izz = prices[4 * link : 4 * link + 4]  # 1 kg at (x, y) costs c₀ + mx x + my y + izz (x² + y²)
            (x0, y0), (x1, y1) = [[-FAR] * 2, [FAR] * 2] if self.boxes is None else self.boxes[link]
            x, y = _find_minimum(mx, izz, x0, x1), _find_minimum(my, izz, y0, y1)
            columns[4 * link : 4 * link + 4, link] = 1.0, x, y, x * x + y * y
        return columns

    def settle(self, body: FloatArray) -> FloatArray:
        """Return the body with negative masses set to 0 and an Izz that is too small increased (rounding errors)."""
        links = body.reshape(-1, 4).copy()
        links[:, 0] = np.maximum(links[:, 0], 0.0)
        first = np.sum(links[:, 1:3] ** 2, axis=1)
        for link in filter(self.is_limited, range(self.links)):
            least = first[link] / links[link, 0] if links[link, 0] > 0.0 else 0.0
            links[link, 3] = max(links[link, 3], least)
        return links.reshape(-1)


def _find_minimum(linear: float, square: float, low: float, high: float) -> float:
    """Return the point between two ends at which linear·x + square·x² is least."""
    inside = [] if square <= 0.0 else [float(np.clip(-linear / (2 * square), low, high))]
    return min([low, high, *inside], key=lambda x: linear * x + square * x * x)


ConicBodies: TypeAlias = "ConeBodies | SemidefiniteBodies"
_ACCURACY, _ITERATIONS = 1e-12, 200
_ROUNDS = 3
_REGULARIZATION = 1e-6  # Clarabel's default is 1e-8
_ENOUGH = 1e-9  # possible relative decrease of the cost below which the rounds end
_NO_MASS = 1e-9  # fraction of the total mass below which a link has no mass
_TINY = 1e-200
_DEPENDENT = 1e-10  # fraction of the largest singular value
_ROUNDING = 1e-7  # relative violation of the cone that counts as rounding


def solve_links(problem: CompressedProblem, bodies: ConicBodies) -> SolverAnswer:
    """Minimise ‖R · mapping · body - d‖² over possible links; return the full parameters of one of many solutions.

    Clarabel's accuracy is relative to the whole wrench, whereas the cost is the small remaining residual. As long as
    the optimality conditions do not hold, Clarabel is run again for a correction on the scale of the residual. If the
    least cost is only approached by larger and larger links, the conditions may still not hold. Clarabel then starts
    again with more regularization. The caller eliminates free parameters (:meth:`CompressedProblem.eliminate_others`).
    """
    mapped, units, (sides, cones) = problem.factor @ bodies.mapping, bodies.units, bodies.sides()
    rows, base = mapped * units, len(problem.target)
    size = float(np.linalg.norm(rows, axis=0).max())
    best = None
    for regularization in (None, _REGULARIZATION):
        body, answer, iterations = np.zeros(len(units)), None, 0
        for _ in range(_ROUNDS):
            target = problem.target - mapped @ body
            length, step, status = float(np.linalg.norm(target)), np.zeros_like(body), "nothing to fit"
            if not min(size, length) < _TINY:  # the variables are the step and its effect y = mapped · step, scaled
                solution, status, used = solve_cones(
                    quadratic=sparse.csc_matrix(np.diag(np.repeat([0.0, 1.0], [len(body), base]))),
                    linear=np.concatenate([np.zeros(len(body)), -target / length]),
                    matrix=np.block([[rows / size, -np.eye(base)], [-sides * units, np.zeros((len(sides), base))]]),
                    bound=np.concatenate([np.zeros(base), sides @ body * (size / length)]),
                    cones=(("zero", base), *cones),
                    regularization=regularization,
                )
                step = solution[: len(body)] * units * (length / size)
                iterations += used
            body = bodies.settle(body + step)
            cost, optimality = problem.cost(bodies.mapping @ body), check_optimality(problem, bodies, body)
            worse = answer is not None and answer.optimality.proven and not optimality.proven
            if answer is not None and (worse or not cost < answer.cost):
                break  # a correction that does not decrease the cost is discarded
            answer = SolverAnswer("clarabel", body, cost, optimality, status, iterations)
            if optimality.excess <= _ENOUGH:
                break
        assert answer is not None
        if best is None or answer.optimality.excess < best.optimality.excess:
            best = answer
        if best.optimality.proven:
            break
    assert best is not None
    return best


def find_closest_links(bodies: ConeBodies, body: FloatArray, aim: FloatArray, scale: FloatArray) -> FloatArray:
    """Return the links with the base parameters of ``body`` that are closest to ``aim``, in units of ``scale``.

    If a link has first moments but no mass, possible links with larger and larger Izz only approach its base
    parameters, and its Izz is NaN.
    """
    hollow, least = [], _NO_MASS * bodies.mass(body)
    for link in range(bodies.links):  # links with an unobservable Izz, and with first moments but no mass
        mass, *first = np.abs(body[4 * link : 4 * link + 3])
        if not bodies.is_limited(link) and mass <= least < max(first) / LENGTH:
            hollow.append(link)
    limits = bodies if hollow else ConeBodies(np.eye(len(body)), bodies.boxes)  # also limits an unobservable Izz
    links = limits.settle(body)
    directions = null_space(bodies.mapping, rcond=_DEPENDENT)
    if directions.shape[1]:
        moved = links + directions @ find_closest_step(limits, links, directions, (aim - links) / scale, scale)
        links = limits.settle(moved) if limits.measure_violation(moved) <= _ROUNDING else links
    links[[4 * link + 3 for link in hollow]] = np.nan
    return links


def find_closest_step(
    limits: ConicBodies, start: FloatArray, directions: FloatArray, distance: FloatArray, scale: FloatArray
) -> FloatArray:
    """Return the steps (d,) along directions (v, d) from ``start`` (v,) to the closest body; NaN if Clarabel fails."""
    sides, cones = limits.sides()
    rows = directions / scale[:, None]  # ``distance`` (v,) is the target minus the start, in units of ``scale`` (v,)
    step, _, _ = solve_cones(
        quadratic=sparse.csc_matrix(rows.T @ rows),
        linear=-rows.T @ distance,
        matrix=-sides @ directions,
        bound=sides @ start,
        cones=(("zero", 0), *cones),
    )
    return step


def solve_cones(
    quadratic: sparse.csc_matrix,
    linear: FloatArray,
    matrix: FloatArray,
    bound: FloatArray,
    cones: tuple[tuple[str, int], ...],
    *,
    accuracy: float = _ACCURACY,
    regularization: float | None = None,
) -> tuple[FloatArray, str, int]:
    """Minimise ½ xᵀ quadratic x + linear·x with bound - matrix·x in cones; return x, status and iterations."""
    import clarabel  # noqa: PLC0415  not needed for a grid

    kinds = {
        "zero": clarabel.ZeroConeT,
        "round": clarabel.SecondOrderConeT,
        "flat": clarabel.NonnegativeConeT,
        "semidefinite": clarabel.PSDTriangleConeT,
    }
    limits = [kinds[kind](size) for kind, size in cones]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_iter = False, _ITERATIONS
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = accuracy
    if regularization is not None:
        settings.static_regularization_constant = regularization
    upper = sparse.csc_matrix(sparse.triu(quadratic))
    try:
        solution = clarabel.DefaultSolver(upper, linear, sparse.csc_matrix(matrix), bound, limits, settings).solve()
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # from Clarabel's eigenvalue routine; not a subclass of Exception
            raise
        return np.full(len(linear), np.nan), "stopped by an internal error", 0
    return np.asarray(solution.x, dtype=np.float64), str(solution.status), int(solution.iterations)


_FLESH, _LEAST_FLESH = 0.1, 0.04  # margin: fraction of the box's longer side; least value, m


@dataclass(frozen=True)
class PointGrid:
    """Grid points of all segments."""

    segment: IntArray  # (p,) segment of each point, base first
    position: FloatArray  # (p, 2) position of each point in the frame of its segment, m
    segments: int  # number of segments, base included

    def moments(self) -> FloatArray:
        """Return the matrix P (4(n + 1), p) of eq. 4.12: full parameters = P · masses."""
        x, y = self.position.T
        values = np.stack([np.ones_like(x), x, y, x * x + y * y])  # (4, p)
        matrix = np.zeros((self.segments, len(PLANAR_PARAMETERS), len(x)))
        for segment in range(self.segments):
            own = self.segment == segment
            matrix[segment][:, own] = values[:, own]
        return matrix.reshape(-1, len(x))

    def boxes(self) -> FloatArray:
        """Return the lowest and the highest corner of each segment's points, (n + 1, 2, 2), m."""
        own = [self.position[self.segment == segment] for segment in range(self.segments)]
        return np.stack([[points.min(axis=0), points.max(axis=0)] for points in own])


def build_grid(
    centres: FloatArray, marker_segment: IntArray, marker_local: FloatArray, points: tuple[int, int] = (5, 9)
) -> PointGrid:
    """Return the grid over the box of each segment's joints and markers (M, 2), m, with a margin for flesh."""
    segments = len(centres) + 1
    boxes = []
    for segment in range(segments):
        markers = marker_local[marker_segment == segment].reshape(-1, 2)
        known = np.concatenate([np.zeros((1, 2)), markers, centres[segment : segment + 1]])
        low, high = known.min(axis=0), known.max(axis=0)
        flesh = max(_LEAST_FLESH, _FLESH * float(np.max(high - low)))
        low, high = low - flesh, high + flesh
        # `points` are the numbers of points along the short and the long side
        counts = points if high[1] - low[1] >= high[0] - low[0] else points[::-1]
        x, y = (np.linspace(low[i], high[i], counts[i]) for i in (0, 1))
        boxes.append(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2))
    return PointGrid(np.repeat(np.arange(segments), [len(box) for box in boxes]), np.concatenate(boxes), segments)


_ACCURACIES = (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)  # OSQP's tolerance in each round, relative to the residual
_MOST_ITERATIONS = 20_000  # largest number of iterations in a round
_EQUAL, _EVEN = 1e5, 1e-3  # weights of the base parameters and of evenly spread masses, relative to the target


@dataclass(frozen=True)
class GridBodies:
    """Bodies of point masses at given points; the numbers that describe a body are its p masses, kg."""

    mapping: FloatArray  # (b, p) matrix B from masses to base parameters

    def measure_violation(self, body: FloatArray) -> float:
        """Return the magnitude of the most negative mass, relative to the largest."""
        return abs(float(body.min(initial=0.0))) / max(float(np.abs(body).max(initial=0.0)), 1e-300)

    def mass(self, body: FloatArray) -> float:
        return float(np.abs(body).sum())

    def find_cheapest(self, prices: FloatArray) -> FloatArray:
        """Return bodies (p, p) with 1 kg at one point each, whatever the prices are."""
        return np.eye(len(prices))


def solve_osqp(problem: CompressedProblem, moments: FloatArray) -> SolverAnswer:
    """Fit point masses with OSQP, given B = M P (b, p) of eq. 4.25; the problem must have no free parameters."""
    mapped = problem.factor @ moments
    masses, status, iterations = np.zeros(moments.shape[1]), "not run", 0
    for accuracy in _ACCURACIES:
        target = problem.target - mapped @ masses
        step, status, used = run_osqp(mapped, target, -masses, accuracy=accuracy)
        iterations += used
        moved = np.maximum(masses + step, 0.0)
        if problem.cost(moments @ moved) < problem.cost(moments @ masses):
            masses = moved
        if check_optimality(problem, GridBodies(moments), masses).excess <= _ENOUGH:
            break
    optimality = check_optimality(problem, GridBodies(moments), masses)
    return SolverAnswer("osqp", masses, problem.cost(moments @ masses), optimality, status, iterations)


def solve_nnls(problem: CompressedProblem, moments: FloatArray) -> SolverAnswer:
    """Fit the point masses by non-negative least squares; the arguments are those of :func:`solve_osqp`."""
    points = moments.shape[1]
    status = "solved"
    try:
        masses = np.asarray(nnls(problem.factor @ moments, problem.target, maxiter=50 * points)[0], dtype=np.float64)
    except RuntimeError as error:
        masses, status = np.full(points, np.nan), str(error)
    optimality = check_optimality(problem, GridBodies(moments), masses)
    return SolverAnswer("nnls", masses, problem.cost(moments @ masses), optimality, status)


def run_osqp(
    mapped: FloatArray,
    target: FloatArray,
    least: FloatArray,
    *,
    accuracy: float,
    iterations: int = _MOST_ITERATIONS,
) -> tuple[FloatArray, str, int]:
    """Minimise ‖y - target‖² over ρ ≥ least and y = mapped · ρ with one run of OSQP, scaled to order one.

    Return ρ (p,), kg, within OSQP's tolerances, ``accuracy`` relative to the target, or zero without a solution; OSQP's
    status text; and the number of iterations.
    """
    import osqp  # noqa: PLC0415  rarely needed

    base, points = mapped.shape
    length = max(float(np.linalg.norm(target)), 1e-300)
    size = max(float(np.linalg.norm(mapped, axis=0).max(initial=0.0)), 1e-300)
    link = sparse.hstack([sparse.csc_matrix(-mapped / size), sparse.identity(base)])
    bounds = sparse.hstack([sparse.identity(points), sparse.csc_matrix((points, base))])
    solver = osqp.OSQP()
    solver.setup(
        P=sparse.block_diag([sparse.csc_matrix((points, points)), sparse.identity(base)], format="csc"),
        q=np.concatenate([np.zeros(points), -target / length]),
        A=sparse.vstack([link, bounds], format="csc"),
        l=np.concatenate([np.zeros(base), np.maximum(least * (size / length), -1e20)]),
        u=np.concatenate([np.zeros(base), np.full(points, np.inf)]),
        eps_abs=accuracy,
        eps_rel=accuracy,
        max_iter=iterations,
        polishing=True,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    masses = np.asarray(result.x[:points], dtype=np.float64) * (length / size)
    return np.where(np.isfinite(masses), masses, 0.0), str(result.info.status), int(result.info.iter)


def spread_masses(
    moments: FloatArray, fitted: FloatArray, full_moments: FloatArray, target: FloatArray, scale: FloatArray
) -> FloatArray:
    """Return the point masses (p,) with given base parameters whose full parameters are closest to a target.

    The data determine only B ρ, with B = ``moments`` (b, p) and the fitted ρ ≥ 0 (p,). A penalty within the fit would
    change B ρ. Here B ρ is constant, because its weight is 1e5 times that of the ``target`` (f,) of the full parameters
    P ρ, with P = ``full_moments`` (f, p) and the standard deviations ``scale`` (f,). Without a target (NaN), the masses
    are spread evenly. NumericalError is raised if the active-set method does not converge.
    """
    aimed, base = np.isfinite(target), moments @ fitted
    total = float(fitted.sum()) or 1.0
    size = np.maximum(np.abs(moments).max(axis=1), 1e-12)
    even = _EVEN * np.eye(moments.shape[1]) / total
    rows = np.vstack([_EQUAL * moments / size[:, None], full_moments[aimed] / scale[aimed, None], even])
    aims = np.concatenate([_EQUAL * base / size, target[aimed] / scale[aimed], np.zeros(moments.shape[1])])
    try:
        return np.asarray(nnls(rows, aims, maxiter=50 * rows.shape[1])[0], dtype=np.float64)
    except RuntimeError as error:
        raise NumericalError(
            f"the {rows.shape[1]} point masses could not be distributed: {error}; check the chain for two joints at "
            "the same position, or for wrong units"
        ) from error


_TOLERABLE = 1e-3  # largest relative distance to the least cost with which a solution is accepted


def fit_consistent(
    problem: CompressedProblem,
    regrouping: FloatArray,
    grid: PointGrid,
    reference: FloatArray,
    *,
    consistency: Consistency = "grid",
    relative_sd: float = 0.15,
) -> Solution:
    """Minimise ‖R [M φ; c] - d‖² over possible bodies φ and free parameters c.

    The problem has b + k columns, and M is ``regrouping`` (b, 4(n + 1)) of eq. 4.24. ``reference`` (4(n + 1),) are full
    parameters to approach, as far as the problem does not determine them, NaN for none; ``relative_sd`` is their
    standard deviation, relative to each parameter's size. NumericalError is raised if no solver's solution is close
    enough to the least cost.
    """
    small, full_moments = problem.eliminate_others(len(regrouping)), grid.moments()
    moments = regrouping @ full_moments
    bodies: BodyCone = _choose_bodies(regrouping, grid, consistency)
    used: Consistency = "grid"

    def spread(answer: SolverAnswer) -> FloatArray:
        scale = compute_reference_sd(reference, relative_sd)
        return spread_masses(moments, answer.body, full_moments, reference, scale)

    # the best body in the cone, if its optimality is proven
    answer, masses = None, np.full(full_moments.shape[1], np.nan)
    if isinstance(bodies, ConeBodies):
        links = solve_links(small, bodies)
        if links.optimality.proven:
            answer, used, aim = links, consistency, reference
            if not np.isfinite(aim).all():
                aim = np.where(np.isfinite(aim), aim, full_moments @ spread(_fit_point_masses(small, moments)))
            full = find_closest_links(bodies, links.body, aim, compute_reference_sd(aim, relative_sd))
    # otherwise, the best point masses on the grid
    if answer is None:
        bodies, answer = GridBodies(moments), _fit_point_masses(small, moments)
        masses = spread(answer)
        full = full_moments @ masses
    # the solution is checked on the whole problem
    parameters = problem.complete(bodies.mapping @ answer.body)
    optimality = check_optimality(problem, bodies, answer.body, parameters[len(bodies.mapping) :])
    free = problem.cost(problem.free_solution())
    return Solution(
        requested=consistency,
        consistency=used,
        parameters=parameters,
        full=full,
        masses=masses,
        answer=replace(answer, optimality=optimality),
        price=max(answer.cost - free, 0.0) / problem.floor(free),
    )


def fit_quickly(
    problem: CompressedProblem, regrouping: FloatArray, grid: PointGrid, consistency: Consistency
) -> FloatArray:
    """Return only the parameters (b + k,) of :func:`fit_consistent`, faster if the solution is proven to be optimal."""
    small, bodies = problem.eliminate_others(len(regrouping)), _choose_bodies(regrouping, grid, consistency)
    answer = solve_nnls(small, bodies.mapping) if isinstance(bodies, GridBodies) else solve_links(small, bodies)
    if answer.optimality.proven:
        return problem.complete(bodies.mapping @ answer.body)
    nowhere = np.full(regrouping.shape[1], np.nan)
    return fit_consistent(problem, regrouping, grid, nowhere, consistency=consistency).parameters


def _choose_bodies(regrouping: FloatArray, grid: PointGrid, consistency: Consistency) -> GridBodies | ConeBodies:
    if consistency == "grid":
        return GridBodies(regrouping @ grid.moments())
    return ConeBodies(regrouping, grid.boxes() if consistency == "bounded-cone" else None)


def _fit_point_masses(problem: CompressedProblem, moments: FloatArray) -> SolverAnswer:
    """Return the proven solution of non-negative least squares, or else the better of this and OSQP's."""
    first = solve_nnls(problem, moments)
    if first.optimality.proven:
        return first
    second = solve_osqp(problem, moments)
    excess = [answer.optimality.excess if np.isfinite(answer.cost) else np.inf for answer in (first, second)]
    if not min(excess) <= _TOLERABLE:
        raise NumericalError(
            f"the fit of point masses did not converge: the cost of {first.solver} ({first.status!r}) may be "
            f"{excess[0]:.1e} above the least cost, and that of {second.solver} ({second.status!r}) {excess[1]:.1e}; "
            f"the limit is {_TOLERABLE:.0e}. Check the chain for two joints at the same position, or for wrong units"
        )
    return first if excess[0] <= excess[1] else second
