"""The tables of a reach study."""

from __future__ import annotations

import pandas as pd

from mocap_id.reporting.grids import Grid, GridColumn, estimate, number, text, to_grid
from mocap_id.reporting.numbers import UNKNOWN, to_number
from mocap_id.reporting.results.study_page import VERDICT

_MEASURES = {
    "volume": "volume (m³)",
    "visited": "visited volume (m³)",
    "surface": "surface",
    "elevation": "elevation (°)",
    "height": "height (m)",
}
_MEASURE = text("measure", lambda row: _MEASURES[row["measure"]])


def list_people(frame: pd.DataFrame) -> Grid:
    """Return table 7.1: reachable volume and clinical score of every person."""
    columns = (
        text("person", "subject"),
        GridColumn("score", lambda row: show_score(row["score"]), optional=True),
        GridColumn("trials", lambda row: f"{row['trials']} of {row['of_trials']}"),
        estimate(_MEASURES["volume"], "volume"),
        number("right (m³)", "volume_right", 3, optional=True),
        number("left (m³)", "volume_left", 3, optional=True),
        estimate(_MEASURES["visited"], "visited"),
    )
    return to_grid("Reachable volume and clinical score (thesis table 7.1), with 95 % intervals", frame, columns)


def list_measures(frame: pd.DataFrame) -> Grid:
    """Return a table of the other measures of reach of every person."""
    others = (estimate(_MEASURES[name], name) for name in ("surface", "elevation", "height"))
    return to_grid("Other measures of reach", frame, (text("person", "subject"), *others))


def list_correlations(frame: pd.DataFrame) -> Grid:
    """Return a table of the correlation of every measure with the clinical score."""
    columns = (
        _MEASURE,
        number("people", "people", 0),
        estimate("Spearman's correlation", "spearman"),
        number("p", "p"),
    )
    caption = "Correlation with the clinical score, with 95 % interval and permutation p-value"
    return to_grid(caption, frame[frame["spearman"].notna()], columns)


def list_differences(frame: pd.DataFrame, caption: str) -> Grid:
    """Return a table of paired differences from rows of the cohort or of every person."""
    columns = (
        text("difference", "comparison"),
        _MEASURE,
        text("person", "subject"),
        text("of", "label"),
        number("people", "people", 0),
        estimate("difference", "difference"),
        number("sd", "sd", optional=True),
    )
    return to_grid(caption, frame, columns)


def list_trials(frame: pd.DataFrame) -> Grid:
    """Return a table of every trial with its verdict and reach."""
    columns = (
        text("trial", "trial"),
        text("person", "subject"),
        text("side", "side"),
        text("session", "session", UNKNOWN),
        VERDICT,
        *(estimate(head, name) for name, head in _MEASURES.items()),
        text("", "why"),
    )
    return to_grid("Every trial, with 95 % intervals", frame, columns)


def show_score(score: object) -> str:
    """Format a clinical score, such as ``2``; return a dash if it is unknown."""
    value = to_number(score)
    return UNKNOWN if value is None else f"{value:g}"
