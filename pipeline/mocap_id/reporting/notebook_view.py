"""Verdict and main numbers of a trial as HTML for a notebook."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mocap_id.reporting import style
from mocap_id.reporting.explanations import LEVELS
from mocap_id.reporting.numbers import UNKNOWN, show_fixed, show_interval, show_with_sd
from mocap_id.reporting.page import environment, explained
from mocap_id.reporting.space import tables as spatial
from mocap_id.reporting.summary_schema import Summary
from mocap_id.reporting.tables import Grid, grid


def notebook_view(document: Mapping[str, Any]) -> str:
    """Return verdict and main numbers, with their 95 % intervals, as a piece of HTML.

    Parameters
    ----------
    document : mapping
        Content of ``summary.json``.
    """
    summary = Summary.model_validate(document)
    headline, lead = LEVELS[summary.verdict.level]
    template = environment().get_template("notebook.html.j2")
    return template.render(
        trial=style.printable(summary.trial),
        headline=headline,
        lead=lead,
        reasons=[explained(reason) for reason in summary.verdict.reasons],
        grids=[_lengths(summary), spatial.angles(summary), _reach(summary), _parameters(summary)],
    )


def _lengths(summary: Summary) -> Grid:
    found = (summary.lengths_m or {}).items()
    rows = [(name, show_with_sd(one.value, one.sd), show_interval(one.value, one.sd)) for name, one in found]
    return grid("Segment lengths", ("segment", "length ± sd (m)", "95 % interval"), rows)


def _reach(summary: Summary) -> Grid:
    reach = summary.workspace
    ends = " … ".join(show_fixed(end, 3) for end in reach.interval_m3 or ())
    rows = [] if reach.volume_m3 is None else [("wrist", show_fixed(reach.volume_m3, 3), ends or UNKNOWN)]
    return grid("Reachable volume", ("point", "volume (m³)", "95 % interval"), rows)


def _parameters(summary: Summary) -> Grid:
    rows = [
        (
            one.name,
            show_with_sd(one.value, one.sd),
            show_interval(one.value, one.sd),
            style.unit(one.unit),
            one.verdict or UNKNOWN,
        )
        for one in summary.dynamics.base or ()
    ]
    caption = f"Base parameters; vertical force: r² {show_fixed(_fit(summary), 4)}"
    return grid(caption, ("parameter", "value ± sd", "95 % interval", "unit", "verdict"), rows, (0, 3, 4))


def _fit(summary: Summary) -> float | None:
    vertical = (summary.dynamics.wrench or {}).get("Fy")
    return vertical.r2 if vertical else None
