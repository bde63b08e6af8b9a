"""``cohort.html``: the page of a study of sit-to-stand trials."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mocap_id.reporting.numbers import UNKNOWN, show, show_fixed
from mocap_id.reporting.page import KeyNumber, Section
from mocap_id.reporting.results.study_page import render_study_page
from mocap_id.reporting.study import tables
from mocap_id.reporting.study.figures import draw_cohort_figures
from mocap_id.reporting.study.page_data import CohortData

_FOOTER = (
    "Lengths and errors have the units that the tables give; the same numbers in SI units are in the CSV and Parquet "
    "files beside this page, which study.json describes. x points along the motion, y up."
)


def render_cohort_page(data: CohortData) -> bytes:
    """Return the HTML page in UTF-8, from the tables trials, lengths, strategies, models, parameters and variation."""
    numbers = [number for number in _make_key_numbers(data) if number.value != UNKNOWN]
    return render_study_page(data, numbers, _make_sections(data), draw_cohort_figures(data), _FOOTER)


def _make_sections(data: CohortData) -> tuple[Section, ...]:
    people = {name: data.of_people(name) for name in ("strategies", "models", "variation")}
    predicted, varied = people["models"]["pairs"] > 0, people["variation"]["trials"] > 1
    return (
        Section("trials", "Trials", (tables.list_trials(data),)),
        Section(
            "lengths",
            "Segment lengths",
            (tables.list_lengths(data), tables.list_strategies(data.of_cohort("strategies"), tables.BY_STRATEGY)),
            ("lengths",),
            (tables.list_strategies(people["strategies"], tables.BY_PERSON),),
        ),
        Section(
            "models",
            "Forces and torques by every model",
            (tables.list_models(data.of_cohort("models"), tables.MODELS), tables.list_doubtful(data)),
            ("pressure",),
            (tables.list_models(people["models"][predicted], tables.MODELS_BY_PERSON),),
        ),
        Section(
            "parameters",
            "Inertial parameters",
            (tables.list_variation(data.of_cohort("variation"), tables.VARIATION),),
            ("parameters",),
            (tables.list_variation(people["variation"][varied], tables.VARIATION_BY_PERSON),),
        ),
    )


def _make_key_numbers(data: CohortData) -> Iterator[KeyNumber]:
    trials = data.tables["trials"]
    complete = trials["complete"]
    yield KeyNumber("people", str(len(data.subjects)), f"{len(data.trials)} trials")
    yield KeyNumber("strategies", str(len(data.strategies)), ", ".join(data.strategies))
    yield KeyNumber("repetitions", str(int(complete.sum())) if complete.notna().any() else UNKNOWN, "complete")
    for name, column, remark in (
        ("re-projection", "reprojection", "median of the trials' rms"),
        ("CoP, own model", "cop_x_own_rms", "median of the trials' rms error"),
        ("CoP, held out", "cop_x_held_out_rms", "on left-out repetitions"),
        ("CoP, allometric", "cop_x_reference_rms", "on the samples of the own model"),
    ):
        yield KeyNumber(name, show_fixed(1e3 * _compute_median(trials[column]), 1, "mm"), remark)
    yield KeyNumber("condition number", show(_compute_median(trials["condition_number"])), "median")


def _compute_median(column: pd.Series[float]) -> float:
    """Return the median of the finite values; NaN if there are none."""
    values = column.to_numpy(dtype=np.float64)
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else float("nan")
