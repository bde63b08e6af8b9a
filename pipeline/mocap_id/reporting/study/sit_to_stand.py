"""The tables of a study of sit-to-stand trials, in the form of the thesis's tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.contents import COHORT
from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.reporting.figure import Drawing, Drawings, Figure, Item, Panel, Points, Symbol, arrange_in_lines
from mocap_id.reporting.grids import Grid, GridColumn, mean_sd, millimetres, number, text, to_grid
from mocap_id.reporting.numbers import UNKNOWN, scale, show, show_fixed, to_number
from mocap_id.reporting.page import KeyNumber, Section
from mocap_id.reporting.study.cohort import (
    VERDICT,
    CohortData,
    draw_dots,
    draw_separators,
    name_rows,
    place_trials,
    render_study_page,
)

BY_STRATEGY = "By strategy (thesis table 6.2): mean ± sd over the people"
BY_PERSON = "By person and strategy: mean ± sd over the person's trials"
MODELS = (
    "Every model on every action of the same person (thesis table 6.3), model minus measurement off the chair, bias ± "
    "sd over all people; torques of both legs together minus those of the action's own model"
)
MODELS_BY_PERSON = "Every model on every trial of the same person, model minus measurement off the chair, bias ± sd"
VARIATION = (
    "Coefficient of variation of base and modified base parameters over each person's trials (thesis figure 6.8): "
    "mean ± sd over the people. The parameters of the allometric body vary only with the chain"
)
VARIATION_BY_PERSON = "Coefficient of variation over each person's trials"


def list_trials(data: CohortData) -> Grid:
    """Return a table of every trial with its verdict and errors."""
    columns = (
        text("trial", "trial"),
        text("subject", "subject"),
        text("strategy", "strategy"),
        VERDICT,
        GridColumn("complete repetitions", _count_complete, optional=True),
        GridColumn("five times (s)", _show_five_times, optional=True),
        millimetres("re-projection (mm)", "reprojection", optional=True),
        number("condition number", "condition_number", optional=True),
        millimetres("CoP, own (mm)", "cop_x_own_rms", optional=True),
        millimetres("held out (mm)", "cop_x_held_out_rms", optional=True),
        millimetres("allometric (mm)", "cop_x_reference_rms", optional=True),
    )
    return to_grid(
        "Every trial; errors of the centre of pressure are rms, off the chair", data.tables["trials"], columns
    )


def list_lengths(data: CohortData) -> Grid:
    """Return table 6.1: lengths by every method against their reference, for the cohort and for every person."""
    columns = (
        text("", "subject"),
        text("segment", "segment"),
        text("method", "method"),
        text("against", "reference", UNKNOWN),
        GridColumn(
            "people, or trials",
            lambda row: str(row["subjects"] if row["subject"] == COHORT else row["trials"] or UNKNOWN),
        ),
        number("length (cm)", "length_mean", 2, 100),
        number("reference (cm)", "reference_length", 2, 100),
        mean_sd("difference (%)", "error"),
        text("", "why"),
    )
    caption = (
        "Lengths against their reference (thesis table 6.1): mean ± sd over the people, or over the trials of a person"
    )
    return to_grid(caption, pd.concat([data.of_cohort("lengths"), data.of_people("lengths")]), columns)


def list_strategies(frame: pd.DataFrame, caption: str) -> Grid:
    """Return table 6.2 (results by strategy) from rows of the cohort or of every person."""
    columns = (
        text("", "subject"),
        text("strategy", "strategy"),
        text("lengths against", "reference", UNKNOWN),
        number("trials", "trials", 0),
        mean_sd("shank (%)", "shank_error"),
        mean_sd("thigh (%)", "thigh_error"),
        mean_sd("re-projection (mm)", "reprojection", 1e3),
        mean_sd("condition number", "condition_number"),
    )
    return to_grid(caption, frame, columns)


def list_models(frame: pd.DataFrame, caption: str) -> Grid:
    """Return table 6.3 (errors of every model) from rows of the cohort or of every person."""
    torques = [
        name.removesuffix("_mean") for name in frame.columns if name.startswith("tau_") and name.endswith("_mean")
    ]
    columns = (
        text("action", lambda row: row["action_trial"] or row["action"]),
        mean_sd("condition number", "condition_number", decimals=0),
        text("model", lambda row: row["model"] if row["model"].startswith("own") else _name_model(row)),
        number("predictions", "pairs", 0),
        mean_sd("Fy (N)", "Fy"),
        mean_sd("τz (N·m)", "tauz"),
        mean_sd("CoP (mm)", "cop_x", 1e3),
        *(mean_sd(f"τ{name[4:]} (N·m)", name) for name in torques),
    )
    return to_grid(caption, frame, columns)


def list_doubtful(data: CohortData) -> Grid:
    """Return a table of the predictions that failed or are doubtful, and why."""
    frame = data.of_people("models")
    columns = (
        text("action", "action_trial"),
        text("model", _name_model),
        text("why", lambda row: row["why"] or _list_titles(row["codes"])),
    )
    caption = "Predictions that could not be made, or that the recordings do not support"
    return to_grid(caption, frame[(frame["why"] != "") | (frame["codes"] != "")], columns)


def list_variation(frame: pd.DataFrame, caption: str) -> Grid:
    """Return figure 6.8 (variation of the parameters) as a table, from rows of the cohort or of every person."""
    columns = (
        text("", "subject"),
        text("set", "set"),
        text("parameter", "parameter"),
        text("expression", "expression"),
        number("trials", "trials", 0),
        GridColumn("own models (%)", lambda row: _show_variation(row, "cv")),
        GridColumn("allometric body (%)", lambda row: _show_variation(row, "reference_cv")),
    )
    return to_grid(caption, frame, columns)


def _count_complete(row: Mapping[str, Any]) -> str:
    return UNKNOWN if pd.isna(row["repetitions"]) else f"{row['complete']} of {row['repetitions']}"


def _show_five_times(row: Mapping[str, Any]) -> str:
    seconds, sd = to_number(row["five_times"]), to_number(row["five_times_sd"])
    return show_fixed(seconds, 2) if seconds is None or sd is None else f"{seconds:.2f} ± {sd:.3f}"


def _name_model(row: Mapping[str, Any]) -> str:
    return str(row["model_trial"] or row["model"])


def _list_titles(codes: str) -> str:
    """Return the titles of reason codes, joined by semicolons; ``codes`` are joined by commas."""
    return "; ".join(EXPLANATIONS[code].title if code in EXPLANATIONS else code for code in codes.split(", "))


def _show_variation(row: Mapping[str, Any], name: str) -> str:
    mean, sd = scale(row[name], 100), scale(row[f"{name}_sd"], 100)
    return show(mean, 2) if sd is None else f"{show(mean, 2)} ± {show(sd, 2)}"


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
        dots = draw_dots(data, trials, segment, f"{segment}_sd", factor=100)
        items = [*draw_separators(data), *_draw_reference_lengths(data, segment), *dots]
        panels.append(_make_panel(data, items, segment, "length (cm)", 0.7 + 0.3 * len(data.subjects)))
    return Figure((tuple(panels),))


def _make_panel(data: CohortData, items: list[Item], title: str, x: str, height: float) -> Panel:
    return Panel(tuple(items), title, x, rows=name_rows(data), height=height)


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
    items = draw_separators(data)
    for label, chosen, symbol, colour in kinds:
        own = frame[chosen]
        if not own.empty:
            trials = own["action_trial"].tolist()
            x, y = 1e3 * own["cop_x_rms"].to_numpy(dtype=np.float64), place_trials(data, trials)
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
        items = [*draw_separators(data), *draw_dots(data, own, "value", "sd")]
        reference = own[np.isfinite(own["reference"].to_numpy(dtype=np.float64))]
        if len(reference):
            x = reference["reference"].to_numpy(dtype=np.float64)
            y = place_trials(data, reference["trial"].tolist())
            items.append(Points(x, y, style.REFERENCE, "allometric body", "x", 4.0))
        title, unit = style.clean(name, 24), style.format_unit(str(own["unit"].iloc[0]))
        panels.append(_make_panel(data, items, title, unit, 0.75 + 0.2 * len(data.subjects)))
    return Figure(arrange_in_lines(tuple(panels), _COLUMNS))


_FOOTER = (
    "Lengths and errors have the units that the tables give; the same numbers in SI units are in the CSV and Parquet "
    "files beside this page, which study.json describes. x points along the motion, y up."
)


def render_cohort_page(data: CohortData) -> bytes:
    """Return the HTML page in UTF-8, from the tables trials, lengths, strategies, models, parameters and variation."""
    numbers = [number for number in _make_key_numbers(data) if number.value != UNKNOWN]
    return render_study_page(data, numbers, _make_sections(data), draw_cohort_figures(data), _FOOTER)


def _make_sections(data: CohortData) -> tuple[Section, ...]:
    people = {name: data.of_people(name) for name in ("strategies", "models", "variation")}
    predicted, varied = people["models"]["pairs"] > 0, people["variation"]["trials"] > 1
    return (
        Section("trials", "Trials", (list_trials(data),)),
        Section(
            "lengths",
            "Segment lengths",
            (list_lengths(data), list_strategies(data.of_cohort("strategies"), BY_STRATEGY)),
            ("lengths",),
            (list_strategies(people["strategies"], BY_PERSON),),
        ),
        Section(
            "models",
            "Forces and torques by every model",
            (list_models(data.of_cohort("models"), MODELS), list_doubtful(data)),
            ("pressure",),
            (list_models(people["models"][predicted], MODELS_BY_PERSON),),
        ),
        Section(
            "parameters",
            "Inertial parameters",
            (list_variation(data.of_cohort("variation"), VARIATION),),
            ("parameters",),
            (list_variation(people["variation"][varied], VARIATION_BY_PERSON),),
        ),
    )


def _make_key_numbers(data: CohortData) -> Iterator[KeyNumber]:
    trials = data.tables["trials"]
    complete = trials["complete"]
    yield KeyNumber("people", str(len(data.subjects)), f"{len(data.trials)} trials")
    yield KeyNumber("strategies", str(len(data.strategies)), ", ".join(data.strategies))
    yield KeyNumber("repetitions", str(int(complete.sum())) if complete.notna().any() else UNKNOWN, "complete")
    for name, column, remark in (
        ("re-projection", "reprojection", "median of the trials' rms"),
        ("CoP, own model", "cop_x_own_rms", "median of the trials' rms error"),
        ("CoP, held out", "cop_x_held_out_rms", "on left-out repetitions"),
        ("CoP, allometric", "cop_x_reference_rms", "on the samples of the own model"),
    ):
        yield KeyNumber(name, show_fixed(1e3 * _compute_median(trials[column]), 1, "mm"), remark)
    yield KeyNumber("condition number", show(_compute_median(trials["condition_number"])), "median")


def _compute_median(column: pd.Series[float]) -> float:
    """Return the median of the finite values; NaN if there are none."""
    values = column.to_numpy(dtype=np.float64)
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else float("nan")
