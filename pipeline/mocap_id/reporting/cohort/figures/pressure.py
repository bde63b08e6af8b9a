"""Error of the centre of pressure for every person: own models, and the allometric body (table 6.3 as a figure)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.cohort.figures import people
from mocap_id.reporting.cohort.material import CohortMaterial
from mocap_id.reporting.figure import Figure, Item, Panel, Points, Symbol

_OWN, _HELD_OUT = "own", "own, held out"


def shown(material: CohortMaterial) -> Figure | str:
    """A row a person, a mark for each prediction of each of the person's trials."""
    frame = material.of_people("models")
    frame = frame[np.isfinite(frame["cop_x_rms"].to_numpy(dtype=np.float64))]
    if frame.empty:
        return "No centre of pressure was predicted: no trial has an identified body."
    carried = ~frame["model"].isin([_OWN, _HELD_OUT]) & (frame["model_trial"] != "")
    kinds: tuple[tuple[str, pd.Series[bool], Symbol, str], ...] = (
        ("own", frame["model"] == _OWN, "dot", style.MODEL),
        ("own, held out", frame["model"] == _HELD_OUT, "ring", style.MODEL),
        ("other trial of the person", carried, "diamond", style.GREEN),
        ("allometric body", frame["model_trial"] == "", "x", style.REFERENCE),
    )
    items: list[Item] = people.between(material)
    most = 1.05e3 * float(frame["cop_x_rms"].max())
    for label, chosen, symbol, colour in kinds:
        own = frame[chosen]
        if not own.empty:
            trials = own["action_trial"].tolist()
            x, told = (
                1e3 * own["cop_x_rms"].to_numpy(dtype=np.float64),
                tuple(style.printable(one, 30) for one in trials),
            )
            items.append(Points(x, people.places(material, trials), colour, label, symbol, 4.5, names=told))
    height = 0.6 + 0.34 * len(material.subjects)
    name = "centre of pressure, rms error (mm)"
    return Figure(((Panel(tuple(items), x=name, x_range=(0, most), rows=people.names(material), height=height),),))
