"""The tables of a reach study as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mocap_id.reporting.numbers import UNKNOWN, known
from mocap_id.reporting.results.grid_columns import GridColumn, estimate, number, text, to_grid
from mocap_id.reporting.results.trial_entries import FATES
from mocap_id.reporting.tables import Grid

_NAMES = {
    "volume": "volume (m³)",
    "visited": "visited volume (m³)",
    "surface": "surface",
    "elevation": "elevation (°)",
    "height": "height (m)",
}


def people(frame: pd.DataFrame) -> Grid:
    """Return table 7.1: a row for every person."""
    columns = (
        text("person", "subject"),
        GridColumn("score", lambda row: show_score(row["score"]), optional=True),
        GridColumn("trials", lambda row: f"{row['trials']} of {row['of_trials']}"),
        _estimate("volume"),
        number("right (m³)", "volume_right", 3, optional=True),
        number("left (m³)", "volume_left", 3, optional=True),
        _estimate("visited"),
    )
    caption = "Reachable volume and clinical score (thesis table 7.1), with 95 % intervals"
    return to_grid(caption, frame.to_dict("records"), columns)


def measures(frame: pd.DataFrame) -> Grid:
    """Return the other measures of reach of every person."""
    columns = (text("person", "subject"), *(_estimate(name) for name in ("surface", "elevation", "height")))
    return to_grid("Other measures of reach", frame.to_dict("records"), columns)


def correlation(frame: pd.DataFrame) -> Grid:
    """Return the correlation of every measure with the score."""
    columns = (
        GridColumn("measure", _name, text=True),
        GridColumn("people", lambda row: str(row["people"])),
        _estimate("spearman", "Spearman's correlation"),
        number("p", "p"),
    )
    known_rows = frame[frame["spearman"].notna()]
    caption = "Correlation with the clinical score, with 95 % interval and permutation p-value"
    return to_grid(caption, known_rows.to_dict("records"), columns)


def differences(frame: pd.DataFrame, caption: str) -> Grid:
    """Return paired differences, of the cohort or of every person."""
    columns = (
        text("difference", "comparison"),
        GridColumn("measure", _name, text=True),
        text("person", "subject"),
        text("of", "label"),
        GridColumn("people", lambda row: str(row["people"])),
        _estimate("difference", "difference"),
        number("sd", "sd", optional=True),
    )
    return to_grid(caption, frame.to_dict("records"), columns)


def trials(frame: pd.DataFrame) -> Grid:
    """Return every trial with its verdict and reach."""
    columns = (
        text("trial", "trial"),
        text("person", "subject"),
        text("side", "side"),
        text("session", "session", UNKNOWN),
        GridColumn("verdict", lambda row: FATES[row["verdict"]], text=True),
        *(_estimate(name) for name in _NAMES),
        text("", "why"),
    )
    return to_grid("Every trial, with 95 % intervals", frame.to_dict("records"), columns)


def show_score(score: object) -> str:
    """Return a clinical score, such as ``2``; a dash if unknown."""
    found = known(score)
    return UNKNOWN if found is None else f"{found:g}"


def _estimate(name: str, head: str = "") -> GridColumn:
    return estimate(head or _NAMES[name], name)


def _name(row: Mapping[str, Any]) -> str:
    return _NAMES[row["measure"]]
