"""The tornado: for each parameter, how far each kind of error moves it, level by level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.figure import Bars, Drawing, Figure, Key, Panel, Rule, Spans, in_lines
from mocap_id.reporting.sensitivity.material import ParameterEntry, SensitivityMaterial

CAPTION = (
    "A panel for each parameter, a row for each kind of error, the worst at the top. The bars of one row are the "
    "levels that were tried, the worst the palest and widest, over all joints or components; the grey band is what is "
    "tolerated. Linear up to 1 %, logarithmic beyond; bars end at 300 %, and so does what could not be identified any "
    "more."
)
_LIMIT = 300.0  # %: bars end here
_LINEAR = 0.6  # decades that the linear part, up to 1 %, takes
_TICKS = (-100.0, -10.0, -1.0, 0.0, 1.0, 10.0, 100.0)
_COLUMNS = 3
_ROW, _HEAD = 0.15, 0.7  # inches
_WITHIN, _NOTICED, _SILENT = style.FAINT, style.BLUE, style.VERMILLION
_LEGEND = (
    Key(_WITHIN, "tolerated"),
    Key(_NOTICED, "too much, and the verdict says so"),
    Key(_SILENT, "too much, and nothing says so"),
)


def drawing(material: SensitivityMaterial) -> Drawing:
    """The figure with its title and caption."""
    return Drawing("tornado", "How far each kind of error moves each parameter", CAPTION, shown(material))


def shown(material: SensitivityMaterial) -> Figure | str:
    """A panel a parameter, a row a kind, the worst at the top; nested bars for the levels, the worst palest."""
    kinds = _order(material)
    if not material.parameters or not kinds:
        return "No parameter is known that could move."
    panels = tuple(_panel(material, parameter, kinds) for parameter in material.parameters)
    return Figure(in_lines(panels, _COLUMNS))


def place(percent: float) -> float:
    """Where a change stands on the axis: linear up to 1 %, logarithmic beyond."""
    size = abs(percent)
    return float(np.sign(percent) * (_LINEAR * size if size <= 1 else _LINEAR + np.log10(size)))


def _order(material: SensitivityMaterial) -> list[str]:
    """Kinds, the one that moves any parameter most first."""
    counted = {parameter.name for parameter in material.parameters}
    responses = material.tables["responses"]
    worst = responses[responses["parameter"].isin(counted)].groupby("kind", sort=False)["ratio"].max()
    return [str(kind) for kind in worst.dropna().sort_values(ascending=False, kind="stable").index]


def _panel(material: SensitivityMaterial, parameter: ParameterEntry, kinds: Sequence[str]) -> Panel:
    responses, perturbations = material.tables["responses"], material.tables["perturbations"]
    own = responses[responses["parameter"] == parameter.name]
    raised = perturbations.set_index("perturbation")["raised"] != ""
    own = own.assign(noticed=own["perturbation"].map(raised).to_numpy() | own["value"].isna().to_numpy())
    allowed = place(100 * parameter.allowed(material.share))
    found = [(row, *bar) for row, kind in enumerate(kinds) for bar in _bars(own[own["kind"] == kind])]
    numbers = [[row, place(low), place(high), shade] for row, low, high, shade, _ in found]
    rows, lows, highs, shades = np.array(numbers, dtype=np.float64).reshape(-1, 4).T
    names = tuple(style.printable(material.titles[kind], 30) for kind in kinds)
    items = (
        *_LEGEND,
        Spans(np.array([-allowed]), np.array([allowed]), style.GRID),
        Bars(
            rows,
            lows,
            highs,
            tuple(colour for *_, colour in found),
            shades,
            tuple(f"{names[row]}: {low:.2g} … {high:.2g} %" for row, low, high, *_ in found),
        ),
        Rule("x", 0.0, style.INK),
    )
    ticks = tuple((place(value), f"{value:g}".replace("-", "−")) for value in _TICKS)
    return Panel(
        items,
        style.printable(parameter.name, 34),
        "change, % of its size",
        x_range=(place(-_LIMIT), place(_LIMIT)),
        x_ticks=ticks,
        rows=names,
        height=_HEAD + _ROW * len(kinds),
    )


def _bars(changes: pd.DataFrame) -> list[tuple[float, float, float, str]]:
    """One kind's bars of one parameter: of each size of the level the stretch from its least to its largest change.

    Lowest and highest change in %, opacity and colour, the widest first.
    """
    spans = []
    for _, group in changes.groupby(changes["level"].abs()):
        percent = group["change_percent"].fillna(_LIMIT).clip(-_LIMIT, _LIMIT)
        beyond = group[group["ratio"] > 1]
        colour = _WITHIN if beyond.empty else _NOTICED if beyond["noticed"].all() else _SILENT
        spans.append((min(0.0, float(percent.min())), max(0.0, float(percent.max())), colour))
    spans.sort(key=lambda span: span[0] - span[1])
    shades = np.linspace(0.35, 1.0, len(spans)) if len(spans) > 1 else [0.35]
    return [(low, high, float(shade), colour) for (low, high, colour), shade in zip(spans, shades, strict=True)]
