"""Residual of each marker as bars."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mocap_id.reporting import style
from mocap_id.reporting.material import Material

_ROW = 0.155  # inches per marker
_MOST = 80  # markers in the figure; the page's table holds them all


def draw(material: Material) -> Figure | str:
    """Bars by segment, the worst first within each."""
    found = material.residuals[material.residuals["rms"].notna()]
    if found.empty:
        return f"No residuals: {material.why_missing('markers.parquet')}."
    shown = found.nlargest(_MOST, "rms").sort_values(["segment", "rms"], ascending=[True, False])
    figure = style.figure(0.9 + _ROW * len(shown))
    axes = figure.subplots()
    rows = np.arange(len(shown))
    colours = [style.colour(int(k)) if k >= 0 else style.FAINT for k in shown["segment"]]
    axes.barh(rows, 1e3 * shown["rms"], height=0.7, color=colours, alpha=0.85)
    axes.plot(1e3 * shown["q95"], rows, "|", color=style.INK, ms=6, mew=1.2, label="95 % quantile")
    axes.set_yticks(rows, [style.printable(label, 24) for label in shown.index])
    axes.tick_params(axis="y", labelsize=6.5)
    axes.set(ylim=(len(shown) - 0.4, -0.6), xlim=(0, None), xlabel="residual (mm)")
    axes.grid(False, axis="y")
    if len(shown) < len(found):
        axes.set_title(f"the {len(shown)} largest of {len(found)} markers")
    _name_segments(figure, material.segment_names, shown["segment"])
    return figure


def _name_segments(figure: Figure, names: tuple[str, ...], segments: pd.Series[int]) -> None:
    """A legend of the segments' colours."""
    for k in sorted(set(segments)):
        name = style.printable(names[k], 20) if 0 <= k < len(names) else "no segment"
        figure.axes[0].plot([], [], "s", color=style.colour(max(k, 0)), label=name)
    style.legend_above(figure, figure.axes)
