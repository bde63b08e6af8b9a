"""Five-times-sit-to-stand test by both stop rules, and load shares of the feet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from protocol_cases import CENTRES, sit_to_stand

from mocap_id.protocols.five_times import PUBLISHED, compute_five_times, compute_load_share, find_foot_plates
from mocap_id.protocols.repetitions import Repetition, RiseDetails, compute_posture
from mocap_id.protocols.sit_to_stand import estimate_event_sd, find_sit_to_stand_repetitions


def repetitions(count: int, cycle: float = 2.5) -> tuple[Repetition, ...]:
    return tuple(
        Repetition(cycle * k, cycle * k + 0.4, cycle * k + 1.1, cycle * k + 1.9, cycle * k + 2.3, True)
        for k in range(count)
    )


def rises(count: int, **of_each: float) -> tuple[RiseDetails, ...]:
    return (RiseDetails(reached=1.0, **of_each),) * count


@pytest.mark.parametrize("count", [5, 6, 9])
def test_both_stop_rules_take_the_first_five(count: int) -> None:
    found = compute_five_times(repetitions(count), rises(count), chair=True)
    assert found.to_fifth_stand_s == pytest.approx(4 * 2.5 + 1.1)
    assert found.to_fifth_seat_contact_s == pytest.approx(4 * 2.5 + 1.9)
    assert found.to_fifth_seated_s == pytest.approx(4 * 2.5 + 2.3)
    assert (found.mean_cycle_s, found.cycle_sd_s) == pytest.approx((2.5, 0.0))
    assert (found.repetitions, found.failed_attempts, found.why) == (count, 0, None)


@pytest.mark.parametrize("count", [0, 1, 4])
def test_fewer_than_five_have_no_time_and_say_why(count: int) -> None:
    found = compute_five_times(repetitions(count), rises(count), chair=True)
    assert (found.to_fifth_stand_s, found.to_fifth_seat_contact_s, found.to_fifth_seated_s) == (None, None, None)
    assert f"{count} of 5" in found.why
    assert (found.mean_cycle_s is None) == (count < 2)


def test_a_rise_that_does_not_reach_standing_is_not_counted() -> None:
    low = (*rises(2), RiseDetails(reached=0.7), *rises(3, attempts=1))
    found = compute_five_times(repetitions(6), low, chair=True)
    assert found.repetitions == 5
    assert found.to_fifth_stand_s == pytest.approx(5 * 2.5 + 1.1)
    assert found.failed_attempts == 3


def test_events_outside_the_recording_are_null_with_a_reason() -> None:
    made = repetitions(5)
    begun = (replace(made[0], start=np.nan, why="the recording begins upright"), *made[1:])
    found = compute_five_times(begun, rises(5), chair=True)
    assert found.to_fifth_stand_s is None
    assert "begins upright" in found.why
    ended = (*made[:4], replace(made[4], seat_on=np.nan, end=np.nan, why="the recording ends upright"))
    found = compute_five_times(ended, rises(5), chair=True)
    assert found.to_fifth_stand_s == pytest.approx(11.1)
    assert found.to_fifth_seat_contact_s is None
    assert "ends upright" in found.why


def test_the_standard_deviation_is_that_of_both_events() -> None:
    """An event at a steep speed is known to a frame; noise adds the time in which it may have passed the limit."""
    recorded, _ = sit_to_stand(5)
    posture = compute_posture(recorded.q, recorded.dq, CENTRES)
    found = find_sit_to_stand_repetitions(recorded.time, posture, None, chair=None)
    frame = 1 / recorded.rate
    exact, noisy = (
        estimate_event_sd(recorded.time, posture, found, np.full(len(recorded.time), sd), None) for sd in (0.0, 0.05)
    )
    for name in ("start", "stand", "end"):
        np.testing.assert_allclose(exact[name], frame / np.sqrt(3))
        assert (noisy[name] > exact[name]).all()
    assert np.isnan(exact["seat_on"]).all()
    made = compute_five_times(found, rises(5), chair=True, event_sd=noisy)
    assert made.to_fifth_stand_sd_s == pytest.approx(noisy["start"][0] + noisy["stand"][4])
    assert made.to_fifth_seat_contact_sd_s is None
    assert compute_five_times(found, rises(5), chair=True).to_fifth_stand_sd_s is None


def test_squats_have_no_test_times() -> None:
    found = compute_five_times(repetitions(5), rises(5), chair=False)
    assert found.to_fifth_stand_s is None
    assert "squats" in found.why


def test_every_published_time_names_its_source_and_its_stop_rule() -> None:
    assert len({(one.limit_s, one.people) for one in PUBLISHED}) == len(PUBLISHED)
    for one in PUBLISHED:
        assert 5 < one.limit_s < 30
        assert one.stop in ("fifth stand", "fifth seat contact", "not said")
        assert any(str(year) in one.source for year in range(1990, 2026))


def test_z_points_to_the_left_if_the_subject_faces_minus_x() -> None:
    """With y up, the left of a subject facing f is y × f; facing -x, it is +z."""
    assert np.cross([0, 1, 0], [-1, 0, 0]).tolist() == [0, 0, 1]
    assert find_foot_plates([(1, 0.2), (2, -0.1)], -1) == (1, 2)
    assert find_foot_plates([(1, 0.2), (2, -0.1)], 1) == (2, 1)
    assert "3" in find_foot_plates([(1, 0.2), (2, -0.1), (3, 0.0)], -1)
    assert "side by side" in find_foot_plates([(1, 0.02), (2, 0.0)], -1)
    assert "side by side" in find_foot_plates([(1, float("nan")), (2, 0.0)], -1)


def test_the_share_of_the_left_foot_is_given_for_each_phase() -> None:
    recorded, truth = sit_to_stand(3)
    body = compute_posture(recorded.q, recorded.dq, CENTRES)
    made = tuple(
        Repetition(*events, True)
        for events in zip(truth.start, truth.seat_off, truth.stand, truth.seat_on, truth.end, strict=True)
    )
    wanted = np.where(body.height > 0.9, 0.4, np.where(body.height < 0.1, 0.6, 0.5))
    left = wanted * recorded.wrench[:, 1]
    found = compute_load_share(recorded.time, body, left, recorded.wrench[:, 1] - left, made)
    assert found["seated"] == pytest.approx([0.6] * 3, abs=1e-9)
    assert found["standing"] == pytest.approx([0.4] * 3, abs=1e-9)
    assert ((found["rising"] > 0.41) & (found["rising"] < 0.59)).all()
    blind = compute_load_share(recorded.time, body, np.full(len(left), np.nan), left, made)
    assert all(np.isnan(values).all() for values in blind.values())
