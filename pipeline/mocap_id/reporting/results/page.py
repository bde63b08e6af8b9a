"""The page of a result: one HTML file that needs no other file and no network."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from mocap_id import __version__
from mocap_id.reporting import style
from mocap_id.reporting.embedding import embed
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.page import environment
from mocap_id.reporting.results.trial_entries import TrialEntry, counts, headline
from mocap_id.reporting.sections import KeyNumber
from mocap_id.reporting.tables import Grid


@dataclass(frozen=True)
class ResultSection:
    """A section of the page: paragraphs, a list, figures, tables, and folded tables, in this order."""

    anchor: str
    title: str
    grids: tuple[Grid, ...] = ()
    figures: tuple[str, ...] = ()
    folded: tuple[Grid, ...] = ()
    folded_as: str = "Each person"  # what a reader opens
    text: tuple[str, ...] = ()
    items: tuple[str, ...] = ()


@dataclass(frozen=True)
class ResultPage:
    """The content of a result's page."""

    name: str  # name of the study or trial
    headline: str  # the result in a few words
    lead: str  # the result in a sentence
    command: str  # the command that made it, such as ``study``
    sections: tuple[ResultSection, ...]
    figures: Drawings
    footer: str
    level: str = ""  # ``ok`` or ``caution`` for a coloured box; empty for plain text
    note: str = ""  # what could not be done; empty if nothing
    key_numbers: tuple[KeyNumber, ...] = ()
    trials: tuple[TrialEntry, ...] = ()  # their verdicts are the last section

    def render(self) -> bytes:
        """Return the page as UTF-8."""
        template = environment().get_template("result.html.j2")
        html = template.render(
            page=self, name=style.printable(self.name), product=__version__, embedded=embed(self.figures)
        )
        return html.encode("utf-8")


def study_page(  # noqa: PLR0917
    study: str,
    trials: tuple[TrialEntry, ...],
    key_numbers: Iterable[KeyNumber],
    sections: Iterable[ResultSection],
    figures: Drawings,
    footer: str,
) -> bytes:
    """Return the page of a study of people as UTF-8; its first sentences say how the trials ended."""
    return ResultPage(
        name=study,
        headline=headline(trials),
        lead=f"{counts(trials)}. Tables and figures are about the trials that went through.",
        command="study",
        level="ok" if all(trial.fate == "ok" for trial in trials) else "caution",
        key_numbers=tuple(key_numbers),
        sections=tuple(sections),
        trials=trials,
        figures=figures,
        footer=footer,
    ).render()
