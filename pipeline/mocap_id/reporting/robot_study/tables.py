"""The tables of a robot study, in the form of the thesis's tables: mean (standard deviation)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import pandas as pd

from mocap_id.reporting.grids import Grid, GridColumn, number, text, to_grid
from mocap_id.reporting.numbers import UNKNOWN, show_fixed, to_number
from mocap_id.reporting.style import format_unit

Kind: TypeAlias = Literal["value", "error"]

_UNITS = {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi), "rad/s": ("deg/s", 180 / np.pi)}
_DECIMALS = {"mm": 2, "deg": 3, "deg/s": 2, "1": 1, "kg·m²": 4}
_SOURCES = {"this": "this program", "thesis": "thesis"}


@dataclass(frozen=True)
class Quantity:
    """A quantity in a table of the thesis, with a column for its mean and one for its standard deviation."""

    name: str
    unit: str
    meaning: str
    symbol: str  # heading of the column
    # For a value, the columns are mean and standard deviation over the trials. For an error, they are the mean of the
    # trials' biases and the root mean square of the trials' standard deviations.
    kind: Kind = "value"
    to_si: float = 1.0  # factor from the thesis's unit to SI
    decimals: int | None = None  # number of decimals; None for the usual number of the unit

    @property
    def grid_column(self) -> GridColumn:
        """Column of a table with cells ``mean (standard deviation)``."""
        shown, factor = _UNITS.get(self.unit, (format_unit(self.unit), 1.0))
        decimals = _DECIMALS.get(shown, 3) if self.decimals is None else self.decimals

        def cell(row: Mapping[str, Any]) -> str:
            mean, sd = to_number(row[f"{self.name}_mean"]), to_number(row[f"{self.name}_sd"])
            if mean is None and sd is None:
                return UNKNOWN
            value = "?" if mean is None else show_fixed(factor * mean, decimals)
            return value if sd is None else f"{value} ({show_fixed(factor * sd, decimals)})"

        return GridColumn(self.symbol if self.unit == "1" else f"{self.symbol} ({shown})", cell)


def list_thesis_rows(title: str, frame: pd.DataFrame, quantities: Sequence[Quantity]) -> Grid:
    """Return one of the thesis's tables with the rows of the study and, below them, those of the thesis."""
    columns = (
        text("joint", "joint", UNKNOWN),
        GridColumn("orientation (deg)", lambda row: show_fixed(row["orientation"], 0), text=True, optional=True),
        text("speed", "speed", UNKNOWN),
        text("obs.", "obs"),
        text("by", lambda row: _SOURCES[row["source"]]),
        text("trials", "trials", UNKNOWN),
        *(quantity.grid_column for quantity in quantities),
    )
    return to_grid(title, frame, columns)


def list_trials(trials: pd.DataFrame) -> Grid:
    """Return a table of every trial with states from the cameras: verdict, and errors if they are known."""
    columns = (
        text("trial", "trial"),
        text("verdict", "verdict"),
        text("reasons", "codes", UNKNOWN),
        number("l₁ (mm)", "base", 2, 1e3),
        number("error of l₁ (mm)", "base_error", 2, 1e3),
        number("acceleration r²", "ddtheta_r2", 4),
        number("condition", "condition"),
        GridColumn("error of my₂ (%)", lambda row: _show_error(row, "my2")),
        GridColumn("error of Izz₂ (%)", lambda row: _show_error(row, "Izz2")),
        text("Izz₂ is", "Izz2_verdict", UNKNOWN),
        number("torque r²", "torque_r2", 4),
        number("clock of the encoder (ms)", "encoder_offset", 3, 1e3),
    )
    caption = "Every trial, with states from the cameras; errors of my₂ and Izz₂ ± sd, relative to the reference"
    return to_grid(caption, trials[trials["method"] == "cameras"], columns)


def _show_error(row: Mapping[str, Any], name: str) -> str:
    """Format the error of a parameter with its standard deviation, in per cent of the reference."""
    value, reference, sd = (to_number(row[key]) for key in (name, f"{name}_reference", f"{name}_sd"))
    if value is None or not reference or sd is None:
        return UNKNOWN
    return f"{show_fixed(100 * (value / reference - 1), 2)} ± {show_fixed(100 * sd / reference, 2)}"
