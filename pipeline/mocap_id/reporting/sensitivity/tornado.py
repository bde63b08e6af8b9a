"""The tornado diagram: how much each level of each kind of error changes each parameter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.figure import Bars, Drawing, Figure, Key, Panel, Rule, Spans, arrange_in_lines
from mocap_id.reporting.sensitivity.page_data import ParameterEntry, SensitivityData

CAPTION = (
    "A panel for each parameter, a row for each kind of error, with the largest change at the top. A row has a bar for "
    "each level, over all joints or components; the worst level is the palest and widest bar. The grey band is the "
    "tolerated change. The scale is linear up to 1 % and logarithmic beyond. Bars end at 300 %, also for "
    "parameters that could no longer be identified."
)
_LIMIT = 300.0  # %; bars end here
_LINEAR = 0.6  # width of the linear part, up to 1 %, in decades
_TICKS = (-100.0, -10.0, -1.0, 0.0, 1.0, 10.0, 100.0)
_COLUMNS = 3
_ROW, _HEAD = 0.15, 0.7  # inches
_WITHIN, _NOTICED, _SILENT = style.FAINT, style.BLUE, style.VERMILLION
_LEGEND = (
    Key(_WITHIN, "tolerated"),
    Key(_NOTICED, "not tolerated, with a new caution"),
    Key(_SILENT, "not tolerated, without a new caution"),
)


def make_drawing(data: SensitivityData) -> Drawing:
    """Return the tornado diagram with its title and caption."""
    return Drawing("tornado", "How much each kind of error changes each parameter", CAPTION, draw(data))


def draw(data: SensitivityData) -> Figure | str:
    """Return a panel for each parameter, or a sentence that says why there is no figure."""
    kinds = _order_kinds(data)
    if not data.parameters or not kinds:
        return "No parameter is known that could change."
    panels = tuple(_draw_panel(data, parameter, kinds) for parameter in data.parameters)
    return Figure(arrange_in_lines(panels, _COLUMNS))


def place(percent: float) -> float:
    """Return the position of a change, in per cent, on the axis: linear up to 1 %, logarithmic beyond."""
    size = abs(percent)
    return float(np.sign(percent) * (_LINEAR * size if size <= 1 else _LINEAR + np.log10(size)))


def _order_kinds(data: SensitivityData) -> list[str]:
    """Return the kinds of error, sorted by their largest change of any parameter, largest first."""
    counted = {parameter.name for parameter in data.parameters}
    responses = data.tables["responses"]
    worst = responses[responses["parameter"].isin(counted)].groupby("kind", sort=False)["ratio"].max()
    return [str(kind) for kind in worst.dropna().sort_values(ascending=False, kind="stable").index]


def _draw_panel(data: SensitivityData, parameter: ParameterEntry, kinds: Sequence[str]) -> Panel:
    responses, perturbations = data.tables["responses"], data.tables["perturbations"]
    own = responses[responses["parameter"] == parameter.name]
    raised = perturbations.set_index("perturbation")["raised"] != ""
    own = own.assign(noticed=own["perturbation"].map(raised).to_numpy() | own["value"].isna().to_numpy())
    tolerated = place(100 * parameter.tolerated(data.tolerance))
    found = [(row, *bar) for row, kind in enumerate(kinds) for bar in _make_bars(own[own["kind"] == kind])]
    numbers = [[row, place(low), place(high), shade] for row, low, high, shade, _ in found]
    rows, lows, highs, shades = np.array(numbers, dtype=np.float64).reshape(-1, 4).T
    names = tuple(style.clean(data.titles[kind], 30) for kind in kinds)
    items = (
        *_LEGEND,
        Spans(np.array([-tolerated]), np.array([tolerated]), style.GRID),
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
        style.clean(parameter.name, 34),
        "change, % of its size",
        x_range=(place(-_LIMIT), place(_LIMIT)),
        x_ticks=ticks,
        rows=names,
        height=_HEAD + _ROW * len(kinds),
    )


def _make_bars(changes: pd.DataFrame) -> list[tuple[float, float, float, str]]:
    """Return the bars of one kind of error for one parameter, widest first.

    There is a bar for each absolute level. It has the lowest and the highest change in %, the opacity and the colour.
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
