"""Axes whose scales are drawn with a handful of objects, where matplotlib makes five for every tick.

A report's figures have hundreds of ticks, each of which matplotlib measures and draws as two marks, a line of the grid
and two texts: more than half of all that it does. A scale here draws its grid as one line, its marks as another and
its numbers with one text that moves, at the places and in the looks that matplotlib would give them. Where something is
asked of a scale that this does not know (logarithms, minor ticks, numbers at an angle or on the other side), it is
matplotlib's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import TICKDOWN, TICKLEFT
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator
from matplotlib.transforms import Bbox

from mocap_id.arrays import FloatArray

_KNOWN = {"left", "right", "bottom", "top", "labelleft", "labelright", "labelbottom", "labeltop", "gridOn", "labelsize"}
_CLOSE = 1e-10  # of the view, by which a tick may lie outside of it


class _Scale(Axis):
    """What the scales of x and of y share."""

    _along: int  # which of a point's coordinates runs along the scale
    _side: str  # at which the numbers stand
    _mark: Any
    _free = True  # the label goes where the numbers leave room
    _own = True  # drawn as here
    _text: Text | None = None
    _asked: float | str | None = None

    def set_ticks(self, ticks: Any, labels: Any = None, *, minor: bool = False, **kwargs: Any) -> Any:
        """As matplotlib's; names without looks of their own do not make it build the ticks."""
        shared = self.axes.get_shared_x_axes() if self._along == 0 else self.axes.get_shared_y_axes()
        if labels is None or minor or kwargs or len(shared.get_siblings(self.axes)) > 1 or not len(ticks):
            self._own = self._own and not kwargs and not minor
            return super().set_ticks(ticks, labels, minor=minor, **kwargs)
        self.set_major_locator(FixedLocator(ticks))
        self.set_major_formatter(FixedFormatter(list(labels)))
        self.set_view_interval(min(ticks), max(ticks))
        return []

    def set_label_coords(self, x: float, y: float, transform: Any = None) -> None:
        self._free = False
        super().set_label_coords(x, y, transform)

    def get_tightbbox(self, renderer: Any = None, *, for_layout_only: bool = False) -> Bbox | None:
        if not self._lean():
            found: Bbox | None = super().get_tightbbox(renderer, for_layout_only=for_layout_only)
            return found
        if not self.get_visible() or (for_layout_only and not self.get_in_layout()):
            return None
        renderer = renderer or self._whole._get_renderer()
        locations, texts = self._marks()
        numbers = self._boxes(renderer, locations, texts)
        self._place(numbers, len(locations))
        held = [*(Bbox(box.reshape(2, 2)) for box in numbers), self._outside(len(locations))]
        if self.offsetText.get_visible() and self.offsetText.get_text():
            held.append(self.offsetText.get_window_extent(renderer))
        if self.label.get_visible() and self.label.get_text():
            label = self.label.get_window_extent(renderer)
            held.append(_collapsed(label, self._along) if for_layout_only else label)
        return Bbox.union(held)

    def draw(self, renderer: Any) -> None:
        if not self._lean():
            super().draw(renderer)
            return
        if not self.get_visible():
            return
        renderer.open_group("matplotlib.axis", gid=self.get_gid())
        locations, texts = self._marks()
        for line in self._lines(locations):
            line.draw(renderer)
        number = self._number()
        for location, text in zip(locations, texts, strict=False):  # none where the scale shows no numbers
            number.set_text(text)
            number.set_position((0, location) if self._along else (location, 0))
            number.draw(renderer)
        self._place(self._boxes(renderer, locations, texts), len(locations))
        self.label.draw(renderer)
        self.offsetText.draw(renderer)
        renderer.close_group("matplotlib.axis")
        self.stale = False

    @property
    def _whole(self) -> Any:
        return self.axes.get_figure(root=True)

    def _setting(self, name: str) -> Any:
        """What the house has set for the ticks of such a scale."""
        settings: Any = mpl.rcParams
        return settings[f"{'ytick' if self._along else 'xtick'}.{name}"]

    def _lean(self) -> bool:
        """Whether everything that is asked of the scale is known here."""
        asked = self.get_tick_params()
        other = "right" if self._along else "top"
        return (
            self._own
            and asked.keys() <= _KNOWN
            and not asked.get(other, False)
            and not asked.get(f"label{other}", False)
            and asked.get(self._side, True)
            and self.get_scale() == "linear"
            and isinstance(self.get_minor_locator(), NullLocator)
        )

    def _marks(self) -> tuple[FloatArray, Sequence[str]]:
        """Where the ticks within view are, (K,), and their K numbers, or none where the scale shows none."""
        locations = np.asarray(self.get_majorticklocs(), dtype=np.float64)
        texts = self.get_major_formatter().format_ticks(locations.tolist())
        self.offsetText.set_text(self.get_major_formatter().get_offset())
        low, high = sorted(self.get_view_interval())
        slack = _CLOSE * (high - low)
        within = (locations >= low - slack) & (locations <= high + slack)
        shown = self.get_tick_params().get(f"label{self._side}", True)
        return locations[within], [text for text, seen in zip(texts, within, strict=False) if seen] if shown else []

    def _lines(self, locations: FloatArray) -> list[Line2D]:
        """The grid, if there is one, and the marks."""
        across, along = np.tile([0.0, 1.0, np.nan], len(locations)), np.repeat(locations, 3)
        through = self.axes.get_yaxis_transform("grid") if self._along else self.axes.get_xaxis_transform("grid")
        grid = Line2D(
            *((across, along) if self._along else (along, across)),
            color=mpl.rcParams["grid.color"],
            linestyle=mpl.rcParams["grid.linestyle"],
            linewidth=mpl.rcParams["grid.linewidth"],
            transform=through,
            clip_box=self.axes.bbox,
        )
        zero = np.zeros(len(locations))
        marks = Line2D(
            *((zero, locations) if self._along else (locations, zero)),
            color=self._setting("color"),
            linestyle="none",
            marker=self._mark,
            markersize=self._setting("major.size"),
            markeredgewidth=self._setting("major.width"),
            transform=through,
        )
        drawn = [grid, marks] if self.get_tick_params().get("gridOn", False) else [marks]
        for line in drawn:
            line.set_figure(self._whole)
        return drawn

    def _outside(self, marks: int) -> Bbox:
        """The scale's line, with its marks."""
        box = self.axes.bbox.frozen()
        size = self._setting("major.size") * self._whole.dpi / 72 if marks else 0.0
        if self._along:
            return Bbox.from_extents(box.x0 - size, box.y0, box.x0, box.y1)
        return Bbox.from_extents(box.x0, box.y0 - size, box.x1, box.y0)

    def _number(self) -> Text:
        """The text that takes the place of each number in turn; made anew only for another size."""
        size = self.get_tick_params().get("labelsize", self._setting("labelsize"))
        if self._text is None or self._asked != size:
            away = self._setting("major.size") + self._setting("major.pad")
            find = self.axes.get_yaxis_text1_transform if self._along else self.axes.get_xaxis_text1_transform
            through, vertical, horizontal = find(away)
            colour = self._setting("color")
            self._text = Text(fontsize=size, color=colour, va=vertical, ha=horizontal, transform=through)
            self._text.set_figure(self._whole)
            self._asked = size
        return self._text

    def _boxes(self, renderer: Any, locations: FloatArray, texts: Sequence[str]) -> FloatArray:
        """Left, bottom, right and top of every number, (K, 4) pixels."""
        number = self._number()
        through = number.get_transform()
        if not texts:
            return np.zeros((0, 4))
        points = np.zeros((len(locations), 2))
        points[:, self._along] = locations
        anchors = through.transform(points)
        sizes = [self._size(renderer, number, text) for text in texts]
        found: FloatArray = np.tile(anchors, 2) + np.array(sizes)
        return found

    def _size(self, renderer: Any, number: Text, text: str) -> FloatArray:
        """A number's box about the point that it stands at, (4,) pixels; what was measured once is known."""
        key = (text, number.get_fontsize(), self._whole.dpi)
        known: dict[Any, FloatArray] = self.__dict__.setdefault("_sizes", {})
        if key not in known:
            number.set_text(text)
            number.set_position((0, 0))
            at = number.get_transform().transform((0, 0))
            known[key] = number.get_window_extent(renderer).extents - np.tile(at, 2)
        return known[key]

    def _place(self, numbers: FloatArray, marks: int) -> None:
        """The label beside the numbers, and what they are to be multiplied by, if anything, at the scale's end."""
        point = self._whole.dpi / 72
        outmost = min([self._outside(marks).extents[1 - self._along], *numbers[:, 1 - self._along]])
        x, y = self.label.get_position()
        if self._free:
            edge = outmost - self.labelpad * point
            self.label.set_position((edge, y) if self._along else (x, edge))
        x, y = self.offsetText.get_position()
        pad = self.OFFSETTEXTPAD * point
        self.offsetText.set_position((x, self.axes.bbox.y1 + pad) if self._along else (x, outmost - pad))


class _Across(_Scale, XAxis):
    _along, _side, _mark = 0, "bottom", TICKDOWN


class _Up(_Scale, YAxis):
    _along, _side, _mark = 1, "left", TICKLEFT


class Panel(Axes):
    """Axes with scales as here."""

    def _init_axis(self) -> None:  # what matplotlib has a new kind of axes define
        self.xaxis = _Across(self, clear=False)
        self.yaxis = _Up(self, clear=False)  # the spines need not know them: they would only ask for their ticks


class Sheet(Figure):
    """A figure whose axes are panels, unless another kind is asked for."""

    def add_subplot(self, *args: Any, **kwargs: Any) -> Any:
        if not {"projection", "polar", "axes_class"} & kwargs.keys() and not any(isinstance(a, Axes) for a in args):
            kwargs["axes_class"] = Panel
        return super().add_subplot(*args, **kwargs)


def _collapsed(box: Bbox, along: int) -> Bbox:
    """A box with hardly any extent along this direction: a label may be longer than what it stands at."""
    points = box.get_points().copy()
    points[:, along] = points[:, along].mean() + np.array([-0.5, 0.5])
    return Bbox(points)
