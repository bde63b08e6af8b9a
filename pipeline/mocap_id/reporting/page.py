"""``report.html``: a self-contained page whose only scripts draw its figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined

from mocap_id.reporting import style
from mocap_id.reporting.embedding import embed
from mocap_id.reporting.explanations import EXPLANATIONS, LEVELS
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.player import Player, player
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.sections import key_numbers, sections
from mocap_id.reporting.space.player import spatial_player
from mocap_id.reporting.space.sections import spatial_sections
from mocap_id.reporting.summary_schema import ReasonEntry, Summary

Prose: TypeAlias = tuple[tuple[str, bool], ...]


@dataclass(frozen=True)
class ExplainedReason:
    """A reason of the verdict with the explanation of its code.

    Prose is a sequence of text pieces, each with a flag for code (text between backticks).
    """

    level: str
    code: str
    title: str
    message: Prose
    meaning: Prose
    action: Prose


def page(data: ReportData, summary: Summary, figures: Drawings) -> bytes:
    """Render the page as UTF-8.

    Parameters
    ----------
    data, summary
        Trial and its summary.
    figures : Drawings
        All figures of :data:`mocap_id.reporting.contents.FIGURES`.
    """
    headline, lead = LEVELS[summary.verdict.level]
    motion_player = trial_player(data)
    html = (
        environment()
        .get_template("report.html.j2")
        .render(
            trial=style.printable(data.trial),
            product=data.product,
            level=summary.verdict.level,
            headline=headline,
            lead=lead,
            reasons=[explained(reason) for reason in summary.verdict.reasons],
            notes=[explained(reason) for reason in summary.verdict.notes],
            glance=key_numbers(data, summary),
            sections=spatial_sections(data, summary) if data.in_space else sections(data, summary),
            in_space=data.in_space,
            figures=figures,
            player=motion_player,
            embedded=embed(figures, motion_player),
        )
    )
    return html.encode("utf-8")


def trial_player(data: ReportData) -> Player | None:
    """Return the player of a trial in the plane or in space; None if there are no moving markers."""
    return spatial_player(data) if data.in_space else player(data)


def environment() -> Environment:
    """Return the template environment, which escapes all values."""
    return Environment(
        loader=PackageLoader("mocap_id.reporting", "templates"),
        autoescape=True,  # labels, names and messages come from untrusted files
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def explained(reason: ReasonEntry) -> ExplainedReason:
    """Return a reason together with the explanation of its code."""
    explained = EXPLANATIONS.get(reason.code)
    return ExplainedReason(
        level=reason.level,
        code=reason.code,
        title=explained.title if explained else reason.code.replace("-", " ").capitalize(),
        message=prose(sentence(style.printable(reason.message))),
        meaning=prose(explained.meaning) if explained else (),
        action=prose(explained.action) if explained else (),
    )


def prose(text: str) -> Prose:
    """Split text at backticks into text and code; an unpaired backtick is text."""
    pieces = text.split("`")
    if len(pieces) % 2 == 0:
        return ((text, False),)
    return tuple((piece, k % 2 == 1) for k, piece in enumerate(pieces) if piece)


def sentence(text: str) -> str:
    """Add a capital letter and a full stop to a message, which has neither on the terminal."""
    return f"{text[:1].upper()}{text[1:]}" + ("" if text.endswith((".", "?", "!", "…")) else ".")
