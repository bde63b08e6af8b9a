"""The report's figures, one file each: a drawing, or a sentence that says why there is none."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from matplotlib.figure import Figure

from mocap_id.reporting import style
from mocap_id.reporting.contents import FigureEntry
from mocap_id.reporting.figures import (
    parameters,
    phases,
    point_masses,
    repetitions,
    residuals,
    skeleton,
    states,
    wrench,
)
from mocap_id.reporting.material import Material

_DRAW: Mapping[str, Callable[[Material], Figure | str]] = {
    "skeleton": skeleton.draw,
    "states": states.draw,
    "repetitions": repetitions.draw,
    "phases": phases.draw,
    "residuals": residuals.draw,
    "wrench": wrench.draw,
    "parameters": parameters.draw,
    "point_masses": point_masses.draw,
}


@dataclass(frozen=True)
class Drawing:
    """A figure of the report as SVG; ``missing`` says why there is nothing to see, where there is nothing."""

    entry: FigureEntry
    svg: bytes
    missing: str | None


def render(entry: FigureEntry, material: Material) -> Drawing:
    """Draw one figure of the report; where its data are missing, the SVG holds the sentence that says so."""
    title = f"{entry.title}: {style.printable(material.trial)}"
    with style.house():
        drawn = _DRAW[entry.name](material)
        if isinstance(drawn, Figure):
            return Drawing(entry, style.svg(drawn, entry.name, title), None)
        return Drawing(entry, style.svg(style.notice(drawn), entry.name, title), style.printable(drawn))
