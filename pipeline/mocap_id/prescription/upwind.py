"""The compiled steps of the level-set equation of a joint (eq. 7.13 to 7.20, corrected).

χ_t + max[0, H(x, ∇χ)] = 0 with H = x₂ p₁ + max over the torques of p₂ (drift + torque / I). The set χ ≤ 0 is what was
reached; it can only grow. Derivatives come from one side (first order, or second order with limited differences, ENO),
time is stepped by Euler's or Heun's method (both keep the total variation from growing). The numerical Hamiltonian is
Godunov's, which is exact for a plane front, or the local Lax–Friedrichs one of eq. 7.15 with the whole of H's
dissipation.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.prescription.compiled import compiled

_PAD = 2


@compiled
def fill_edges(padded: FloatArray) -> None:  # pragma: no cover
    """Continue the padded values (N + 4, M + 4) linearly beyond the grid."""
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
def _limited(a: float, b: float) -> float:  # pragma: no cover
    """The smaller in size of two numbers of one sign, else 0."""
    if a * b <= 0.0:
        return 0.0
    return a if abs(a) < abs(b) else b


@compiled
def advance(  # noqa: PLR0917
    padded: FloatArray,
    out: FloatArray,
    velocity: FloatArray,
    slowest: FloatArray,
    fastest: FloatArray,
    steps: FloatArray,
    dt: float,
    cap: float,
    second_order: bool,
    friedrichs: bool,
    grows_only: bool,
) -> float:  # pragma: no cover
    """One Euler step; the largest rate at which anything crosses a node, 1/s.

    Where χ and its neighbours are at the cap nothing is computed: no front is near.

    Parameters
    ----------
    padded : (N + 4, M + 4) array
        χ with two values beyond every edge.
    out : (N + 4, M + 4) array
        Its inner part is written.
    velocity : (M,) array
        x₂, rad/s.
    slowest, fastest : (N, M) arrays
        Least and largest acceleration, rad/s².
    steps : (2,) array
        Of the grid, rad and rad/s.
    dt : float
        s.
    cap : float
        Largest value of χ.
    second_order, friedrichs, grows_only : bool
        Limited second differences; Lax–Friedrichs; max[0, H] rather than H.
    """
    rows, columns = slowest.shape
    by1, by2 = 1.0 / steps[0], 1.0 / steps[1]
    rate = 0.0
    for i in range(rows):
        a = i + 2
        for j in range(columns):
            b = j + 2
            here = padded[a, b]
            if (
                here >= cap
                and padded[a - 1, b] >= cap
                and padded[a + 1, b] >= cap
                and padded[a, b - 1] >= cap
                and padded[a, b + 1] >= cap
            ):
                out[a, b] = here
                continue
            left, right = (here - padded[a - 1, b]) * by1, (padded[a + 1, b] - here) * by1
            down, up = (here - padded[a, b - 1]) * by2, (padded[a, b + 1] - here) * by2
            if second_order:
                bend = right - left
                before, after = left - (padded[a - 1, b] - padded[a - 2, b]) * by1, 0.0
                after = (padded[a + 2, b] - padded[a + 1, b]) * by1 - right
                left += 0.5 * _limited(bend, before)
                right -= 0.5 * _limited(bend, after)
                bend = up - down
                before = down - (padded[a, b - 1] - padded[a, b - 2]) * by2
                after = (padded[a, b + 2] - padded[a, b + 1]) * by2 - up
                down += 0.5 * _limited(bend, before)
                up -= 0.5 * _limited(bend, after)
            x2, low, high = velocity[j], slowest[i, j], fastest[i, j]
            rate = max(rate, abs(x2) * by1 + max(abs(low), abs(high)) * by2)
            if friedrichs:
                p1, p2 = 0.5 * (left + right), 0.5 * (down + up)
                h = x2 * p1 + (p2 * high if p2 > 0 else p2 * low)
                h -= 0.5 * abs(x2) * (right - left) + 0.5 * max(abs(low), abs(high)) * (up - down)
            else:
                h = x2 * left if x2 > 0 else x2 * right
                if low > 0:
                    h += down * high if down > 0 else down * low
                elif high < 0:
                    h += up * high if up > 0 else up * low
                else:
                    h += max(max(down, 0.0) * high, min(up, 0.0) * low)
            if grows_only and h < 0:
                h = 0.0
            out[a, b] = here - dt * h
    return rate


@compiled
def march(  # noqa: PLR0917
    padded: FloatArray,
    arrival: FloatArray,
    barrier: FloatArray,
    velocity: FloatArray,
    slowest: FloatArray,
    fastest: FloatArray,
    steps: FloatArray,
    start: float,
    end: float,
    cfl: float,
    cap: float,
    second_order: bool,
    friedrichs: bool,
    grows_only: bool,
) -> int:  # pragma: no cover
    """Advance χ in place from one time to another; the number of steps.

    A step is as long as the front's own rates allow. It is cut where it turns out too long for what the front came
    upon.

    Parameters
    ----------
    padded, velocity, slowest, fastest, steps, second_order, friedrichs, grows_only
        As for :func:`advance`.
    arrival : (N, M) array
        When each state was first reached, s; infinite before.
    barrier : (N, M) array
        χ is never less: positive where the joint cannot go.
    start, end : float
        s.
    cfl : float
        Share of the largest stable step.
    cap : float
        As for :func:`advance`.
    """
    rows, columns = slowest.shape
    first, second = padded.copy(), padded.copy()
    time, taken, rate = start, 0, 0.0
    fill_edges(padded)
    rate = advance(padded, first, velocity, slowest, fastest, steps, 0.0, cap, second_order, friedrichs, grows_only)
    while time < end:
        dt = end - time if rate == 0.0 else min(end - time, cfl / rate)
        fill_edges(padded)
        found = advance(padded, first, velocity, slowest, fastest, steps, dt, cap, second_order, friedrichs, grows_only)
        if second_order:
            fill_edges(first)
            later = advance(
                first, second, velocity, slowest, fastest, steps, dt, cap, second_order, friedrichs, grows_only
            )
            found = max(found, later)
        if found * dt > 1.0:
            rate = found
            continue
        rate = found
        for i in range(rows):
            for j in range(columns):
                before = padded[i + 2, j + 2]
                after = 0.5 * (before + second[i + 2, j + 2]) if second_order else first[i + 2, j + 2]
                after = max(after, barrier[i, j])
                if after <= 0.0 and before > 0.0 and arrival[i, j] == np.inf:
                    arrival[i, j] = time + dt * before / (before - after)
                padded[i + 2, j + 2] = after
        time += dt
        taken += 1
        if end - time < 1e-12 * end:
            break
    return taken
