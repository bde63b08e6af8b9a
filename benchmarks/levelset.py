"""Time of a level set solution beside the ``hj_reachability`` package: ``python benchmarks/levelset.py [NODES]``.

It needs ``hj_reachability`` (with jax, on the CPU), which is not a dependency of this program. Both compute the states
that the joint of docs/prescribe.md reaches within 2 s, on the same grid, with their second-order schemes. The first
call of each, which compiles, does not count. Prints the shortest time, the ratio, and how much the two sets differ.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from mocap_id_assist.level_set import (
    JointDynamics,
    Scheme,
    StateGrid,
    compute_reachable_states,
    make_grid,
    solve_level_set,
)
from mocap_id_assist.springs import OneJoint

HORIZON = 2.0
WEIGHT, INERTIA, STIFFNESS, REST = 3.43 * 9.81 * 0.30, 0.43, 4.297, np.radians(210)


def main() -> None:
    nodes = int(sys.argv[1]) if len(sys.argv) > 1 else 101
    # the thesis's arm with a fifth of the required strength, and its spring
    limits = np.radians([-60, 180])
    one = OneJoint(WEIGHT, 0.0, float(limits[0]), float(limits[1]), -0.2 * WEIGHT, 0.2 * WEIGHT)
    dynamics, scheme = JointDynamics(one, INERTIA, STIFFNESS, float(REST)), Scheme(nodes, nodes)
    grid = make_grid(dynamics, scheme, HORIZON)
    at = dynamics.equilibrium()
    assert at is not None
    size = Scheme().radius * grid.steps
    # the initial χ: a small ellipse about the equilibrium
    first = np.hypot((grid.angle - at)[:, None] / size[0], grid.velocity / size[1]) - 1.0
    free = np.full((len(grid.angle), len(grid.velocity)), -np.inf)

    def least(call: Callable[[], Any]) -> tuple[float, Any]:
        """Return the shortest wall time of five calls, s, and the result."""
        result, times = call(), []
        for _ in range(5):
            start = time.perf_counter()
            result = call()
            times.append(time.perf_counter() - start)
        return min(times), result

    whole, plain = least(lambda: solve_level_set(dynamics, grid, first, free, (HORIZON,), scheme).values[-1])
    band, _ = least(lambda: compute_reachable_states(dynamics, (HORIZON,), scheme))
    other, values = least(theirs(grid, first))
    apart = float(np.mean((plain <= 0) != (values <= 0)) / np.mean(plain <= 0))
    print(f"grid {len(grid.angle)} x {len(grid.velocity)}, {HORIZON:g} s, shortest of 5:")
    print(f"  mocap-id, near the front       {band:.3f} s")
    print(f"  mocap-id, the whole grid       {whole:.3f} s")
    print(f"  hj_reachability, whole grid    {other:.3f} s")
    print(f"  ratio to mocap-id: {other / band:.1f} and {other / whole:.1f}")
    print(f"  the sets differ in {100 * apart:.1f} % of their states")


def theirs(grid: StateGrid, first: Any) -> Callable[[], Any]:
    """Return a function that computes the same set by ``hj_reachability``: backwards in time, with reversed motion."""
    import hj_reachability as hj  # noqa: PLC0415
    import jax.numpy as jnp  # noqa: PLC0415

    class Reversed(hj.ControlAndDisturbanceAffineDynamics):
        def __init__(self) -> None:
            none = hj.sets.Box(jnp.zeros(1), jnp.zeros(1))
            strength = jnp.array([0.2 * WEIGHT])
            super().__init__("min", "max", hj.sets.Box(-strength, strength), none)

        def open_loop_dynamics(self, state: Any, _time: Any) -> Any:
            torque = WEIGHT * jnp.sin(state[0]) + STIFFNESS * (state[0] - REST)
            return jnp.array([-state[1], torque / INERTIA])

        def control_jacobian(self, _state: Any, _time: Any) -> Any:
            return jnp.array([[0.0], [1.0 / INERTIA]])

        def disturbance_jacobian(self, _state: Any, _time: Any) -> Any:
            return jnp.zeros((2, 1))

    axes = (grid.angle, grid.velocity)
    corners = (jnp.array([axis[0] for axis in axes]), jnp.array([axis[-1] for axis in axes]))
    lattice = hj.Grid.from_lattice_parameters_and_boundary_conditions(
        hj.sets.Box(*corners), (len(grid.angle), len(grid.velocity))
    )
    settings = hj.SolverSettings.with_accuracy("medium", hamiltonian_postprocessor=hj.solver.backwards_reachable_tube)
    start, motion = jnp.array(first), Reversed()
    return lambda: np.asarray(hj.step(settings, motion, lattice, 0.0, start, -HORIZON, progress_bar=False))


if __name__ == "__main__":
    main()
