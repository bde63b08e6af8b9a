"""Shank and thigh of every person against landmarks and stature (table 6.1 as a figure)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.reporting import style
from mocap_id.reporting.cohort.figures import people
from mocap_id.reporting.cohort.material import CohortMaterial

_SEGMENTS = ("shank", "thigh")


def draw(material: CohortMaterial) -> Figure | str:
    """A panel a segment, a row a person."""
    trials = material.tables["trials"]
    if not np.isfinite(trials[list(_SEGMENTS)].to_numpy(dtype=np.float64)).any():
        return "No segment lengths: no trial has a shank or a thigh."
    figure = style.figure(0.9 + 0.3 * len(material.subjects))
    panels = figure.subplots(1, 2)
    for axes, segment in zip(panels, _SEGMENTS, strict=True):
        people.dots(axes, material, trials, segment, f"{segment}_sd", factor=100)
        _references(axes, material, segment)
        people.rows(axes, material.subjects, named=segment == _SEGMENTS[0])
        axes.margins(x=0.08)
        axes.set_title(segment)
        axes.set_xlabel("length (cm)")
    style.legend_above(figure, list(panels))
    return figure


def _references(axes: Axes, material: CohortMaterial, segment: str) -> None:
    lengths = material.of_people("lengths")
    own = lengths[lengths["segment"] == segment]
    landmarks = own[(own["reference"] == "landmarks") & (own["method"] == "framework")]
    against = own[(own["reference"] != "landmarks") & (own["method"] == "framework")]
    look = {"marker": "|", "ms": 16, "mew": 2, "color": style.INK, "label": "landmarks"}
    _marks(axes, material, landmarks, look)
    stature = pd.concat(
        [
            against[["subject", "reference_length"]],
            own[own["method"] == "stature"][["subject", "length_mean"]].rename(
                columns={"length_mean": "reference_length"}
            ),
        ]
    )
    look = {"marker": "x", "ms": 6, "mew": 1.6, "color": style.REFERENCE, "label": "stature"}
    _marks(axes, material, stature, look)


def _marks(axes: Axes, material: CohortMaterial, frame: pd.DataFrame, look: Mapping[str, Any]) -> None:
    known = frame[np.isfinite(frame["reference_length"].to_numpy(dtype=np.float64))]
    if not known.empty:
        y = [material.subjects.index(subject) for subject in known["subject"]]
        x = 100 * known["reference_length"].to_numpy(dtype=np.float64)
        axes.plot(x, y, ls="none", zorder=1, **look)
