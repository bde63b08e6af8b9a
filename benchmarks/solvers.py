"""Accuracy and time of every solver of the constrained least squares of ``identify-dim``.

All solvers get the same problems: random problems, problems of simulated trials and, with MOCAP_ID_RECORDINGS, problems
of real trials. It takes about two minutes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any
from unittest import mock

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import clarabel
import numpy as np
import osqp
from harness import (
    describe_source,
    find_recordings,
    format_table,
    make_parser,
    publish,
    temporary_folder,
    write_real_trial,
)
from scipy import sparse

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.dynamics import consistency, identification
from mocap_id.dynamics.consistency import (
    ConeBodies,
    GridBodies,
    PointGrid,
    SolverAnswer,
    build_grid,
    check_optimality,
    run_osqp,
    solve_links,
    solve_nnls,
    solve_osqp,
)
from mocap_id.dynamics.regressor import CompressedProblem, structural_base
from mocap_id.runner import run
from mocap_id_simulation import Options, simulate

FIRST = 940_000  # seed
REPEATS = 5
ONCE, ITERATIONS = 1e-8, 200_000  # OSQP without corrections
REAL = ("STS1", "squats1")


@dataclass(frozen=True)
class Case:
    name: str
    problem: CompressedProblem
    regrouping: FloatArray  # (b, f) M
    grid: PointGrid

    @property
    def moments(self) -> FloatArray:
        """Matrix B = M P from the masses of the grid to the base parameters."""
        return self.regrouping @ self.grid.moments()


def draw_case(seed: int) -> Case:
    rng = np.random.default_rng([FIRST, seed])
    joints = int(rng.integers(1, 5))
    centres = np.column_stack([rng.uniform(-0.1, 0.1, joints), rng.uniform(0.1, 0.5, joints)])
    segment = np.repeat(np.arange(joints + 1), 4)
    local = rng.uniform([-0.15, 0.0], [0.15, 0.6], size=(len(segment), 2))
    grid = build_grid(centres, segment, local)
    regrouping = structural_base(centres).regrouping
    base = regrouping @ grid.moments() @ rng.exponential(0.3, len(grid.segment))
    if seed % 2:
        base = base * rng.uniform(0.3, 1.7, len(base))
    rows = rng.normal(size=(600, len(base))) * 10 ** rng.uniform(-0.5, 0.5, len(base))
    wrench = rows @ base
    noise = wrench.std() * 10 ** rng.uniform(-2, -0.5)
    target = (wrench + noise * rng.normal(size=600)) / noise
    return Case(f"random {seed}", CompressedProblem.of(rows / noise, target), regrouping, grid)


def read_case(yaml: Path, name: str) -> Case:
    """Return the last constrained problem of a trial's identification."""
    found: list[Case] = []

    def note(problem: CompressedProblem, regrouping: FloatArray, grid: PointGrid, *rest: Any, **keys: Any) -> Any:
        found.append(Case(name, problem.eliminate_others(len(regrouping)), regrouping, grid))
        return consistency.fit_consistent(problem, regrouping, grid, *rest, **keys)

    with mock.patch.object(identification, "fit_consistent", note):
        run(load(yaml))
    return found[-1]


def solve_osqp_once(case: Case) -> SolverAnswer:
    """Solve the split form without corrections, at 1e-8."""
    mapped = case.problem.factor @ case.moments
    nothing = np.zeros(mapped.shape[1])
    masses, status, iterations = run_osqp(mapped, case.problem.target, nothing, accuracy=ONCE, iterations=ITERATIONS)
    return check_answer(case, "osqp, once", np.maximum(masses, 0.0), status, iterations)


def solve_osqp_dense(case: Case, accuracy: float = ONCE) -> SolverAnswer:
    """Solve for the masses with a dense quadratic form."""
    mapped = case.problem.factor @ case.moments
    solver = osqp.OSQP()
    solver.setup(
        P=sparse.csc_matrix(np.triu(mapped.T @ mapped)),
        q=-mapped.T @ case.problem.target,
        A=sparse.identity(mapped.shape[1], format="csc"),
        l=np.zeros(mapped.shape[1]),
        u=np.full(mapped.shape[1], np.inf),
        eps_abs=accuracy,
        eps_rel=accuracy,
        max_iter=ITERATIONS,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    return check_answer(case, "osqp, dense", np.maximum(result.x, 0.0), str(result.info.status), int(result.info.iter))


def solve_clarabel(case: Case) -> SolverAnswer:
    """Solve for the masses and the mapped masses by Clarabel."""
    mapped = case.problem.factor @ case.moments
    base, points = mapped.shape
    size, length = np.linalg.norm(mapped, axis=0).max(), max(np.linalg.norm(case.problem.target), 1e-300)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(np.diag(np.repeat([0.0, 1.0], [points, base]))),
        np.concatenate([np.zeros(points), -case.problem.target / length]),
        sparse.csc_matrix(np.block([[mapped / size, -np.eye(base)], [-np.eye(points), np.zeros((points, base))]])),
        np.zeros(base + points),
        [clarabel.ZeroConeT(base), clarabel.NonnegativeConeT(points)],
        settings,
    ).solve()
    masses = np.maximum(np.asarray(solution.x[:points]), 0.0) * length / size
    return check_answer(case, "clarabel", masses, str(solution.status), int(solution.iterations))


