"""The report of a trial: its files, its key numbers, and what a notebook shows of it."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from mocap_id.reporting import PAGE_FILE, SUMMARY_FILE, PdfFonts, style
from mocap_id.reporting.explanations import LEVELS
from mocap_id.reporting.figure import Drawing, Drawings
from mocap_id.reporting.figures import draw_figures
from mocap_id.reporting.grids import (
    UNKNOWN,
    GridColumn,
    numbers,
    scale,
    show,
    show_ends,
    show_fixed,
    show_interval,
    texts,
    to_grid,
    with_sd,
)
from mocap_id.reporting.page import KeyNumber, Page, embed, make_environment, read_figures
from mocap_id.reporting.player import Player, make_player
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.sections import describe_band, list_angles, make_sections
from mocap_id.reporting.summary import encode_summary, summarise
from mocap_id.reporting.summary_schema import Summary
from mocap_id.store import Document


def make_documents(data: ReportData, *, figures: bool = False, pdf_fonts: PdfFonts = "type-3") -> tuple[Document, ...]:
    """Return the files of :data:`mocap_id.reporting.FILES`, followed by the paper figures if requested."""
    summary = summarise(data)
    verdict = summary.verdict
    headline, lead = LEVELS[verdict.level]
    along = "the first horizontal axis of the recording" if data.in_space else "the motion"
    page = Page(
        name=data.trial,
        headline=headline,
        lead=lead,
        command="report",
        sections=tuple(make_sections(data, summary)),
        figures=draw_figures(data),
        footer=f"SI units; x along {along}, y up. Angles are in degrees here and in radians in the data files.",
        level=verdict.level,
        reasons=tuple(verdict.reasons),
        key_numbers=tuple(make_key_numbers(data, summary)),
        player=make_player(data),
        notes=tuple(verdict.notes),
    )
    contents = {SUMMARY_FILE: encode_summary(summary), PAGE_FILE: page.render()}
    if figures:
        from mocap_id.reporting import paper_figures  # noqa: PLC0415  loads matplotlib

        contents |= paper_figures.make_figure_files(
            read_figures(contents[PAGE_FILE].decode("utf-8")), pdf_fonts
        )  # as `mocap-id figures` does
    return tuple(Document(file, content) for file, content in contents.items())


def make_key_numbers(data: ReportData, summary: Summary) -> list[KeyNumber]:
    """Return the known key numbers for the top of the page."""
    dynamics, segments, five_times, curls = summary.dynamics, summary.segments, summary.five_times, summary.curls
    mass = next((entry for entry in dynamics.base or () if entry.unit == "kg"), None)
    mass_sd = None if mass is None else mass.sd
    vertical = (dynamics.wrench or {}).get("Fy")
    band = "" if data.low_pass is None else f", {describe_band(data)}"
    sd, scaled = five_times.to_fifth_stand_sd_s, dynamics.condition_number_scaled
    counted = KeyNumber("repetitions", show_fixed(len(summary.repetitions or ()) or None, 0), "found")
    if curls.count is not None:
        remark = "to the end of the recording"
        if curls.end_rule != "recording":
            remark = f"to the end of the trial at {show_fixed(curls.end_s, 1, 's')} ({curls.end_rule})"
        counted = KeyNumber("curls", str(curls.count), f"{remark}; {curls.partial} failed")
    found = (
        KeyNumber("segments", show_fixed(segments.count, 0), f"confidence {show_fixed(segments.confidence, 2)}"),
        KeyNumber("reprojection error", show(summary.markers.reprojection_rms_mm, 3, "mm"), "rms over all markers"),
        KeyNumber(
            "missing samples",
            show_fixed(scale(summary.markers.missing_fraction, 100), 1, "%"),
            "of all marker samples",
        ),
        counted,
        KeyNumber(
            "five-times test",
            show_fixed(five_times.to_fifth_stand_s, 2, "s"),
            "to the fifth stand" if sd is None else f"± {show_fixed(sd, 3)} s, to the fifth stand",
        ),
        KeyNumber("mass, measured", show(dynamics.mass_kg, 3, "kg"), "by the plates at rest"),
        KeyNumber(
            "mass, identified",
            show(mass.value if mass else None, 3, "kg"),
            "from the motion" if mass_sd is None else f"± {show(mass_sd, 2)} kg, from the motion",
        ),
        KeyNumber("mean CoP", show_fixed(scale(dynamics.cop_mean_m, 1e3), 1, "mm"), "along the motion, measured"),
        KeyNumber("vertical force fit", show_fixed(vertical.r2 if vertical else None, 4), f"r² of the model{band}"),
        KeyNumber("CoP error", show_fixed(scale(dynamics.cop_rms_m, 1e3), 1, "mm"), f"rms of the model{band}"),
        KeyNumber(
            "condition number",
            show(dynamics.condition_number),
            "of the chain's regressor" if scaled is None else f"of the chain; {show(scaled)} with unit-norm columns",
        ),
        KeyNumber("clock offset", show_fixed(scale(dynamics.clock_offset_s, 1e3), 2, "ms"), "plates after cameras"),
    )
    return [one for one in found if one.value != UNKNOWN]


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
        reasons=summary.verdict.reasons,
        grids=[lengths, list_angles(summary), volume, parameters],
    )
    return (
        view if player is None else view + _make_frame(render_figure_page(summary.trial, player=player), _PLAYER_HEIGHT)
    )


def render_figure_frame(of: str, drawing: Drawing) -> str:
    """Return an HTML frame that contains the page of one figure of the trial or study named ``of``."""
    panels = (
        0.0
        if isinstance(drawing.figure, str)
        else sum(max(panel.height for panel in line) + _TITLE for line in drawing.figure.lines)
    )
    return _make_frame(render_figure_page(of, drawing), round(_PER_INCH * panels) + 180)


def render_figure_page(of: str, *drawings: Drawing, player: Player | None = None) -> str:
    """Return an HTML page, including its scripts, for figures or the player of the trial or study named ``of``."""
    template = make_environment().get_template("notebook_frame.html.j2")
    embedded = embed(Drawings(of, drawings), player)
    return template.render(title=style.clean(of), drawings=drawings, player=player, embedded=embedded)


def _make_frame(page: str, height: int) -> str:
    """Return an HTML frame with a page whose scripts can access neither the notebook nor the network.

    ``height`` is in pixels.
    """
    look = f"width: 100%; height: {height}px; border: 0; resize: vertical; overflow: auto"
    return f'<iframe sandbox="allow-scripts allow-downloads" style="{look}" srcdoc="{escape(page)}"></iframe>'
