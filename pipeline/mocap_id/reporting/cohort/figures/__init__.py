"""The figures of a cohort's page: a figure, or a sentence that says why there is none."""

from __future__ import annotations

from mocap_id.reporting import style
from mocap_id.reporting.cohort.figures import lengths, parameters, pressure
from mocap_id.reporting.cohort.material import CohortMaterial
from mocap_id.reporting.figure import Drawing, Drawings


def drawings(material: CohortMaterial) -> Drawings:
    """Every figure of the page."""
    made = (
        Drawing(
            "lengths",
            "Segment lengths against their reference",
            "A dot for each trial with its 95 % interval, coloured by strategy. Bars are what was measured on the "
            "body, crosses what the allometric table says for the person's height.",
            lengths.shown(material),
        ),
        Drawing(
            "pressure",
            "Centre of pressure: own models and the allometric body",
            "Root mean square error of the predicted centre of pressure off the chair, a mark for each prediction. "
            "Own: the trial's model on its own samples; held out: on repetitions that it was not fitted to; other "
            "trial: the model of another trial of the same person.",
            pressure.shown(material),
        ),
        Drawing(
            "parameters",
            "Base parameters of every person",
            "A dot for each trial with its 95 % interval, coloured by strategy; crosses are the allometric body. Each "
            "panel has a scale of its own.",
            parameters.shown(material),
        ),
    )
    return Drawings(style.printable(material.study), made)
