"""Compiled time steps of the level-set equation of a joint (eq. 7.13 to 7.20, corrected).

χ_t + max[0, H(x, ∇χ)] = 0 with H = x₂ p₁ + max over the torques of p₂ (drift + torque / I). The reached set is χ ≤ 0;
it can only grow. Derivatives are one-sided: first order, or second order with limited differences (ENO). Time steps
follow Euler's or Heun's method; neither increases the total variation. The numerical Hamiltonian is Godunov's, which is
exact for a plane front, or the local Lax–Friedrichs one of eq. 7.15 with the full dissipation of H.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.compilation import compiled


class StateRates(NamedTuple):
    """Rates of change of the states on a grid of N angles and M velocities."""

    velocity: FloatArray  # (M,) rad/s
    slowest: FloatArray  # (N, M) least acceleration, rad/s²
    fastest: FloatArray  # (N, M) largest acceleration, rad/s²
    steps: FloatArray  # (2,) of the grid, rad and rad/s
    barrier: FloatArray  # (N, M) lower limit of χ: positive outside the joint's limits


class MarchOptions(NamedTuple):
    """Options of the numerical scheme."""

    cfl: float  # time step as a fraction of the largest stable one
    cap: float  # largest value of χ
    second_order: bool  # limited second differences, and Heun's steps
    friedrichs: bool  # Lax–Friedrichs
    grows_only: bool  # max[0, H] rather than H


@compiled
def fill_edges(padded: FloatArray) -> None:  # pragma: no cover
    """Extrapolate the values in ``padded`` (N + 4, M + 4) linearly beyond the grid, in place."""
    rows, columns = padded.shape
    for j in range(2, columns - 2):
        padded[1, j] = 2 * padded[2, j] - padded[3, j]
        padded[0, j] = 2 * padded[1, j] - padded[2, j]
        padded[rows - 2, j] = 2 * padded[rows - 3, j] - padded[rows - 4, j]
        padded[rows - 1, j] = 2 * padded[rows - 2, j] - padded[rows - 3, j]
    for i in range(rows):
        padded[i, 1] = 2 * padded[i, 2] - padded[i, 3]
        padded[i, 0] = 2 * padded[i, 1] - padded[i, 2]
        padded[i, columns - 2] = 2 * padded[i, columns - 3] - padded[i, columns - 4]
        padded[i, columns - 1] = 2 * padded[i, columns - 2] - padded[i, columns - 3]


@compiled
def _limit_slope(a: float, b: float) -> float:  # pragma: no cover
    """Return the number with the smaller absolute value if both have the same sign, otherwise 0."""
    if a * b <= 0.0:
        return 0.0
    return a if abs(a) < abs(b) else b


@compiled
def _one_sided_derivatives(
    before: float, left: float, right: float, after: float, second_order: bool
) -> tuple[float, float]:  # pragma: no cover
    """Return the left and right derivatives from four consecutive differences."""
    if not second_order:
        return left, right
    bend = right - left
    return left + 0.5 * _limit_slope(bend, left - before), right - 0.5 * _limit_slope(bend, after - right)


@compiled
def _friedrichs(
    x2: float, low: float, high: float, p1: tuple[float, float], p2: tuple[float, float]
) -> float:  # pragma: no cover
    """Return the Lax–Friedrichs Hamiltonian (eq. 7.15) with α of eq. 7.20."""
    middle = 0.5 * (p2[0] + p2[1])
    h = 0.5 * x2 * (p1[0] + p1[1]) + (middle * high if middle > 0 else middle * low)
    return h - 0.5 * abs(x2) * (p1[1] - p1[0]) - 0.5 * max(abs(low), abs(high)) * (p2[1] - p2[0])


@compiled
def _godunov(
    x2: float, low: float, high: float, p1: tuple[float, float], p2: tuple[float, float]
) -> float:  # pragma: no cover
    """Return Godunov's Hamiltonian: each term takes the derivative from its upwind side."""
    h = x2 * p1[0] if x2 > 0 else x2 * p1[1]
    if low > 0:
        return h + (p2[0] * high if p2[0] > 0 else p2[0] * low)
    if high < 0:
        return h + (p2[1] * high if p2[1] > 0 else p2[1] * low)
    return h + max(max(p2[0], 0.0) * high, min(p2[1], 0.0) * low)


