"""Trials and figures as HTML for a notebook: verdict, main numbers, player and interactive figures."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from mocap_id.reporting import style
from mocap_id.reporting.embedding import embed
from mocap_id.reporting.explanations import LEVELS
from mocap_id.reporting.figure import Drawing, Drawings
from mocap_id.reporting.numbers import UNKNOWN, show_fixed, show_interval, show_with_sd
from mocap_id.reporting.page import environment, explained
from mocap_id.reporting.player import Player
from mocap_id.reporting.space import tables as spatial
from mocap_id.reporting.summary_schema import Summary
from mocap_id.reporting.tables import Grid, grid

_PER_INCH = 104  # pixels of the page for an inch on paper, as in chart.js
_TITLE = 0.35  # inches, the title of a panel and the space below
_PLAYER_HEIGHT = 860  # pixels, in a notebook 60rem wide


def notebook_view(document: Mapping[str, Any], player: Player | None = None) -> str:
    """Return verdict, main numbers with their 95 % intervals, and player as a piece of HTML.

    Parameters
    ----------
    document : mapping
        Content of ``summary.json``.
    player : Player, optional
        Without it the piece has no script.
    """
    summary = Summary.model_validate(document)
    headline, lead = LEVELS[summary.verdict.level]
    template = environment().get_template("notebook.html.j2")
    view = template.render(
        trial=style.printable(summary.trial),
        headline=headline,
        lead=lead,
        reasons=[explained(reason) for reason in summary.verdict.reasons],
        grids=[_lengths(summary), spatial.angles(summary), _reach(summary), _parameters(summary)],
    )
    return view if player is None else view + _frame(_page(summary.trial, player=player), _PLAYER_HEIGHT)


def figure_page(of: str, drawing: Drawing) -> str:
    """Return a whole page, with its scripts, that shows one figure.

    Parameters
    ----------
    of : str
        Trial or study of the figure.
    drawing : Drawing
    """
    return _page(of, drawing)


def figure_frame(of: str, drawing: Drawing) -> str:
    """Return one figure as a piece of HTML: :func:`figure_page` in a frame of its own."""
    panels = (
        0.0
        if isinstance(drawing.figure, str)
        else sum(max(panel.height for panel in line) + _TITLE for line in drawing.figure.lines)
    )
    return _frame(_page(of, drawing), round(_PER_INCH * panels) + 180)


def _page(of: str, *drawings: Drawing, player: Player | None = None) -> str:
    template = environment().get_template("notebook_frame.html.j2")
    embedded = embed(Drawings(of, drawings), player)
    return template.render(title=style.printable(of), drawings=drawings, player=player, embedded=embedded)


def _frame(page: str, height: int) -> str:
    """Return a frame with a page inside; its scripts can reach neither the notebook nor the network."""
    look = f"width: 100%; height: {height}px; border: 0; resize: vertical; overflow: auto"
    return f'<iframe sandbox="allow-scripts allow-downloads" style="{look}" srcdoc="{escape(page)}"></iframe>'


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
