"""Error of the centre of pressure for every person: own models, and the allometric body (table 6.3 as a figure)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mocap_id.reporting import style
from mocap_id.reporting.cohort.figures import people
from mocap_id.reporting.cohort.material import CohortMaterial

_OWN, _HELD_OUT = "own", "own, held out"


def draw(material: CohortMaterial) -> Figure | str:
    """A row a person, a mark for each prediction of each of the person's trials."""
    frame = material.of_people("models")
    frame = frame[np.isfinite(frame["cop_x_rms"].to_numpy(dtype=np.float64))]
    if frame.empty:
        return "No centre of pressure was predicted: no trial has an identified body."
    figure = style.figure(0.9 + 0.34 * len(material.subjects))
    axes = figure.subplots()
    carried = ~frame["model"].isin([_OWN, _HELD_OUT]) & (frame["model_trial"] != "")
    kinds: tuple[tuple[str, pd.Series[bool], dict[str, Any]], ...] = (
        ("own", frame["model"] == _OWN, {"marker": "o", "color": style.MODEL}),
        ("own, held out", frame["model"] == _HELD_OUT, {"marker": "o", "color": style.MODEL, "mfc": "none"}),
        ("other trial of the person", carried, {"marker": "d", "color": style.GREEN, "mfc": "none"}),
        ("allometric body", frame["model_trial"] == "", {"marker": "x", "color": style.REFERENCE, "mew": 1.6}),
    )
    for label, chosen, look in kinds:
        own = frame[chosen]
        if not own.empty:
            y = people.places(own["action_trial"].tolist(), people.trials_of(material), material.subjects)
            axes.plot(1e3 * own["cop_x_rms"].to_numpy(dtype=np.float64), y, ls="none", ms=4.5, label=label, **look)
    people.rows(axes, material.subjects)
    axes.set_xlim(0, None)
    axes.margins(x=0.05)
    axes.set_xlabel("centre of pressure, rms error (mm)")
    style.legend_above(figure, [axes])
    return figure
