"""The tables of a study of sit-to-stand trials, in the form of the thesis's tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.reporting.grids import Grid, GridColumn, mean_sd, millimetres, number, text, to_grid
from mocap_id.reporting.numbers import UNKNOWN, scale, show, show_fixed, to_number
from mocap_id.reporting.results.study_page import VERDICT
from mocap_id.reporting.study.page_data import COHORT, CohortData

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
