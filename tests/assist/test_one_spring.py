"""The spring of one joint: against a grid search of its own, against the figures of the thesis, and at its edges."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id_assist.springs import OneJoint, Prescription, find_least_spring, prescribe_spring

LOWER, UPPER = np.radians([-60.0, 180.0])


def joint(low: float, high: float, weight: float = 1.0, turned: float = 0.0) -> OneJoint:
    """Limits by the moment of gravity; ``turned`` shifts the angle that hangs down."""
    sine, cosine = weight * np.cos(turned), -weight * np.sin(turned)
    return OneJoint(sine, cosine, LOWER + turned, UPPER + turned, low * weight, high * weight)


def degrees(found: Prescription) -> list[float]:
    return np.degrees([found.rest, *found.range]).tolist()


def searched(one: OneJoint, required: tuple[float, ...] = ()) -> tuple[float, float, float]:
    """Range, stiffness and rest angle by trying springs, two degrees and a fiftieth apart."""
    angle = np.radians(np.arange(np.degrees(one.lower), np.degrees(one.upper) + 0.1, 0.25))
    asked = np.array([np.abs(angle - r).argmin() for r in required], dtype=int)
    best = (-1.0, 0.0, 0.0)
    for stiffness in np.arange(0.0, 1.2, 0.02) * one.weight:
        for rest in np.radians(np.arange(-360.0, 361.0, 2.0)) if stiffness else [0.0]:
            torque = one.gravity(angle) + stiffness * (angle - rest)
            held = (torque >= one.torque_low) & (torque <= one.torque_high)
            ends = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]])))
            for start, end in zip(ends[::2], ends[1::2], strict=True):
                width = angle[end - 1] - angle[start]
                if width > best[0] and np.all((asked >= start) & (asked < end)):
                    best = (float(width), float(stiffness), float(rest))
    return best


def test_a_fifth_of_the_strength() -> None:
    found = prescribe_spring(joint(-0.2, 0.2))
    assert found.helps
    assert found.stiffness == pytest.approx(0.445, rel=0.01)
    assert degrees(found) == pytest.approx([206.0, 64.3, 179.8], abs=0.5)
    assert np.degrees(found.without or ()) == pytest.approx([-11.537, 11.537], abs=1e-3)


def test_half_the_strength() -> None:
    found = prescribe_spring(joint(-0.5, 0.5))
    assert found.stiffness == pytest.approx(0.11, abs=0.005)
    assert np.degrees(found.range) == pytest.approx([9.4, 180.0], abs=0.5)
    assert np.ptp(found.range) >= np.radians(180.0 - 9.4)  # the grid that gave 9.4 at 354° is one degree wide


def test_the_healthy_need_no_spring() -> None:
    found = prescribe_spring(joint(-1.0, 1.0))
    assert (found.stiffness, found.helps) == (0.0, False)
    assert np.degrees(found.range) == pytest.approx([-60.0, 180.0])


def test_what_the_thesis_prints_is_held_with_its_own_weight() -> None:
    one = joint(-0.2, 0.2, weight=10.1)
    widest = one.widest_interval(0.075 * 180 / np.pi, np.radians(210.0))
    assert widest is not None
    parts = one.held_intervals(0.075 * 180 / np.pi, np.radians(210.0))
    assert np.degrees([parts[0][0], parts[-1][1]]) == pytest.approx([63.0, 178.0], abs=1.5)


@pytest.mark.slow
@pytest.mark.parametrize(("low", "high"), [(-0.1, 0.1), (-0.2, 0.2), (-0.5, 0.5), (-0.2, 0.6), (-0.6, 0.2)])
def test_no_spring_of_a_grid_is_better(low: float, high: float) -> None:
    one = joint(low, high)
    found, (width, _, _) = prescribe_spring(one), searched(one)
    mine = np.ptp(found.range)
    assert mine >= width - 1e-9
    assert mine <= width + np.radians(8.0)  # the grid is coarse, but not that coarse
    assert mine + found.gap >= width


@pytest.mark.parametrize("required", [(30.0,), (0.0,), (60.0, 100.0)])
def test_required_angles_are_held(required: tuple[float, ...]) -> None:
    one, angles = joint(-0.2, 0.2), tuple(np.radians(required).tolist())
    found = prescribe_spring(one, angles)
    assert all(found.range[0] - 1e-6 <= angle <= found.range[1] + 1e-6 for angle in angles)
    width, _, _ = searched(one, angles)
    assert np.ptp(found.range) >= width - np.radians(0.3)


@pytest.mark.parametrize(
    ("required", "told"), [((-50.0, 170.0), "no spring"), ((-90.0,), "outside the joint's limits")]
)
def test_required_angles_that_cannot_be(required: tuple[float, ...], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        prescribe_spring(joint(-0.2, 0.2), tuple(np.radians(required).tolist()))


@pytest.mark.parametrize("weight", [0.01, 250.0])
def test_the_result_goes_with_the_weight_and_the_zero_of_the_angle(weight: float) -> None:
    plain, other = prescribe_spring(joint(-0.2, 0.2)), prescribe_spring(joint(-0.2, 0.2, weight, turned=0.0))
    assert other.stiffness == pytest.approx(weight * plain.stiffness, rel=1e-3)
    turned = prescribe_spring(joint(-0.2, 0.2, weight, turned=0.7), rest=(-2 * np.pi + 0.7, 2 * np.pi + 0.7))
    assert turned.stiffness == pytest.approx(other.stiffness, rel=1e-3)
    assert np.subtract(turned.range, 0.7) == pytest.approx(other.range, abs=1e-3)


def test_the_whole_range_is_within_the_limits() -> None:
    for low, high in ((-0.2, 0.2), (-0.05, 0.3), (-0.5, 0.5)):
        one = joint(low, high)
        found = prescribe_spring(one)
        torque = one.torque(np.linspace(*found.range, 20_001), found.stiffness, found.rest)
        assert torque.min() >= low - 1e-6
        assert torque.max() <= high + 1e-6


def test_turning_points_are_where_the_torque_turns() -> None:
    one = joint(-0.2, 0.2)
    angle = np.linspace(one.lower, one.upper, 200_001)
    for stiffness in (0.0, 0.3, 0.9):
        torque = one.torque(angle, stiffness, 1.0)
        slope = np.sign(np.diff(torque))
        numeric = angle[1:-1][slope[1:] != slope[:-1]]
        assert one.turning_points(stiffness) == pytest.approx(numeric, abs=1e-4)
    assert not len(one.turning_points(1.01))


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"lower": 1.0, "upper": 1.0}, "limits of the angle are crossed"),
        ({"torque_low": 2.0}, "limits of the torque are crossed"),
        ({"sine": 0.0}, "gravitational moment is zero"),
    ],
)
def test_joints_that_cannot_be(changed: dict[str, float], told: str) -> None:
    whole = {"sine": 1.0, "cosine": 0.0, "lower": 0.0, "upper": 1.0, "torque_low": -1.0, "torque_high": 1.0}
    with pytest.raises(ValueError, match=told):
        OneJoint(**(whole | changed))


@pytest.mark.parametrize("interval", [(60.0, 100.0), (90.0, 90.0), (100.0, 170.0)])
def test_the_softest_spring_is_no_stiffer_than_any_of_a_grid(interval: tuple[float, float]) -> None:
    one, span = joint(-0.2, 0.2), np.radians(interval)
    found = find_least_spring(one, (float(span[0]), float(span[1])), (-2 * np.pi, 2 * np.pi))
    assert found is not None
    angle = np.linspace(*span, 201)
    assert np.abs(one.torque(angle, *found)).max() <= 0.2 + 1e-6
    for stiffness in np.arange(0.005, found[0] - 0.005, 0.02):
        for rest in np.radians(np.arange(-360.0, 361.0, 1.0)):
            assert np.abs(one.torque(angle, float(stiffness), float(rest))).max() > 0.2 - 1e-9


def test_a_spring_that_is_not_needed_or_will_not_do() -> None:
    one, rest = joint(-0.2, 0.2), (-2 * np.pi, 2 * np.pi)
    assert find_least_spring(one, (-0.1, 0.1), rest)[0] == 0.0  # type: ignore[index]
    assert find_least_spring(one, (LOWER, UPPER), rest) is None
