"""The player as the page holds it: scripts, data, and what the page's policy lets run."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

from bokeh.util.paths import bokehjs_path

from mocap_id.reporting import style
from mocap_id.reporting.material import Material
from mocap_id.reporting.player.frames import Frames, frames
from mocap_id.reporting.player.plots import FRAME, plots


@dataclass(frozen=True)
class Key:
    """An entry of the player's legend: a colour of the page's style, how it is drawn, and what it stands for."""

    colour: str
    look: str
    text: str


@dataclass(frozen=True)
class Player:
    """What the template needs.

    Parameters
    ----------
    library, script : str
        Bokeh's script and the player's own.
    policy : str
        Sources of scripts for the page's content security policy: these two by their digests, and no other.
    data : str
        JSON that may stand in a script element.
    moments : int
        Positions of the slider.
    curves : bool
        Whether anything is known over time, to show beside the figure.
    legend : mapping of str to tuple of Key
        By what is drawn: joints, forces.
    arrow : float or None
        Force that an arrow of one metre stands for, N.
    width : int
        Of the figure, pixels.
    motion : str
        A sentence on what moves the figure and the model; empty where nothing was identified.
    """

    library: str
    script: str
    policy: str
    data: str
    moments: int
    curves: bool
    legend: Mapping[str, tuple[Key, ...]]
    arrow: float | None
    width: int
    motion: str


def player(material: Material) -> Player | None:
    """The player of a trial; None where nothing moves."""
    moving = frames(material)
    if moving is None:
        return None
    drawn = plots(material, moving)
    roots = {drawn.figure: "player-figure"} | ({drawn.curves: "player-curves"} if drawn.curves else {})
    held = {"document": drawn.document, "roots": roots, "frames": moving.packed(), "themed": style.ON_PAGE}
    library, script, policy = _scripts()
    return Player(
        library=library,
        script=script,
        policy=policy,
        data=_inert(json.dumps(held, separators=(",", ":"), allow_nan=False)),
        moments=len(moving.time),
        curves=drawn.curves is not None,
        legend=_legend(material, moving),
        arrow=moving.newton_per_metre,
        width=FRAME[0],
        motion=_motion(material),
    )


@cache
def _scripts() -> tuple[str, str, str]:
    library = Path(bokehjs_path(), "js", "bokeh.min.js").read_text("utf-8").strip()
    script = files("mocap_id.reporting").joinpath("templates", "player.js").read_text("utf-8").strip()
    digests = (base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode() for text in (library, script))
    return library, script, " ".join(f"'sha256-{digest}'" for digest in digests)


def _inert(text: str) -> str:
    """JSON whose labels cannot end the element that it stands in."""
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _legend(material: Material, moving: Frames) -> dict[str, tuple[Key, ...]]:
    joints = material.skeleton.joints if material.skeleton is not None and material.motion is not None else ()
    names = [_key(style.colour(k), style.printable(name, 20)) for k, name in enumerate(joints, start=1)]
    told = {part.source for part in moving.parts}
    forces = [_key(style.MEASURED, "measured")] if "measured" in told else []
    if "model" in told:
        forces.append(_key(style.MODEL, "identified model, 95 %"))
        table = material.frame("dynamics.parquet")
        if table is not None and "Fy_reference" in table and table["Fy_reference"].notna().any():
            forces.append(_key(style.REFERENCE, "allometric reference", "dashed"))
    return {title: tuple(keys) for title, keys in (("joints", names), ("forces", forces)) if keys}


def _motion(material: Material) -> str:
    if material.measured_poses:
        return "The stick figure is the pinned chain; the model's forces rest on the measured poses."
    known = material.facts("dynamics.h5").get("motion") is not None
    return "Stick figure and model move as the pinned chain." if known else ""


def _key(colour: str, text: str, look: str = "solid") -> Key:
    return Key(style.on_page(colour), look, text)
