"""Tables of a page: declarations of columns, and rows as texts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from mocap_id.arrays import NORMAL_95
from mocap_id.reporting import style
from mocap_id.results import Quantity, Result, list_quantities

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


Source: TypeAlias = str | int | Callable[[Any], Any]
"""Source of a column's values: a key, attribute or place in each row, or a function of the row."""

_SUFFIXES = {"s": "s", "m": "m", "hz": "Hz", "deg": "deg", "kg": "kg", "N": "N"}
"""Units in the suffixes of fact keys."""
_LABELS = {
    "arc_deg": "arcs of the joints in the fitted samples (deg)",
    "asked": "requested",
    "asymmetry_deg": "angle between left and right (deg)",
    "bridged_fraction": "share of bridged samples",
    "condition_number_scaled": "condition number with unit-norm columns",
    "count": "number of segments",
    "cutoff_hz": "low-pass cut-off (Hz)",
    "dual": "dual residual",
    "kkt": "KKT residual",
    "missing_fraction": "share of missing samples",
    "noise_floor_m": "movement of still markers (m)",
    "outlier_fraction": "share of outliers",
    "price_of_consistency": "relative cost of physical consistency",
    "primal": "primal residual",
    "proven": "optimality proven",
    "reference_pulls": "reference body used as a prior",
    "reprojection_rms_m": "reprojection error, rms (m)",
    "samples": "number of samples",
    "sd_holds": "standard deviations include",
    "static_gap": "movement of moving over still markers",
    "untold": "torques not determined",
    "window_proposed": "window chosen automatically",
}
"""Labels of fact keys whose names are not clear enough for readers."""


@dataclass(frozen=True)
class Grid:
    """A table of a page: caption, column headings and rows of cells. A page omits a table without rows.

    ``text`` contains the indices of the left-aligned columns.
    """

    caption: str = ""
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    text: frozenset[int] = frozenset()


@dataclass(frozen=True)
class GridColumn:
    """Declaration of a column: its heading, and the function that returns the cell of a row.

    A text column is left-aligned. An optional column is omitted if no row has a value.
    """

    head: str
    cell: Callable[[Any], str]
    text: bool = False
    optional: bool = False


def get_element(source: Source, key: int | str) -> Callable[[Any], Any]:
    """Return a function of a row: element ``key`` of the list or mapping that ``source`` gives.

    The result is None if the list is empty or missing, or if the mapping has no such key.
    """

    def value(row: Any) -> Any:
        values = _get_value(row, source)
        return values.get(key) if isinstance(values, Mapping) else values[key] if values else None

    return value


def texts(head: str, source: Source, missing: str = "") -> GridColumn:
    """Return a column of texts, with ``missing`` for an empty value."""
    return GridColumn(head, lambda row: str(_get_value(row, source) or missing), text=True)


def numbers(
    head: str, source: Source, decimals: int | None = None, factor: float = 1.0, *, optional: bool = False
) -> GridColumn:
    """Return a column of numbers times ``factor``, with ``decimals`` or, if None, with three significant digits."""

    def cell(row: Any) -> str:
        value = scale(_get_value(row, source), factor)
        return show(value) if decimals is None else show_fixed(value, decimals)

    return GridColumn(head, cell, optional=optional)


def millimetres(head: str, source: Source, *, optional: bool = False) -> GridColumn:
    """Return a column of lengths in metres, shown in millimetres."""
    return numbers(head, source, 1, 1e3, optional=optional)


def percent(head: str, source: Source) -> GridColumn:
    """Return a column of fractions, shown in per cent."""
    return numbers(head, source, 1, 100)


def with_sd(head: str, value: Source, sd: Source, factor: float = 1.0) -> GridColumn:
    """Return a column of ``value ± sd``, both multiplied by ``factor``."""
    return GridColumn(
        head, lambda row: show_with_sd(scale(_get_value(row, value), factor), scale(_get_value(row, sd), factor))
    )


def columns_of(kind: type[Result], names: str = "") -> list[GridColumn]:
    """Return the columns of the described fields of a result: of all fields, or of these, separated by blanks."""
    described = dict(list_quantities(kind))

    def cell(row: Any, name: str) -> str:
        return _show_quantity(described[name], *(_get_value(row, one) for one in (name, described[name].sd) if one))

    return [GridColumn(described[name].head, partial(cell, name=name)) for name in names.split() or described]


def list_values(found: Result, names: str = "") -> dict[str, str]:
    """Return the described fields of a result as texts by their headings: all fields, or these."""
    described = dict(list_quantities(type(found)))
    return {
        described[name].head: _show_quantity(described[name], getattr(found, name))
        for name in names.split() or described
    }


