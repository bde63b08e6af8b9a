"""How near each solver comes to the least cost, and how long it takes: ``python benchmarks/solvers.py [--write PAGE]``.

The constrained least squares of ``identify-dim`` on random problems and on those of whole trials, fresh simulated ones
and, where MOCAP_ID_RECORDINGS names the folder of the recordings, a real sit-to-stand. Every solver sees the same
problems in one run. Prints docs/solvers.md, and with ``--write docs/solvers.md`` replaces that page. Some two minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
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
from scipy import sparse
from solvers_page import TEXT

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.dynamics import consistent, identify
from mocap_id.dynamics.base import structural_base
from mocap_id.dynamics.cone import ConeBodies
from mocap_id.dynamics.conic import solve_links
from mocap_id.dynamics.grid import PointGrid, segment_grid
from mocap_id.dynamics.optimality import Answer, check
from mocap_id.dynamics.point_masses import GridBodies, osqp_split, solve_nnls, solve_osqp
from mocap_id.dynamics.solve import Compressed
from mocap_id.runner import run
from mocap_id.workflows.simulate import Options, simulate

FRESH = 940_000  # the first seed; nothing was tuned on these
REPEATS = 5
ONCE, ITERATIONS = 1e-8, 200_000  # OSQP where it is asked once
REAL = ("STS1", "squats1")


@dataclass(frozen=True)
class Case:
    """A problem over base parameters, without free ones.

    Parameters
    ----------
    name : str
    problem : Compressed
    regrouping : (b, f) array
        M.
    grid : PointGrid
    """

    name: str
    problem: Compressed
    regrouping: FloatArray
    grid: PointGrid

    @property
    def moments(self) -> FloatArray:
        """B = M P."""
        return self.regrouping @ self.grid.moments()


def random_case(seed: int) -> Case:
    """A random chain, body and wrench."""
    rng = np.random.default_rng([FRESH, seed])
    joints = int(rng.integers(1, 5))
    centres = np.column_stack([rng.uniform(-0.1, 0.1, joints), rng.uniform(0.1, 0.5, joints)])
    segment = np.repeat(np.arange(joints + 1), 4)
    local = rng.uniform([-0.15, 0.0], [0.15, 0.6], size=(len(segment), 2))
    grid = segment_grid(centres, segment, local)
    regrouping = structural_base(centres).regrouping
    base = regrouping @ grid.moments() @ rng.exponential(0.3, len(grid.segment))
    if seed % 2:
        base = base * rng.uniform(0.3, 1.7, len(base))
    rows = rng.normal(size=(600, len(base))) * 10 ** rng.uniform(-0.5, 0.5, len(base))
    wrench = rows @ base
    noise = wrench.std() * 10 ** rng.uniform(-2, -0.5)
    target = (wrench + noise * rng.normal(size=600)) / noise
    return Case(f"random {seed}", Compressed.of(rows / noise, target), regrouping, grid)


def trial_case(yaml: Path, name: str) -> Case:
    """The problem that a trial's identification ends in."""
    found: list[Case] = []

    def note(problem: Compressed, regrouping: FloatArray, grid: PointGrid, *rest: Any, **keys: Any) -> Any:
        found.append(Case(name, problem.over(len(regrouping)), regrouping, grid))
        return consistent.fit_consistent(problem, regrouping, grid, *rest, **keys)

    with mock.patch.object(identify, "fit_consistent", note):
        run(load(yaml))
    return found[-1]


def osqp_once(case: Case) -> Answer:
    """The split form in one go at 1e-8."""
    mapped = case.problem.factor @ case.moments
    nothing = np.zeros(mapped.shape[1])
    masses, status, iterations = osqp_split(mapped, case.problem.target, nothing, accuracy=ONCE, iterations=ITERATIONS)
    return grid_answer(case, "osqp, once", np.maximum(masses, 0.0), status, iterations)


def osqp_dense(case: Case, accuracy: float = ONCE) -> Answer:
    """The masses alone as variables, and the product as the quadratic form."""
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
    return grid_answer(case, "osqp, dense", np.maximum(result.x, 0.0), str(result.info.status), int(result.info.iter))


def clarabel_grid(case: Case) -> Answer:
    """Clarabel over the masses and the mapped masses."""
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
    return grid_answer(case, "clarabel", masses, str(solution.status), int(solution.iterations))


def grid_answer(case: Case, solver: str, masses: FloatArray, status: str, iterations: int) -> Answer:
    """An answer with its own check."""
    cost = case.problem.cost(case.moments @ masses)
    return Answer(solver, masses, cost, check(case.problem, GridBodies(case.moments), masses), status, iterations)


def outlines(case: Case) -> ConeBodies:
    """The cone within the grid's outlines."""
    return ConeBodies(case.regrouping, case.grid.boxes())


ON_GRID: Mapping[str, Callable[[Case], Answer]] = {
    "OSQP, split": lambda case: solve_osqp(case.problem, case.moments),
    "OSQP, split, once": osqp_once,
    "OSQP, dense": osqp_dense,
    "OSQP, dense, 1e-3": lambda case: osqp_dense(case, 1e-3),
    "NNLS": lambda case: solve_nnls(case.problem, case.moments),
    "Clarabel": clarabel_grid,
}
TRUSTED = ("OSQP, split", "NNLS", "Clarabel")
EXACT: Mapping[str, Callable[[Case], Answer]] = {
    "Clarabel, bounded cone": lambda case: solve_links(case.problem, outlines(case)),
    "Clarabel, cone": lambda case: solve_links(case.problem, ConeBodies(case.regrouping)),
}


