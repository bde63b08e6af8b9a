"""Level sets against a closed form, against bang-bang trajectories, and against table 7.2 of the thesis."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import RegularGridInterpolator

from mocap_id_assist.files import SearchGrid
from mocap_id_assist.level_set import (
    JointDynamics,
    Scheme,
    StateGrid,
    compute_reachable_states,
    find_reached_and_held,
    solve_level_set,
)
from mocap_id_assist.prescriptions import ROWS_FILE, map_springs
from mocap_id_assist.springs import OneJoint

WEIGHT, INERTIA, STIFFNESS, REST = 3.43 * 9.81 * 0.30, 0.43, 4.297, float(np.radians(210))
SECOND, FIRST = Scheme(second_order=True, grows_only=False), Scheme(second_order=False, grows_only=False)


def weak_arm(strength: float = 0.2) -> OneJoint:
    low, high = np.radians([-60.0, 180.0]).tolist()
    return OneJoint(WEIGHT, 0.0, low, high, -strength * WEIGHT, strength * WEIGHT)


def arm() -> JointDynamics:
    return JointDynamics(weak_arm(), INERTIA, STIFFNESS, REST)


def radius_needed(states: np.ndarray, time: float) -> np.ndarray:
    """Radius of the ball about 0 from which a double integrator with |u| ≤ 1 is at each state at a time, exactly.

    The reachable set has the support function ρ |e^{Aᵀt} n| + ∫ |Bᵀ e^{Aᵀs} n| ds.
    """
    turn = np.linspace(0, 2 * np.pi, 7201)[:-1]
    normal = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    before, after = normal[:, 1], normal[:, 1] + time * normal[:, 0]
    crossed = before * after < 0
    straight = 0.5 * np.abs(before + after) * time
    bent = (before**2 + after**2) / np.maximum(2 * np.abs(normal[:, 0]), 1e-12)
    pushed = np.where(crossed, bent, straight)
    return np.asarray(((states @ normal.T - pushed) / np.hypot(normal[:, 0], after)).max(axis=1))


def double_integrator_error(scheme: Scheme, nodes: int) -> float:
    """Mean error of χ = |x|² - ¼ after 0.6 s."""
    free = JointDynamics(OneJoint(1e-12, 0.0, -3.0, 3.0, -1.0, 1.0), 1.0)
    grid = StateGrid(np.linspace(-3, 3, nodes), np.linspace(-3, 3, nodes))
    first = grid.angle[:, None] ** 2 + grid.velocity**2 - 0.25
    found = solve_level_set(free, grid, first, np.full_like(first, -np.inf), (0.6,), scheme).values[-1]
    states = np.stack(np.meshgrid(grid.angle, grid.velocity, indexing="ij"), axis=-1).reshape(-1, 2)
    near = np.all(np.abs(states) <= 1.6, axis=1)
    radius = radius_needed(states[near], 0.6)
    ring = (radius > 0.3) & (radius < 1.0)
    return float(np.mean(np.abs(found.ravel()[near][ring] - (radius[ring] ** 2 - 0.25))))


@pytest.mark.slow
@pytest.mark.parametrize("friedrichs", [False, True])
@pytest.mark.parametrize(("second", "order"), [(True, 1.5), (False, 0.9)])
def test_the_error_falls_at_the_order_of_the_scheme(second: bool, order: float, friedrichs: bool) -> None:
    scheme = Scheme(second_order=second, friedrichs=friedrichs, grows_only=False)
    coarse, fine = double_integrator_error(scheme, 41), double_integrator_error(scheme, 81)
    assert np.log2(coarse / fine) > order
    assert fine < (0.004 if second else 0.06)


def extremes(dynamics: JointDynamics, time: float, size: tuple[float, float]) -> np.ndarray:
    """Ends (K, 2) of trajectories that push as Pontryagin's principle says, from an ellipse about the equilibrium."""
    at, strength = dynamics.equilibrium(), dynamics.joint.torque_high
    assert at is not None

    def motion(_: float, y: np.ndarray) -> list[float]:
        angle, velocity, p1, p2 = y
        torque = -WEIGHT * np.sin(angle) - STIFFNESS * (angle - REST) + strength * np.sign(p2)
        return [velocity, torque / INERTIA, p2 * (WEIGHT * np.cos(angle) + STIFFNESS) / INERTIA, -p1]

    ends = []
    for turn in np.linspace(0, 2 * np.pi, 41)[:-1]:
        c, s = np.cos(turn), np.sin(turn)
        start = [at + size[0] * c, size[1] * s, c / size[0], s / size[1]]
        ends.append(solve_ivp(motion, (0, time), start, rtol=1e-7, atol=1e-9, max_step=0.02).y[:2, -1])
    return np.array(ends)


