"""Base parameters of every trial, a panel a parameter and a row a person (figure 6.8's parameters themselves)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.reporting import style
from mocap_id.reporting.cohort.figures import people
from mocap_id.reporting.cohort.material import CohortMaterial

_COLUMNS = 4
_MOST = 16  # panels


def draw(material: CohortMaterial) -> Figure | str:
    """Dots with 95 % intervals, crosses for the allometric body."""
    frame = material.tables["parameters"]
    if frame.empty:
        return "No base parameters: nothing was identified on any trial."
    names = list(dict.fromkeys(frame["parameter"]))[:_MOST]
    lines = -(-len(names) // _COLUMNS)
    figure = style.figure(0.7 + lines * (0.75 + 0.2 * len(material.subjects)))
    panels = figure.subplots(lines, _COLUMNS, squeeze=False)
    for k, axes in enumerate(panels.ravel()):
        if k >= len(names):
            axes.set_axis_off()
        else:
            _panel(axes, material, frame[frame["parameter"] == names[k]], named=k % _COLUMNS == 0)
    style.legend_above(figure, panels.ravel())
    return figure


def _panel(axes: Axes, material: CohortMaterial, frame: pd.DataFrame, *, named: bool) -> None:
    people.dots(axes, material, frame, "value", "sd")
    reference = frame[np.isfinite(frame["reference"].to_numpy(dtype=np.float64))]
    if not reference.empty:
        y = people.places(reference["trial"].tolist(), people.trials_of(material), material.subjects)
        x = reference["reference"].to_numpy(dtype=np.float64)
        axes.plot(x, y, "x", color=style.REFERENCE, ms=4, mew=1.2, label="allometric body")
    people.rows(axes, material.subjects, named=named)
    axes.margins(x=0.1)
    axes.locator_params(axis="x", nbins=4)
    axes.set_title(style.printable(frame["parameter"].iloc[0], 12))
    axes.set_xlabel(style.unit(str(frame["unit"].iloc[0])))
