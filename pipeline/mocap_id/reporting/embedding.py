"""What a page's figures need in its one file: data, scripts, and a policy that lets these run and nothing else."""

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
    """What the templates need.

    Parameters
    ----------
    data : mapping of str to str
        JSON that may stand in a script element, by the element's id.
    scripts : tuple of str
        The library, and what draws with it.
    policy : str
        The page's content security policy: these scripts by their digests, and no connection.
    """

    data: Mapping[str, str]
    scripts: tuple[str, ...]
    policy: str


def embedded(drawings: Drawings, player: Player | None = None) -> Embedded:
    """The figures of a page, and its player if it has one."""
    told: dict[str, Any] = {"figure-data": to_json(drawings)}
    if player is not None:
        told["player-data"] = player.to_json()
    scripts = (*_library(), *([_script("player.js")] if player is not None else []))
    digests = " ".join(f"'sha256-{digest}'" for _, digest in scripts)
    return Embedded(
        data={name: _inert(json.dumps(held, separators=(",", ":"), allow_nan=False)) for name, held in told.items()},
        scripts=tuple(text for text, _ in scripts),
        policy=f"default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; script-src {digests}",
    )


def read(page: str) -> Drawings:
    """The figures that a page holds.

    Raises
    ------
    ValueError, TypeError, KeyError, AttributeError, RecursionError
        It holds none that can be read.
    """
    drawings = from_json(json.loads(page.partition(_OPENING)[2].partition("</script>")[0]))
    if not isinstance(drawings, Drawings) or not all(re.fullmatch(r"[a-z0-9_-]+", one.name) for one in drawings.all):
        raise ValueError("these are no figures of ours")
    return drawings


@cache
def _library() -> tuple[tuple[str, str], ...]:
    return _script("plotly-basic.min.js"), _script("chart.js")


@cache
def _script(name: str) -> tuple[str, str]:
    """A script and its digest."""
    text = files("mocap_id.reporting").joinpath("templates", name).read_text("utf-8").strip()
    return text, base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()


def _inert(text: str) -> str:
    """JSON whose labels cannot end the element that it stands in."""
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