def check_answer(case: Case, solver: str, masses: FloatArray, status: str, iterations: int) -> SolverAnswer:
    cost = case.problem.cost(case.moments @ masses)
    optimality = check_optimality(case.problem, GridBodies(case.moments), masses)
    return SolverAnswer(solver, masses, cost, optimality, status, iterations)


ON_GRID: Mapping[str, Callable[[Case], SolverAnswer]] = {
    "OSQP, split": lambda case: solve_osqp(case.problem, case.moments),
    "OSQP, split, once": solve_osqp_once,
    "OSQP, dense": solve_osqp_dense,
    "OSQP, dense, 1e-3": lambda case: solve_osqp_dense(case, 1e-3),
    "NNLS": lambda case: solve_nnls(case.problem, case.moments),
    "Clarabel": solve_clarabel,
}
TRUSTED = ("OSQP, split", "NNLS", "Clarabel")
EXACT: Mapping[str, Callable[[Case], SolverAnswer]] = {
    "Clarabel, bounded cone": lambda case: solve_links(case.problem, ConeBodies(case.regrouping, case.grid.boxes())),
    "Clarabel, cone": lambda case: solve_links(case.problem, ConeBodies(case.regrouping)),
}


@dataclass(frozen=True)
class Result:
    above: float  # relative excess over the lowest cost of the trusted solvers on the grid; for a cone the bound
    answer: SolverAnswer
    seconds: float


def measure(case: Case, repeats: int) -> dict[str, Result]:
    answers, seconds = {}, {}
    for name, solve in {**ON_GRID, **EXACT}.items():
        times = []
        for _ in range(repeats):
            start = perf_counter()
            answers[name] = solve(case)
            times.append(perf_counter() - start)
        seconds[name] = median(times)
    least = min(answers[name].cost for name in TRUSTED)
    results = {}
    for name, answer in answers.items():
        above = (answer.cost - least) / case.problem.floor(least) if name in ON_GRID else answer.optimality.excess
        results[name] = Result(above, answer, seconds[name])
    return results


def format_scientific(value: float) -> str:
    """Return two digits, and rounding errors as 0."""
    return "0" if abs(value) < 1e-15 else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e+")


def main() -> None:
    given = make_parser(__doc__, problems=200, trials=5).parse_args()
    random = [measure(draw_case(seed), 1) for seed in range(given.problems)]
    by_solver = []
    for name in random[0]:
        mine = [found[name] for found in random]
        above, kkt = [result.above for result in mine], [result.answer.optimality.excess for result in mine]
        proven = sum(result.answer.optimality.proven for result in mine)
        solved = sum(result.answer.status.lower() == "solved" for result in mine)
        costs = [format_scientific(value) for value in (median(above), max(above), max(kkt))]
        by_solver.append([name, *costs, f"{proven}", f"{solved}", f"{1e3 * median(r.seconds for r in mine):.1f}"])
    with temporary_folder() as place:
        cases, folder = [], find_recordings()
        for k in range(given.trials):
            kind = "robot" if k == given.trials - 1 else "sit-to-stand"
            yaml = simulate(kind, place / f"{k}", Options(seed=FIRST + k, repetitions=3))
            cases.append(read_case(yaml, f"simulated {kind}, seed {FIRST + k}"))
        for name in REAL if folder else ():
            yaml = write_real_trial(folder / "sit-to-stand" / name, place / f"{name}.yaml")
            cases.append(read_case(yaml, f"real, {name}"))
    by_trial, prices, excess = [], [], []
    for case in cases:
        found = measure(case, REPEATS)
        cells = [f"{format_scientific(each.above)} / {1e3 * each.seconds:.1f}" for each in found.values()]
        by_trial.append([case.name, *cells])
        free = case.problem.cost(case.problem.free_solution())
        costs = [found[name].answer.cost for name in ("OSQP, split", *EXACT)]  # the grid, and both cones
        above_free = [format_scientific(max(cost / free - 1, 0.0)) for cost in costs]
        beyond = [format_scientific(max(cost / costs[-1] - 1, 0.0)) for cost in costs[:2]]
        prices.append([case.name, *above_free, *beyond])
        excess.append(costs[0] / costs[1] - 1)
    head = ["solver", "excess cost: median", "largest", "bound, largest", "proven", "says solved", "ms"]
    price = ["trial", "grid", "bounded cone", "cone", "grid above cone", "bounded cone above cone"]
    sections = {
        "solvers-problems": describe_source(__file__, f"{given.problems} random problems"),
        "solvers-random": format_table(head, by_solver, numbers_from=1),
        "solvers-trials": f"Simulated trials: seeds {FIRST} to {FIRST + given.trials - 1}. Each cell: excess cost "
        "/ milliseconds.",
        "solvers-by-trial": format_table(["trial", *ON_GRID, *EXACT], by_trial, numbers_from=1),
        "solvers-constraint": format_table(price, prices, numbers_from=1),
        "solvers-grid": f"The grid of {np.bincount(cases[-1].grid.segment)[0]} points per segment is within "
        f"{format_scientific(max(excess))} of what masses anywhere in the same outlines achieve.",
    }
    publish(sections, write=given.write)


if __name__ == "__main__":
    main()
