"""Base parameters of every trial: a panel for each parameter, a row for each person (parameters of figure 6.8)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Panel, Points, in_lines
from mocap_id.reporting.study.figures import people
from mocap_id.reporting.study.page_data import CohortData

_COLUMNS = 4
_MOST = 16  # panels


def draw(data: CohortData) -> Figure | str:
    """Return dots with 95 % intervals and crosses for the allometric body, or why there is no figure."""
    frame = data.tables["parameters"]
    if frame.empty:
        return "No base parameters: nothing was identified on any trial."
    names = list(dict.fromkeys(frame["parameter"]))[:_MOST]
    panels = tuple(_panel(data, frame[frame["parameter"] == name]) for name in names)
    return Figure(in_lines(panels, _COLUMNS))


def _panel(data: CohortData, frame: pd.DataFrame) -> Panel:
    reference = frame[np.isfinite(frame["reference"].to_numpy(dtype=np.float64))]
    x, y = reference["reference"].to_numpy(dtype=np.float64), people.trial_places(data, reference["trial"].tolist())
    crosses = [Points(x, y, style.REFERENCE, "allometric body", "x", 4.0)] if len(x) else []
    items = (*people.separators(data), *people.dots(data, frame, "value", "sd"), *crosses)
    title, unit = style.printable(frame["parameter"].iloc[0], 24), style.unit(str(frame["unit"].iloc[0]))
    height = 0.75 + 0.2 * len(data.subjects)
    return Panel(items, title, unit, rows=people.row_names(data), height=height)
