"""Columns of a table as it is shown: a head, and the text of a row's cell."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mocap_id.reporting.numbers import UNKNOWN, known, show, show_fixed
from mocap_id.reporting.tables import Grid, grid

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class GridColumn:
    """A column as it is shown."""

    head: str
    cell: Callable[[Any], str]  # returns the text of a row's cell
    text: bool = False  # the column is text, and set left
    optional: bool = False  # the column is left out where no row has a value


def text(head: str, name: str, missing: str = "") -> GridColumn:
    """Return a column of texts; `missing` stands for an empty one."""
    return GridColumn(head, lambda row: str(row[name] or missing), text=True)


def number(
    head: str, name: str, decimals: int | None = None, factor: float = 1.0, *, optional: bool = False
) -> GridColumn:
    """Return a column of numbers times a factor, with so many decimals, or else with three significant digits."""

    def cell(row: Mapping[str, Any]) -> str:
        value = times(row[name], factor)
        return show(value) if decimals is None else show_fixed(value, decimals)

    return GridColumn(head, cell, optional=optional)


def mean_sd(head: str, name: str, factor: float = 1.0, decimals: int = 1) -> GridColumn:
    """Return a column of ``mean ± sd``; the mean alone where there is no standard deviation."""

    def cell(row: Mapping[str, Any]) -> str:
        mean, sd = (times(row[f"{name}_{part}"], factor) for part in ("mean", "sd"))
        return (
            show_fixed(mean, decimals) if sd is None else f"{show_fixed(mean, decimals)} ± {show_fixed(sd, decimals)}"
        )

    return GridColumn(head, cell)


def estimate(head: str, name: str) -> GridColumn:
    """Return a column of values with their intervals; left out where no row has one."""
    return GridColumn(head, lambda row: show_estimate(row, name), optional=True)


def show_estimate(row: Mapping[str, Any], name: str, factor: float = 1.0) -> str:
    """Return a value with its interval, such as ``0.312 (0.287 … 0.330)``."""
    value, low, high = (times(row[f"{name}{end}"], factor) for end in ("", "_low", "_high"))
    return show(value) if low is None or high is None else f"{show(value)} ({show(low)} … {show(high)})"


def records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a data frame by column name."""
    return [{str(name): value for name, value in row.items()} for row in frame.to_dict("records")]


def to_grid(caption: str, rows: Iterable[Any], columns: Sequence[GridColumn]) -> Grid:
    """Return the rows as text, without the optional columns that are empty."""
    cells = [[column.cell(row) for column in columns] for row in rows]
    kept = [k for k, one in enumerate(columns) if not one.optional or any(row[k] != UNKNOWN for row in cells)]
    left = [place for place, k in enumerate(kept) if columns[k].text]
    return grid(caption, [columns[k].head for k in kept], ([row[k] for k in kept] for row in cells), left)


def times(value: object, factor: float) -> float | None:
    """Return a known number times a factor; None where it is not known."""
    found = known(value)
    return None if found is None else factor * found
