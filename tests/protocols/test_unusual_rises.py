"""Unusual rises in synthetic trials: cut off, failed, paused, incomplete or supported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from protocol_cases import CENTRES, RATE, RISE, WEIGHT, sit_to_stand
from scipy.signal import find_peaks

from mocap_id.dynamics.preparation import FitSettings, TrialData, prepare
from mocap_id.protocols.five_times import _find_peaks, find_failed_attempts
from mocap_id.protocols.movement import Movement, find_movement
from mocap_id.protocols.repetitions import (
    SUPPORT_LIMIT,
    RiseDetails,
    compute_posture,
    find_greatest_height,
    find_model_agreement,
    find_share_crossing,
    measure_paused_time,
    measure_support,
)
from mocap_id.protocols.sit_to_stand import add_remarks, explain_repetitions


def read(recorded: TrialData) -> Movement:
    prepared = prepare(recorded, FitSettings())
    return find_movement(
        "sit-to-stand", recorded, prepared, "seat-force", weight_share=0.72, knee_bend=0.8, stands=True
    )


def of_samples(recorded: TrialData, order: np.ndarray, **changed: np.ndarray) -> TrialData:
    series = ("time", "q", "dq", "ddq", "ddq_sd", "observed", "wrench")
    parts = {name: getattr(recorded, name)[order] for name in series}
    return TrialData(**{**parts, **changed, "centres": CENTRES})


def cut(recorded: TrialData, begin: float, finish: float) -> TrialData:
    inside = (recorded.time >= begin) & (recorded.time <= finish)
    return of_samples(recorded, np.flatnonzero(inside))


def attempts(recorded: TrialData, movement: Movement) -> list[float]:
    vertical = recorded.wrench[:, 1] / WEIGHT
    found = find_failed_attempts(recorded.time, movement.posture, vertical, movement.repetitions, chair=True)
    return [one.time_s for one in found]


def test_a_recording_that_starts_in_a_rise_has_an_unknown_start() -> None:
    recorded, truth = sit_to_stand(3)
    low = read(cut(recorded, truth.start[0] + 0.42 * RISE, np.inf)).repetitions[0]
    high = read(cut(recorded, truth.start[0] + 0.55 * RISE, np.inf)).repetitions[0]
    for found in (low, high):
        assert np.isnan(found.start)
        assert found.stand == pytest.approx(truth.stand[0], abs=0.35)
        assert not found.complete
        assert "the recording begins during the rise" in found.why


@pytest.mark.parametrize("share", [0.45, 0.75])
def test_a_recording_that_ends_in_a_descent_has_an_unknown_end(share: float) -> None:
    recorded, truth = sit_to_stand(2)
    down = truth.end[1] - 2.0
    found = read(cut(recorded, 0.0, down + share * 2.0)).repetitions[-1]
    assert np.isnan(found.end)
    assert found.stand == pytest.approx(truth.stand[1], abs=0.35)
    assert "the recording ends during the descent" in found.why


def test_an_unfinished_last_rise_is_reported() -> None:
    recorded, truth = sit_to_stand(3)
    part = cut(recorded, 0.0, truth.start[2] + 0.38 * RISE)
    movement = read(part)
    assert len(movement.repetitions) == 2
    told = explain_repetitions(movement.repetitions, [RiseDetails()] * 2, (), movement.posture)
    assert [reason.code for reason in told] == ["repetition-cut"]
    assert "not counted" in told[0].message


@pytest.mark.parametrize("height", [0.12, 0.25, 0.35])
def test_hips_that_rise_and_fall_back_are_an_attempt(height: float) -> None:
    recorded, truth = sit_to_stand(3, attempt=(6.55, height))
    recorded = cut(recorded, 0.0, truth.end[0] + 20.0)
    movement = read(recorded)
    assert len(movement.repetitions) == 3
    # between the first descent, at 6 s, and the second rise, at 7 s
    assert attempts(recorded, movement) == pytest.approx([6.55], abs=0.25)


def test_ordinary_repetitions_have_no_attempt_and_no_pause() -> None:
    for seed in range(3):
        recorded, _ = sit_to_stand(4, seed=seed)
        movement = read(recorded)
        assert attempts(recorded, movement) == []
        assert [measure_paused_time(recorded.time, movement.posture, each) for each in movement.repetitions] == [
            0.0
        ] * 4


def test_arms_that_swing_change_neither_height_nor_speed() -> None:
    """A shoulder is carried up and down by the leaning trunk; the hip shows rises, attempts and pauses."""
    recorded, _ = sit_to_stand(2)
    swing = 1.5 * np.sin(4 * recorded.time)
    with_arms = compute_posture(
        np.column_stack([recorded.q, swing]),
        np.column_stack([recorded.dq, np.gradient(swing, recorded.time)]),
        np.vstack([CENTRES, [0.0, 0.5]]),
    )
    plain = compute_posture(recorded.q, recorded.dq, CENTRES)
    for name in ("height", "rise", "upright", "speed"):
        np.testing.assert_allclose(getattr(with_arms, name), getattr(plain, name))


def test_unloading_the_chair_is_an_attempt_and_slight_leaning_is_not() -> None:
    recorded, _ = sit_to_stand(2)
    seated = recorded.wrench[:50, 1].mean()
    for share, expected in ((0.7, [0.5]), (0.2, [])):
        wrench = recorded.wrench.copy()
        bump = np.exp(-(((recorded.time - 0.5) / 0.15) ** 2))
        wrench[:, 1] += share * (WEIGHT - seated) * bump
        lifted = replace(recorded, wrench=wrench)
        assert attempts(lifted, read(recorded)) == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("seed", range(20))
def test_peaks_have_the_required_prominence(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = np.cumsum(rng.normal(size=300)) if seed % 2 else rng.normal(size=rng.integers(1, 300))
    expected = find_peaks(values, prominence=1.5)[0].tolist()
    assert _find_peaks(values, 1.5) == expected


def test_a_low_rise_is_incomplete() -> None:
    recorded, _ = sit_to_stand(3, heights=(1.0, 0.65, 1.0))
    movement = read(recorded)
    heights = [find_greatest_height(recorded.time, movement.posture, each) for each in movement.repetitions]
    assert [height < 0.9 for height in heights] == [False, True, False]
    rises = [RiseDetails(reached=height) for height in heights]
    told = [add_remarks(each, rise) for each, rise in zip(movement.repetitions, rises, strict=True)]
    assert [each.complete for each in told] == [True, False, True]
    assert "of the standing height" in told[1].why
    (reason,) = explain_repetitions(movement.repetitions, rises, (), movement.posture)
    assert reason.code == "rise-partial"
    assert "in repetition 2:" in reason.message


@pytest.mark.parametrize("share", [0.35, 0.6])
def test_a_pause_in_the_rise_does_not_move_start_or_stand(share: float) -> None:
    recorded, truth = sit_to_stand(2)
    at = int((truth.start[0] + share * RISE) * RATE)
    still = int(1.0 * RATE)
    order = np.concatenate([np.arange(at), np.full(still, at), np.arange(at, len(recorded.time))])
    moving = (np.arange(len(order)) < at) | (np.arange(len(order)) >= at + still)
    paused = of_samples(
        recorded,
        order,
        time=np.arange(len(order)) / RATE,
        dq=recorded.dq[order] * moving[:, None],
        ddq=recorded.ddq[order] * moving[:, None],
    )
    found = find_movement(
        "sit-to-stand", paused, None, "seat-force", weight_share=0.72, knee_bend=0.8, stands=True
    ).repetitions
    assert len(found) == 2
    assert found[0].start == pytest.approx(truth.start[0], abs=0.35)
    assert found[0].stand == pytest.approx(truth.stand[0] + 1.0, abs=0.35)
    body = compute_posture(paused.q, paused.dq, CENTRES)
    assert measure_paused_time(paused.time, body, found[0]) == pytest.approx(1.0, abs=0.2)
    assert measure_paused_time(paused.time, body, found[1]) == 0.0


def test_support_is_the_missing_force_above_chair_height() -> None:
    recorded, _ = sit_to_stand(3)
    movement = read(recorded)
    missing = np.where(movement.posture.height > 0.0, 12.0, 0.0)  # a model that is 12 N too heavy
    times = recorded.time
    for k, each in enumerate(movement.repetitions):
        helped = (times > each.start) & (times < each.stand) if k == 1 else np.zeros(len(times), bool)
        found = measure_support(
            times, movement.posture, missing + 0.1 * WEIGHT * helped, WEIGHT, each, seat_measured=False
        )
        assert found == pytest.approx(0.1 if k == 1 else 0.0, abs=1e-9)
        assert (found > SUPPORT_LIMIT) == (k == 1)


def test_the_chair_is_not_taken_for_support() -> None:
    recorded, _ = sit_to_stand(3)
    movement = read(recorded)
    chair = np.where(movement.posture.height < 0.2, 0.5 * WEIGHT, 0.0)
    for each in movement.repetitions:
        assert measure_support(recorded.time, movement.posture, chair, WEIGHT, each, seat_measured=False) == 0.0


def test_seat_off_by_the_rules_of_the_thesis_is_before_zero_chair_force() -> None:
    recorded, truth = sit_to_stand(3)
    movement = read(recorded)
    clean = sit_to_stand(3, noise=0.0)[0].wrench[:, 1] / WEIGHT
    for each, off in zip(movement.repetitions, truth.seat_off, strict=True):
        share = find_share_crossing(recorded.time, recorded.wrench[:, 1] / WEIGHT, 0.72, each)
        assert np.interp(share, recorded.time, clean) == pytest.approx(0.72, abs=0.02)
        model = find_model_agreement(recorded.time, movement.contact.above_noise, each)
        assert share < model <= each.seat_off
        assert model == pytest.approx(off, abs=0.12)


def test_without_a_plate_there_is_no_seat_off_by_force() -> None:
    recorded, _ = sit_to_stand(1)
    (each,) = read(recorded).repetitions
    assert np.isnan(find_share_crossing(recorded.time, np.full(len(recorded.time), np.nan), 0.72, each))
    assert np.isnan(find_model_agreement(recorded.time, None, each))
