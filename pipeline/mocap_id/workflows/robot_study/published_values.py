"""The thesis's tables 5.1 to 5.6, from ``thesis_tables.csv``: mean and standard deviation of every quantity.

The units are the thesis's. A cell is empty if the thesis does not give the value, or if our copy is
illegible there.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from importlib.resources import files
from typing import TypeAlias

Row: TypeAlias = tuple[tuple[float, float], ...]
"""Mean and standard deviation of each quantity; NaN if not known."""
Cell: TypeAlias = tuple[str, str, float | None, str]
"""Joint, speed, orientation (degrees), and source of the states."""


def published(table: str) -> Mapping[Cell, Row]:
    """Return the rows of one table of the thesis, such as ``table_5_1``."""
    text = files("mocap_id.workflows.robot_study").joinpath("thesis_tables.csv").read_text("utf-8")
    _, *lines = csv.reader(text.splitlines())
    found: dict[Cell, Row] = {}
    for name, joint, speed, orientation, obs, *cells in lines:
        if name == table:
            numbers = [float(cell or "nan") for cell in cells]
            cell = (joint, speed, float(orientation) if orientation else None, obs)
            found[cell] = tuple(zip(numbers[::2], numbers[1::2], strict=True))
    return found
