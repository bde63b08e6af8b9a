"""The page that trials, studies and other results share: one HTML file that needs no other file and no network.

The scripts of the page only draw the figures and the player.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mocap_id import __version__
from mocap_id.reporting import style
from mocap_id.reporting.embedding import embed
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.grids import Grid

if TYPE_CHECKING:
    from jinja2 import Environment

    from mocap_id.reporting.player import Player
    from mocap_id.reporting.reasons import ExplainedReason
    from mocap_id.reporting.study.cohort import TrialEntry


@dataclass(frozen=True)
class Section:
    """A section of a page: paragraphs, a list, figures, tables and folded tables (shown on a click), in this order."""

    anchor: str
    title: str
    grids: tuple[Grid, ...] = ()
    figures: tuple[str, ...] = ()
    folded: tuple[Grid, ...] = ()
    folded_as: str = "Each person"  # label on which the reader clicks to show the folded tables
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
    level: str = ""  # level of the verdict, which sets the colour of the box; empty for a box without colour
    note: str = ""  # what could not be done; empty if everything could be done
    reasons: tuple[ExplainedReason, ...] = ()
    key_numbers: tuple[KeyNumber, ...] = ()
    player: Player | None = None
    trials: tuple[TrialEntry, ...] = ()  # trials of a study; their verdicts are shown after the sections
    notes: tuple[ExplainedReason, ...] = ()  # notes of the verdict, shown in the last section

    def render(self) -> bytes:
        """Return the HTML page in UTF-8."""
        template = make_environment().get_template("page.html.j2")
        embedded = embed(self.figures, self.player)
        return template.render(page=self, name=style.clean(self.name), product=__version__, embedded=embedded).encode(
            "utf-8"
        )


def make_environment() -> Environment:
    """Return the environment of the templates; it escapes all values for HTML."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415  only a page that is made needs it

    return Environment(
        loader=PackageLoader("mocap_id.reporting", "templates"),
        autoescape=True,  # labels, names and messages come from untrusted files
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
