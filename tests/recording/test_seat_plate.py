"""A chair's own plate: its empty reading comes off, and a plate that is no chair's is seen."""

from __future__ import annotations

import numpy as np
import pytest
from test_plate_choice import CHAIR, FEET, RATE, RISE, TIME, WEIGHT, carrying, choose, person

from mocap_id.recording import PlateChoice, choose_plates, doubtful, seat_wrench

ON_CHAIR = 0.75 * WEIGHT * np.clip(1 - RISE / 0.6, 0, 1)
EMPTY = np.array([3.0, 60.0, 24.0])


def reading(load: np.ndarray) -> np.ndarray:
    """A chair 0.4 m behind the origin that weighs 60 N and carries a load, on a plate with errors: (F, 3)."""
    noise = np.random.default_rng(1).normal(size=(len(load), 3)) * 0.3
    return np.column_stack([0.05 * load, load, 0.4 * load]) + EMPTY + noise


def test_what_the_plate_reads_without_the_person_comes_off() -> None:
    wrench, ok = reading(ON_CHAIR), np.ones(len(TIME), dtype=bool)
    ok[10:30] = False
    seat = seat_wrench(wrench, ok, person(), RATE, "standing")
    np.testing.assert_allclose(seat.zero, EMPTY, atol=0.1)
    np.testing.assert_allclose(seat.spread, 0.3, atol=0.05)
    assert np.isnan(seat.wrench[10:30]).all()
    exact = np.column_stack([0.05 * ON_CHAIR, ON_CHAIR, 0.4 * ON_CHAIR])
    np.testing.assert_allclose(seat.wrench[ok], exact[ok], atol=1.5)


def test_without_standing_the_zero_is_unknown() -> None:
    wrench, ok = reading(np.full(len(TIME), 400.0)), np.ones(len(TIME), dtype=bool)
    seat = seat_wrench(wrench, ok, person(np.zeros(len(TIME))), RATE, "standing")
    assert seat.zero is None
    np.testing.assert_array_equal(seat.wrench, wrench)


def test_a_plate_that_was_zeroed_with_the_chair_is_taken_as_it_reads() -> None:
    wrench, ok = reading(ON_CHAIR), np.ones(len(TIME), dtype=bool)
    seat = seat_wrench(wrench, ok, person(), RATE, "none")
    np.testing.assert_array_equal(seat.wrench, wrench)
    np.testing.assert_array_equal(seat.zero, 0.0)


def doubts(*loads: np.ndarray, **uses: tuple[int, ...]) -> dict[int, str]:
    made = [carrying(i, load) for i, load in enumerate(loads, start=1)]
    samples = [each for _, each in made]
    choice: PlateChoice = choose_plates([plate for plate, _ in made], samples, person(), **uses)
    return doubtful(samples, choice, person())


def test_plates_that_are_swapped_are_both_doubted() -> None:
    found = doubts(FEET, CHAIR, feet=(2,), seat=(1,))
    assert set(found) == {0, 1}
    assert "684 N while the person stands and up to 468 N before" in found[0]
    assert "while the body is low" in found[1]


@pytest.mark.parametrize("uses", [{}, {"feet": (1,), "seat": (2,)}, {"seat": (2,)}])
def test_right_plates_are_not_doubted(uses: dict[str, tuple[int, ...]]) -> None:
    assert doubts(FEET, CHAIR, **uses) == {}


def test_a_heavy_chair_may_be_named() -> None:
    assert doubts(FEET, CHAIR + 300, feet=(1,), seat=(2,)) == {}


def test_a_heavy_chair_is_told_by_the_steadiness_of_its_weight() -> None:
    """A chair of 70 kg keeps more than half of its load; feet that shift their weight never rest like that."""
    heavy = ON_CHAIR + 700 + np.random.default_rng(2).normal(size=len(TIME))
    assert choose(FEET, heavy) == ("feet", "seat")
    assert choose(FEET, ON_CHAIR + 700 + 40 * np.sin(6 * TIME)) == ("feet", "feet")


def test_a_chair_named_as_the_feets_is_doubted_and_a_jump_is_not() -> None:
    assert set(doubts(FEET, CHAIR, feet=(1, 2))) == {1}
    airborne = np.where(RISE < 0.5, WEIGHT, 0.0)
    assert doubts(airborne) == {}
