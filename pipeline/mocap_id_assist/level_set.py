"""States that a joint with a spring reaches within a time, by level sets (thesis 7.4.2, eq. 7.12-7.20, corrected)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, find_runs
from mocap_id_assist.level_set_kernels import MarchOptions, StateRates, march
from mocap_id_assist.springs import OneJoint

CFL = 0.8
"""Time step as a fraction of the largest stable one."""


_PAD = 2
_CAP = 3.0  # largest computed χ, in radii of the initial set


@dataclass(frozen=True)
class JointDynamics:
    """Dynamics of a joint with a spring (eq. 7.17).

    ValueError is raised if the inertia is not positive, or the stiffness or damping is negative.
    """

    joint: OneJoint
    inertia: float  # I_T of arm and device about the joint, kg·m²
    stiffness: float = 0.0  # N·m/rad
    rest: float = 0.0  # rad
    damping: float = 0.0  # N·m·s/rad

    def __post_init__(self) -> None:
        if not self.inertia > 0:
            raise ValueError(f"the inertia is {self.inertia:g} kg·m²; expected more than 0")
        for name, value in (("stiffness", self.stiffness), ("damping", self.damping)):
            if not value >= 0:
                raise ValueError(f"the {name} is {value:g}; expected 0 or more")

    def drift(self, angle: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return the acceleration without the person's torque, rad/s²."""
        torque = self.joint.torque(angle, self.stiffness, self.rest) + self.damping * velocity
        return np.asarray(-torque / self.inertia)

    def equilibrium(self) -> float | None:
        """Return the stable equilibrium nearest to the middle of the limits, rad; None if there is none."""
        grid = np.linspace(self.joint.lower, self.joint.upper, 2001)
        value = self.joint.torque(grid, self.stiffness, self.rest)
        stable = np.flatnonzero((value[:-1] <= 0) & (value[1:] > 0))
        if not len(stable):
            return None
        root = grid[stable] - value[stable] * (grid[1] - grid[0]) / (value[stable + 1] - value[stable])
        middle = 0.5 * (self.joint.lower + self.joint.upper)
        return float(root[np.abs(root - middle).argmin()])

    def largest_speed(self) -> float:
        """Return an upper bound of the speed that the joint can reach from rest at the equilibrium, rad/s.

        The bound follows from the work of the full torque over the whole range, back and forth, and from the largest
        decrease of the potential energy.
        """
        grid = np.linspace(self.joint.lower, self.joint.upper, 721)
        force = self.joint.torque(grid, self.stiffness, self.rest)
        potential = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(grid))])
        start = self.equilibrium()
        level = potential.max() if start is None else float(np.interp(start, grid, potential))
        strength = max(abs(self.joint.torque_low), abs(self.joint.torque_high))
        work = 2 * strength * (self.joint.upper - self.joint.lower)
        return float(np.sqrt(2 * (max(level - potential.min(), 0.0) + work) / self.inertia))


@dataclass(frozen=True)
class Scheme:
    """Numerical scheme of the level-set equation."""

    angles: int = 121  # number of angles of the grid
    velocities: int = 121  # number of velocities of the grid; made odd, so that zero is one of them
    second_order: bool = True  # second order in space and time
    friedrichs: bool = False  # the Lax–Friedrichs Hamiltonian instead of Godunov's upwind one
    grows_only: bool = True  # compute the states reached within the time, not those reached exactly at the time
    radius: float = 2.0  # radius of the initial set, in steps of the grid


@dataclass(frozen=True)
class StateGrid:
    """Grid of states: evenly spaced angles (N,), rad, and velocities (M,), rad/s."""

    angle: FloatArray
    velocity: FloatArray

    @property
    def steps(self) -> FloatArray:
        """Steps (2,) of the grid, rad and rad/s."""
        return np.array([self.angle[1] - self.angle[0], self.velocity[1] - self.velocity[0]])


@dataclass(frozen=True)
class ReachableStates:
    """Reachable sets at K times."""

    grid: StateGrid
    times: tuple[float, ...]  # s
    values: FloatArray  # (K, N, M) level-set function χ; a state is reached where χ ≤ 0
    arrival: FloatArray  # (N, M) time at which each state is first reached, s; infinite if it is not reached


