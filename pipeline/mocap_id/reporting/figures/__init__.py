"""Figures of the report, one module each; a function returns a figure, or a sentence on why there is none."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mocap_id.reporting import style
from mocap_id.reporting.contents import FIGURES
from mocap_id.reporting.figure import Drawing, Drawings, Figure
from mocap_id.reporting.figures import (
    parameters,
    phases,
    point_masses,
    recovery,
    repetitions,
    residuals,
    skeleton,
    states,
    wrench,
)
from mocap_id.reporting.figures.captions import caption
from mocap_id.reporting.report_data import ReportData

FIGURE_FUNCTIONS: Mapping[str, Callable[[ReportData], Figure | str]] = {
    "skeleton": skeleton.draw,
    "recovery": recovery.draw,
    "states": states.draw,
    "repetitions": repetitions.draw,
    "phases": phases.draw,
    "residuals": residuals.draw,
    "wrench": wrench.draw,
    "parameters": parameters.draw,
    "point_masses": point_masses.draw,
}


def drawings(data: ReportData) -> Drawings:
    """Return all figures of :data:`mocap_id.reporting.contents.FIGURES`, or those of a trial in space."""
    entries, functions = FIGURES, FIGURE_FUNCTIONS
    if data.in_space:
        from mocap_id.reporting.space import figures as spatial  # noqa: PLC0415  these use the figures above

        entries, functions = spatial.FIGURES, spatial.FIGURE_FUNCTIONS
    made = (Drawing(one.name, one.title, caption(one, data), functions[one.name](data)) for one in entries)
    return Drawings(style.printable(data.trial), tuple(made))
