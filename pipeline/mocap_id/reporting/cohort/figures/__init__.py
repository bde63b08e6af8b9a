"""The figures of a cohort's page: a drawing, or a sentence that says why there is none."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from matplotlib.figure import Figure

from mocap_id.reporting.cohort.figures import lengths, parameters, pressure
from mocap_id.reporting.cohort.material import CohortMaterial
from mocap_id.reporting.contents import FigureEntry
from mocap_id.reporting.figures import Drawing, drawing

FIGURES: tuple[FigureEntry, ...] = (
    FigureEntry(
        "lengths",
        "Segment lengths against their reference",
        "A dot for each trial with its 95 % interval, coloured by strategy. Bars are what was measured on the body, "
        "crosses what the allometric table says for the person's height.",
    ),
    FigureEntry(
        "pressure",
        "Centre of pressure: own models and the allometric body",
        "Root mean square error of the predicted centre of pressure off the chair, a mark for each prediction. Own: "
        "the trial's model on its own samples; held out: on repetitions that it was not fitted to; other trial: the "
        "model of another trial of the same person.",
    ),
    FigureEntry(
        "parameters",
        "Base parameters of every person",
        "A dot for each trial with its 95 % interval, coloured by strategy; crosses are the allometric body. Each "
        "panel has a scale of its own.",
    ),
)
_DRAW: Mapping[str, Callable[[CohortMaterial], Figure | str]] = {
    "lengths": lengths.draw,
    "pressure": pressure.draw,
    "parameters": parameters.draw,
}


def render(entry: FigureEntry, material: CohortMaterial) -> Drawing:
    """Draw one figure of the page."""
    return drawing(entry, material.study, lambda: _DRAW[entry.name](material))
