"""A drawing under the house's style, as SVG."""

from __future__ import annotations

from collections.abc import Callable

from matplotlib.figure import Figure

from mocap_id.reporting import style


def drawn(name: str, title: str, draw: Callable[[], Figure]) -> bytes:
    """The SVG of what ``draw`` draws; ``name`` makes its ids, ``title`` is for screen readers."""
    with style.house():
        return style.svg(draw(), name, style.printable(title))
