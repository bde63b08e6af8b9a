"""The common page of trials, studies and other results: one HTML file that needs no other file and no network.

Its only scripts draw the figures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from jinja2 import Environment, PackageLoader, StrictUndefined

from mocap_id import __version__
from mocap_id.reporting import style
from mocap_id.reporting.embedding import embed
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.grids import Grid

if TYPE_CHECKING:
    from mocap_id.reporting.player import Player
    from mocap_id.reporting.reasons import ExplainedReason
    from mocap_id.reporting.results.study_page import TrialEntry


@dataclass(frozen=True)
class Section:
    """A section of a page: paragraphs, a list, figures, tables, and folded tables, in this order."""

    anchor: str
    title: str
    grids: tuple[Grid, ...] = ()
    figures: tuple[str, ...] = ()
    folded: tuple[Grid, ...] = ()
    folded_as: str = "Each person"  # label on which the reader clicks
    text: tuple[str, ...] = ()
    items: tuple[str, ...] = ()
    needs: str = ""  # artefact without which the section is empty


@dataclass(frozen=True)
class KeyNumber:
    """A key number at the top of a page, with a remark."""

    name: str
    value: str
    remark: str


@dataclass(frozen=True)
class Page:
    """The content of a page."""

    name: str  # name of the trial or study
    headline: str  # the result in a few words
    lead: str  # the result in a sentence
    command: str  # command that writes the page, such as ``study``
    sections: tuple[Section, ...]
    figures: Drawings
    footer: str
    level: str = ""  # level of the verdict, for the colour of the box; empty for plain text
    note: str = ""  # what could not be done; empty if nothing
    reasons: tuple[ExplainedReason, ...] = ()
    key_numbers: tuple[KeyNumber, ...] = ()
    player: Player | None = None
    trials: tuple[TrialEntry, ...] = ()  # their verdicts follow the sections
    notes: tuple[ExplainedReason, ...] = ()  # the last section

    def render(self) -> bytes:
        """Return the page as UTF-8."""
        template = make_environment().get_template("page.html.j2")
        embedded = embed(self.figures, self.player)
        return template.render(page=self, name=style.clean(self.name), product=__version__, embedded=embedded).encode(
            "utf-8"
        )


def make_environment() -> Environment:
    """Return the template environment, which escapes all values."""
    return Environment(
        loader=PackageLoader("mocap_id.reporting", "templates"),
        autoescape=True,  # labels, names and messages come from untrusted files
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
