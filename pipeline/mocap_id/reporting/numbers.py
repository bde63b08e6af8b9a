"""Formatting of numbers in the report with a suitable number of digits; a dash stands for an unknown number."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from mocap_id.arrays import NORMAL_95

UNKNOWN = "–"
"""Text for an unknown quantity."""


def to_number(value: object) -> float | None:
    """Return a value as a finite number; None if it is missing, NaN, infinite or not a number."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        return None
    return float(value) if math.isfinite(value) else None


def scale(value: object, factor: float) -> float | None:
    """Return a value times a factor; None if the value is not a finite number."""
    number = to_number(value)
    return None if number is None else factor * number


def to_numbers(values: object) -> list[float] | None:
    """Return a vector as a list of finite numbers; None if it is missing or empty, or if any element is unknown."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        return None
    numbers = [to_number(value) for value in values]
    found = [number for number in numbers if number is not None]
    return found if numbers and len(found) == len(numbers) else None


def show(value: object, digits: int = 3, unit: str = "") -> str:
    """Format a number with ``digits`` significant digits and its unit; return a dash if it is unknown.

    >>> show(0.0123456, unit="m")
    '0.0123 m'
    >>> show(float("nan"))
    '–'
    """
    number = to_number(value)
    if number is None:
        return UNKNOWN
    decimals = digits - 1 - _find_magnitude(number)
    text = f"{number:.{digits - 1}e}" if decimals > 6 or decimals < -4 else f"{number:.{max(decimals, 0)}f}"
    return f"{text.replace('-', '−')} {unit}".rstrip()


def show_fixed(value: object, decimals: int, unit: str = "") -> str:
    """Format a number with a fixed number of decimals and its unit; return a dash if it is unknown."""
    number = to_number(value)
    if number is None:
        return UNKNOWN
    rounded = round(number, decimals) + 0.0  # no negative zero
    text = f"{rounded:.{decimals}f}".replace("-", "−")
    return f"{text} {unit}".rstrip()


def show_millimetres(metres: object) -> str:
    """Format a length given in metres as millimetres with one decimal; return a dash if it is unknown."""
    return show_fixed(scale(metres, 1e3), 1)


def show_percent(share: object) -> str:
    """Format a fraction in per cent with one decimal; return a dash if it is unknown."""
    return show_fixed(scale(share, 100), 1)


def show_with_sd(value: object, sd: object, unit: str = "") -> str:
    """Format ``value ± sd``, both to the second significant digit of the standard deviation.

    If the standard deviation is 0 or unknown, only the value is returned, with four significant digits.

    >>> show_with_sd(0.41234, 0.00312, "m")
    '0.4123 ± 0.0031 m'
    """
    if not to_number(sd):
        return show(value, 4, unit)
    number = show_beside(value, sd)
    return number if number == UNKNOWN else f"{number} ± {show_beside(sd, sd, unit)}"


def show_beside(value: object, sd: object, unit: str = "") -> str:
    """Format a number to the second significant digit of ``sd``; to four significant digits if it is 0 or None."""
    spread = to_number(sd)
    if not spread:
        return show(value, 4, unit)
    return show_fixed(value, min(max(1 - _find_magnitude(spread), 0), 6), unit)


def show_interval(value: object, sd: object) -> str:
    """Format the 95 % interval of a normally distributed quantity; return a dash if an argument is unknown."""
    number, spread = to_number(value), to_number(sd)
    if number is None or not spread:
        return UNKNOWN
    low, high = (show_beside(number + side * NORMAL_95 * spread, spread) for side in (-1, 1))
    return f"{low} … {high}"


def _find_magnitude(number: float) -> int:
    """Return the power of ten of the leading digit; 0 for zero."""
    return 0 if number == 0 else math.floor(math.log10(abs(number)))
