"""The page that trials, studies and other results share: one HTML file that needs no other file and no network.

The scripts of the page only draw the figures and the player.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from mocap_id import __version__
from mocap_id.reporting import style
from mocap_id.reporting.explanations import EXPLANATIONS, LEVELS
from mocap_id.reporting.figure import Drawings, from_json, to_json
from mocap_id.reporting.grids import Grid

if TYPE_CHECKING:
    from jinja2 import Environment

    from mocap_id.reporting.player import Player
    from mocap_id.reporting.study import TrialEntry
    from mocap_id.reporting.summary_schema import ReasonEntry


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
    reasons: tuple[ReasonEntry, ...] = ()
    key_numbers: tuple[KeyNumber, ...] = ()
    player: Player | None = None
    trials: tuple[TrialEntry, ...] = ()  # trials of a study; their verdicts are shown after the sections
    notes: tuple[ReasonEntry, ...] = ()  # notes of the verdict, shown in the last section

    def render(self) -> bytes:
        """Return the HTML page in UTF-8."""
        template, embedded = make_environment().get_template("page.html.j2"), embed(self.figures, self.player)
        page = template.render(page=self, name=style.clean(self.name), product=__version__, embedded=embedded)
        return page.encode("utf-8")


def make_environment() -> Environment:
    """Return the environment of the templates; it escapes all values for HTML.

    The filter ``sentence`` makes a sentence of a message; ``code`` splits a text into pieces, true for code.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415  only a page that is made needs it

    environment = Environment(
        loader=PackageLoader("mocap_id.reporting", "templates"),
        autoescape=True,  # labels, names and messages come from untrusted files
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"sentence": lambda message: to_sentence(style.clean(message)), "code": _split_code}
    environment.globals |= {"explanations": EXPLANATIONS, "levels": LEVELS}
    return environment


_OPENING = '<script type="application/json" id="figure-data">'


def embed(drawings: Drawings, player: Player | None = None) -> dict[str, Any]:
    """Return data and scripts for the figures of a page and for its player, if it has one, for the templates.

    ``data`` has JSON texts that are safe in a script element, by the id of the element; ``scripts`` are Plotly and our
    own; ``policy`` is the content security policy, which allows these scripts by their digests, and no connection.
    """
    contents: dict[str, Any] = {"figure-data": to_json(drawings)}
    if player is not None:
        contents["player-data"] = player.to_json()
    names = ("plotly-basic.min.js", "chart.js", *(() if player is None else ("player.js",)))
    scripts = [_read_script(name) for name in names]
    digests = " ".join(f"'sha256-{digest}'" for _, digest in scripts)
    data = {}
    for name, content in contents.items():
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        # no label can close the script element
        data[name] = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    policy = f"default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; script-src {digests}"
    return {"data": data, "scripts": [text for text, _ in scripts], "policy": policy}


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


def _split_code(text: str) -> tuple[tuple[str, bool], ...]:
    """Split a text at backticks into text and code; a text with an unpaired backtick stays one piece of text."""
    pieces = text.split("`")
    if len(pieces) % 2 == 0:
        return ((text, False),)
    return tuple((piece, k % 2 == 1) for k, piece in enumerate(pieces) if piece)


def to_sentence(message: str) -> str:
    """Return a message with a capital letter and a full stop, which it does not have on the terminal."""
    return f"{message[:1].upper()}{message[1:]}" + ("" if message.endswith((".", "?", "!", "…")) else ".")
