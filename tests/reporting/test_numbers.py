"""Formatting of numbers."""

from __future__ import annotations

import pytest

from mocap_id.reporting.grids import UNKNOWN, show, show_beside, show_fixed, show_interval, show_with_sd


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0123456, "0.0123"),
        (1234.5, "1234"),
        (-2.5, "−2.50"),
        (0, "0.00"),
        (1.5e-9, "1.50e−09"),
        (6.1e12, "6.10e+12"),
        (None, UNKNOWN),
        (float("inf"), UNKNOWN),
        ("text", UNKNOWN),
    ],
)
def test_significant_digits(value: object, shown: str) -> None:
    assert show(value) == shown


def test_units_follow_a_number_and_never_a_dash() -> None:
    assert show(2.0, unit="kg") == "2.00 kg" and show(None, unit="kg") == UNKNOWN


def test_there_is_no_negative_zero() -> None:
    assert show_fixed(-0.0004, 2) == "0.00"


@pytest.mark.parametrize(
    ("value", "sd", "shown"),
    [
        (0.41234, 0.00312, "0.4123 ± 0.0031"),
        (71.2345, 12.0, "71 ± 12"),
        (71.2345, None, "71.23"),
        (71.2345, 0.0, "71.23"),
        (None, 0.1, UNKNOWN),
        (1.0, 1e-12, "1.000000 ± 0.000000"),
    ],
)
def test_digits_follow_the_standard_deviation(value: object, sd: object, shown: str) -> None:
    assert show_with_sd(value, sd) == shown


def test_intervals_and_references_have_the_digits_of_the_standard_deviation() -> None:
    assert show_interval(28.1, 0.4) == "27.32 … 28.88"
    assert show_interval(28.1, None) == UNKNOWN == show_interval(None, 0.4)
    assert show_beside(4.9e-16, 0.026) == "0.000" and show_beside(None, 0.1) == UNKNOWN
