"""The figures of a study of sit-to-stand trials; a sentence replaces a missing figure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.figure import Drawing, Drawings, Figure, Item, Panel, Points, Symbol, arrange_in_lines
from mocap_id.reporting.study import people_rows
from mocap_id.reporting.study.page_data import CohortData

_SEGMENTS = ("shank", "thigh")
_COLUMNS, _MOST_PANELS = 4, 16
_OWN, _HELD_OUT = "own", "own, held out"


def draw_cohort_figures(data: CohortData) -> Drawings:
    """Return all figures of the page."""
    lengths = Drawing(
        "lengths",
        "Segment lengths against their reference",
        "A dot for each trial with its 95 % interval, coloured by strategy. Bars are the lengths measured on the body; "
        "crosses are the lengths of the allometric table for the person's height.",
        _draw_lengths(data),
    )
    pressure = Drawing(
        "pressure",
        "Centre of pressure: own models and the allometric body",
        "Root mean square error of the predicted centre of pressure off the chair, a mark for each prediction. Own: "
        "the trial's model on its own samples. Held out: models on repetitions to which they were not fitted. Other "
        "trial: the model of another trial of the same person.",
        _draw_pressure(data),
    )
    parameters = Drawing(
        "parameters",
        "Base parameters of every person",
        "A dot for each trial with its 95 % interval, coloured by strategy; crosses are the allometric body. Each "
        "panel has its own scale.",
        _draw_parameters(data),
    )
    return Drawings(style.clean(data.study), (lengths, pressure, parameters))


def _draw_lengths(data: CohortData) -> Figure | str:
    """Return the lengths of shank and thigh: identified, by landmarks and by stature (table 6.1 as a figure)."""
    trials = data.tables["trials"]
    if not np.isfinite(trials[list(_SEGMENTS)].to_numpy(dtype=np.float64)).any():
        return "No segment lengths: no trial has a shank or a thigh."
    panels = []
    for segment in _SEGMENTS:
        dots = people_rows.draw_dots(data, trials, segment, f"{segment}_sd", factor=100)
        items = [*people_rows.draw_separators(data), *_draw_reference_lengths(data, segment), *dots]
        panels.append(_make_panel(data, items, segment, "length (cm)", 0.7 + 0.3 * len(data.subjects)))
    return Figure((tuple(panels),))


def _make_panel(data: CohortData, items: list[Item], title: str, x: str, height: float) -> Panel:
    return Panel(tuple(items), title, x, rows=people_rows.name_rows(data), height=height)


def _draw_reference_lengths(data: CohortData, segment: str) -> list[Item]:
    """Return the lengths measured on the body, and the lengths of the table for the person's height."""
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


def _draw_pressure(data: CohortData) -> Figure | str:
    """Return a row for each person, with a mark for the error of each predicted centre of pressure (table 6.3)."""
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
    items = people_rows.draw_separators(data)
    for label, chosen, symbol, colour in kinds:
        own = frame[chosen]
        if not own.empty:
            trials = own["action_trial"].tolist()
            x, y = 1e3 * own["cop_x_rms"].to_numpy(dtype=np.float64), people_rows.place_trials(data, trials)
            names = tuple(style.clean(trial, 30) for trial in trials)
            items.append(Points(x, y, colour, label, symbol, 4.5, names=names))
    panel = _make_panel(data, items, "", "centre of pressure, rms error (mm)", 0.6 + 0.34 * len(data.subjects))
    return Figure(((replace(panel, x_range=(0, 1.05e3 * float(frame["cop_x_rms"].max()))),),))


def _draw_parameters(data: CohortData) -> Figure | str:
    """Return a panel for each parameter with a row for each person (parameters of figure 6.8)."""
    frame = data.tables["parameters"]
    if frame.empty:
        return "No base parameters: nothing was identified on any trial."
    panels = []
    for name in list(dict.fromkeys(frame["parameter"]))[:_MOST_PANELS]:
        own = frame[frame["parameter"] == name]
        items = [*people_rows.draw_separators(data), *people_rows.draw_dots(data, own, "value", "sd")]
        reference = own[np.isfinite(own["reference"].to_numpy(dtype=np.float64))]
        if len(reference):
            x = reference["reference"].to_numpy(dtype=np.float64)
            y = people_rows.place_trials(data, reference["trial"].tolist())
            items.append(Points(x, y, style.REFERENCE, "allometric body", "x", 4.0))
        title, unit = style.clean(name, 24), style.format_unit(str(own["unit"].iloc[0]))
        panels.append(_make_panel(data, items, title, unit, 0.75 + 0.2 * len(data.subjects)))
    return Figure(arrange_in_lines(tuple(panels), _COLUMNS))
