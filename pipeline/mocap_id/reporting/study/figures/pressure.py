"""Error of the centre of pressure by person: own models and the allometric body (table 6.3 as a figure)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Item, Panel, Points, Symbol
from mocap_id.reporting.study.figures import people
from mocap_id.reporting.study.page_data import CohortData

_OWN, _HELD_OUT = "own", "own, held out"


def draw(data: CohortData) -> Figure | str:
    """Return a row for each person with a mark for each prediction, or why there is no figure."""
    frame = data.of_people("models")
    frame = frame[np.isfinite(frame["cop_x_rms"].to_numpy(dtype=np.float64))]
    if frame.empty:
        return "No centre of pressure was predicted: no trial has an identified body."
    transferred = ~frame["model"].isin([_OWN, _HELD_OUT]) & (frame["model_trial"] != "")
    kinds: tuple[tuple[str, pd.Series[bool], Symbol, str], ...] = (
        ("own", frame["model"] == _OWN, "dot", style.MODEL),
        ("own, held out", frame["model"] == _HELD_OUT, "ring", style.MODEL),
        ("other trial of the person", transferred, "diamond", style.GREEN),
        ("allometric body", frame["model_trial"] == "", "x", style.REFERENCE),
    )
    items: list[Item] = people.separators(data)
    most = 1.05e3 * float(frame["cop_x_rms"].max())
    for label, chosen, symbol, colour in kinds:
        own = frame[chosen]
        if not own.empty:
            trials = own["action_trial"].tolist()
            x, names = 1e3 * own["cop_x_rms"].to_numpy(dtype=np.float64), [style.printable(one, 30) for one in trials]
            items.append(Points(x, people.trial_places(data, trials), colour, label, symbol, 4.5, names=tuple(names)))
    height = 0.6 + 0.34 * len(data.subjects)
    name = "centre of pressure, rms error (mm)"
    return Figure(((Panel(tuple(items), x=name, x_range=(0, most), rows=people.row_names(data), height=height),),))
