"""The figures of a study of curls: box plots of repetitions (thesis figure 8.5), and compensation by condition."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.curl_study.tables import NAMES
from mocap_id.reporting.figure import Bars, Drawing, Drawings, Figure, Item, Line, Panel, Points, Rule, arrange_in_lines
from mocap_id.reporting.study.page_data import CohortData
from mocap_id.reporting.study.people_rows import spread_evenly

_ANGLES = tuple(name for name in NAMES if name.startswith(("shoulder", "thorax")))
_BOX = 0.3  # half of the height of a box, in rows


def draw_curl_figures(data: CohortData, reference: str) -> Drawings:
    """Return all figures of the page; ``reference`` is the name of the reference condition."""
    boxes = Drawing(
        "repetitions",
        "Repetitions by condition",
        f"Number of repetitions (left), and the same divided by the number in the person's {reference} trial with "
        "the same trial number (right). A box contains the middle half of the trials, its line is the median, and the "
        "whiskers reach the lowest and the highest trial. A dot is a trial; each person has a colour.",
        _draw_repetitions(data),
    )
    compensation = Drawing(
        "compensation",
        "Compensation by condition",
        "Mean range of each angle within a curl: dots are trials, rings the mean over people with its 95 % interval. "
        "A range left of the dotted line can be due to errors alone.",
        _draw_compensation(data),
    )
    return Drawings(style.clean(data.study), (boxes, compensation))


def _list_conditions(data: CohortData) -> list[str]:
    """Return the distinct conditions in the order of the trials."""
    return list(dict.fromkeys(data.tables["trials"]["condition"]))


def _name_rows(data: CohortData) -> tuple[str, ...]:
    return tuple(style.clean(name, 16) for name in _list_conditions(data))


def _draw_repetitions(data: CohortData) -> Figure | str:
    trials = data.tables["trials"]
    if trials["repetitions"].isna().all():
        return "No repetitions: no trial has any."
    height = 0.8 + 0.35 * len(_list_conditions(data))
    panels = []
    for name in ("repetitions", "normalised"):
        items: list[Item] = [Rule("x", 1.0, style.FAINT, ":")] if name == "normalised" else []
        for row, condition in enumerate(_list_conditions(data)):
            values = trials[trials["condition"] == condition][name].dropna().to_numpy(dtype=np.float64)
            if len(values):
                items += _draw_box(values, row)
        items += _draw_dots(data, name)
        panels.append(Panel(tuple(items), x=NAMES[name], rows=_name_rows(data), height=height))
    return Figure((tuple(panels),))


def _draw_box(values: FloatArray, row: int) -> list[Item]:
    """Return the box plot of the values (N,) in the row with this number."""
    lowest, q1, median, q3, highest = np.quantile(values, (0, 0.25, 0.5, 0.75, 1))
    ends = np.array([lowest, q1, np.nan, q3, highest])
    return [
        Bars(np.array([row]), np.array([q1]), np.array([q3]), (style.BLUE,), np.array([0.3]), thick=2 * _BOX),
        Line(ends, np.full(5, float(row)), style.INK, width=0.8),
        Line(np.array([median, median]), np.array([row - _BOX, row + _BOX]), style.INK, width=1.6),
    ]


def _draw_dots(data: CohortData, name: str, size: float = 3.0) -> list[Item]:
    """Return a dot for the measure ``name`` of every trial, in the row of its condition, coloured by person."""
    trials, conditions, people = data.tables["trials"], _list_conditions(data), data.subjects
    items: list[Item] = []
    offsets = spread_evenly(len(people), 1.6 * _BOX)
    for k, (subject, offset) in enumerate(zip(people, offsets, strict=True), start=1):
        own = trials[(trials["subject"] == subject) & trials[name].notna()]
        if own.empty:
            continue
        rows = np.array([conditions.index(condition) for condition in own["condition"]], dtype=np.float64)
        label, names = style.clean(subject, 16), tuple(style.clean(one, 30) for one in own["trial"])
        values = own[name].to_numpy(dtype=np.float64)
        items.append(Points(values, rows + offset, style.pick_colour(k), label, size=size, names=names))
    return items


def _draw_compensation(data: CohortData) -> Figure | str:
    trials, means = data.tables["trials"], data.tables["conditions"]
    known = [name for name in _ANGLES if trials[name].notna().any()]
    if not known:
        return "No compensation: no trial has angles of the shoulder or the thorax."
    height = 0.8 + 0.3 * len(_list_conditions(data))
    panels = []
    for name in known:
        floor = float(trials[f"floor_{name}"].median())
        items = [Rule("x", floor, style.FAINT, ":"), *_draw_dots(data, name, 2.5), *_draw_means(data, means, name)]
        panels.append(Panel(tuple(items), x=NAMES[name], rows=_name_rows(data), height=height))
    return Figure(arrange_in_lines(tuple(panels), 3))


def _draw_means(data: CohortData, means: pd.DataFrame, name: str) -> list[Item]:
    """Return a ring with a 95 % interval for the mean of the measure ``name`` in every condition."""
    own = means[means["measure"] == name]
    conditions = _list_conditions(data)
    rows = np.array([conditions.index(condition) for condition in own["condition"]], dtype=np.float64)
    value, low = (own[column].to_numpy(dtype=np.float64) for column in ("mean", "mean_low"))
    half = np.where(np.isfinite(low), value - low, 0.0)
    return [Points(value, rows, style.INK, symbol="ring", size=5.0, half=half)]
