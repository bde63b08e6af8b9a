"""What a figure shows, told once: panels of curves, bands, points and bars with axes and units.

A figure is plain data. The page's ``chart.js`` draws it with Plotly, :mod:`mocap_id.reporting.paper` with matplotlib; a
page holds its figures as JSON (:func:`to_json`), from which they are read again for a paper (:func:`from_json`).
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any, Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray

Dash: TypeAlias = Literal["-", "--", "-.", ":"]
Symbol: TypeAlias = Literal["dot", "ring", "x", "+", "|", "diamond", "square"]
"""A dot is filled; ring and diamond are open."""


@dataclass(frozen=True, eq=False)
class Line:
    """A curve through (K,) points; NaN lifts the pen. Widths and sizes are in points of a figure on paper."""

    x: FloatArray
    y: FloatArray
    colour: str
    label: str = ""
    dash: Dash = "-"
    width: float = 1.1
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Band:
    """An area between two curves; NaN leaves a gap."""

    x: FloatArray
    low: FloatArray
    high: FloatArray
    colour: str
    opacity: float = 0.25


@dataclass(frozen=True, eq=False)
class Points:
    """Single points, with half-widths of their intervals along x and names where they have some."""

    x: FloatArray
    y: FloatArray
    colour: str
    label: str = ""
    symbol: Symbol = "dot"
    size: float = 4.0
    half: FloatArray | None = None
    names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Heat:
    """Squares coloured by a value on the figure's scale."""

    x: FloatArray
    y: FloatArray
    value: FloatArray
    size: float = 4.5


@dataclass(frozen=True, eq=False)
class Bars:
    """Horizontal bars from ``low`` to ``high``, one a row; each has its own colour, opacity and name."""

    row: FloatArray
    low: FloatArray
    high: FloatArray
    colours: tuple[str, ...]
    opacity: FloatArray | None = None
    names: tuple[str, ...] = ()
    thick: float = 0.7


@dataclass(frozen=True, eq=False)
class Spans:
    """Stretches of x that are shaded over the whole panel."""

    start: FloatArray
    end: FloatArray
    colour: str
    opacity: float = 0.5


@dataclass(frozen=True)
class Rule:
    """A straight line across the whole panel, at this place of an axis."""

    axis: Literal["x", "y"]
    at: float
    colour: str
    dash: Dash = "-"
    width: float = 0.5


@dataclass(frozen=True)
class Text:
    """Words to the right of a place."""

    x: float
    y: float
    words: str


@dataclass(frozen=True)
class Key:
    """An entry of the legend for what has no single item of its own."""

    colour: str
    label: str


Item: TypeAlias = Line | Band | Points | Heat | Bars | Spans | Rule | Text | Key


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    Parameters
    ----------
    items : tuple of Item
        From the lowest to the topmost.
    title, x, y : str
        Above, and on the axes, with units.
    x_range, y_range : (2,) tuples or None
        What is shown; None for all.
    x_ticks : tuple of (float, str)
        Positions and labels of the ticks, where x is not a plain scale.
    rows : tuple of str
        Where y counts rows (0 on top): their names. Beside another panel of a line they are not repeated.
    equal : bool
        A metre is as long on either axis.
    linked : bool
        x is shared with the other linked panels of the figure; its numbers stand where the axis has a name.
    height : float
        Inches on paper, with everything that stands around it.
    """

    items: tuple[Item, ...]
    title: str = ""
    x: str = ""
    y: str = ""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    x_ticks: tuple[tuple[float, str], ...] = ()
    rows: tuple[str, ...] = ()
    equal: bool = False
    linked: bool = False
    height: float = 2.1


@dataclass(frozen=True)
class Scale:
    """The colours of :class:`Heat`: lowest and highest value, and what they are."""

    low: float
    high: float
    label: str


@dataclass(frozen=True)
class Figure:
    """Lines of panels, each line as wide as the page; on a narrow page they stand below each other."""

    lines: tuple[tuple[Panel, ...], ...]
    scale: Scale | None = None

    @property
    def panels(self) -> tuple[Panel, ...]:
        return tuple(panel for line in self.lines for panel in line)


@dataclass(frozen=True)
class Drawing:
    """A figure of a page: its file's stem, title and caption; ``figure`` is a sentence where there is none."""

    name: str
    title: str
    caption: str
    figure: Figure | str

    @property
    def missing(self) -> str | None:
        """Why there is nothing to see; None where there is something."""
        return self.figure if isinstance(self.figure, str) else None


@dataclass(frozen=True)
class Drawings:
    """All figures of a page, and what it is about."""

    of: str
    all: tuple[Drawing, ...]

    def __getitem__(self, name: str) -> Drawing:
        return next(one for one in self.all if one.name == name)


_KINDS = {
    kind.__name__: kind
    for kind in (Line, Band, Points, Heat, Bars, Spans, Rule, Text, Key, Panel, Scale, Figure, Drawing, Drawings)
}


def in_lines(panels: tuple[Panel, ...], most: int) -> tuple[tuple[Panel, ...], ...]:
    """Panels in lines of at most so many, and of as equal a number as possible."""
    count = -(-len(panels) // most)
    size = -(-len(panels) // max(count, 1))
    return tuple(panels[k : k + size] for k in range(0, len(panels), max(size, 1)))


def to_json(value: Any) -> Any:
    """A figure, or a part of one, as JSON values; arrays as base64 of 32-bit numbers, defaults left out."""
    if isinstance(value, np.ndarray):
        return {"f4": base64.b64encode(value.astype("<f4").tobytes()).decode("ascii")}
    if isinstance(value, tuple):
        return [to_json(one) for one in value]
    if type(value).__name__ not in _KINDS:
        return value
    told = {field.name: (getattr(value, field.name), field.default) for field in fields(value)}
    return {"is": type(value).__name__} | {
        name: to_json(own) for name, (own, default) in told.items() if default is MISSING or own is not default
    }


def from_json(told: Any) -> Any:
    """The figure that :func:`to_json` told.

    Raises
    ------
    ValueError, TypeError, KeyError
        It is no figure.
    """
    if isinstance(told, list):
        return tuple(from_json(one) for one in told)
    if not isinstance(told, Mapping):
        return told
    if "f4" in told:
        return np.frombuffer(base64.b64decode(told["f4"], validate=True), "<f4").astype(np.float64)
    return _KINDS[told["is"]](**{name: from_json(own) for name, own in told.items() if name != "is"})
