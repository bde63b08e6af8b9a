"""The page that trials, studies and other results share: one HTML file that needs no other file and no network.

The scripts of the page only draw the figures and the player.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, TypeAlias

from mocap_id import __version__
from mocap_id.reporting import style
from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.reporting.figure import Drawings, from_json, to_json
from mocap_id.reporting.grids import Grid
from mocap_id.reporting.summary_schema import ReasonEntry

if TYPE_CHECKING:
    from jinja2 import Environment

    from mocap_id.reporting.player import Player
    from mocap_id.reporting.study import TrialEntry


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


_OPENING = '<script type="application/json" id="figure-data">'


@dataclass(frozen=True)
class Embedded:
    """Data and scripts for the page templates."""

    data: Mapping[str, str]  # JSON texts that are safe in a script element, by the id of the element
    scripts: tuple[str, ...]  # Plotly, and our scripts that draw with Plotly
    policy: str  # content security policy: it allows these scripts by their digests, and no connection


def embed(drawings: Drawings, player: Player | None = None) -> Embedded:
    """Return the data and scripts for the figures of a page, and for its player if the page has one."""
    contents: dict[str, Any] = {"figure-data": to_json(drawings)}
    if player is not None:
        contents["player-data"] = player.to_json()
    names = ("plotly-basic.min.js", "chart.js", *(() if player is None else ("player.js",)))
    scripts = [_read_script(name) for name in names]
    digests = " ".join(f"'sha256-{digest}'" for _, digest in scripts)
    return Embedded(
        data={
            # no label can close the script element
            name: json.dumps(content, separators=(",", ":"), allow_nan=False)
            .replace("<", "\\u003c")
            .replace(">", "\\u003e")
            .replace("&", "\\u0026")
            for name, content in contents.items()
        },
        scripts=tuple(text for text, _ in scripts),
        policy=f"default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; script-src {digests}",
    )


def read_figures(page: str) -> Drawings:
    """Read the figures embedded in a page.

    Raises
    ------
    ValueError, TypeError, KeyError, AttributeError, RecursionError
        The page contains no valid figures.
    """
    drawings = from_json(json.loads(page.partition(_OPENING)[2].partition("</script>")[0]))
    if not isinstance(drawings, Drawings) or not all(re.fullmatch(r"[a-z0-9_-]+", one.name) for one in drawings.all):
        raise ValueError("the page contains no figures of mocap-id")
    return drawings


@cache
def _read_script(name: str) -> tuple[str, str]:
    """Return the text of a script and its SHA-256 digest in base64."""
    text = files("mocap_id.reporting").joinpath("templates", name).read_text("utf-8").strip()
    return text, base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


Prose: TypeAlias = tuple[tuple[str, bool], ...]
"""Pieces of a text; the flag of a piece is true for code, which was between backticks."""


@dataclass(frozen=True)
class ExplainedReason:
    """A reason for the verdict with the explanation of its code; meaning and action are empty for an unknown code."""

    level: str
    code: str
    title: str
    message: Prose
    meaning: Prose
    action: Prose


def explain_reason(reason: ReasonEntry) -> ExplainedReason:
    """Return a reason together with the explanation of its code."""
    explanation = EXPLANATIONS.get(reason.code)
    return ExplainedReason(
        level=reason.level,
        code=reason.code,
        title=explanation.title if explanation else reason.code.replace("-", " ").capitalize(),
        message=split_code(to_sentence(style.clean(reason.message))),
        meaning=split_code(explanation.meaning) if explanation else (),
        action=split_code(explanation.action) if explanation else (),
    )


def split_code(text: str) -> Prose:
    """Split a text at backticks into text and code; a text with an unpaired backtick stays one piece of text."""
    pieces = text.split("`")
    if len(pieces) % 2 == 0:
        return ((text, False),)
    return tuple((piece, k % 2 == 1) for k, piece in enumerate(pieces) if piece)


def to_sentence(message: str) -> str:
    """Return a message with a capital letter and a full stop, which it does not have on the terminal."""
    return f"{message[:1].upper()}{message[1:]}" + ("" if message.endswith((".", "?", "!", "…")) else ".")
