"""Trials and figures as HTML for a notebook: verdict, main numbers, player and interactive figures."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from mocap_id.reporting import style
from mocap_id.reporting.explanations import LEVELS
from mocap_id.reporting.figure import Drawing, Drawings
from mocap_id.reporting.grids import GridColumn, numbers, show_ends, texts, to_grid, with_sd
from mocap_id.reporting.numbers import UNKNOWN, show_fixed, show_interval
from mocap_id.reporting.page import embed, explain_reason, make_environment
from mocap_id.reporting.player import Player
from mocap_id.reporting.summary_schema import Summary
from mocap_id.reporting.tables import list_angles

_PER_INCH = 104  # pixels of the page for an inch on paper, as in chart.js
_TITLE = 0.35  # inches, for the title of a panel and the space below it
_PLAYER_HEIGHT = 860  # pixels, in a notebook 60rem wide


def render_notebook_view(document: Mapping[str, Any], player: Player | None = None) -> str:
    """Return the verdict, the main numbers with 95 % intervals, and the player as an HTML fragment.

    ``document`` is the content of ``summary.json``. Without a ``player``, the HTML fragment has no script.
    """
    summary = Summary.model_validate(document)
    headline, lead = LEVELS[summary.verdict.level]
    lengths = to_grid(
        "Segment lengths",
        summary.lengths_m or {},
        (
            with_sd("length ± sd (m)", "value", "sd"),
            GridColumn("95 % interval", lambda entry: show_interval(entry.value, entry.sd)),
        ),
        "segment",
    )
    volume = to_grid(
        "Reachable volume",
        {} if summary.workspace.volume_m3 is None else {"wrist": summary.workspace},
        (
            numbers("volume (m³)", "volume_m3", 3),
            GridColumn("95 % interval", lambda entry: show_ends(entry.interval_m3, 3)),
        ),
        "point",
    )
    vertical = (summary.dynamics.wrench or {}).get("Fy")
    parameters = to_grid(
        f"Base parameters; vertical force: r² {show_fixed(vertical.r2 if vertical else None, 4)}",
        summary.dynamics.base or (),
        (
            texts("parameter", "name"),
            with_sd("value ± sd", "value", "sd"),
            GridColumn("95 % interval", lambda entry: show_interval(entry.value, entry.sd)),
            texts("unit", lambda entry: style.format_unit(entry.unit)),
            texts("verdict", "verdict", UNKNOWN),
        ),
    )
    template = make_environment().get_template("notebook.html.j2")
    view = template.render(
        trial=style.clean(summary.trial),
        headline=headline,
        lead=lead,
        reasons=[explain_reason(reason) for reason in summary.verdict.reasons],
        grids=[lengths, list_angles(summary), volume, parameters],
    )
    return view if player is None else view + _make_frame(_render_page(summary.trial, player=player), _PLAYER_HEIGHT)


def render_figure_page(of: str, drawing: Drawing) -> str:
    """Return an HTML page, including its scripts, for one figure of the trial or study named ``of``."""
    return _render_page(of, drawing)


def render_figure_frame(of: str, drawing: Drawing) -> str:
    """Return an HTML frame that contains the page of one figure of the trial or study named ``of``."""
    panels = (
        0.0
        if isinstance(drawing.figure, str)
        else sum(max(panel.height for panel in line) + _TITLE for line in drawing.figure.lines)
    )
    return _make_frame(_render_page(of, drawing), round(_PER_INCH * panels) + 180)


def _render_page(of: str, *drawings: Drawing, player: Player | None = None) -> str:
    template = make_environment().get_template("notebook_frame.html.j2")
    embedded = embed(Drawings(of, drawings), player)
    return template.render(title=style.clean(of), drawings=drawings, player=player, embedded=embedded)


def _make_frame(page: str, height: int) -> str:
    """Return an HTML frame with a page whose scripts can access neither the notebook nor the network.

    ``height`` is in pixels.
    """
    look = f"width: 100%; height: {height}px; border: 0; resize: vertical; overflow: auto"
    return f'<iframe sandbox="allow-scripts allow-downloads" style="{look}" srcdoc="{escape(page)}"></iframe>'
