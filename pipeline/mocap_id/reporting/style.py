"""How every figure looks: colours, dashes, labels and ranges.

The colours are Okabe and Ito's, which people with any colour vision tell apart. The page's style replaces those in
:data:`ON_PAGE` by its own, so that a figure is readable on light and on dark.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting.figure import Dash

INK, GRID, FAINT = "#1b1c1f", "#d3d4d8", "#6b6e75"
BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
MEASURED, MODEL, REFERENCE = INK, BLUE, ORANGE
OTHER = "#b2182b"
"""Another system's curves."""
NOW = "#882255"
"""The player's time."""
ON_PAGE: Mapping[str, str] = {INK: "--ink", GRID: "--grid", BLUE: "--blue", NOW: "--now"}
"""Colours that the page has a lighter one of where it is dark, with the names that they go by in its style."""

_CHAIN_COLOURS = (VERMILLION, GREEN, PURPLE, SKY, ORANGE, BLUE)  # last those that stand beside them for forces
_DASHES: tuple[Dash, ...] = ("-", "--", "-.", ":")


def colour(k: int) -> str:
    """Colour of joint or segment ``k``; 0 is the base, a negative one none."""
    return FAINT if k <= 0 else _CHAIN_COLOURS[(k - 1) % len(_CHAIN_COLOURS)]


def dashes(k: int) -> Dash:
    """Line style of joint ``k``: solid until the colours are used up."""
    return _DASHES[(k - 1) // len(_CHAIN_COLOURS) % len(_DASHES)]


def printable(text: object, limit: int = 0) -> str:
    """A label without control characters, cut to ``limit`` characters (0 = whole)."""
    clean = "".join(char if char.isprintable() else "\N{REPLACEMENT CHARACTER}" for char in str(text))
    return f"{clean[: limit - 1]}…" if 0 < limit < len(clean) else clean


def unit(text: str) -> str:
    """A unit as it is set: ``kg*m^2`` as kg·m²."""
    return text.replace("*", "·").replace("^2", "²").replace("^3", "³")


def extent(curves: Sequence[FloatArray], tail: float = 0.0) -> tuple[float, float] | None:
    """Lowest and highest of the curves, each without this share of its samples at either end; None of nothing known."""
    known = [curve[np.isfinite(curve)] for curve in curves]
    if tail:
        ends = [tuple(np.quantile(curve, (tail, 1 - tail))) for curve in known if len(curve)]
    else:
        ends = [(curve.min(), curve.max()) for curve in known if len(curve)]
    if not ends:
        return None
    return float(min(low for low, _ in ends)), float(max(high for _, high in ends))


def framed(curves: Sequence[FloatArray], tail: float = 0.0) -> tuple[float, float] | None:
    """The range that shows the curves with a margin, see :func:`extent`; None where nothing is known or all is one."""
    found = extent(curves, tail)
    if found is None or not found[1] > found[0]:
        return None
    margin = 0.1 * (found[1] - found[0])
    return found[0] - margin, found[1] + margin
