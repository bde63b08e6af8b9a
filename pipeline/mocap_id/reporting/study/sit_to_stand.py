"""``cohort.html`` of a study of sit-to-stand trials: tables in the form of the thesis's tables, and figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.reporting.figure import Drawing, Drawings, Figure, Item, Panel, Points, Symbol, arrange_in_lines
from mocap_id.reporting.grids import UNKNOWN, means_with_sd, show, show_fixed, texts
from mocap_id.reporting.page import KeyNumber, Section
from mocap_id.reporting.study import (
    CohortData,
    draw_dots,
    draw_separators,
    place_trials,
    render_study_page,
    to_floats,
)

_SEGMENTS = ("shank", "thigh")
_COLUMNS, _MOST_PANELS = 4, 16
_OWN, _HELD_OUT = "own", "own, held out"
_FOOTER = (
    "Lengths and errors have the units that the tables give; the same numbers in SI units are in the CSV and Parquet "
    "files beside this page, which study.json describes. x points along the motion, y up."
)


def render_cohort_page(data: CohortData) -> bytes:
    """Return the HTML page in UTF-8, from the tables trials, lengths, strategies, models, parameters and variation."""
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
    figures = Drawings(style.clean(data.study), (lengths, pressure, parameters))
    numbers = [number for number in _make_key_numbers(data) if number.value != UNKNOWN]
    return render_study_page(data, numbers, _make_sections(data), figures, _FOOTER)


def _make_key_numbers(data: CohortData) -> Iterator[KeyNumber]:
    trials, strategies = data.frame("trials"), data.list_labels("strategy")
    complete = trials["complete"]
    yield KeyNumber("people", str(len(data.subjects)), f"{len(data.trials)} trials")
    yield KeyNumber("strategies", str(len(strategies)), ", ".join(strategies))
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
    values = to_floats(column)
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else float("nan")


def _make_sections(data: CohortData) -> Iterator[Section]:
    tables = data.tables
    cohort, people = (
        {name: select(name) for name in ("lengths", "strategies", "models", "variation")}
        for select in (data.of_cohort, data.of_people)
    )
    trials = tables["trials"].grid(
        "Every trial; errors of the centre of pressure are rms, off the chair",
        "trial",
        texts("subject", "subject"),
        "strategy verdict repetitions five_times reprojection condition_number",
        "cop_x_own_rms cop_x_held_out_rms cop_x_reference_rms",
    )
    yield Section("trials", "Trials", (trials,))
    lengths = tables["lengths"].grid(
        "Lengths against their reference (thesis table 6.1): mean ± sd over the people, or over the trials of a person",
        "subject segment method reference trials length_mean reference_length error_mean why",
        rows=pd.concat([cohort["lengths"], people["lengths"]]),
    )
    means = "shank_error_mean thigh_error_mean reprojection_mean condition_number_mean"
    by_strategy, by_person = (
        tables["strategies"].grid(caption, "subject strategy reference trials", means, rows=rows)
        for caption, rows in (
            ("By strategy (thesis table 6.2): mean ± sd over the people", cohort["strategies"]),
            ("By person and strategy: mean ± sd over the person's trials", people["strategies"]),
        )
    )
    yield Section("lengths", "Segment lengths", (lengths, by_strategy), ("lengths",), (by_person,))
    names = map(str, data.frame("models").columns)
    torques = [name[4:-5] for name in names if name.startswith("tau_") and name.endswith("_mean")]
    all_people, each_person = (
        tables["models"].grid(
            caption,
            "action condition_number_mean model pairs Fy_mean tauz_mean cop_x_mean",
            *(means_with_sd(f"τ{k} (N·m)", f"tau_{k}") for k in torques),
            rows=rows,
        )
        for caption, rows in (
            (
                "Every model on every action of the same person (thesis table 6.3), model minus measurement off the "
                "chair, bias ± sd over all people; torques of both legs together minus those of the action's own model",
                cohort["models"],
            ),
            (
                "Every model on every trial of the same person, model minus measurement off the chair, bias ± sd",
                people["models"][people["models"]["pairs"] > 0],
            ),
        )
    )
    doubtful = people["models"]

    def name_code(code: str) -> str:
        return EXPLANATIONS[code].title if code in EXPLANATIONS else code

    doubts = tables["models"].grid(
        "Predictions that could not be made, or that the recordings do not support",
        "action_trial model_trial",
        texts("why", lambda row: row["why"] or "; ".join(map(name_code, row["codes"].split(", ")))),
        rows=doubtful[(doubtful["why"] != "") | (doubtful["codes"] != "")],
    )
    yield Section("models", "Forces and torques by every model", (all_people, doubts), ("pressure",), (each_person,))
    of_cohort, of_people = (
        tables["variation"].grid(caption, "subject set parameter expression trials cv reference_cv", rows=rows)
        for caption, rows in (
            (
                "Coefficient of variation of base and modified base parameters over each person's trials (thesis "
                "figure 6.8): mean ± sd over the people. The parameters of the allometric body vary only with the "
                "chain",
                cohort["variation"],
            ),
            (
                "Coefficient of variation over each person's trials",
                people["variation"][people["variation"]["trials"] > 1],
            ),
        )
    )
    yield Section("parameters", "Inertial parameters", (of_cohort,), ("parameters",), (of_people,))


def _draw_lengths(data: CohortData) -> Figure | str:
    """Return the lengths of shank and thigh: identified, by landmarks and by stature (table 6.1 as a figure)."""
    trials = data.frame("trials")
    if not np.isfinite(trials[list(_SEGMENTS)].to_numpy(dtype=np.float64)).any():
        return "No segment lengths: no trial has a shank or a thigh."
    panels = []
    for segment in _SEGMENTS:
        # the lengths measured on the body, and the lengths of the table for the person's height
        items = draw_separators(data)
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
        for frame, colour, label, symbol, size in kinds:
            known = frame[np.isfinite(to_floats(frame["reference_length"]))]
            if not known.empty:
                y = np.array([data.subjects.index(subject) for subject in known["subject"]], dtype=np.float64)
                x = 100 * to_floats(known["reference_length"])
                items.append(Points(x, y, colour, label, symbol, size))
        items += draw_dots(data, trials, segment, f"{segment}_sd", factor=100)
        panels.append(_make_panel(data, items, segment, "length (cm)", 0.7 + 0.3 * len(data.subjects)))
    return Figure((tuple(panels),))


def _make_panel(data: CohortData, items: list[Item], title: str, x: str, height: float) -> Panel:
    return Panel(
        tuple(items), title, x, rows=tuple(style.clean(subject, 16) for subject in data.subjects), height=height
    )


def _draw_pressure(data: CohortData) -> Figure | str:
    """Return a row for each person, with a mark for the error of each predicted centre of pressure (table 6.3)."""
    frame = data.of_people("models")
    frame = frame[np.isfinite(to_floats(frame["cop_x_rms"]))]
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
            x, y = 1e3 * to_floats(own["cop_x_rms"]), place_trials(data, trials)
            names = tuple(style.clean(trial, 30) for trial in trials)
            items.append(Points(x, y, colour, label, symbol, 4.5, names=names))
    panel = _make_panel(data, items, "", "centre of pressure, rms error (mm)", 0.6 + 0.34 * len(data.subjects))
    return Figure(((replace(panel, x_range=(0, 1.05e3 * float(frame["cop_x_rms"].max()))),),))


def _draw_parameters(data: CohortData) -> Figure | str:
    """Return a panel for each parameter with a row for each person (parameters of figure 6.8)."""
    frame = data.frame("parameters")
    if frame.empty:
        return "No base parameters: nothing was identified on any trial."
    panels = []
    for name in list(dict.fromkeys(frame["parameter"]))[:_MOST_PANELS]:
        own = frame[frame["parameter"] == name]
        items = [*draw_separators(data), *draw_dots(data, own, "value", "sd")]
        reference = own[np.isfinite(to_floats(own["reference"]))]
        if len(reference):
            x = to_floats(reference["reference"])
            y = place_trials(data, reference["trial"].tolist())
            items.append(Points(x, y, style.REFERENCE, "allometric body", "x", 4.0))
        title, unit = style.clean(name, 24), style.format_unit(str(own["unit"].iloc[0]))
        panels.append(_make_panel(data, items, title, unit, 0.75 + 0.2 * len(data.subjects)))
    return Figure(arrange_in_lines(tuple(panels), _COLUMNS))