def make_grid(dynamics: JointDynamics, scheme: Scheme, horizon: float) -> StateGrid:
    """Return a grid of all angles of the joint and all velocities that are possible within ``horizon``, s."""
    joint = dynamics.joint
    angle = np.linspace(joint.lower, joint.upper, scheme.angles)
    widest = np.abs(dynamics.drift(angle, np.zeros_like(angle))).max()
    strength = max(abs(joint.torque_low), abs(joint.torque_high)) / dynamics.inertia
    top = 1.05 * min(dynamics.largest_speed(), (widest + strength) * horizon)
    return StateGrid(angle, np.linspace(-top, top, scheme.velocities | 1))


def compute_reachable_states(
    dynamics: JointDynamics, times: Sequence[float], scheme: Scheme = Scheme()
) -> ReachableStates:
    """Return the states within the joint's limits that can be reached from rest at the equilibrium.

    ``times``, s, are the ascending times for which the set is returned.

    ValueError is raised if there is no equilibrium within the limits, or the times do not ascend from 0.
    """
    at = dynamics.equilibrium()
    if at is None:
        raise ValueError("the joint has no stable equilibrium within its limits, from which the motion could start")
    grid = make_grid(dynamics, scheme, max(times))
    size = scheme.radius * grid.steps
    around = np.hypot((grid.angle - at)[:, None] / size[0], grid.velocity / size[1])
    edge = np.maximum(dynamics.joint.lower - grid.angle, grid.angle - dynamics.joint.upper)
    barrier = np.broadcast_to((edge / size[0])[:, None], around.shape)
    return solve_level_set(dynamics, grid, around - 1.0, barrier, times, scheme, _CAP)


def solve_level_set(  # noqa: PLR0917
    dynamics: JointDynamics,
    grid: StateGrid,
    first: FloatArray,
    barrier: FloatArray,
    times: Sequence[float],
    scheme: Scheme,
    cap: float = np.inf,
) -> ReachableStates:
    """Return the reachable sets at ``times``, s; χ is ``first`` (N, M) at time 0, and at least ``barrier`` (N, M).

    ValueError is raised if the times do not ascend from 0.
    """
    ends = np.array([0.0, *times])
    if np.any(np.diff(ends) <= 0):
        raise ValueError(f"the times {list(times)} do not ascend from 0")
    drift = dynamics.drift(grid.angle[:, None], grid.velocity)
    low = np.ascontiguousarray(drift + dynamics.joint.torque_low / dynamics.inertia)
    high = np.ascontiguousarray(drift + dynamics.joint.torque_high / dynamics.inertia)
    motion = StateRates(grid.velocity, low, high, grid.steps, np.minimum(barrier, cap))
    method = MarchOptions(CFL, cap, scheme.second_order, scheme.friedrichs, scheme.grows_only)
    padded = np.pad(np.minimum(np.maximum(first, barrier), cap), _PAD)
    arrival = np.where(padded[_PAD:-_PAD, _PAD:-_PAD] <= 0, 0.0, np.inf)
    values = []
    for begin, end in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        march(padded, arrival, motion, method, begin, end)
        values.append(padded[_PAD:-_PAD, _PAD:-_PAD].copy())
    return ReachableStates(grid, tuple(times), np.stack(values), arrival)


def find_reached_and_held(
    dynamics: JointDynamics, reached: ReachableStates, index: int = -1
) -> list[tuple[float, float]]:
    """Return the intervals of angles, rad, reached at rest until ``times[index]`` that can then be held (eq. 7.8)."""
    grid, joint = reached.grid, dynamics.joint
    x, y = grid.angle, reached.values[index][:, len(grid.velocity) // 2]

    def crossing(inner: int, outer: int) -> float:
        if not 0 <= outer < len(x):
            return float(x[inner])
        return float(x[inner] + (x[outer] - x[inner]) * y[inner] / (y[inner] - y[outer]))

    # the intervals in which the piecewise linear curve through the points is 0 or less
    negative = [(crossing(run.start, run.start - 1), crossing(run.stop - 1, run.stop)) for run in find_runs(y <= 0)]
    return sorted(
        (max(a, c), min(b, d))
        for a, b in negative
        for c, d in joint.held_intervals(dynamics.stiffness, dynamics.rest)
        if max(a, c) < min(b, d)
    )
