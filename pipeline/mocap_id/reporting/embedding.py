"""Figures embedded in an HTML page: their data, the scripts that draw them, and the content security policy."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from mocap_id.reporting.figure import Drawings, from_json, to_json
from mocap_id.reporting.player import Player

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
    scripts = (*_read_library(), *([_read_script("player.js")] if player is not None else []))
    digests = " ".join(f"'sha256-{digest}'" for _, digest in scripts)
    return Embedded(
        data={
            name: _escape(json.dumps(content, separators=(",", ":"), allow_nan=False))
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
def _read_library() -> tuple[tuple[str, str], ...]:
    return _read_script("plotly-basic.min.js"), _read_script("chart.js")


@cache
def _read_script(name: str) -> tuple[str, str]:
    """Return the text of a script and its SHA-256 digest in base64."""
    text = files("mocap_id.reporting").joinpath("templates", name).read_text("utf-8").strip()
    return text, base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


def _escape(text: str) -> str:
    """Return JSON with <, > and & escaped, so that no label in it can close the script element."""
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
