"""``cohort.html`` of a study of curls."""

from __future__ import annotations

from collections.abc import Iterator

from mocap_id.reporting.curl_study import tables
from mocap_id.reporting.curl_study.figures import draw_curl_figures
from mocap_id.reporting.grids import show_estimate
from mocap_id.reporting.page import KeyNumber, Section
from mocap_id.reporting.results.study_page import render_study_page
from mocap_id.reporting.study.page_data import CohortData

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
        (
            tables.list_conditions(
                found, tables.REPETITIONS, "Repetitions by condition, with 95 % intervals of the mean"
            ),
        ),
        ("repetitions",),
        text=_REPETITIONS,
    )
    if len(cohort):
        yield Section(
            "differences",
            f"Differences from {reference}",
            (tables.list_comparisons(to_reference, tables.REPETITIONS, "Paired differences of repetitions"),),
            folded=(
                tables.list_comparisons(others, tables.REPETITIONS, "Between the other conditions"),
                tables.list_comparisons(people[people["first"] == reference], tables.REPETITIONS, "Of every person"),
            ),
            folded_as="More differences",
            text=_DIFFERENCES,
        )
    yield Section(
        "compensation",
        "Compensation, tempo and torque by condition",
        (tables.list_comparisons(to_reference, tables.OTHERS, f"Paired differences from {reference}"),)
        if len(to_reference)
        else (),
        ("compensation",),
        folded=(tables.list_conditions(found, tables.OTHERS, "By condition, with 95 % intervals of the mean"),),
        folded_as="Each condition",
        text=_COMPENSATION,
    )
    yield Section("trials", "Trials", (tables.list_trials(data.tables["trials"]),))


def _make_key_numbers(data: CohortData, reference: str) -> Iterator[KeyNumber]:
    yield KeyNumber("people", str(len(data.subjects)), f"{len(data.trials)} trials")
    frame = data.of_cohort("comparisons")
    for row in frame[(frame["measure"] == "normalised") & (frame["first"] == reference)].to_dict("records"):
        difference = f"{show_estimate(row, 'difference', 100.0)} %"
        yield KeyNumber(row["comparison"], difference, f"normalised repetitions, {row['people']} people")
