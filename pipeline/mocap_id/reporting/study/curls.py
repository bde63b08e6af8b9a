"""The tables of a study of curls."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Bars, Drawing, Drawings, Figure, Item, Line, Panel, Points, Rule, arrange_in_lines
from mocap_id.reporting.grids import Grid, GridColumn, estimate, number, show_estimate, text, to_grid
from mocap_id.reporting.numbers import show_fixed
from mocap_id.reporting.page import KeyNumber, Section
from mocap_id.reporting.study.cohort import VERDICT, CohortData, render_study_page, spread_evenly

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


_FOOTER = (
    "The same numbers in SI units, angles in degrees, are in the CSV and Parquet files beside this page, which "
    "study.json describes."
)
_REPETITIONS = (
    "Repetitions are complete curls up to the end of the trial. A failed attempt, a pause, a break of the tempo, or "
    "motion out of the plane ends the trial. The value of a person is the mean over the person's trials; means and "
    "their Student t intervals are over the people.",
)
_DIFFERENCES = (
    "A difference compares a person's trials with the same number. Its interval is Student's t interval over the "
    "people. p compares all combinations of signs of the people's differences; with n people it is at least 2/2ⁿ. p is "
    "not corrected for several tests: of twenty comparisons without any effect, one has p below 0.05 on average.",
    "The differences between conditions apply to these people and trials. They do not show the cause.",
)
_COMPENSATION = (
    "Range of each angle within a curl, mean over the curls of a trial. Curls should only bend the elbow. If the "
    "range is smaller than errors alone can cause (dotted line), the angle may not move at all.",
)


def render_curl_page(data: CohortData, reference: str) -> bytes:
    """Return the HTML page in UTF-8, from the tables `conditions`, `comparisons` and `trials`.

    ``reference`` is the name of the reference condition.
    """
    figures = draw_curl_figures(data, reference)
    return render_study_page(
        data, _make_key_numbers(data, reference), _make_sections(data, reference), figures, _FOOTER
    )


def _make_sections(data: CohortData, reference: str) -> Iterator[Section]:
    found, cohort, people = data.tables["conditions"], data.of_cohort("comparisons"), data.of_people("comparisons")
    to_reference, others = (cohort[(cohort["first"] == reference) == which] for which in (True, False))
    yield Section(
        "repetitions",
        "Repetitions (thesis figure 8.5)",
        (list_conditions(found, REPETITIONS, "Repetitions by condition, with 95 % intervals of the mean"),),
        ("repetitions",),
        text=_REPETITIONS,
    )
    if len(cohort):
        yield Section(
            "differences",
            f"Differences from {reference}",
            (list_comparisons(to_reference, REPETITIONS, "Paired differences of repetitions"),),
            folded=(
                list_comparisons(others, REPETITIONS, "Between the other conditions"),
                list_comparisons(people[people["first"] == reference], REPETITIONS, "Of every person"),
            ),
            folded_as="More differences",
            text=_DIFFERENCES,
        )
    yield Section(
        "compensation",
        "Compensation, tempo and torque by condition",
        (list_comparisons(to_reference, OTHERS, f"Paired differences from {reference}"),) if len(to_reference) else (),
        ("compensation",),
        folded=(list_conditions(found, OTHERS, "By condition, with 95 % intervals of the mean"),),
        folded_as="Each condition",
        text=_COMPENSATION,
    )
    yield Section("trials", "Trials", (list_trials(data.tables["trials"]),))


def _make_key_numbers(data: CohortData, reference: str) -> Iterator[KeyNumber]:
    yield KeyNumber("people", str(len(data.subjects)), f"{len(data.trials)} trials")
    frame = data.of_cohort("comparisons")
    for row in frame[(frame["measure"] == "normalised") & (frame["first"] == reference)].to_dict("records"):
        difference = f"{show_estimate(row, 'difference', 100.0)} %"
        yield KeyNumber(row["comparison"], difference, f"normalised repetitions, {row['people']} people")
