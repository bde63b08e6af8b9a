"""Shank and thigh of every person against landmarks and stature (table 6.1 as a figure)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.cohort.figures import people
from mocap_id.reporting.cohort.material import CohortMaterial
from mocap_id.reporting.figure import Figure, Item, Panel, Points, Symbol

_SEGMENTS = ("shank", "thigh")


def shown(material: CohortMaterial) -> Figure | str:
    """A panel a segment, a row a person."""
    trials = material.tables["trials"]
    if not np.isfinite(trials[list(_SEGMENTS)].to_numpy(dtype=np.float64)).any():
        return "No segment lengths: no trial has a shank or a thigh."
    return Figure((tuple(_panel(material, segment) for segment in _SEGMENTS),))


def _panel(material: CohortMaterial, segment: str) -> Panel:
    items = (
        *people.between(material),
        *_references(material, segment),
        *people.dots(material, material.tables["trials"], segment, f"{segment}_sd", factor=100),
    )
    height = 0.7 + 0.3 * len(material.subjects)
    return Panel(items, segment, "length (cm)", rows=people.names(material), height=height)


def _references(material: CohortMaterial, segment: str) -> list[Item]:
    lengths = material.of_people("lengths")
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
            y = np.array([material.subjects.index(subject) for subject in known["subject"]], dtype=np.float64)
            x = 100 * known["reference_length"].to_numpy(dtype=np.float64)
            items.append(Points(x, y, colour, label, symbol, size))
    return items
