"""``sensitivity.html``: the page of a sensitivity study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.reporting import style
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.grids import Grid, GridColumn, number, text, to_grid
from mocap_id.reporting.numbers import show, show_fixed, show_with_sd
from mocap_id.reporting.page import KeyNumber, Page, Section
from mocap_id.reporting.sensitivity import tornado
from mocap_id.reporting.sensitivity.page_data import SensitivityData

_FAILED = ("refused", "failed")
_FOOTER = (
    "Levels are in SI units. Torques, states and lengths are compared with the unperturbed trial; the numbers are for "
    "the joint with the largest change. The response of every parameter to every perturbation is in responses.csv and "
    "responses.parquet beside this page."
)


def render_sensitivity_page(data: SensitivityData) -> bytes:
    """Return the HTML page in UTF-8."""
    drawing = tornado.make_drawing(data)
    sentences = tuple(style.clean(sentence) for sentence in data.tables["tolerates"]["sentence"])
    return Page(
        name=data.trial,
        headline="what this trial tolerates",
        lead=f"{describe_criterion(data.tolerance)} The limit between two tried levels is interpolated.",
        note=style.clean(data.note),
        command="sensitivity",
        key_numbers=_make_key_numbers(data),
        sections=(
            Section("tolerates", "Tolerated levels", items=sentences),
            Section("tornado", drawing.title, figures=(drawing.name,)),
            Section("numbers", "Numbers", (_list_parameters(data), _list_perturbations(data))),
        ),
        figures=Drawings(style.clean(data.trial), (drawing,)),
        footer=_FOOTER,
    ).render()


def describe_criterion(share: float) -> str:
    """Return a sentence that says when a perturbation is tolerated."""
    return (
        f"A perturbation is tolerated if no parameter changes by more than {show(100 * share, 2, '%')} of its size, or "
        "by its own stated standard deviation if that is larger."
    )


def _make_key_numbers(data: SensitivityData) -> tuple[KeyNumber, ...]:
    tried = data.tables["perturbations"]
    beyond = tried[~tried["tolerated"]]
    silent = beyond[(beyond["raised"] == "") & ~beyond["verdict"].isin(_FAILED)]
    return (
        KeyNumber("perturbations", str(len(tried)), f"{tried['kind'].nunique()} kinds, seed {data.seed}"),
        KeyNumber("tolerated", str(len(tried) - len(beyond)), "of these perturbations"),
        KeyNumber("unnoticed", str(len(silent)), "not tolerated, and no new caution"),
        KeyNumber("unperturbed verdict", data.verdict, data.trial),
    )


def _list_parameters(data: SensitivityData) -> Grid:
    columns = (
        text("parameter", "name"),
        GridColumn("value", lambda one: show_with_sd(one.value, one.sd, style.format_unit(one.unit))),
        GridColumn("size", lambda one: show(one.size, 3, style.format_unit(one.unit))),
        GridColumn("tolerated change", lambda one: show(100 * one.tolerated(data.tolerance), 2, "%")),
    )
    return to_grid("The unperturbed parameters", data.parameters, columns)


def _list_perturbations(data: SensitivityData) -> Grid:
    tried = data.tables["perturbations"]
    torques = [name for name in tried.columns if name.startswith("tau_")]

    def ratio(row: Mapping[str, Any]) -> str:
        return "not identified" if row["ratio"] == float("inf") else show(row["ratio"], 2)

    def largest_torque(row: Mapping[str, Any]) -> str:
        return show(max((row[name] for name in torques if np.isfinite(row[name])), default=np.nan), 2, "N·m")

    columns = (
        text("perturbation", "perturbation"),
        GridColumn("change divided by the tolerated change", ratio),
        text("parameter", "parameter"),
        text("new cautions", lambda row: row["raised"] or (row["verdict"] if row["verdict"] in _FAILED else "")),
        number("condition", "condition_number"),
        GridColumn(
            "r² Fx, Fy, tauz", lambda row: ", ".join(show_fixed(row[f"{name}_r2"], 4) for name in ("Fx", "Fy", "tauz"))
        ),
        GridColumn("CoP rms", lambda row: show_fixed(1e3 * row["cop_rms"], 1, "mm")),
        GridColumn("worst torque", largest_torque),
        number("acceleration r²", "ddtheta_r2", 4),
        GridColumn("offset found", lambda row: show_fixed(1e3 * row["clock_offset"], 2, "ms")),
    )
    return to_grid("Every perturbation", tried, columns)
