"""The cohort's tables as text, in the form of the thesis's tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.reporting.numbers import UNKNOWN, show
from mocap_id.reporting.results.grid_columns import GridColumn, mean_sd, number, text, times, to_grid
from mocap_id.reporting.results.trial_entries import FATES
from mocap_id.reporting.study.page_data import COHORT, CohortData
from mocap_id.reporting.tables import Grid

BY_STRATEGY = "By strategy (thesis table 6.2): mean ± sd over the people"
BY_PERSON = "By person and strategy: mean ± sd over the person's trials"
MODELS = (
    "Every model on every action of the same person (thesis table 6.3), model less measurement off the chair, "
    "bias ± sd over all people; torques against those of the action's own model"
)
MODELS_BY_PERSON = "Every model on every trial of the same person, model less measurement off the chair, bias ± sd"
VARIATION = (
    "Coefficient of variation of base and modified base parameters over each person's trials (thesis figure 6.8): "
    "mean ± sd over the people. The allometric body varies only with the chain that it is put on"
)
VARIATION_BY_PERSON = "Coefficient of variation over each person's trials"


def trials(data: CohortData) -> Grid:
    """Return every trial with its verdict and errors."""
    columns = (
        text("trial", "trial"),
        text("subject", "subject"),
        text("strategy", "strategy"),
        GridColumn("verdict", lambda row: FATES[row["verdict"]], text=True),
        GridColumn("complete repetitions", _complete, optional=True),
        number("five times (s)", "five_times", 2, optional=True),
        number("re-projection (mm)", "reprojection", 1, 1e3, optional=True),
        number("condition number", "condition_number", optional=True),
        number("CoP, own (mm)", "cop_x_own_rms", 1, 1e3, optional=True),
        number("held out (mm)", "cop_x_held_out_rms", 1, 1e3, optional=True),
        number("allometric (mm)", "cop_x_reference_rms", 1, 1e3, optional=True),
    )
    caption = "Every trial; errors of the centre of pressure are rms, off the chair"
    return to_grid(caption, data.tables["trials"].to_dict("records"), columns)


def lengths(data: CohortData) -> Grid:
    """Return table 6.1, methods against their reference, with the rows of every person."""
    columns = (
        text("", "subject"),
        text("segment", "segment"),
        text("method", "method"),
        text("against", "reference", UNKNOWN),
        GridColumn("people, or trials", _counted),
        number("length (cm)", "length_mean", 2, 100),
        number("reference (cm)", "reference_length", 2, 100),
        mean_sd("difference (%)", "error"),
        text("", "why"),
    )
    caption = "Lengths against their reference (thesis table 6.1): mean ± sd over the people, of one person over trials"
    frame = pd.concat([data.of_cohort("lengths"), data.of_people("lengths")])
    return to_grid(caption, frame.to_dict("records"), columns)


def strategies(frame: pd.DataFrame, caption: str) -> Grid:
    """Return table 6.2, of the cohort or of every person."""
    columns = (
        text("", "subject"),
        text("strategy", "strategy"),
        text("lengths against", "reference", UNKNOWN),
        GridColumn("trials", lambda row: str(row["trials"])),
        mean_sd("shank (%)", "shank_error"),
        mean_sd("thigh (%)", "thigh_error"),
        mean_sd("re-projection (mm)", "reprojection", 1e3),
        mean_sd("condition number", "condition_number"),
    )
    return to_grid(caption, frame.to_dict("records"), columns)


def models(frame: pd.DataFrame, caption: str) -> Grid:
    """Return table 6.3, of the cohort or of every person."""
    torques = [
        name.removesuffix("_mean") for name in frame.columns if name.startswith("tau_") and name.endswith("_mean")
    ]
    columns = (
        GridColumn("action", lambda row: row["action_trial"] or row["action"], text=True),
        mean_sd("condition number", "condition_number", decimals=0),
        GridColumn("model", _model, text=True),
        GridColumn("predictions", lambda row: str(row["pairs"])),
        mean_sd("Fy (N)", "Fy"),
        mean_sd("τz (N·m)", "tauz"),
        mean_sd("CoP (mm)", "cop_x", 1e3),
        *(mean_sd(f"τ{name[4:]} (N·m)", name) for name in torques),
    )
    return to_grid(caption, frame.to_dict("records"), columns)


def doubtful(data: CohortData) -> Grid:
    """Return the predictions that could not be made or should not be believed, and why."""
    frame = data.of_people("models")
    frame = frame[(frame["why"] != "") | (frame["codes"] != "")]
    columns = (
        text("action", "action_trial"),
        GridColumn("model", lambda row: row["model_trial"] or row["model"], text=True),
        GridColumn("why", lambda row: row["why"] or _titles(row["codes"]), text=True),
    )
    caption = "Predictions that could not be made, or that the recordings do not support"
    return to_grid(caption, frame.to_dict("records"), columns)


def variation(frame: pd.DataFrame, caption: str) -> Grid:
    """Return figure 6.8 as a table, of the cohort or of every person."""
    columns = (
        text("", "subject"),
        text("set", "set"),
        text("parameter", "parameter"),
        text("which is", "expression"),
        GridColumn("trials", lambda row: str(row["trials"])),
        GridColumn("own models (%)", lambda row: _percent(row, "cv")),
        GridColumn("allometric body (%)", lambda row: _percent(row, "reference_cv")),
    )
    return to_grid(caption, frame.to_dict("records"), columns)


def _complete(row: Mapping[str, Any]) -> str:
    return UNKNOWN if pd.isna(row["repetitions"]) else f"{row['complete']} of {row['repetitions']}"


def _counted(row: Mapping[str, Any]) -> str:
    return str(row["subjects"] if row["subject"] == COHORT else row["trials"] or UNKNOWN)


def _model(row: Mapping[str, Any]) -> str:
    return str(row["model"] if row["model"].startswith("own") else row["model_trial"] or row["model"])


def _titles(codes: str) -> str:
    """Return the titles of the codes' explanations."""
    return "; ".join(EXPLANATIONS[code].title if code in EXPLANATIONS else code for code in codes.split(", "))


def _percent(row: Mapping[str, Any], name: str) -> str:
    mean, sd = times(row[name], 100), times(row[f"{name}_sd"], 100)
    return show(mean, 2) if sd is None else f"{show(mean, 2)} ± {show(sd, 2)}"
