"""``report.html``: one file that opens anywhere, with nothing to fetch and no script but what draws its figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined

from mocap_id.reporting import style
from mocap_id.reporting.embedding import embedded
from mocap_id.reporting.explanations import EXPLANATIONS, LEVELS
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.material import Material
from mocap_id.reporting.player import player
from mocap_id.reporting.sections import glance, sections
from mocap_id.reporting.shape import ReasonEntry, Summary

Prose: TypeAlias = tuple[tuple[str, bool], ...]


@dataclass(frozen=True)
class Advice:
    """A reason of the verdict as it is shown, with what its code means where the code is one that is explained.

    Prose comes in pieces, each with whether it is code: what a message holds between backticks.
    """

    level: str
    code: str
    title: str
    message: Prose
    meaning: Prose
    action: Prose


def page(material: Material, summary: Summary, figures: Drawings) -> bytes:
    """The page as UTF-8.

    Parameters
    ----------
    material, summary
        The trial and its summary.
    figures : Drawings
        Every figure of :data:`mocap_id.reporting.contents.FIGURES`.
    """
    headline, lead = LEVELS[summary.verdict.level]
    moving = player(material)
    html = (
        environment()
        .get_template("report.html.j2")
        .render(
            trial=style.printable(material.trial),
            product=material.product,
            level=summary.verdict.level,
            headline=headline,
            lead=lead,
            reasons=[advice(reason) for reason in summary.verdict.reasons],
            notes=[advice(reason) for reason in summary.verdict.notes],
            glance=glance(material, summary),
            sections=sections(material, summary),
            figures=figures,
            player=moving,
            embedded=embedded(figures, moving),
        )
    )
    return html.encode("utf-8")


def environment() -> Environment:
    """Templates whose values are escaped."""
    return Environment(
        loader=PackageLoader("mocap_id.reporting", "templates"),
        autoescape=True,  # labels, names and messages come from files that anybody may have made
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def advice(reason: ReasonEntry) -> Advice:
    """A reason with what its code means and what to do about it."""
    explained = EXPLANATIONS.get(reason.code)
    return Advice(
        level=reason.level,
        code=reason.code,
        title=explained.title if explained else reason.code.replace("-", " ").capitalize(),
        message=prose(sentence(style.printable(reason.message))),
        meaning=prose(explained.meaning) if explained else (),
        action=prose(explained.action) if explained else (),
    )


def prose(text: str) -> Prose:
    """Pieces of text and of code; an unpaired backtick is text."""
    pieces = text.split("`")
    if len(pieces) % 2 == 0:
        return ((text, False),)
    return tuple((piece, k % 2 == 1) for k, piece in enumerate(pieces) if piece)


def sentence(text: str) -> str:
    """A message with a capital and a full stop, as messages on a terminal go without."""
    return f"{text[:1].upper()}{text[1:]}" + ("" if text.endswith((".", "?", "!", "…")) else ".")
