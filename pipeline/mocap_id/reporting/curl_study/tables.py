"""The tables of a study of curls as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mocap_id.reporting.numbers import UNKNOWN, show_fixed
from mocap_id.reporting.results.grid_columns import GridColumn, estimate, number, records, text, to_grid
from mocap_id.reporting.results.trial_entries import FATES
from mocap_id.reporting.tables import Grid

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
"""Names of the measures with their units."""
REPETITIONS = ("repetitions", "normalised")
OTHERS = tuple(name for name in NAMES if name not in REPETITIONS)


def conditions(frame: pd.DataFrame, measures: tuple[str, ...], caption: str) -> Grid:
    """Return a row for every measure and condition."""
    columns = (
        GridColumn("", _name, text=True),
        text("condition", "condition"),
        number("people", "people", 0),
        GridColumn("trials", lambda row: f"{row['trials']} of {row['of_trials']}"),
        estimate("mean", "mean"),
        number("median", "median"),
        GridColumn("half of the trials", lambda row: f"{show_fixed(row['q1'], 2)} … {show_fixed(row['q3'], 2)}"),
    )
    return to_grid(caption, _rows(frame, measures), columns)


def comparisons(frame: pd.DataFrame, measures: tuple[str, ...], caption: str) -> Grid:
    """Return paired differences, of the cohort or of every person."""
    columns = (
        GridColumn("", _name, text=True),
        text("difference", "comparison"),
        text("person", "subject"),
        number("people", "people", 0),
        number("pairs", "pairs", 0),
        estimate("mean difference", "difference"),
        GridColumn("p", lambda row: show_fixed(row["p"], 3), optional=True),
        number("sd between people", "sd_between", optional=True),
        number("sd within a person", "sd_within", optional=True),
    )
    return to_grid(caption, _rows(frame, measures), columns)


def trials(frame: pd.DataFrame) -> Grid:
    """Return every trial with its verdict, repetitions and end."""
    columns = (
        text("trial", "trial"),
        text("person", "subject"),
        text("condition", "condition"),
        number("number", "number", 0),
        GridColumn("verdict", lambda row: FATES[row["verdict"]], text=True),
        number("repetitions", "repetitions", 0),
        number("normalised", "normalised", 2),
        GridColumn("failed attempts", lambda row: UNKNOWN if pd.isna(row["partial"]) else str(row["partial"])),
        number("end (s)", "end", 1),
        text("ended by", "end_rule"),
        text("", "why"),
    )
    return to_grid("Every trial", frame.to_dict("records"), columns)


def _rows(frame: pd.DataFrame, measures: tuple[str, ...]) -> list[dict[str, Any]]:
    kept = frame[frame["measure"].isin(measures)]
    return records(kept)


def _name(row: Mapping[str, Any]) -> str:
    return NAMES[row["measure"]]
