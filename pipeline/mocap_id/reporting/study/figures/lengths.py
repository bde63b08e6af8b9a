"""Lengths of shank and thigh of every person, identified, by landmarks and by stature (table 6.1 as a figure)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Item, Panel, Points, Symbol
from mocap_id.reporting.study.figures import people
from mocap_id.reporting.study.page_data import CohortData

_SEGMENTS = ("shank", "thigh")


def draw(data: CohortData) -> Figure | str:
    """Return a panel for each segment with a row for each person, or why there is none."""
    trials = data.tables["trials"]
    if not np.isfinite(trials[list(_SEGMENTS)].to_numpy(dtype=np.float64)).any():
        return "No segment lengths: no trial has a shank or a thigh."
    return Figure((tuple(_panel(data, segment) for segment in _SEGMENTS),))


def _panel(data: CohortData, segment: str) -> Panel:
    items = (
        *people.separators(data),
        *_references(data, segment),
        *people.dots(data, data.tables["trials"], segment, f"{segment}_sd", factor=100),
    )
    height = 0.7 + 0.3 * len(data.subjects)
    return Panel(items, segment, "length (cm)", rows=people.row_names(data), height=height)


def _references(data: CohortData, segment: str) -> list[Item]:
    lengths = data.of_people("lengths")
    own = lengths[lengths["segment"] == segment]
    framework, stature = own[own["method"] == "framework"], own[own["method"] == "stature"]
    measured = framework["reference"] == "landmarks"
    by_height = pd.concat(
        [
            framework[~measured][["subject", "reference_length"]],
            stature[["subject", "length_mean"]].rename(columns={"length_mean": "reference_length"}),
        ]
    )
    kinds: tuple[tuple[pd.DataFrame, str, str, Symbol, float], ...] = (
        (framework[measured], style.INK, "landmarks", "|", 14.0),
        (by_height, style.REFERENCE, "stature", "x", 6.0),
    )
    items: list[Item] = []
    for frame, colour, label, symbol, size in kinds:
        known = frame[np.isfinite(frame["reference_length"].to_numpy(dtype=np.float64))]
        if not known.empty:
            y = np.array([data.subjects.index(subject) for subject in known["subject"]], dtype=np.float64)
            x = 100 * known["reference_length"].to_numpy(dtype=np.float64)
            items.append(Points(x, y, colour, label, symbol, size))
    return items