@dataclass(frozen=True)
class Result:
    """One solver on one problem.

    Parameters
    ----------
    above : float
        Relative to the least cost that any trusted solver found on the grid; for a cone the bound.
    answer : Answer
    seconds : float
    """

    above: float
    answer: Answer
    seconds: float


def timed(solve: Callable[[Case], Answer], case: Case, repeats: int) -> tuple[Answer, float]:
    """An answer, and the median time to it."""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        answer = solve(case)
        times.append(perf_counter() - start)
    return answer, median(times)


def measure(case: Case, repeats: int) -> dict[str, Result]:
    """Every solver on one problem."""
    found = {name: timed(solve, case, repeats) for name, solve in {**ON_GRID, **EXACT}.items()}
    least = min(found[name][0].cost for name in TRUSTED)
    results = {}
    for name, (answer, seconds) in found.items():
        above = (answer.cost - least) / case.problem.floor(least) if name in ON_GRID else answer.optimality.excess
        results[name] = Result(above, answer, seconds)
    return results


def scientific(value: float) -> str:
    """Two figures; what is rounding as 0."""
    return "0" if abs(value) < 1e-15 else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e+")


def random_table(results: Sequence[Mapping[str, Result]]) -> str:
    """A row a solver."""
    head = ["solver", "above the least: median", "largest", "left to gain, largest", "proven", "says solved", "ms"]
    rows = []
    for name in results[0]:
        mine = [found[name] for found in results]
        above, kkt = [result.above for result in mine], [result.answer.optimality.excess for result in mine]
        rows.append(
            [
                name,
                scientific(median(above)),
                scientific(max(above)),
                scientific(max(kkt)),
                f"{sum(result.answer.optimality.proven for result in mine)}",
                f"{sum(result.answer.status.lower() == 'solved' for result in mine)}",
                f"{1e3 * median(result.seconds for result in mine):.1f}",
            ]
        )
    return markdown(head, rows)


def trial_table(cases: Sequence[Case], results: Sequence[Mapping[str, Result]]) -> str:
    """A row a trial."""
    names = list(results[0])
    rows = [
        [case.name, *(f"{scientific(found[name].above)} / {1e3 * found[name].seconds:.1f}" for name in names)]
        for case, found in zip(cases, results, strict=True)
    ]
    return markdown(["trial", *names], rows)


def price_table(cases: Sequence[Case], results: Sequence[Mapping[str, Result]]) -> str:
    """What the constraint costs, a row a trial."""
    rows = []
    for case, found in zip(cases, results, strict=True):
        free = case.problem.cost(case.problem.free_solution())
        costs = [found[name].answer.cost for name in ("OSQP, split", *EXACT)]
        prices = [scientific(max(cost / free - 1, 0.0)) for cost in costs]
        beyond = [scientific(max(cost / costs[-1] - 1, 0.0)) for cost in costs[:2]]
        rows.append([case.name, *prices, *beyond])
    head = ["trial", "grid", "bounded cone", "cone", "grid beyond the cone", "bounded cone beyond it"]
    return markdown(head, rows)


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def trials(count: int, place: Path) -> list[Case]:
    """Fresh simulated trials, and the real ones where there are recordings."""
    cases = []
    for k in range(count):
        kind = "robot" if k == count - 1 else "sit-to-stand"
        yaml = simulate(kind, place / f"{k}", Options(seed=FRESH + k, repetitions=3))
        cases.append(trial_case(yaml, f"simulated {kind}, seed {FRESH + k}"))
    recordings = os.environ.get("MOCAP_ID_RECORDINGS")
    if recordings:
        for name in REAL:
            source = Path(recordings).resolve() / "sit-to-stand" / name
            files = {"markers": f"{source}.trc", "forces": f"{source}_grf.mot"}
            yaml = place / f"{name}.yaml"
            yaml.write_text(json.dumps({"trial": name, "recording": files, "protocol": "sit-to-stand"}), "utf-8")
            cases.append(trial_case(yaml, f"real, {name}"))
    return cases


def page(count: int, simulated: int) -> str:
    """The whole page."""
    random = [measure(random_case(seed), 1) for seed in range(count)]
    with tempfile.TemporaryDirectory() as place:
        cases = trials(simulated, Path(place))
    results = [measure(case, REPEATS) for case in cases]
    names = ("OSQP, split", "Clarabel, bounded cone")
    gaps = [found[names[0]].answer.cost / found[names[1]].answer.cost - 1 for found in results]
    return TEXT.format(
        count=count,
        random=random_table(random),
        first=FRESH,
        last=FRESH + simulated - 1,
        trials=trial_table(cases, results),
        prices=price_table(cases, results),
        points=int(np.bincount(cases[-1].grid.segment)[0]),
        gap=scientific(max(gaps)),
    )


def main() -> None:
    """Measure, print and perhaps write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--random", type=int, default=200, help="random problems")
    parser.add_argument("--trials", type=int, default=5, help="simulated trials, the last of them a robot's")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="write the page there")
    arguments = parser.parse_args()
    text = page(arguments.random, arguments.trials)
    sys.stdout.write(text)
    if arguments.write:
        arguments.write.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
