"""events.parquet of a sit-to-stand: unexplained support is what is missing with every possible clock."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from protocol_cases import WEIGHT, sit_to_stand

from mocap_id.dynamics.preparation import FitSettings, prepare
from mocap_id.protocols.movement import find_movement
from mocap_id.protocols.repetitions import SUPPORT_LIMIT
from mocap_id.stages.identify_dim.events import compute_missing_force, make_sit_to_stand_events
from mocap_id.store import Table
from mocap_id.store.provenance import WRENCH

LATE = 0.15  # s, error of the clock


def events(
    shift: float,
    helped: float,
    plates: list[dict[str, object]] | None = None,
    *,
    clocks: slice = slice(None),
    wrong: tuple[float, float] = (0.0, 0.0),
) -> Table:
    """Events of three rises with a clock error ``shift`` and external support as a share of the weight.

    Markers of the legs are rejected within ``wrong``, s.
    """
    recorded, _ = sit_to_stand(3)
    prepared = prepare(recorded, FitSettings())
    movement = find_movement(
        "sit-to-stand", recorded, prepared, "seat-force", weight_share=0.72, knee_bend=0.8, stands=True
    )
    rising = np.zeros(len(recorded.time), dtype=bool)
    for each in movement.repetitions:
        rising |= (recorded.time >= each.start) & (recorded.time <= each.stand)
    measured = recorded.wrench[:, 1]
    expected = np.where(movement.contact.touching, measured + 300.0, measured) + helped * WEIGHT * rising
    shifted = np.interp(recorded.time + shift, recorded.time, measured)
    columns = {"Fy_reference": expected, "Fy": shifted}
    seen = (recorded.time < wrong[0]) | (recorded.time > wrong[1])
    wrench = pd.DataFrame({"Fy_p1": 0.45 * measured, "Fy_p2": 0.55 * measured})
    return make_sit_to_stand_events(
        Table.from_frame(WRENCH, wrench, {"plates": plates or []}),
        recorded,
        movement,
        compute_missing_force(prepared, columns)[clocks],
        share=0.72,
        seat_measured=False,
        measured=seen,
        modelled=seen,
    )


def test_a_wrong_clock_is_not_taken_for_support() -> None:
    # the synthetic chair is released at 0.37 of the rise, later than real ones, so its force affects the mean
    base = events(0.0, 0.0).frame["support"].to_numpy()
    deceived = []
    for shift in (LATE, -LATE):
        assert (events(shift, 0.0).frame["support"].to_numpy() <= base + 1e-9).all()
        deceived.append(events(shift, 0.0, clocks=slice(0, 1)).frame["support"].to_numpy())
    assert (np.max(deceived, axis=0) > base + SUPPORT_LIMIT).all()


def test_support_gives_a_reason_and_a_remark_in_every_row() -> None:
    table = events(0.0, 0.3)
    assert "support-unexplained" in {reason.code for reason in table.reasons}
    assert table.frame["why"].str.contains("carried by an unknown support").all()
    assert (table.frame["support"] > 0.25).all()


def test_left_and_right_are_facts_and_columns() -> None:
    feet = [{"index": 1, "use": "feet", "across_m": 0.15}, {"index": 2, "use": "feet", "across_m": -0.12}]
    table = events(0.0, 0.0, feet)
    assert (table.facts["load_share"]["left_plate"], table.facts["load_share"]["why"]) == (1, None)
    for phase in ("seated", "rising", "standing"):
        assert table.facts["load_share"]["left"][phase]["mean"] == pytest.approx(0.45)
        np.testing.assert_allclose(table.frame[f"left_{phase}"], 0.45)
    assert "the feet are on 0" in events(0.0, 0.0).facts["load_share"]["why"]


def test_without_a_plate_nothing_is_missing() -> None:
    assert compute_missing_force(None, {}) == ()


@pytest.mark.parametrize("event", ["start", "seat_off", "stand", "seat_on", "end"])
def test_an_event_is_unknown_where_markers_are_rejected(event: str) -> None:
    usual = events(0.0, 0.0)
    at = usual.frame[event][1]
    found = events(0.0, 0.0, wrong=(at - 0.1, at + 0.1)).frame
    names = ["start", "seat_off", "stand", "seat_on", "end"]
    assert np.isnan(found[event][1])
    assert f"not used at its {event.replace('_', '-')}" in found["why"][1]
    assert not found["complete"][1]
    np.testing.assert_array_equal(found[names].iloc[[0, 2]], usual.frame[names].iloc[[0, 2]])


def test_a_rise_whose_stand_is_unknown_still_counts() -> None:
    usual = events(0.0, 0.0)
    at = usual.frame["stand"][1]
    table = events(0.0, 0.0, wrong=(at - 0.3, at + 0.3))
    assert table.facts["five_times"]["repetitions"] == usual.facts["five_times"]["repetitions"] == 3
    assert {reason.code for reason in table.reasons} == {reason.code for reason in usual.reasons}
