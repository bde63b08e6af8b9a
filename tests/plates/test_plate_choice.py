"""Classification of plates as feet, seat or unloaded, and the mass of the person."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.errors import ConfigError
from mocap_id.plates.choice import choose_plates, weigh_person
from mocap_id.recording import Plate, PlateSamples
from mocap_id.recording.sample_checks import find_upright

RATE = 50.0
TIME = np.arange(0, 20, 1 / RATE)
RISE = np.clip(3 * np.sin(2 * np.pi * TIME / 10), -1, 1) / 2 + 0.5
"""0 is seated, 1 is standing; two repetitions."""

WEIGHT = 70 * 9.81


def person(rise: np.ndarray = RISE) -> np.ndarray:
    """Return markers (F, M, 3) of resting feet and a trunk that rises by 0.4 m."""
    heights = np.array([0.02, 0.05, 0.08, 0.9, 1.1, 1.4])
    moving = heights > 0.5
    return np.stack(
        [
            np.broadcast_to(np.arange(6) * 0.05, (len(rise), 6)),
            np.zeros((len(rise), 6)),
            heights + moving * 0.4 * (rise[:, None] - 1),
        ],
        axis=2,
    )


def carrying(index: int, vertical: np.ndarray, *, problem: str = "") -> tuple[Plate, PlateSamples]:
    force = np.zeros((len(vertical), 3))
    force[:, 2] = vertical
    ok = np.full(len(vertical), not problem)
    plate = Plate(index, "type 2", None, force, np.zeros_like(force), ok, RATE, 0.0, problem)
    return plate, PlateSamples(force, np.zeros_like(force), ok)


def choose(*loads: np.ndarray, **options: tuple[int, ...]) -> tuple[str, ...]:
    made = [carrying(i, load) for i, load in enumerate(loads, start=1)]
    return choose_plates([plate for plate, _ in made], [samples for _, samples in made], person(), **options).uses


FEET = WEIGHT * (0.25 + 0.75 * RISE)
CHAIR = 60 + WEIGHT * 0.75 * (1 - RISE)


def test_a_chair_is_distinguished_from_feet() -> None:
    assert choose(CHAIR, FEET, np.zeros(len(TIME))) == ("seat", "feet", "unloaded")


def test_one_plate_for_each_foot() -> None:
    assert choose(FEET / 2, FEET / 2) == ("feet", "feet")


def test_small_loads_are_unloaded() -> None:
    assert choose(FEET, np.full(len(TIME), 15.0)) == ("feet", "unloaded")
    assert choose(FEET, np.full(len(TIME), -30.0)) == ("feet", "unloaded")  # an offset, 4 % of the weight


def test_without_a_change_of_height_every_load_is_from_the_feet() -> None:
    noise = np.random.default_rng(0).normal(size=len(TIME))
    made = [carrying(1, WEIGHT + noise), carrying(2, 50.0 + noise)]
    choice = choose_plates([p for p, _ in made], [s for _, s in made], person(np.ones(len(TIME))))
    assert choice.uses == ("feet", "feet")


def test_if_no_plate_stays_loaded_there_is_no_chair() -> None:
    """In a jump, both plates are unloaded when the body is highest."""
    assert choose(WEIGHT / 2 * (1 - RISE), WEIGHT / 2 * (1 - RISE)) == ("feet", "feet")


def test_the_configuration_has_priority() -> None:
    assert choose(CHAIR, FEET, FEET, feet=(1,), seat=(2,)) == ("feet", "seat", "ignored")
    with pytest.raises(ConfigError, match=r"\[4\]"):
        choose(FEET, feet=(4,))


def test_unusable_plates_are_ignored_with_their_reason() -> None:
    made = [carrying(1, FEET), carrying(2, FEET, problem="it is broken")]
    plates, samples = [p for p, _ in made], [s for _, s in made]
    choice = choose_plates(plates, samples, person())
    assert choice.uses == ("feet", "ignored")
    assert choice.why[1] == "it is broken"
    assert np.isnan(choice.loads[1])
    assert choice.loads[0] == pytest.approx(FEET.mean())


def test_mass_from_quiet_standing_among_sitting() -> None:
    noise = np.random.default_rng(0).normal(size=len(TIME)) * 20
    mass, why = weigh_person(person(), RATE, FEET + noise)
    assert why is None
    assert mass == pytest.approx(70, rel=0.005)


def test_no_mass_without_standing_still() -> None:
    bouncing = 0.5 + 0.5 * np.sin(2 * np.pi * 3 * TIME)
    mass, why = weigh_person(person(bouncing), RATE, FEET)
    assert mass is None
    assert why is not None
    assert "never stands still" in why
    assert weigh_person(person(), RATE, np.full(len(TIME), np.nan))[0] is None


def test_markers_with_gaps_do_not_change_the_posture() -> None:
    positions = person()
    tall, low = find_upright(positions)
    positions[100:200, 5] = np.nan
    positions[300:, 4] = np.nan
    again = find_upright(positions)
    assert np.mean(again[0] == tall) > 0.97
    assert np.mean(again[1] == low) > 0.97
    assert np.all(RISE[tall] > 0.8)
    assert np.all(RISE[low] < 0.2)
