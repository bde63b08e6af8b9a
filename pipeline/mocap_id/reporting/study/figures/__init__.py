"""The figures of a cohort's page; where there is no figure, a sentence says why."""

from __future__ import annotations

from mocap_id.reporting import style
from mocap_id.reporting.figure import Drawing, Drawings
from mocap_id.reporting.study.figures import lengths, parameters, pressure
from mocap_id.reporting.study.page_data import CohortData


def cohort_figures(data: CohortData) -> Drawings:
    """Return every figure of the page."""
    made = (
        Drawing(
            "lengths",
            "Segment lengths against their reference",
            "A dot for each trial with its 95 % interval, coloured by strategy. Bars are the lengths measured on the "
            "body, crosses those that the allometric table gives for the person's height.",
            lengths.draw(data),
        ),
        Drawing(
            "pressure",
            "Centre of pressure: own models and the allometric body",
            "Root mean square error of the predicted centre of pressure off the chair, a mark for each prediction. "
            "Own: the trial's model on its own samples; held out: on repetitions that it was not fitted to; other "
            "trial: the model of another trial of the same person.",
            pressure.draw(data),
        ),
        Drawing(
            "parameters",
            "Base parameters of every person",
            "A dot for each trial with its 95 % interval, coloured by strategy; crosses are the allometric body. Each "
            "panel has its own scale.",
            parameters.draw(data),
        ),
    )
    return Drawings(style.printable(data.study), made)
