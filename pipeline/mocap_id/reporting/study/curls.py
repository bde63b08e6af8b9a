"""``cohort.html`` of a study of curls: tables, repetitions (thesis figure 8.5), compensation by condition."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.figure import Bars, Drawing, Drawings, Figure, Item, Line, Panel, Points, Rule, arrange_in_lines
from mocap_id.reporting.grids import Grid, numbers, show_estimate
from mocap_id.reporting.page import KeyNumber, Section
from mocap_id.reporting.study import CohortData, render_study_page, spread_evenly, to_floats

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
_COUNTED = ("repetitions", "normalised")  # measures of the first sections; the others follow
_BOX = 0.3  # half of the height of a box, in rows


def render_curl_page(data: CohortData, reference: str) -> bytes:
    """Return the HTML page in UTF-8, from the tables `conditions`, `comparisons` and `trials`.

    ``reference`` is the name of the reference condition.
    """
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
    figures = Drawings(style.clean(data.study), (boxes, compensation))
    numbers, sections = _make_key_numbers(data, reference), _make_sections(data, reference)
    return render_study_page(data, numbers, sections, figures, _FOOTER)


def _make_key_numbers(data: CohortData, reference: str) -> Iterator[KeyNumber]:
    yield KeyNumber("people", str(len(data.subjects)), f"{len(data.trials)} trials")
    frame = data.of_cohort("comparisons")
    for row in frame[(frame["measure"] == "normalised") & (frame["first"] == reference)].to_dict("records"):
        difference = f"{show_estimate(row, 'difference', 100.0)} %"
        yield KeyNumber(row["comparison"], difference, f"normalised repetitions, {row['people']} people")


def _make_sections(data: CohortData, reference: str) -> Iterator[Section]:
    found, cohort, people = data.frame("conditions"), data.of_cohort("comparisons"), data.of_people("comparisons")
    to_reference, others = (cohort[(cohort["first"] == reference) == which] for which in (True, False))
    further = [name for name in data.tables["trials"].heads if name not in _COUNTED]

    def list_conditions(measures: Collection[str], caption: str) -> Grid:
        columns = "measure condition people trials mean median q1"
        return data.tables["conditions"].grid(caption, columns, rows=found[found["measure"].isin(measures)])

    def list_comparisons(frame: pd.DataFrame, measures: Collection[str], caption: str) -> Grid:
        columns = "measure comparison subject people pairs difference p sd_between sd_within"
        return data.tables["comparisons"].grid(caption, columns, rows=frame[frame["measure"].isin(measures)])

    yield Section(
        "repetitions",
        "Repetitions (thesis figure 8.5)",
        (list_conditions(_COUNTED, "Repetitions by condition, with 95 % intervals of the mean"),),
        ("repetitions",),
        text=_REPETITIONS,
    )
    if len(cohort):
        yield Section(
            "differences",
            f"Differences from {reference}",
            (list_comparisons(to_reference, _COUNTED, "Paired differences of repetitions"),),
            folded=(
                list_comparisons(others, _COUNTED, "Between the other conditions"),
                list_comparisons(people[people["first"] == reference], _COUNTED, "Of every person"),
            ),
            folded_as="More differences",
            text=_DIFFERENCES,
        )
    paired = (list_comparisons(to_reference, further, f"Paired differences from {reference}"),)
    yield Section(
        "compensation",
        "Compensation, tempo and torque by condition",
        paired if len(to_reference) else (),
        ("compensation",),
        folded=(list_conditions(further, "By condition, with 95 % intervals of the mean"),),
        folded_as="Each condition",
        text=_COMPENSATION,
    )
    trials = data.tables["trials"].grid(
        "Every trial",
        "trial subject condition number verdict",
        numbers("repetitions", "repetitions", 0),
        numbers("normalised", "normalised", 2),
        "partial end end_rule why",
    )
    yield Section("trials", "Trials", (trials,))


def _draw_repetitions(data: CohortData) -> Figure | str:
    trials = data.frame("trials")
    if trials["repetitions"].isna().all():
        return "No repetitions: no trial has any."
    panels = []
    for name in _COUNTED:
        items: list[Item] = [Rule("x", 1.0, style.FAINT, ":")] if name == "normalised" else []
        for row, condition in enumerate(data.list_labels("condition")):
            values = to_floats(trials[trials["condition"] == condition][name].dropna())
            if len(values):
                lowest, q1, median, q3, highest = np.quantile(values, (0, 0.25, 0.5, 0.75, 1))
                ends, at = np.array([lowest, q1, np.nan, q3, highest]), np.array([row])
                items += [
                    Bars(at, np.array([q1]), np.array([q3]), (style.BLUE,), np.array([0.3]), thick=2 * _BOX),
                    Line(ends, np.full(5, float(row)), style.INK, width=0.8),
                    Line(np.array([median, median]), np.array([row - _BOX, row + _BOX]), style.INK, width=1.6),
                ]
        panels.append(_make_panel(data, name, [*items, *_draw_trials(data, name)], 0.35))
    return Figure((tuple(panels),))


def _draw_compensation(data: CohortData) -> Figure | str:
    trials, means = data.frame("trials"), data.frame("conditions")
    angles = [name for name in data.tables["trials"].heads if name.startswith(("shoulder", "thorax"))]
    known = [name for name in angles if trials[name].notna().any()]
    if not known:
        return "No compensation: no trial has angles of the shoulder or the thorax."
    conditions, panels = data.list_labels("condition"), []
    for name in known:
        floor = Rule("x", float(trials[f"floor_{name}"].median()), style.FAINT, ":")
        # A ring with a 95 % interval for the mean over people in every condition.
        own = means[means["measure"] == name]
        rows = np.array([conditions.index(condition) for condition in own["condition"]], dtype=np.float64)
        value, low = to_floats(own["mean"]), to_floats(own["mean_low"])
        half = np.where(np.isfinite(low), value - low, 0.0)
        rings = Points(value, rows, style.INK, symbol="ring", size=5.0, half=half)
        panels.append(_make_panel(data, name, [floor, *_draw_trials(data, name, 2.5), rings], 0.3))
    return Figure(arrange_in_lines(tuple(panels), 3))


def _make_panel(data: CohortData, name: str, items: list[Item], row_height: float) -> Panel:
    """Return a panel for a measure with a row for every condition."""
    rows = tuple(style.clean(condition, 16) for condition in data.list_labels("condition"))
    return Panel(tuple(items), x=data.tables["trials"].heads[name], rows=rows, height=0.8 + row_height * len(rows))


def _draw_trials(data: CohortData, name: str, size: float = 3.0) -> list[Item]:
    """Return a dot for the measure ``name`` of every trial, in the row of its condition, coloured by person."""
    trials, conditions, people = data.frame("trials"), data.list_labels("condition"), data.subjects
    items: list[Item] = []
    offsets = spread_evenly(len(people), 1.6 * _BOX)
    for k, (subject, offset) in enumerate(zip(people, offsets, strict=True), start=1):
        own = trials[(trials["subject"] == subject) & trials[name].notna()]
        if own.empty:
            continue
        rows = np.array([conditions.index(condition) for condition in own["condition"]], dtype=np.float64)
        label, names = style.clean(subject, 16), tuple(style.clean(one, 30) for one in own["trial"])
        values = to_floats(own[name])
        items.append(Points(values, rows + offset, style.pick_colour(k), label, size=size, names=names))
    return items
