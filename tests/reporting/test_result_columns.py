"""Results that take their values from facts, and the columns that their fields have in the report."""

from __future__ import annotations

from typing import Annotated

import pytest

from mocap_id.reporting.grids import columns_of, to_grid
from mocap_id.results import Quantity, Result


class Reading(Result):
    """A result with fields of every kind."""

    length_m: Annotated[float | None, Quantity("length", "mm")]
    share: Annotated[float | None, Quantity("share", "%")]
    clock_s: Annotated[float | None, Quantity("clock", "ms", sd="clock_sd_s")]
    clock_sd_s: float | None
    interval_deg: Annotated[list[float] | None, Quantity("interval", "deg", decimals=1)]
    count: Annotated[int | None, Quantity("count", decimals=0)]
    other: float | None
    why: str | None


FACTS = {
    **{"length_m": 0.0123, "share": 0.5, "clock_s": 0.0041, "clock_sd_s": 0.0002, "interval_deg": [1.0, 2.5]},
    **{"count": 3, "other": 1.0, "unknown": 1.0},
}


def test_a_field_has_the_heading_unit_and_decimals_that_it_declares() -> None:
    grid = to_grid("", [Reading.explain("", FACTS)], columns_of(Reading))
    assert grid.head == ("length (mm)", "share (%)", "clock (ms)", "interval (deg)", "count")
    assert grid.rows == (("12.3", "50.0", "4.10 ± 0.20", "1.0 … 2.5", "3"),)


def test_columns_can_be_chosen() -> None:
    assert [column.head for column in columns_of(Reading, "count share")] == ["count", "share (%)"]


@pytest.mark.parametrize("lacking", ["length_m", "other"])
def test_a_missing_fact_is_none_and_explained(lacking: str) -> None:
    found = Reading.explain("not measured", {name: value for name, value in FACTS.items() if name != lacking})
    assert getattr(found, lacking) is None and found.why == "not measured"


def test_nan_is_none_and_explained() -> None:
    assert Reading.explain("not measured", FACTS, other=float("nan")).why == "not measured"
    assert Reading.explain("not measured", FACTS).why is None