def _show_quantity(one: Quantity, value: Any, *sd: Any) -> str:
    factor = 100.0 if one.unit.startswith("%") else 1e3 if one.unit in ("mm", "ms") else 1.0
    if sd:
        return show_with_sd(scale(value, factor), scale(sd[0], factor))
    if isinstance(value, list):  # both ends of an interval
        return " … ".join(_show_quantity(one, end) for end in value)
    if one.decimals is None and factor == 1.0:
        return show(value, one.digits)
    return show_fixed(scale(value, factor), 1 if one.decimals is None else one.decimals)


def to_words(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries with underscores in their keys replaced by blanks."""
    return {name.replace("_", " "): entry for name, entry in entries.items()}


def means_with_sd(head: str, name: str, factor: float = 1.0, decimals: int = 1) -> GridColumn:
    """Return a column of ``mean ± sd``, from ``<name>_mean`` and ``<name>_sd`` of a result table times ``factor``."""

    def cell(row: Mapping[str, Any]) -> str:
        mean, sd = (scale(row[f"{name}_{part}"], factor) for part in ("mean", "sd"))
        shown = show_fixed(mean, decimals)
        return shown if sd is None else f"{shown} ± {show_fixed(sd, decimals)}"

    return GridColumn(head, cell)


def show_estimate(row: Mapping[Any, Any], name: str, factor: float = 1.0) -> str:
    """Format a value times ``factor`` with its interval, such as ``0.312 (0.287 … 0.330)``.

    The row has the keys ``name``, ``<name>_low`` and ``<name>_high``; an unknown interval is omitted.
    """
    value, low, high = (scale(row[f"{name}{end}"], factor) for end in ("", "_low", "_high"))
    return show(value) if low is None or high is None else f"{show(value)} ({show(low)} … {show(high)})"


def show_ends(ends: Sequence[float] | None, decimals: int) -> str:
    """Format the two ends of an interval; return a dash if it is unknown."""
    return UNKNOWN if ends is None else " … ".join(show_fixed(end, decimals) for end in ends)


def to_grid(caption: str, rows: Iterable[Any], columns: Sequence[GridColumn], index: str = "") -> Grid:
    """Return the table of these rows as texts, with unprintable characters replaced.

    ``rows`` are mappings or objects from which the columns take their values, a mapping of them, or a DataFrame.
    ``index`` is the heading of an additional first column: the keys if ``rows`` is a mapping, else the numbers of the
    rows, from 1.
    """
    keys: Iterable[Any] = itertools.count(1)
    if isinstance(rows, Mapping):
        keys, rows = rows.keys(), rows.values()
    elif hasattr(rows, "to_dict"):
        rows = rows.to_dict("records")
    cells = [[style.clean(column.cell(row)) for column in columns] for row in rows]
    if index:
        columns = [texts(index, ""), *columns]
        cells = [[style.clean(key), *row] for key, row in zip(keys, cells, strict=False)]
    kept = [k for k, one in enumerate(columns) if not one.optional or any(row[k] != UNKNOWN for row in cells)]
    left = frozenset(place for place, k in enumerate(kept) if columns[k].text)
    return Grid(
        caption, tuple(columns[k].head for k in kept), tuple(tuple(row[k] for k in kept) for row in cells), left
    )


def list_facts(caption: str, values: Mapping[str, Any]) -> Grid:
    """Return a table of the known values; nested keys are joined with colons, and matrices are left out."""
    return Grid(caption, ("quantity", "value"), tuple(_flatten(values, "")), frozenset({0, 1}))


def _get_value(row: Any, source: Source) -> Any:
    if callable(source):
        return source(row)
    if isinstance(source, int):
        return row[source]
    return row.get(source) if isinstance(row, Mapping) else getattr(row, source)


def _flatten(values: Mapping[str, Any], above: str) -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        rows = [row for row in value if isinstance(row, list)] if isinstance(value, list) else []
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{above}{_make_label(key)}: ")
        elif value not in (None, "", UNKNOWN, [], ()) and not any(
            isinstance(item, float) for row in rows for item in row
        ):
            yield style.clean(above + _make_label(key)), style.clean(_format(value))


def _make_label(key: str) -> str:
    """Return the key of a fact as readable text, such as "window (s)" for ``window_s``."""
    if key in _LABELS or not key.isidentifier():
        return _LABELS.get(key, key)
    stem, _, suffix = key.rpartition("_")
    return f"{stem.replace('_', ' ')} ({_SUFFIXES[suffix]})" if suffix in _SUFFIXES and stem else key.replace("_", " ")


def _format(value: object) -> str:
    """Format any JSON value as short text."""
    match value:
        case None:
            return UNKNOWN
        case bool():
            return "yes" if value else "no"
        case float():
            return show(value, 4)
        case Mapping():
            return ", ".join(f"{key}: {_format(item)}" for key, item in value.items())
        case list() | tuple():
            nested = any(isinstance(item, (list, tuple)) for item in value)
            return (" | " if nested else ", ").join(_format(item) for item in value)
    return str(value)
