"""Base parameters of every trial, a panel a parameter and a row a person (figure 6.8's parameters themselves)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.cohort.figures import people
from mocap_id.reporting.cohort.material import CohortMaterial
from mocap_id.reporting.figure import Figure, Panel, Points, in_lines

_COLUMNS = 4
_MOST = 16  # panels


def shown(material: CohortMaterial) -> Figure | str:
    """Dots with 95 % intervals, crosses for the allometric body."""
    frame = material.tables["parameters"]
    if frame.empty:
        return "No base parameters: nothing was identified on any trial."
    names = list(dict.fromkeys(frame["parameter"]))[:_MOST]
    panels = tuple(_panel(material, frame[frame["parameter"] == name]) for name in names)
    return Figure(in_lines(panels, _COLUMNS))


def _panel(material: CohortMaterial, frame: pd.DataFrame) -> Panel:
    reference = frame[np.isfinite(frame["reference"].to_numpy(dtype=np.float64))]
    x, y = reference["reference"].to_numpy(dtype=np.float64), people.places(material, reference["trial"].tolist())
    crosses = [Points(x, y, style.REFERENCE, "allometric body", "x", 4.0)] if len(x) else []
    items = (*people.between(material), *people.dots(material, frame, "value", "sd"), *crosses)
    title, unit = style.printable(frame["parameter"].iloc[0], 24), style.unit(str(frame["unit"].iloc[0]))
    height = 0.75 + 0.2 * len(material.subjects)
    return Panel(items, title, unit, rows=people.names(material), height=height)
