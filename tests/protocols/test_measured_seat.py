"""A chair on its own plate: contact is measured, and all samples are used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from protocol_cases import WEIGHT, sit_to_stand

from mocap_id.dynamics.preparation import FitSettings, TrialData, prepare
from mocap_id.dynamics.regressor import SEAT, ExternalWrench
from mocap_id.protocols.movement import Movement, find_movement


def seated(repetitions: int, **options: bool) -> tuple[TrialData, list[float], list[float]]:
    """The sit-to-stand of the other tests, with the force missing under the feet on the chair's plate."""
    recorded, truth = sit_to_stand(repetitions, noise=0.0, **options)
    free, _ = sit_to_stand(repetitions, chair=False, noise=0.0, **options)
    noise = np.random.default_rng(2).normal(size=(2, *free.wrench.shape)) * [0.5, 0.5, 0.15]
    chair = ExternalWrench(SEAT, 2, free.wrench - recorded.wrench + noise[0], True)
    return replace(recorded, wrench=recorded.wrench + noise[1], external=(chair,)), truth.seat_off, truth.seat_on


def read(recorded: TrialData) -> Movement:
    prepared = prepare(recorded, FitSettings())
    return find_movement("sit-to-stand", recorded, prepared, "seat-force", weight_share=0.7, knee_bend=0.8, stands=True)


@pytest.mark.parametrize("repetitions", [1, 4])
def test_events_come_from_the_plate_and_every_sample_is_free(repetitions: int) -> None:
    recorded, off, on = seated(repetitions)
    movement = read(recorded)
    assert movement.contact.rule == "seat-plate"
    assert movement.contact.chair is True
    assert movement.free.all()
    assert movement.reasons == ()
    assert movement.contact.weight == pytest.approx(WEIGHT, rel=0.002)
    np.testing.assert_allclose([rep.seat_off for rep in movement.repetitions], off, atol=0.08)
    np.testing.assert_allclose([rep.seat_on for rep in movement.repetitions], on, atol=0.08)
    assert all(rep.complete for rep in movement.repetitions)


def test_an_unused_chair_is_not_a_chair() -> None:
    recorded, *_ = seated(3, begins_upright=True)
    free, _ = sit_to_stand(3, chair=False, begins_upright=True)
    empty = ExternalWrench(SEAT, 2, np.random.default_rng(1).normal(size=free.wrench.shape) * 0.3, True)
    movement = read(replace(recorded, wrench=free.wrench, external=(empty,)))
    assert movement.contact.chair is False
    assert [reason.code for reason in movement.reasons] == ["no-chair"]
