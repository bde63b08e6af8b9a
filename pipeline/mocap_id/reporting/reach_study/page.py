"""``cohort.html`` of a reach study."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pandas as pd

from mocap_id.reporting.numbers import show
from mocap_id.reporting.reach_study import tables
from mocap_id.reporting.reach_study.figures import reach_figures
from mocap_id.reporting.reach_study.page_data import Shape
from mocap_id.reporting.results.grid_columns import records, show_estimate
from mocap_id.reporting.results.page import ResultSection, study_page
from mocap_id.reporting.sections import KeyNumber
from mocap_id.reporting.study.page_data import CohortData

_FOOTER = (
    "The same numbers in SI units are in the CSV and Parquet files beside this page, which study.json describes. A "
    "left arm is mirrored, so that numbers of both sides mean the same."
)
_MEANING = (
    "The volume is what the wrist can reach if each joint uses its whole range, independent of the others, as in the "
    "thesis. The visited volume uses only recorded combinations of joint angles. The surface is the reached share of "
    "the hemisphere in front of the shoulder; elevation and height are the largest ones.",
    "A person's number is the mean of both sides. Its interval is the mean interval of the trials, because their "
    "errors may be common.",
)
_CORRELATION = (
    "People without a score are not in the correlation. Its interval is that among people like these; with few people "
    "it is wide even if their order is perfect."
)
_DIFFERENCES = (
    "Paired differences, with 95 % intervals: of a person from the intervals of the trials, of the cohort from the "
    "spread between people (Student's t). If nobody changed between two sessions, twice the standard deviation is the "
    "smallest change of one person that repetition alone does not explain."
)


def reach_cohort_page(data: CohortData, shapes: Sequence[Shape]) -> bytes:
    """Return the page as UTF-8.

    Parameters
    ----------
    data : CohortData
        With the tables people, correlation, differences and trials.
    shapes : sequence of Shape
        Surfaces of reachable volumes, at most one for each person, side and session, in the order of the sessions.
    """
    figures = reach_figures(data, shapes)
    return study_page(data.study, data.trials, _key_numbers(data), _sections(data), figures, _FOOTER)


def _sections(data: CohortData) -> Iterator[ResultSection]:
    correlation = data.tables["correlation"]
    scored = bool(correlation["spearman"].notna().any())
    people = data.tables["people"]
    grids = (tables.people(people), *([tables.correlation(correlation)] if scored else []), tables.measures(people))
    text = (*_MEANING, _CORRELATION) if scored else _MEANING
    yield ResultSection("volume", "Reachable volume", grids, ("volumes",), text=text)
    yield ResultSection(
        "shapes",
        "The volumes on one scale (thesis figures 7.3 and 7.4)",
        figures=("reach-sides", "reach-sessions"),
    )
    if len(data.tables["differences"]):
        yield ResultSection(
            "differences",
            "Left and right, session and session",
            (tables.differences(data.of_cohort("differences"), "Mean differences over the people"),),
            folded=(tables.differences(data.of_people("differences"), "Differences of every person"),),
            text=(_DIFFERENCES,),
        )
    yield ResultSection("trials", "Trials", (tables.trials(data.tables["trials"]),))


def _key_numbers(data: CohortData) -> Iterator[KeyNumber]:
    frame = data.tables["people"]
    yield KeyNumber("people", str(len(frame)), f"{len(data.trials)} trials")
    volumes = frame["volume"].dropna()
    if len(volumes):
        yield KeyNumber(
            "volume", f"{show(volumes.min())} … {show(volumes.max())} m³", "smallest and largest of a person"
        )
    for row in _of_volume(data.tables["correlation"]):
        about = f"95 % interval {show(row['spearman_low'])} … {show(row['spearman_high'])}, {row['people']} people"
        yield KeyNumber("volume and score", show(row["spearman"]), f"Spearman's correlation, {about}")
    for row in _of_volume(data.of_cohort("differences")):
        yield KeyNumber(row["comparison"], show_estimate(row, "difference"), "mean difference of volume, m³")


def _of_volume(frame: pd.DataFrame) -> list[dict[str, Any]]:
    column = "spearman" if "spearman" in frame else "difference"
    known = frame[(frame["measure"] == "volume") & frame[column].notna()]
    return records(known)
