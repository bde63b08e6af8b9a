"""The tornado: for each parameter, how far each kind of error moves it, level by level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, NullLocator

from mocap_id.reporting import style
from mocap_id.reporting.sensitivity.material import ParameterEntry, SensitivityMaterial
from mocap_id.reporting.vector import svg_and_pdf

TITLE = "How far each kind of error moves each parameter"
_LIMIT = 300.0  # %: bars end here
_LINEAR = 1.0  # %: linear up to here, logarithmic beyond
_TICKS = (-100.0, -10.0, -1.0, 0.0, 1.0, 10.0, 100.0)
_COLUMNS = 3
_ROW, _HEAD = 0.15, 0.55  # inches
_WITHIN, _NOTICED, _SILENT = style.FAINT, style.BLUE, style.VERMILLION
_LEGEND = (
    (_WITHIN, "tolerated"),
    (_NOTICED, "too much, and the verdict says so"),
    (_SILENT, "too much, and nothing says so"),
)


def render(material: SensitivityMaterial) -> tuple[bytes, bytes]:
    """The figure as SVG and as PDF, the same bytes for the same study."""
    with style.house():
        return svg_and_pdf(draw(material), "tornado", f"{TITLE}: {style.printable(material.trial)}")


def draw(material: SensitivityMaterial) -> Figure:
    """A panel a parameter, a row a kind, the worst at the top; nested bars for the levels, the worst palest."""
    kinds = _order(material)
    if not material.parameters or not kinds:
        return style.notice("No parameter is known that could move.")
    columns = min(_COLUMNS, len(material.parameters))
    rows = -(-len(material.parameters) // columns)
    figure = style.figure(0.5 + rows * (_HEAD + _ROW * len(kinds)))
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes in panels.ravel()[len(material.parameters) :]:
        axes.set_axis_off()
    for axes, parameter in zip(panels.ravel(), material.parameters, strict=False):
        _panel(axes, material, parameter, kinds)
    for axes in panels[:, 0]:
        axes.set_yticks(np.arange(len(kinds)), [style.printable(material.titles[kind], 30) for kind in kinds])
    for column in range(columns):
        lowest = panels[(len(material.parameters) - 1 - column) // columns, column]
        lowest.set_xlabel("change, % of its size")
        lowest.tick_params(axis="x", labelbottom=True)
    patches = [Patch(color=colour, label=label) for colour, label in _LEGEND]
    figure.legend(handles=patches, loc="outside upper left", ncols=len(patches))
    return figure


def _order(material: SensitivityMaterial) -> list[str]:
    """Kinds, the one that moves any parameter most first."""
    counted = {parameter.name for parameter in material.parameters}
    responses = material.tables["responses"]
    worst = responses[responses["parameter"].isin(counted)].groupby("kind", sort=False)["ratio"].max()
    return [str(kind) for kind in worst.dropna().sort_values(ascending=False, kind="stable").index]


def _panel(axes: Axes, material: SensitivityMaterial, parameter: ParameterEntry, kinds: Sequence[str]) -> None:
    responses, perturbations = material.tables["responses"], material.tables["perturbations"]
    own = responses[responses["parameter"] == parameter.name]
    raised = perturbations.set_index("perturbation")["raised"] != ""
    own = own.assign(noticed=own["perturbation"].map(raised).to_numpy() | own["value"].isna().to_numpy())
    allowed = 100 * parameter.allowed(material.share)
    axes.axvspan(-allowed, allowed, color=style.GRID, alpha=0.5, lw=0)
    for row, kind in enumerate(kinds):
        _bars(axes, row, own[own["kind"] == kind])
    axes.axvline(0.0, color=style.INK, lw=0.5)
    axes.set_xscale("symlog", linthresh=_LINEAR, linscale=0.6)
    axes.set_xlim(-_LIMIT, _LIMIT)
    axes.set_xticks(_TICKS)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−")))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_ylim(len(kinds) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set_title(f"{style.printable(parameter.name, 34)}", fontsize=7.5)


def _bars(axes: Axes, row: int, changes: pd.DataFrame) -> None:
    """One kind's bars of one parameter: of each size of the level the stretch from its least to its largest change."""
    sizes = changes["level"].abs()
    spans = []
    for _, group in changes.groupby(sizes):
        percent = group["change_percent"].fillna(_LIMIT).clip(-_LIMIT, _LIMIT)
        low, high = min(0.0, percent.min()), max(0.0, percent.max())
        beyond = group[group["ratio"] > 1]
        colour = _WITHIN if beyond.empty else _NOTICED if beyond["noticed"].all() else _SILENT
        spans.append((high - low, low, colour))
    for rank, (width, low, colour) in enumerate(sorted(spans, reverse=True)):
        shade = 0.35 + 0.65 * rank / max(len(spans) - 1, 1)
        axes.barh(row, width, left=low, height=0.72, color=colour, alpha=shade, lw=0)