@compiled
def advance_levels(
    padded: FloatArray, out: FloatArray, motion: StateRates, method: MarchOptions, dt: float
) -> float:  # pragma: no cover
    """Compute one Euler step of ``dt``, s, and return the largest rate at which a state crosses a node, 1/s.

    ``padded`` (N + 4, M + 4) is χ with two additional values beyond every edge. The inner part of ``out``, which has
    the same shape, receives the result. Nodes are skipped if χ is at the cap there and at its neighbours, because no
    front is near.
    """
    by1, by2, cap = 1.0 / motion.steps[0], 1.0 / motion.steps[1], method.cap
    velocity, slowest, fastest = motion.velocity, motion.slowest, motion.fastest
    second_order, friedrichs, grows_only = method.second_order, method.friedrichs, method.grows_only
    rate = 0.0
    for a in range(2, padded.shape[0] - 2):
        for b in range(2, padded.shape[1] - 2):
            here, west, east = padded[a, b], padded[a - 1, b], padded[a + 1, b]
            south, north = padded[a, b - 1], padded[a, b + 1]
            if here >= cap and west >= cap and east >= cap and south >= cap and north >= cap:
                out[a, b] = here
                continue
            before, after = (west - padded[a - 2, b]) * by1, (padded[a + 2, b] - east) * by1
            p1 = _one_sided_derivatives(before, (here - west) * by1, (east - here) * by1, after, second_order)
            before, after = (south - padded[a, b - 2]) * by2, (padded[a, b + 2] - north) * by2
            p2 = _one_sided_derivatives(before, (here - south) * by2, (north - here) * by2, after, second_order)
            x2, low, high = velocity[b - 2], slowest[a - 2, b - 2], fastest[a - 2, b - 2]
            rate = max(rate, abs(x2) * by1 + max(abs(low), abs(high)) * by2)
            h = _friedrichs(x2, low, high, p1, p2) if friedrichs else _godunov(x2, low, high, p1, p2)
            if grows_only and h < 0:
                h = 0.0
            out[a, b] = here - dt * h
    return rate


@compiled
def _store_step(  # noqa: PLR0917
    padded: FloatArray, new: FloatArray, arrival: FloatArray, motion: StateRates, time: float, dt: float, heun: bool
) -> None:  # pragma: no cover
    """Store new values, at least the barrier, in ``padded``, and the times of states first reached in ``arrival``."""
    for i in range(arrival.shape[0]):
        for j in range(arrival.shape[1]):
            before = padded[i + 2, j + 2]
            after = 0.5 * (before + new[i + 2, j + 2]) if heun else new[i + 2, j + 2]
            after = max(after, motion.barrier[i, j])
            if after <= 0.0 and before > 0.0 and arrival[i, j] == np.inf:
                arrival[i, j] = time + dt * before / (before - after)
            padded[i + 2, j + 2] = after


@compiled
def march(  # noqa: PLR0917
    padded: FloatArray, arrival: FloatArray, motion: StateRates, method: MarchOptions, start: float, end: float
) -> int:  # pragma: no cover
    """Advance χ in place from time ``start`` to ``end``, s, and return the number of steps.

    ``padded`` is as for :func:`advance_levels`. ``arrival`` (N, M) receives the time, s, at which each state is first
    reached. The length of a step follows from the rates near the front; it is reduced if the front meets faster states.
    """
    first, second = padded.copy(), padded.copy()
    time, taken = start, 0
    fill_edges(padded)
    rate = advance_levels(padded, first, motion, method, 0.0)
    while end - time > 1e-12 * end:
        dt = end - time if rate == 0.0 else min(end - time, method.cfl / rate)
        fill_edges(padded)
        rate = advance_levels(padded, first, motion, method, dt)
        if method.second_order:
            fill_edges(first)
            rate = max(rate, advance_levels(first, second, motion, method, dt))
        if rate * dt > 1.0:
            continue
        _store_step(padded, second if method.second_order else first, arrival, motion, time, dt, method.second_order)
        time += dt
        taken += 1
    return taken