def test_the_front_is_where_bang_bang_trajectories_end() -> None:
    dynamics, size, time = arm(), (0.15, 0.6), 0.8
    ends, at = extremes(dynamics, time, size), dynamics.equilibrium()

    def distance(scheme: Scheme, nodes: int) -> float:
        """Median distance of the front from the ends, rad, velocities by 5 rad/s."""
        grid = StateGrid(np.linspace(*np.radians([-60.0, 180.0]), nodes), np.linspace(-6, 6, nodes))
        first = np.hypot((grid.angle - at)[:, None] / size[0], grid.velocity / size[1]) - 1
        values = solve_level_set(dynamics, grid, first, np.full_like(first, -np.inf), (time,), scheme).values[-1]
        slopes = np.gradient(values, grid.angle, grid.velocity)
        here, by_angle, by_velocity = (
            RegularGridInterpolator((grid.angle, grid.velocity), each)(ends) for each in (values, *slopes)
        )
        return float(np.median(np.abs(here) / np.hypot(by_angle, 5 * by_velocity)))

    first = [distance(FIRST, nodes) for nodes in (61, 121)]
    second = [distance(SECOND, nodes) for nodes in (61, 121)]
    assert first[0] / first[1] > 1.7
    assert second[0] / second[1] > 3.0
    assert second[1] < 0.01


def test_table_7_2() -> None:
    dynamics, times = arm(), (1.0, 2.0, 3.0, 4.0)
    reached = compute_reachable_states(dynamics, times, Scheme(81, 81))
    held = dynamics.joint.held_intervals(STIFFNESS, REST)
    bounds = [find_reached_and_held(dynamics, reached, k) for k in range(len(times))]
    lower, upper = np.degrees([part[0][0] for part in bounds]), np.degrees([part[-1][1] for part in bounds])
    static = np.degrees([held[0][0], held[-1][1]])
    assert lower == pytest.approx(static[0], abs=0.1)
    assert np.all(np.diff(upper) >= 0)
    assert upper[0] < static[1] - 30
    assert upper[-1] == pytest.approx(static[1], abs=3.0)
    assert np.all(upper <= static[1] + 1e-6)
    # pushing upwards for 0.823 s and braking afterwards ends at rest at 137.43° after 1 s (integrated step by step)
    coarse = compute_reachable_states(dynamics, times, Scheme(41, 41))
    of_grid = abs(np.degrees(find_reached_and_held(dynamics, coarse, 0)[-1][1]) - upper[0])
    assert abs(upper[0] - 137.43) < of_grid
    assert np.degrees(held[0][1]) == pytest.approx(113.27, abs=0.01)  # the person can pass the angles
    assert np.degrees(held[1][0]) == pytest.approx(117.13, abs=0.01)  # between these, but not hold them


def test_what_was_reached_stays_and_the_limits_hold() -> None:
    reached = compute_reachable_states(arm(), (0.5, 1.0, 2.0), Scheme(61, 61))
    assert np.all(np.diff(reached.values, axis=0) <= 1e-12)
    known = np.isfinite(reached.arrival)
    assert known.sum() == (reached.values[-1] <= 0).sum()
    assert reached.arrival[known].max() <= 2.0
    inside = np.diff(reached.grid.angle[[0, -1]])
    assert inside == pytest.approx(np.radians(240.0))


@pytest.mark.parametrize("friedrichs", [False, True])
def test_a_stronger_person_reaches_more(friedrichs: bool) -> None:
    scheme = Scheme(61, 61, second_order=False, friedrichs=friedrichs)
    sizes = []
    for strength in (0.1, 0.2, 0.4):
        dynamics = JointDynamics(weak_arm(strength), INERTIA, STIFFNESS, REST)
        found = compute_reachable_states(dynamics, (1.0,), scheme)
        sizes.append((found.values[-1] <= 0).sum() * np.prod(found.grid.steps))
    assert sizes[0] < sizes[1] < sizes[2]


def test_a_damper_slows_the_front() -> None:
    free, damped = (JointDynamics(weak_arm(), INERTIA, STIFFNESS, REST, damping=d) for d in (0.0, 2.0))
    sizes = []
    for dynamics in (free, damped):
        found = compute_reachable_states(dynamics, (1.0,), Scheme(61, 61))
        sizes.append((found.values[-1] <= 0).sum() * np.prod(found.grid.steps))
    assert sizes[1] < 0.8 * sizes[0]


@pytest.mark.parametrize(
    ("changed", "told"),
    [({"inertia": 0.0}, "inertia"), ({"stiffness": -1.0}, "stiffness"), ({"damping": -1.0}, "damping")],
)
def test_dynamics_that_cannot_be(changed: dict[str, float], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        JointDynamics(weak_arm(), **({"inertia": 1.0} | changed))


def test_a_map_resumes_where_it_was_left(tmp_path) -> None:  # type: ignore[no-untyped-def]
    grid = SearchGrid(
        stiffness_mNm_per_deg=(25, 75, 25), rest_deg=(200, 320, 60), horizon_s=0.5, angles=41, velocities=41
    )
    told: list[str] = []

    def stopped(line: str) -> None:
        told.append(line)
        if len(told) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        map_springs(weak_arm(), INERTIA, grid, tmp_path, stopped)
    assert (tmp_path / ROWS_FILE).is_file()
    again = map_springs(weak_arm(), INERTIA, grid, tmp_path, told.append)
    assert len(told) == 3
    whole = map_springs(weak_arm(), INERTIA, grid, None, lambda line: None)
    np.testing.assert_array_equal(again.width, whole.width)
    assert np.nanmax(whole.width - whole.static) <= 1e-9
    other = map_springs(weak_arm(0.3), INERTIA, grid, tmp_path, lambda line: None)
    assert np.nansum(other.static) > np.nansum(whole.static)
