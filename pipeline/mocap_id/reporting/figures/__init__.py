"""The report's figures, one file each: a figure, or a sentence that says why there is none."""

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
from mocap_id.reporting.figures.moved import caption
from mocap_id.reporting.material import Material

SHOWN: Mapping[str, Callable[[Material], Figure | str]] = {
    "skeleton": skeleton.shown,
    "recovery": recovery.shown,
    "states": states.shown,
    "repetitions": repetitions.shown,
    "phases": phases.shown,
    "residuals": residuals.shown,
    "wrench": wrench.shown,
    "parameters": parameters.shown,
    "point_masses": point_masses.shown,
}


def drawings(material: Material) -> Drawings:
    """Every figure of :data:`mocap_id.reporting.contents.FIGURES`."""
    made = (Drawing(one.name, one.title, caption(one, material), SHOWN[one.name](material)) for one in FIGURES)
    return Drawings(style.printable(material.trial), tuple(made))
