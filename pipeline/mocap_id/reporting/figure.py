"""Figures as data: panels of curves, bands, points and bars, independent of the drawing library.

The page's ``chart.js`` draws a figure with Plotly; :mod:`mocap_id.reporting.paper_figures` draws it with matplotlib. A
page contains its figures as JSON (:func:`to_json`); paper figures are made from this JSON (:func:`from_json`). Curves,
bands and shaded intervals have fewer points than the samples, without losing peaks.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs

Dash: TypeAlias = Literal["-", "--", "-.", ":"]
Symbol: TypeAlias = Literal["dot", "ring", "x", "+", "|", "diamond", "square"]
"""Marker symbols; ring and diamond are open."""


@dataclass(frozen=True, eq=False)
class Line:
    """A curve through K points, interrupted where a coordinate is NaN.

    ``z`` is the third coordinate in a panel with a ``view``. Widths and sizes of all items are in points (1/72 inch).
    """

    x: FloatArray
    y: FloatArray
    colour: str
    label: str = ""
    dash: Dash = "-"
    width: float = 1.1
    opacity: float = 1.0
    z: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Band:
    """The area between the curves ``low`` and ``high``, interrupted where they are NaN."""

    x: FloatArray
    low: FloatArray
    high: FloatArray
    colour: str
    opacity: float = 0.25


@dataclass(frozen=True, eq=False)
class Points:
    """Single points, with optional names and intervals along x (± ``half``); ``z`` as in :class:`Line`."""

    x: FloatArray
    y: FloatArray
    colour: str
    label: str = ""
    symbol: Symbol = "dot"
    size: float = 4.0
    half: FloatArray | None = None
    names: tuple[str, ...] = ()
    z: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Heat:
    """Squares whose colours show ``value`` on the colour scale of the figure."""

    x: FloatArray
    y: FloatArray
    value: FloatArray
    size: float = 4.5


@dataclass(frozen=True, eq=False)
class Bars:
    """Horizontal bars from ``low`` to ``high``, each with its own row, colour, opacity and name."""

    row: FloatArray
    low: FloatArray
    high: FloatArray
    colours: tuple[str, ...]
    opacity: FloatArray | None = None
    names: tuple[str, ...] = ()
    thick: float = 0.7


@dataclass(frozen=True, eq=False)
class Spans:
    """Intervals of x, shaded over the full height of the panel."""

    start: FloatArray
    end: FloatArray
    colour: str
    opacity: float = 0.5


@dataclass(frozen=True)
class Rule:
    """A straight line across the whole panel, perpendicular to ``axis`` at the position ``at``."""

    axis: Literal["x", "y"]
    at: float
    colour: str
    dash: Dash = "-"
    width: float = 0.5


@dataclass(frozen=True)
class Text:
    """Text to the right of a point."""

    x: float
    y: float
    words: str


@dataclass(frozen=True)
class Key:
    """A legend entry for a colour that no other item explains."""

    colour: str
    label: str


Item: TypeAlias = Line | Band | Points | Heat | Bars | Spans | Rule | Text | Key


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    Linked panels share x with all other linked panels of the figure; only a linked panel with an x label shows numbers.
    A panel with a ``view`` contains only lines and points with three coordinates, y up. On a page the reader can rotate
    the view, starting from this one; a figure for a paper has this view.
    """

    items: tuple[Item, ...]  # from back to front
    title: str = ""
    x: str = ""  # label of the axis, with unit
    y: str = ""
    x_range: tuple[float, float] | None = None  # None to show all items
    y_range: tuple[float, float] | None = None
    x_ticks: tuple[tuple[float, str], ...] = ()  # positions and labels, if x is not a numeric scale
    rows: tuple[str, ...] = ()  # row names if y is a row number (0 at the top); shown by the first panel of a line
    equal: bool = False  # whether both axes have the same scale
    linked: bool = False  # whether x is shared with the other linked panels
    height: float = 2.1  # height on paper including labels, inches
    view: tuple[float, float] | None = None  # turn and tilt of :func:`project`, degrees

    def flat(self) -> Panel:
        """Return the panel with its lines and points projected onto its view; the same panel if it has no view."""
        if self.view is None:
            return self
        turn, tilt = np.radians(self.view).tolist()
        items = []
        for item in self.items:
            assert isinstance(item, Line | Points) and item.z is not None
            across, up = project(np.stack([item.x, item.y, item.z], axis=1), turn, tilt).T
            items.append(replace(item, x=across, y=up, z=None))
        return replace(self, items=tuple(items), view=None)


def project(points: FloatArray, turn: float, tilt: float) -> FloatArray:
    """Return the horizontal and vertical coordinates (..., 2) of points (..., 3) in a view without perspective.

    For zero angles the viewer is on the side of +z. ``turn`` rotates the viewer about y towards +x, and ``tilt`` raises
    the viewer; both are in rad.

    Examples
    --------
    >>> project(np.array([1.0, 2.0, 3.0]), 0.0, 0.0)
    array([1., 2.])
    """
    across = np.array([np.cos(turn), 0.0, -np.sin(turn)])
    up = np.array([-np.sin(turn) * np.sin(tilt), np.cos(tilt), -np.cos(turn) * np.sin(tilt)])
    return np.asarray(points @ np.stack([across, up], axis=1))


@dataclass(frozen=True)
class Scale:
    """Colour scale of :class:`Heat`: lowest value, highest value and label."""

    low: float
    high: float
    label: str


