"""The tables of a study of curls."""

from __future__ import annotations

import pandas as pd

from mocap_id.reporting.grids import Grid, GridColumn, estimate, number, text, to_grid
from mocap_id.reporting.numbers import show_fixed
from mocap_id.reporting.results.study_page import VERDICT

NAMES = {
    "repetitions": "repetitions",
    "normalised": "normalised repetitions",
    "duration": "time of a curl (s)",
    "torque": "largest torque (N·m)",
    "torque_person": "largest torque of the person (N·m)",
    "shoulder_plane": "shoulder plane (°)",
    "shoulder_elevation": "shoulder elevation (°)",
    "shoulder_axial": "shoulder axial rotation (°)",
    "thorax_lateral": "thorax lateral (°)",
    "thorax_axial": "thorax axial (°)",
    "thorax_flexion": "thorax flexion (°)",
}
"""Names of the measures for readers, with units, by column name."""
REPETITIONS = ("repetitions", "normalised")
OTHERS = tuple(name for name in NAMES if name not in REPETITIONS)
_MEASURE = text("", lambda row: NAMES[row["measure"]])


def list_conditions(frame: pd.DataFrame, measures: tuple[str, ...], caption: str) -> Grid:
    """Return a table with a row for every condition and each of these measures."""
    columns = (
        _MEASURE,
        text("condition", "condition"),
        number("people", "people", 0),
        GridColumn("trials", lambda row: f"{row['trials']} of {row['of_trials']}"),
        estimate("mean", "mean"),
        number("median", "median"),
        GridColumn("half of the trials", lambda row: f"{show_fixed(row['q1'], 2)} … {show_fixed(row['q3'], 2)}"),
    )
    return to_grid(caption, frame[frame["measure"].isin(measures)], columns)


def list_comparisons(frame: pd.DataFrame, measures: tuple[str, ...], caption: str) -> Grid:
    """Return a table of the paired differences in these measures, from rows of the cohort or of every person."""
    columns = (
        _MEASURE,
        text("difference", "comparison"),
        text("person", "subject"),
        number("people", "people", 0),
        number("pairs", "pairs", 0),
        estimate("mean difference", "difference"),
        number("p", "p", 3, optional=True),
        number("sd between people", "sd_between", optional=True),
        number("sd within a person", "sd_within", optional=True),
    )
    return to_grid(caption, frame[frame["measure"].isin(measures)], columns)


def list_trials(frame: pd.DataFrame) -> Grid:
    """Return a table of every trial with its verdict, repetitions and end."""
    columns = (
        text("trial", "trial"),
        text("person", "subject"),
        text("condition", "condition"),
        number("number", "number", 0),
        VERDICT,
        number("repetitions", "repetitions", 0),
        number("normalised", "normalised", 2),
        number("failed attempts", "partial", 0),
        number("end (s)", "end", 1),
        text("ended by", "end_rule"),
        text("", "why"),
    )
    return to_grid("Every trial", frame, columns)
