"""What a trial tolerates, from numbers that are chosen so that the answer is known."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from mocap_id.workflows.sensitivity.perturbations import Perturbation
from mocap_id.workflows.sensitivity.study import (
    Estimates,
    Parameter,
    PerturbationRun,
    SeriesChanges,
    Tolerance,
    describe_failures,
    describe_tolerance,
    find_tolerances,
    tolerance_ratio,
)

MASS = Parameter("m1+m2", "kg", value=20.0, sd=0.1, size=20.0, verdict="known")
WEAK = Parameter("mx1", "kg*m", value=1.0, sd=0.5, size=1.0, verdict="weak")
OWN = Estimates(
    {one.name: one for one in (MASS, WEAK)}, 10.0, 0.0, 0.001, (0.9, 0.9, 0.9), 500, "ok", frozenset({"gap"})
)


def tried(kind: str, level: float, change: float, *codes: str, target: str = "") -> PerturbationRun:
    """A perturbation that moved the mass by so much, kg."""
    moved = {**OWN.parameters, "m1+m2": replace(MASS, value=MASS.value + change)}
    now = replace(OWN, parameters=moved, codes=OWN.codes | set(codes))
    return PerturbationRun(Perturbation(kind, target, level), now, SeriesChanges(), "", refused=False, seconds=0.0)


def lost(kind: str, level: float) -> PerturbationRun:
    return PerturbationRun(Perturbation(kind, "", level), None, SeriesChanges(), "it broke", refused=False, seconds=0.0)


def only(*found: PerturbationRun) -> Tolerance:
    (one,) = find_tolerances(OWN, found, tuple(OWN.parameters), 0.05)
    return one


def test_the_limit_is_a_share_of_the_size_or_a_stated_deviation() -> None:
    assert tolerance_ratio(MASS, replace(MASS, value=21.0), 0.05) == pytest.approx(1.0)
    assert tolerance_ratio(WEAK, replace(WEAK, value=1.5), 0.05) == pytest.approx(1.0)
    assert tolerance_ratio(MASS, None, 0.05) == math.inf
    assert math.isnan(tolerance_ratio(replace(MASS, value=math.nan), MASS, 0.05))


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_the_level_at_which_it_becomes_too_much_follows_a_power_law(power: float) -> None:
    """Changes of 1 kg (level / 0.004)^power cross the mass's limit of 1 kg at 0.004."""
    found = only(*(tried("soft-tissue", level, (level / 0.004) ** power) for level in (0.001, 0.003, 0.01)))
    assert found.high == pytest.approx(0.004)
    assert found.broken is not None
    assert found.broken.level == 0.01


def test_below_the_mildest_level_it_is_taken_in_proportion() -> None:
    assert only(tried("camera-noise", 0.002, 4.0)).high == pytest.approx(0.0005)


def test_of_two_ways_the_worse_counts() -> None:
    found = only(tried("clock-offset", 0.01, 0.2), tried("clock-offset", -0.01, -5.0))
    assert found.points[0].ratio == pytest.approx(5.0)
    assert len(found.points) == 1


def test_numbers_of_things_are_not_interpolated() -> None:
    few = only(tried("marker-count", 4, 0.1), tried("marker-count", 3, 3.0), tried("marker-count", 2, 9.0))
    assert few.high == 4
    assert "down to 4 markers; 3 markers change m1+m2 by 15 %" in describe_tolerance(few)
    assert math.isnan(only(tried("frame-rate", 2, 9.0)).high)


def test_filter_noise_is_bounded_on_either_side() -> None:
    levels = ((1e1, 4.0), (1e2, 0.25), (1e3, 0.0), (1e4, 0.5))
    found = only(*(tried("filter-noise", level, change, target="0.001") for level, change in levels))
    assert found.low == pytest.approx(10 * 10**0.5)  # the change falls by 16 over a decade, so by 4 over half of one
    assert found.high == 1e4


def test_what_is_lost_is_beyond_and_not_interpolated() -> None:
    found = only(tried("drop-outs", 0.2, 0.5), lost("drop-outs", 0.5))
    assert found.high == 0.2
    assert found.silent == ()
    assert "at 50 % of the samples nothing is identified any more" in describe_tolerance(found)


def test_it_is_silent_where_the_verdict_has_nothing_new() -> None:
    found = only(tried("soft-tissue", 0.003, 2.0), tried("soft-tissue", 0.01, 9.0, "parameters-weak"))
    assert found.silent == (0.003,)
    assert "at 3 mm the verdict does not warn of it" in describe_tolerance(found)
    assert "the verdict warns of it" in describe_tolerance(only(tried("soft-tissue", 0.01, 9.0, "parameters-weak")))
    assert only(tried("soft-tissue", 0.01, 9.0, "gap")).silent == (0.01,)  # it said so before


def test_all_that_was_tried_is_said_to_be_tolerated() -> None:
    found = only(tried("clock-offset", 0.1, 0.024))
    assert found.high == 0.1
    assert (
        describe_tolerance(found)
        == "clock offset, estimated: up to 100 ms, all levels that were tried (m1+m2 changes most, by 0.12 %)."
    )


def test_perturbations_that_failed_are_noted_with_the_reason() -> None:
    good = tried("soft-tissue", 0.001, 0.0)
    refused = replace(lost("soft-tissue", 0.002), refused=True)
    assert describe_failures((good, refused)) == ""
    note = describe_failures((good, refused, lost("soft-tissue", 0.01)))
    assert note == "1 of 3 perturbations failed and count as not tolerated (it broke)"
