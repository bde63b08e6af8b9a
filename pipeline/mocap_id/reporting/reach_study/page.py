"""``cohort.html`` of a reach study."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mocap_id.reporting.grids import show_estimate
from mocap_id.reporting.numbers import show
from mocap_id.reporting.page import KeyNumber, Section
from mocap_id.reporting.reach_study import tables
from mocap_id.reporting.reach_study.figures import Shape, draw_reach_figures
from mocap_id.reporting.results.study_page import render_study_page
from mocap_id.reporting.study.page_data import CohortData

_FOOTER = (
    "The same numbers in SI units are in the CSV and Parquet files beside this page, which study.json describes. A "
    "left arm is mirrored, so that the numbers of both sides have the same meaning."
)
_MEANING = (
    "The volume is what the wrist can reach if each joint uses its whole range, independent of the others, as in the "
    "thesis. The visited volume uses only recorded combinations of joint angles. The surface is the reached fraction "
    "of the hemisphere in front of the shoulder. For elevation and height, the largest values are given.",
    "A person's number is the mean of both sides. Its interval is the mean interval of the trials, because the "
    "trials may have the same errors.",
)
_CORRELATION = (
    "The correlation excludes people without a score. Its interval applies to people like these; with few people it is "
    "wide even if their order is perfect."
)
_DIFFERENCES = (
    "Paired differences with 95 % intervals. The interval of a person follows from the intervals of the trials, the "
    "interval of the cohort from the differences between people (Student's t). If nobody changed between two sessions, "
    "twice the standard deviation is the smallest change of one person that repetition alone does not explain."
)


def render_reach_page(data: CohortData, shapes: Sequence[Shape]) -> bytes:
    """Return the HTML page in UTF-8.

    Parameters
    ----------
    data : CohortData
        Data of the study with the tables `people`, `correlation`, `differences` and `trials`.
    shapes : sequence of Shape
        Surfaces of reachable volumes, at most one for each person, side and session, in the order of the sessions.
    """
    return render_study_page(
        data, _make_key_numbers(data), _make_sections(data), draw_reach_figures(data, shapes), _FOOTER
    )


def _make_sections(data: CohortData) -> Iterator[Section]:
    correlation = data.tables["correlation"]
    scored = bool(correlation["spearman"].notna().any())
    people = data.tables["people"]
    grids = (
        tables.list_people(people),
        *([tables.list_correlations(correlation)] if scored else []),
        tables.list_measures(people),
    )
    text = (*_MEANING, _CORRELATION) if scored else _MEANING
    yield Section("volume", "Reachable volume", grids, ("volumes",), text=text)
    yield Section(
        "shapes",
        "The volumes on one scale (thesis figures 7.3 and 7.4)",
        figures=("reach-sides", "reach-sessions"),
    )
    if len(data.tables["differences"]):
        yield Section(
            "differences",
            "Left and right, session and session",
            (tables.list_differences(data.of_cohort("differences"), "Mean differences over the people"),),
            folded=(tables.list_differences(data.of_people("differences"), "Differences of every person"),),
            text=(_DIFFERENCES,),
        )
    yield Section("trials", "Trials", (tables.list_trials(data.tables["trials"]),))


def _make_key_numbers(data: CohortData) -> Iterator[KeyNumber]:
    frame = data.tables["people"]
    yield KeyNumber("people", str(len(frame)), f"{len(data.trials)} trials")
    volumes = frame["volume"].dropna()
    if len(volumes):
        extremes = f"{show(volumes.min())} … {show(volumes.max())} m³"
        yield KeyNumber("volume", extremes, "smallest and largest volume of a person")
    correlation, differences = data.tables["correlation"], data.of_cohort("differences")
    for row in correlation[(correlation["measure"] == "volume") & correlation["spearman"].notna()].to_dict("records"):
        about = f"95 % interval {show(row['spearman_low'])} … {show(row['spearman_high'])}, {row['people']} people"
        yield KeyNumber("volume and score", show(row["spearman"]), f"Spearman's correlation, {about}")
    known = differences[(differences["measure"] == "volume") & differences["difference"].notna()]
    for row in known.to_dict("records"):
        yield KeyNumber(row["comparison"], show_estimate(row, "difference"), "mean difference of volume, m³")