@dataclass(frozen=True)
class Figure:
    """Lines of panels; a line is as wide as the page, and a narrow page shows the panels of a line below each other."""

    lines: tuple[tuple[Panel, ...], ...]
    scale: Scale | None = None

    @property
    def panels(self) -> tuple[Panel, ...]:
        """All panels, line by line."""
        return tuple(panel for line in self.lines for panel in line)


@dataclass(frozen=True)
class Drawing:
    """A figure of a page, or a sentence that replaces it; ``name`` is the stem of its file names."""

    name: str
    title: str
    caption: str
    figure: Figure | str

    @property
    def missing(self) -> str | None:
        """Sentence that says why the figure is missing; None if there is a figure."""
        return self.figure if isinstance(self.figure, str) else None


@dataclass(frozen=True)
class Drawings:
    """All figures of a page; ``of`` is the name of the trial or study."""

    of: str
    all: tuple[Drawing, ...]

    def __getitem__(self, name: str) -> Drawing:
        return next(one for one in self.all if one.name == name)


_KINDS = {
    kind.__name__: kind
    for kind in (Line, Band, Points, Heat, Bars, Spans, Rule, Text, Key, Panel, Scale, Figure, Drawing, Drawings)
}


def arrange_in_lines(panels: tuple[Panel, ...], most: int) -> tuple[tuple[Panel, ...], ...]:
    """Arrange panels in lines of at most ``most`` panels and of nearly equal length."""
    count = -(-len(panels) // most)
    size = -(-len(panels) // max(count, 1))
    return tuple(panels[k : k + size] for k in range(0, len(panels), max(size, 1)))


def to_json(value: Any) -> Any:
    """Return a figure, or a part of it, as JSON values: arrays as base64 of 32-bit floats, without default values."""
    if isinstance(value, np.ndarray):
        return {"f4": base64.b64encode(value.astype("<f4").tobytes()).decode("ascii")}
    if isinstance(value, tuple):
        return [to_json(one) for one in value]
    if type(value).__name__ not in _KINDS:
        return value
    members = {field.name: (getattr(value, field.name), field.default) for field in fields(value)}
    return {"is": type(value).__name__} | {
        name: to_json(own) for name, (own, default) in members.items() if default is MISSING or own is not default
    }


def from_json(value: Any) -> Any:
    """Return the figure, or the part of a figure, from which :func:`to_json` made ``value``.

    Raises
    ------
    ValueError, TypeError, KeyError
        The values do not describe a figure.
    """
    if isinstance(value, list):
        return tuple(from_json(one) for one in value)
    if not isinstance(value, Mapping):
        return value
    if "f4" in value:
        return np.frombuffer(base64.b64decode(value["f4"], validate=True), "<f4").astype(np.float64)
    return _KINDS[value["is"]](**{name: from_json(own) for name, own in value.items() if name != "is"})


BINS = 450
"""Number of bins across a figure; a finer resolution is not visible on paper."""


def thin_curve(time: FloatArray, values: FloatArray, bins: int = BINS) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest sample of a curve in each bin, in order of time; K ≤ 3 bins samples.

    NaN in ``values`` (T,) interrupts the curve; of a bin with NaN values, one NaN is also returned. A curve with at
    most ``3 * bins`` samples is returned unchanged.
    """
    if len(time) <= 3 * bins:
        return time, values
    block = _reshape(np.arange(len(time), dtype=np.float64), bins).astype(np.int64)
    value = values[block]  # (bins, size)
    missing = np.isnan(value)
    rows = np.arange(len(block))
    low = block[rows, np.where(missing, np.inf, value).argmin(axis=1)]
    high = block[rows, np.where(missing, -np.inf, value).argmax(axis=1)]
    broken = block[rows, missing.argmax(axis=1)]  # the first sample if none is missing, which is harmless
    picked = np.unique(np.concatenate([low, high, broken]))
    return time[picked], values[picked]


def thin_band(
    time: FloatArray, low: FloatArray, high: FloatArray, bins: int = BINS
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a band with the minimum of its lower edge and the maximum of its upper edge in each bin; K ≤ bins samples.

    The result has the mean time of each bin and the two edges, NaN if a whole bin is unknown. A band with at most
    ``bins`` samples is returned unchanged. ``time``, ``low`` and ``high`` are (T,) arrays, NaN where unknown.
    """
    if len(time) <= bins:
        return time, low, high
    lowest = np.where(np.isnan(low), np.inf, low)
    highest = np.where(np.isnan(high), -np.inf, high)
    under, over = _reshape(lowest, bins).min(axis=1), _reshape(highest, bins).max(axis=1)
    known = np.isfinite(under) & np.isfinite(over)
    return _reshape(time, bins).mean(axis=1), np.where(known, under, np.nan), np.where(known, over, np.nan)


def find_shaded_spans(time: FloatArray, mask: BoolArray, bins: int = BINS) -> list[tuple[float, float]]:
    """Return start and width, s, of each interval where ``mask`` (T,) is true; gaps shorter than a bin are closed."""
    runs = find_runs(mask)
    if not runs:
        return []
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    start = time[[run.start for run in runs]]
    end = time[[run.stop - 1 for run in runs]] + step
    apart = start[1:] - end[:-1] > (time[-1] - time[0]) / bins
    first = np.concatenate([[True], apart])
    last = np.concatenate([apart, [True]])
    return [(float(a), float(b - a)) for a, b in zip(start[first], end[last], strict=True)]


def _reshape(values: FloatArray, bins: int) -> FloatArray:
    """Reshape values (T,) to (K, size) with K ≤ ``bins``; the last value is repeated to fill the last row."""
    size = -(-len(values) // bins)
    rows = -(-len(values) // size)
    return np.pad(values, (0, rows * size - len(values)), mode="edge").reshape(rows, size)
