"""The tables of a robot study as text, in the form of the thesis's tables: mean (standard deviation)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import pandas as pd

from mocap_id.reporting.numbers import UNKNOWN, known, show_fixed
from mocap_id.reporting.results.grid_columns import GridColumn, number, text, to_grid
from mocap_id.reporting.style import unit
from mocap_id.reporting.tables import Grid

Kind: TypeAlias = Literal["value", "error"]

_UNITS = {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi), "rad/s": ("deg/s", 180 / np.pi)}
_DECIMALS = {"mm": 2, "deg": 3, "deg/s": 2, "1": 1, "kg·m²": 4}
_SOURCES = {"this": "this program", "thesis": "thesis"}


@dataclass(frozen=True)
class Quantity:
    """A pair of columns, mean and standard deviation, in a table of the thesis."""

    name: str
    unit: str
    meaning: str
    symbol: str  # the head of the column as it is shown
    # a value has its mean and standard deviation over the trials. An error has the mean of the
    # trials' biases, and the root mean square of their standard deviations: those of all samples together
    kind: Kind = "value"
    to_si: float = 1.0  # factor from the thesis's unit to SI
    decimals: int | None = None  # as shown; None for the usual number for the unit

    @property
    def grid_column(self) -> GridColumn:
        """The column as it is shown: ``mean (standard deviation)``."""
        shown, factor = _UNITS.get(self.unit, (unit(self.unit), 1.0))
        decimals = _DECIMALS.get(shown, 3) if self.decimals is None else self.decimals

        def cell(row: Mapping[str, Any]) -> str:
            mean, sd = known(row[f"{self.name}_mean"]), known(row[f"{self.name}_sd"])
            if mean is None and sd is None:
                return UNKNOWN
            value = "?" if mean is None else show_fixed(factor * mean, decimals)
            return value if sd is None else f"{value} ({show_fixed(factor * sd, decimals)})"

        return GridColumn(self.symbol if self.unit == "1" else f"{self.symbol} ({shown})", cell)


def thesis_table(title: str, frame: pd.DataFrame, quantities: Sequence[Quantity]) -> Grid:
    """Return one of the thesis's tables, with its rows below ours."""
    columns = (
        text("joint", "joint", UNKNOWN),
        GridColumn("orientation (deg)", lambda row: show_fixed(row["orientation"], 0), text=True, optional=True),
        text("speed", "speed", UNKNOWN),
        text("obs.", "obs"),
        GridColumn("by", lambda row: _SOURCES[row["source"]], text=True),
        GridColumn("trials", lambda row: str(row["trials"] or UNKNOWN), text=True),
        *(quantity.grid_column for quantity in quantities),
    )
    return to_grid(title, frame.to_dict("records"), columns)


def overview(trials: pd.DataFrame) -> Grid:
    """Return a row for every trial with its states from the cameras: verdict, and errors if known."""
    columns = (
        text("trial", "trial"),
        text("verdict", "verdict"),
        text("reasons", "codes", UNKNOWN),
        number("l₁ (mm)", "base", 2, 1e3),
        number("off (mm)", "base_error", 2, 1e3),
        number("acceleration r²", "ddtheta_r2", 4),
        number("condition", "condition"),
        GridColumn("my₂ off (%)", lambda row: _relative_error(row, "my2")),
        GridColumn("Izz₂ off (%)", lambda row: _relative_error(row, "Izz2")),
        text("Izz₂ is", "Izz2_verdict", UNKNOWN),
        number("torque r²", "torque_r2", 4),
        number("encoder's clock (ms)", "encoder_offset", 3, 1e3),
    )
    caption = "Every trial by its cameras; errors of my₂ and Izz₂ ± standard deviation, as shares of the reference"
    return to_grid(caption, trials[trials["method"] == "cameras"].to_dict("records"), columns)


def _relative_error(row: Mapping[str, Any], name: str) -> str:
    value, reference, sd = (known(row[key]) for key in (name, f"{name}_reference", f"{name}_sd"))
    if value is None or not reference or sd is None:
        return UNKNOWN
    return f"{show_fixed(100 * (value / reference - 1), 2)} ± {show_fixed(100 * sd / reference, 2)}"
