"""Style of all figures: colours, dashes, labels and ranges.

The colours are those of Okabe and Ito, which colour-blind readers can distinguish. The style sheet of the page
replaces the colours in :data:`ON_PAGE`, so that figures are readable on light and dark backgrounds.
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
"""Colour of curves from another measurement system or method."""
NOW = "#882255"
"""Colour of the current time in the player."""
ON_PAGE: Mapping[str, str] = {INK: "--ink", GRID: "--grid", BLUE: "--blue", NOW: "--now"}
"""Colours with a lighter variant on dark pages, and the names of their CSS variables."""

_CHAIN_COLOURS = (VERMILLION, GREEN, PURPLE, SKY, ORANGE, BLUE)  # last: the colours also used for forces
_DASHES: tuple[Dash, ...] = ("-", "--", "-.", ":")


def pick_colour(k: int) -> str:
    """Return the colour of joint or segment ``k``; 0 is the base, and a negative number means no segment."""
    return FAINT if k <= 0 else _CHAIN_COLOURS[(k - 1) % len(_CHAIN_COLOURS)]


def pick_dash(k: int) -> Dash:
    """Return the line style of joint ``k``: solid until every colour is used once."""
    return _DASHES[(k - 1) // len(_CHAIN_COLOURS) % len(_DASHES)]


def clean(text: object, limit: int = 0) -> str:
    """Return a label with unprintable characters replaced, cut to ``limit`` characters (0 = no limit)."""
    clean = "".join(char if char.isprintable() else "\N{REPLACEMENT CHARACTER}" for char in str(text))
    return f"{clean[: limit - 1]}…" if 0 < limit < len(clean) else clean


def format_unit(text: str) -> str:
    """Return a unit with typographic signs: kg·m² for ``kg*m^2``."""
    return text.replace("*", "·").replace("^2", "²").replace("^3", "³")


def find_extent(curves: Sequence[FloatArray], tail: float = 0.0) -> tuple[float, float] | None:
    """Return the lowest and the highest value of all curves; None if all their values are NaN.

    The fraction ``tail`` of the values of each curve is ignored at the lower end, and as much at the upper end.
    """
    known = [curve[np.isfinite(curve)] for curve in curves]
    if tail:
        ends = [tuple(np.quantile(curve, (tail, 1 - tail))) for curve in known if len(curve)]
    else:
        ends = [(curve.min(), curve.max()) for curve in known if len(curve)]
    if not ends:
        return None
    return float(min(low for low, _ in ends)), float(max(high for _, high in ends))


def find_range(curves: Sequence[FloatArray], tail: float = 0.0) -> tuple[float, float] | None:
    """Return the result of :func:`find_extent` with a margin of 10 % on each side; None if all are NaN or equal."""
    found = find_extent(curves, tail)
    if found is None or not found[1] > found[0]:
        return None
    margin = 0.1 * (found[1] - found[0])
    return found[0] - margin, found[1] + margin
