"""Scales drawn with a handful of objects look and are laid out as matplotlib's own."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import AutoMinorLocator
from reporting_cases import Trial, context

from mocap_id.reporting import style
from mocap_id.reporting.figures import _DRAW
from mocap_id.reporting.panel import Panel, Sheet
from mocap_id.reporting.vector import settle
from mocap_id.stages.report.function import material


def drawn(draw: Callable[[], Figure]) -> tuple[Figure, np.ndarray]:
    """A figure, laid out, and what an eye sees of it, (rows, columns, 4)."""
    with style.house():
        figure = draw()
        figure.dpi = 144
        settle(figure)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        return figure, np.asarray(canvas.buffer_rgba()).astype(int)


def both(monkeypatch: pytest.MonkeyPatch, draw: Callable[[], Figure]) -> tuple[tuple[Figure, np.ndarray], ...]:
    """The same with these scales and with matplotlib's own."""
    here = drawn(draw)
    monkeypatch.setattr(style, "Sheet", Figure)
    own = drawn(draw)
    assert any(type(axes) is Panel for axes in here[0].axes) and not any(type(axes) is Panel for axes in own[0].axes)
    return here, own


@pytest.mark.parametrize("name", _DRAW)
def test_a_figure_is_matplotlibs_own_to_the_pixel(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = material(context(Trial(frames=900).artefacts()))
    (here, seen), (own, expected) = both(monkeypatch, lambda: _DRAW[name](trial))  # type: ignore[arg-type, return-value]
    for one, other in zip(here.axes, own.axes, strict=True):
        np.testing.assert_allclose(one.get_position().extents, other.get_position().extents, atol=1e-9)
    assert np.count_nonzero(seen != expected) == 0


def thousands(axes: Axes) -> None:
    axes.plot([0, 1], [2.0e7, 2.1e7])
    axes.set(xlabel="x", ylabel="y", title="what all numbers are times")


def hidden(axes: Axes) -> None:
    axes.plot([-1e-9, 1e-9], [0.1, 0.3])
    axes.tick_params(labelbottom=False, labelsize=5)
    axes.grid(False, axis="x")
    axes.set(ylim=(0.3, 0.1))


def names(axes: Axes) -> None:
    axes.plot([1, 2, 3], [1, 2, 3])
    axes.set_xticks([1, 2, 3], ["one", "a second of them", "three"])
    axes.set_yticks([])
    axes.set_xlim(0.8, 2.9)


def turned(axes: Axes) -> None:
    axes.plot([1, 2, 3], [1, 2, 3])
    axes.set_xticks([1, 2, 3], ["one", "two", "three"], rotation=45)


def logarithmic(axes: Axes) -> None:
    axes.loglog([1, 1e4], [1e-3, 1e3])


def finer(axes: Axes) -> None:
    axes.plot([0, 1], [0, 1])
    axes.xaxis.set_minor_locator(AutoMinorLocator())
    axes.yaxis.tick_right()


@pytest.mark.parametrize("fill", [thousands, hidden, names, turned, logarithmic, finer])
def test_whatever_is_asked_of_a_scale(fill: Callable[[Axes], None], monkeypatch: pytest.MonkeyPatch) -> None:
    def draw() -> Figure:
        figure = style.figure(2.5)
        fill(figure.subplots())
        return figure

    (here, seen), (own, expected) = both(monkeypatch, draw)
    np.testing.assert_allclose(here.axes[0].get_position().extents, own.axes[0].get_position().extents, atol=1e-9)
    assert np.count_nonzero(seen != expected) == 0


def test_no_tick_is_made_but_the_one_that_matplotlib_asks_its_looks_of() -> None:
    with style.house():
        figure = style.figure(2.5)
        axes = figure.subplots()
        axes.plot([0, 100], [0, 1])
        axes.set_yticks([0, 0.5, 1], ["none", "half", "all"])
        settle(figure)
        figure.savefig(io.BytesIO(), format="svg")
    assert len(axes.xaxis.majorTicks) == len(axes.yaxis.majorTicks) == 1
    assert len(axes.get_xticks()) > 4


def test_other_kinds_of_axes_are_left_alone() -> None:
    figure = Sheet()
    assert type(figure.add_subplot(1, 2, 1, projection="polar")) is not Panel
    assert type(figure.add_subplot(1, 2, 2)) is Panel
