"""The plate under a chair: its empty reading is subtracted, and contradictions are found."""

from __future__ import annotations

import numpy as np
import pytest
from test_plate_choice import CHAIR, FEET, RATE, RISE, TIME, WEIGHT, carrying, choose, person

from mocap_id.geometry.planar import PlaneFrame
from mocap_id.plates.choice import PlateChoice, choose_plates, find_contradictions, measure_empty_chair
from mocap_id.recording import PlateSamples, ThinnedFrames
from mocap_id.stages.planarise.wrenches import ExternalWrenches, measure_seat

ON_CHAIR = 0.75 * WEIGHT * np.clip(1 - RISE / 0.6, 0, 1)
EMPTY = np.array([3.0, 60.0, 24.0])


def reading(load: np.ndarray) -> np.ndarray:
    """Return the wrench (F, 3) of a chair of 60 N, 0.4 m behind the origin, with a load and plate errors."""
    noise = np.random.default_rng(1).normal(size=(len(load), 3)) * 0.3
    return np.column_stack([0.05 * load, load, 0.4 * load]) + EMPTY + noise


def test_the_reading_of_the_empty_chair_is_found() -> None:
    wrench, ok = reading(ON_CHAIR), np.ones(len(TIME), dtype=bool)
    ok[10:30] = False
    median, spread = measure_empty_chair(wrench, ok, person(), RATE, "standing")
    np.testing.assert_allclose(median, EMPTY, atol=0.1)
    np.testing.assert_allclose(spread, 0.3, atol=0.05)


def test_without_standing_it_is_unknown() -> None:
    wrench, ok = reading(np.full(len(TIME), 400.0)), np.ones(len(TIME), dtype=bool)
    assert measure_empty_chair(wrench, ok, person(np.zeros(len(TIME))), RATE, "standing")[0] is None


def seated(rise: np.ndarray = RISE, rule: str = "standing", every: int = 1) -> tuple[np.ndarray, ExternalWrenches]:
    """Return the chair's wrench (F, 3) in the plane, with half of the samples known, and its reasons."""
    found = reading(ON_CHAIR)
    force, moment = np.zeros((2, len(TIME), 3))
    force[:, [0, 2]], moment[:, 1] = found[:, :2], -found[:, 2]
    ok = np.arange(len(TIME)) % 200 >= 100
    samples, positions = PlateSamples(force, moment, ok), person(rise)
    looked = PlateSamples(force[::every], moment[::every], ok[::every])
    thinned = ThinnedFrames(every, positions[::every], TIME[::every], RATE / every, (looked,))
    choice = PlateChoice(("seat",), (500.0,), ("it is one",))
    assert rule in ("standing", "none")
    external = ExternalWrenches()
    measure_seat(external, choice, [samples], thinned, PlaneFrame(0.0), zero=rule, time=TIME)
    return found, external


@pytest.mark.parametrize("every", [1, 4])
def test_the_empty_reading_is_subtracted_from_every_known_frame(every: int) -> None:
    _, measured = seated(every=every)
    wrench = np.stack(list(measured.columns.values()), axis=1)
    known = np.arange(len(TIME)) % 200 >= 100
    exact = np.column_stack([0.05 * ON_CHAIR, ON_CHAIR, 0.4 * ON_CHAIR])
    np.testing.assert_allclose(wrench[known], exact[known], atol=1.5)
    assert np.isnan(wrench[~known]).all()


def test_nothing_is_subtracted_without_standing_or_if_zeroed_with_the_chair() -> None:
    known = np.arange(len(TIME)) % 200 >= 100
    for rise, rule, codes in ((np.zeros(len(TIME)), "standing", ["seat-zero-unknown"]), (RISE, "none", [])):
        found, measured = seated(rise, rule)
        wrench = np.stack(list(measured.columns.values()), axis=1)
        np.testing.assert_allclose(wrench[known], found[known], atol=1e-9)
        assert [reason.code for reason in measured.reasons] == codes


def doubts(*loads: np.ndarray, **uses: tuple[int, ...]) -> dict[int, str]:
    made = [carrying(i, load) for i, load in enumerate(loads, start=1)]
    samples = [each for _, each in made]
    choice: PlateChoice = choose_plates([plate for plate, _ in made], samples, person(), **uses)
    return find_contradictions(samples, choice, person())


def test_swapped_plates_are_both_contradictions() -> None:
    found = doubts(FEET, CHAIR, feet=(2,), seat=(1,))
    assert set(found) == {0, 1}
    assert "684 N while the person stands and up to 468 N before" in found[0]
    assert "while the body is low" in found[1]


@pytest.mark.parametrize("uses", [{}, {"feet": (1,), "seat": (2,)}, {"seat": (2,)}])
def test_right_plates_are_no_contradiction(uses: dict[str, tuple[int, ...]]) -> None:
    assert doubts(FEET, CHAIR, **uses) == {}


def test_a_heavy_chair_may_be_named() -> None:
    assert doubts(FEET, CHAIR + 300, feet=(1,), seat=(2,)) == {}


def test_a_heavy_chair_is_recognised_by_its_constant_weight() -> None:
    """A chair of 70 kg keeps more than half of the load, but unlike under feet it is constant."""
    heavy = ON_CHAIR + 700 + np.random.default_rng(2).normal(size=len(TIME))
    assert choose(FEET, heavy) == ("feet", "seat")
    assert choose(FEET, ON_CHAIR + 700 + 40 * np.sin(6 * TIME)) == ("feet", "feet")


def test_a_chair_named_as_feet_is_a_contradiction_and_a_jump_is_not() -> None:
    assert set(doubts(FEET, CHAIR, feet=(1, 2))) == {1}
    airborne = np.where(RISE < 0.5, WEIGHT, 0.0)
    assert doubts(airborne) == {}
