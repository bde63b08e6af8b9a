"""Curls: repetitions, end of the trial, compensation, torque and fatigue."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap_id.protocols.curl import (
    Curl,
    CurlRules,
    Mass,
    SegmentMotion,
    compute_elbow_torque,
    find_curls,
    find_trial_end,
    fit_part_in_step,
    fit_trend,
    measure_compensation,
)

TIME = np.arange(0, 24, 0.01)
RULES = CurlRules(0.5, 0.26, 0.6, 0.5, 2.0, plane=0.35, compensation=0.17, sustained=0.25)
AXIS = np.tile([0.0, 0.0, 1.0], (len(TIME), 1))


def step(at: np.ndarray) -> np.ndarray:
    """Movement of least jerk from 0 to 1."""
    s = np.clip(at, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)


def flexion(heights: list[float], start: float = 3.0, period: float = 2.0) -> np.ndarray:
    """Curls of these heights: up in 0.95 s, 0.05 s at the top, down in 0.95 s, 0.05 s of rest."""
    angle = np.full(len(TIME), 0.4)
    for k, height in enumerate(heights):
        begin = start + k * period
        angle += height * (step((TIME - begin) / 0.95) - step((TIME - begin - 1.0) / 0.95))
    return angle


def found(heights: list[float], noise: float = 0.0) -> tuple[Curl, ...]:
    shaken = flexion(heights) + noise * np.random.default_rng(1).normal(size=len(TIME))
    return find_curls(TIME, shaken, np.full(len(TIME), max(noise, 1e-4)), RULES)


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_curls_are_counted_and_timed(noise: float) -> None:
    curls = found([1.9] * 8, noise)
    assert [curl.complete for curl in curls] == [True] * 8
    starts = np.array([curl.start for curl in curls])
    np.testing.assert_allclose(starts, 3.0 + 2.0 * np.arange(8), atol=0.06)
    np.testing.assert_allclose([curl.top - curl.start for curl in curls], 0.975, atol=0.06)
    np.testing.assert_allclose([curl.end - curl.start for curl in curls], 1.95, atol=0.11)
    np.testing.assert_allclose([curl.amplitude for curl in curls], 1.9, atol=0.03)


def test_a_failed_attempt_does_not_count_and_ends_the_trial() -> None:
    curls = found([1.9] * 6 + [0.6])
    assert [curl.complete for curl in curls] == [True] * 6 + [False]
    assert "rises by 34°" in curls[-1].why
    end, rule, _ = find_trial_end(TIME, AXIS, curls, RULES)
    assert rule == "stopped"
    assert end == pytest.approx(15.0, abs=0.1)


@pytest.mark.parametrize(
    ("hole", "event"), [((5.8, 6.2), "top"), ((4.8, 5.1), "start"), ((6.8, 7.1), "end"), ((5.3, 5.6), "")]
)
def test_an_event_where_the_arm_is_not_measured_is_unknown(hole: tuple[float, float], event: str) -> None:
    """The flexion of the second curl is bridged there, by a value that no marker shows."""
    measured = (hole[0] > TIME) | (hole[1] < TIME)
    angle = flexion([1.9] * 4)
    bridged = np.interp(TIME, TIME[measured], angle[measured])
    curls = find_curls(TIME, bridged, np.full(len(TIME), 1e-4), RULES, measured)
    assert len(curls) == 4
    second = {name: getattr(curls[1], name) for name in ("start", "top", "end")}
    assert [name for name in second if np.isnan(second[name])] == [event][: len(event)]
    assert np.isnan(curls[1].amplitude) == (event in {"start", "top"})
    assert (event in curls[1].why) and (f"({hole[0]:.2f}–" in curls[1].why or not event)
    for k in (0, 3):
        assert curls[k].amplitude == pytest.approx(1.9, abs=0.01)
    assert not any(curl.unknown for curl in curls)
    assert [curl.complete for curl in curls] == [True] * 4
    assert find_trial_end(TIME, AXIS, curls, RULES)[1] == "recording"


def test_a_curl_that_may_be_complete_is_no_failed_attempt() -> None:
    """The elbow is not measured from 34° on; the bridge stays there, and no rule may end the trial."""
    angle = flexion([1.9] * 4)
    high = (TIME > 9) & (angle > 1.0)
    bridged = np.minimum(angle, np.where(high, 1.0, np.inf))
    curls = find_curls(TIME, bridged, np.full(len(TIME), 1e-4), RULES, ~high)
    assert [(curl.complete, curl.unknown) for curl in curls] == [(True, False)] * 3 + [(False, True)]
    assert find_trial_end(TIME, AXIS, curls, RULES)[1] == "recording"


def test_a_slow_curl_breaks_the_tempo() -> None:
    curls = (*found([1.9] * 3), Curl(9.0, 11.0, 13.0, 1.9, complete=True))
    assert find_trial_end(TIME, AXIS, curls, RULES)[1] == "tempo"
    assert find_trial_end(TIME, AXIS, curls, replace(RULES, metronome=None))[1] == "recording"


def test_a_pause_ends_the_trial() -> None:
    curls = (*found([1.9] * 3), Curl(16.0, 17.0, 18.0, 1.9, complete=True))
    end, rule, _ = find_trial_end(TIME, AXIS, curls, RULES)
    assert (rule, round(end)) == ("stopped", 9)


@pytest.mark.parametrize(("seconds", "rule"), [(0.1, "recording"), (0.5, "plane")])
def test_only_a_sustained_motion_out_of_the_plane_ends_the_trial(seconds: float, rule: str) -> None:
    out = np.where((TIME > 8) & (8 + seconds > TIME), np.radians(30), 0.0)
    axis = np.stack([np.sin(out), np.zeros(len(TIME)), np.cos(out)], axis=1)
    assert find_trial_end(TIME, axis, found([1.9] * 8), RULES)[1] == rule


def test_compensation_has_range_offset_and_floor() -> None:
    curls = found([1.9] * 4)
    sway = np.zeros(len(TIME))
    sway += np.radians(12) * (step((TIME - 7) / 0.5) - step((TIME - 8.4) / 0.5))
    measured = measure_compensation(TIME, sway, np.full(len(TIME), 0.01), curls, RULES)
    ranges = [one["range_rad"] if one else np.nan for one in measured]
    np.testing.assert_allclose(np.degrees(ranges), [0, 0, 12, 0], atol=0.1)
    still, moved = measured[0], measured[2]
    assert still is not None
    assert moved is not None
    assert still["range_rad"] < still["floor_rad"]
    assert moved["interval_rad"][0] > 0
    assert moved["sustained_s"] > 0.5
    assert still["sustained_s"] == 0


def test_a_part_in_step_with_the_flexion_is_stated_apart() -> None:
    """An axis that errs turns the upper arm in step with the flexion; what a curl adds to it is left."""
    curls, q = found([1.9] * 4), flexion([1.9] * 4)
    added = np.radians(4) * (step((TIME - 7) / 0.5) - step((TIME - 8.4) / 0.5))
    spread = np.diag([0.0, 0.05**2])
    sd = np.full(len(TIME), 0.02)
    apart = fit_part_in_step(TIME, 0.06 * np.sin(q) - 0.02 * np.cos(q) + added, sd, q, spread, curls)
    assert apart is not None
    curve, rest_sd, size, interval = apart
    np.testing.assert_allclose(np.ptp(curve - 0.06 * np.sin(q) + 0.02 * np.cos(q)), 0, atol=1e-9)
    inside = slice(*np.searchsorted(TIME, [curls[0].start, curls[0].end]))
    turned = np.sin(q[inside]) - np.sin(q[inside].min())
    assert interval[1] - size == pytest.approx(1.96 * 0.05 * np.abs(turned).max(), rel=1e-6)
    assert interval[0] == max(0.0, 2 * size - interval[1])
    measured = measure_compensation(TIME, added, rest_sd, curls, RULES)
    assert measured[2] is not None
    assert np.degrees(measured[2]["range_rad"]) == pytest.approx(4, abs=0.1)
    assert measured[2]["interval_rad"][0] > 0


def test_no_part_in_step_without_a_curl() -> None:
    nothing = np.full(len(TIME), np.nan)
    assert fit_part_in_step(TIME, nothing, nothing, flexion([1.9] * 3), None, found([1.9] * 3)) is None
    assert fit_part_in_step(TIME, TIME, TIME, TIME, None, ()) is None


def test_compensation_of_an_unknown_angle_is_none() -> None:
    curls = found([1.9] * 3)
    assert measure_compensation(TIME, np.full(len(TIME), np.nan), np.ones(len(TIME)), curls, RULES) == [None] * 3


def test_torque_is_that_of_a_pendulum() -> None:
    """A point mass at the end of a rod: τ = m l² q̈ + m g l sin q, about z, with q from hanging down."""
    mass, length = 4.0, 0.3
    q, omega, alpha = 1 + 0.8 * np.sin(3 * TIME), 2.4 * np.cos(3 * TIME), -7.2 * np.sin(3 * TIME)
    turn = np.zeros((len(TIME), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = np.cos(q), -np.sin(q), np.sin(q), np.cos(q)
    turn[:, 2, 2] = 1
    body = Mass(mass, np.array([0.0, -length, 0.0]), np.zeros(3), 0.02)
    still = np.zeros((len(TIME), 3))
    motion = SegmentMotion(still, turn, AXIS * omega[:, None], AXIS * alpha[:, None], np.full(len(TIME), 0.2), [body])
    torque, sd = compute_elbow_torque(TIME, AXIS, [motion], tilt=0.01)
    np.testing.assert_allclose(torque, mass * length**2 * alpha + mass * 9.81 * length * np.sin(q), atol=1e-9)
    assert (sd > mass * length**2 * 0.2).all()


def test_a_divided_body_has_the_torque_of_the_whole() -> None:
    """Two halves on forearm and hand that move as one are the same as one body."""
    rng = np.random.default_rng(2)
    turn = np.linalg.qr(rng.normal(size=(len(TIME), 3, 3)))[0]
    omega, alpha = rng.normal(size=(2, len(TIME), 3))
    origin = np.zeros((len(TIME), 3))
    wrist = np.einsum("tij,j->ti", turn, [0.0, -0.25, 0.0])

    def motion(place: np.ndarray, bodies: list[Mass]) -> SegmentMotion:
        return SegmentMotion(place, turn, omega, alpha, np.zeros(len(TIME)), bodies)

    near, far = np.array([0.01, -0.1, 0.02]), np.array([0.0, -0.33, 0.01])
    inertia = np.array([0.01, 0.002, 0.01])
    whole = [Mass(1.5, near, inertia, 0.0), Mass(4.0, far, inertia, 0.0)]
    parts = [
        motion(origin, whole[:1]),
        motion(wrist, [Mass(4.0, far - [0.0, -0.25, 0.0], inertia, 0.0)]),
    ]
    one = compute_elbow_torque(TIME, AXIS, [motion(origin, whole)], tilt=0.0)[0]
    np.testing.assert_allclose(compute_elbow_torque(TIME, AXIS, parts, tilt=0.0)[0], one, atol=1e-9)


def test_a_trend_needs_four_curls_and_holds_the_slope() -> None:
    rng = np.random.default_rng(3)
    values = 0.2 * np.arange(12) + rng.normal(0, 0.1, 12)
    found_trend = fit_trend(values)
    assert found_trend is not None
    assert found_trend["interval"][0] < 0.2 < found_trend["interval"][1]
    assert fit_trend(values[:3]) is None
