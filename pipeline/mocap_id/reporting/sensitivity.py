"""``sensitivity.html``: the page of a sensitivity study, with its tornado diagram."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap_id.reporting import style
from mocap_id.reporting.figure import Bars, Drawing, Drawings, Figure, Key, Panel, Rule, Spans, arrange_in_lines
from mocap_id.reporting.grids import GridColumn, show, show_fixed, show_with_sd, texts, to_grid
from mocap_id.reporting.page import KeyNumber, Page, Section
from mocap_id.verdict import Level

if TYPE_CHECKING:
    from mocap_id.reporting.results import ResultTable


@dataclass(frozen=True)
class Parameter:
    """A base parameter, or the length of a segment; NaN where unknown."""

    name: str
    unit: str
    value: float
    sd: float  # standard deviation
    size: float  # value by which changes are divided; the verdict on the standard deviation uses the same value
    verdict: str = ""  # ``known``, ``weak`` or ``not identifiable``; empty for a length

    def tolerated(self, share: float) -> float:
        """Return the tolerated change as a fraction of the size: ``share``, or sd / size if this is larger."""
        return max(share, self.sd / self.size if self.sd > 0 and self.size > 0 else 0.0)


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


def _place(percent: float) -> float:
    """Return the position of a change, in per cent, on the axis: linear up to 1 %, logarithmic beyond."""
    size = abs(percent)
    return float(np.sign(percent) * (_LINEAR * size if size <= 1 else _LINEAR + np.log10(size)))


def _draw_tornado(
    parameters: Sequence[Parameter], titles: Mapping[str, str], tolerance: float, tables: Mapping[str, ResultTable]
) -> Figure | str:
    """Return a panel for each parameter, or a sentence that says why there is no figure."""
    responses, perturbations = tables["responses"].frame, tables["perturbations"].frame
    counted = responses["parameter"].isin({parameter.name for parameter in parameters})
    worst = responses[counted].groupby("kind", sort=False)["ratio"].max()
    kinds = [str(kind) for kind in worst.dropna().sort_values(ascending=False, kind="stable").index]  # largest first
    if not parameters or not kinds:
        return "No parameter is known that could change."
    raised = perturbations.set_index("perturbation")["raised"] != ""
    titles_shown, panels = tuple(style.clean(titles[kind], 30) for kind in kinds), []
    for parameter in parameters:
        own = responses[responses["parameter"] == parameter.name]
        own = own.assign(noticed=own["perturbation"].map(raised).to_numpy() | own["value"].isna().to_numpy())
        bars, colours, names = [], [], []
        for row, kind in enumerate(kinds):
            # a bar for each absolute level, from the lowest to the highest change, %; widest first
            spans = []
            changes = own[own["kind"] == kind]
            for _, group in changes.groupby(changes["level"].abs()):
                percent = group["change_percent"].fillna(_LIMIT).clip(-_LIMIT, _LIMIT)
                beyond = group[group["ratio"] > 1]
                colour = _WITHIN if beyond.empty else _NOTICED if beyond["noticed"].all() else _SILENT
                spans.append((min(0.0, float(percent.min())), max(0.0, float(percent.max())), colour))
            spans.sort(key=lambda span: span[0] - span[1])
            shades = np.linspace(0.35, 1.0, len(spans)) if len(spans) > 1 else [0.35]
            for (low, high, colour), shade in zip(spans, shades, strict=True):
                bars.append([row, _place(low), _place(high), float(shade)])
                colours.append(colour)
                names.append(f"{titles_shown[row]}: {low:.2g} … {high:.2g} %")
        rows, lows, highs, opacity = np.array(bars, dtype=np.float64).reshape(-1, 4).T
        tolerated = np.array([_place(100 * parameter.tolerated(tolerance))])
        items = (
            *_LEGEND,
            Spans(-tolerated, tolerated, style.GRID),
            Bars(rows, lows, highs, tuple(colours), opacity, tuple(names)),
            Rule("x", 0.0, style.INK),
        )
        panels.append(
            Panel(
                items,
                style.clean(parameter.name, 34),
                "change, % of its size",
                x_range=(_place(-_LIMIT), _place(_LIMIT)),
                x_ticks=tuple((_place(value), f"{value:g}".replace("-", "−")) for value in _TICKS),
                rows=titles_shown,
                height=_HEAD + _ROW * len(kinds),
            )
        )
    return Figure(arrange_in_lines(tuple(panels), _COLUMNS))


_FAILED = ("refused", "failed")
_FOOTER = (
    "Levels are in SI units. Torques, states and lengths are compared with the unperturbed trial; the numbers are for "
    "the joint with the largest change. The response of every parameter to every perturbation is in responses.csv and "
    "responses.parquet beside this page."
)


def render_sensitivity_page(
    *,
    trial: str,
    verdict: Level,
    note: str,
    tolerance: float,
    seed: int,
    parameters: Sequence[Parameter],
    titles: Mapping[str, str],
    tables: Mapping[str, ResultTable],
) -> bytes:
    """Return the HTML page in UTF-8.

    ``verdict`` is that of the unperturbed ``trial``; ``note`` says which perturbations could not be studied;
    ``tolerance`` is the tolerated change of a parameter as a fraction of its size; ``titles`` are those of the kinds of
    perturbation; ``tables`` are `responses`, `perturbations` and `tolerates`.
    """
    title = "How much each kind of error changes each parameter"
    drawing = Drawing("tornado", title, CAPTION, _draw_tornado(parameters, titles, tolerance, tables))
    sentences = tuple(style.clean(sentence) for sentence in tables["tolerates"].frame["sentence"])
    tried = tables["perturbations"].frame
    beyond = tried[~tried["tolerated"]]
    silent = beyond[(beyond["raised"] == "") & ~beyond["verdict"].isin(_FAILED)]
    unperturbed = to_grid(
        "The unperturbed parameters",
        parameters,
        (
            texts("parameter", "name"),
            GridColumn("value", lambda one: show_with_sd(one.value, one.sd, style.format_unit(one.unit))),
            GridColumn("size", lambda one: show(one.size, 3, style.format_unit(one.unit))),
            GridColumn("tolerated change", lambda one: show(100 * one.tolerated(tolerance), 2, "%")),
        ),
    )
    torques = [name for name in tried.columns if name.startswith("tau_")]

    def ratio(row: Mapping[str, Any]) -> str:
        return "not identified" if row["ratio"] == float("inf") else show(row["ratio"], 2)

    def largest_torque(row: Mapping[str, Any]) -> str:
        return show(max((row[name] for name in torques if np.isfinite(row[name])), default=np.nan), 2, "N·m")

    listed = tables["perturbations"].grid(
        "Every perturbation",
        "perturbation",
        GridColumn("change divided by the tolerated change", ratio),
        "parameter",
        texts("new cautions", lambda row: row["raised"] or (row["verdict"] if row["verdict"] in _FAILED else "")),
        "condition_number",
        GridColumn(
            "r² Fx, Fy, tauz", lambda row: ", ".join(show_fixed(row[f"{name}_r2"], 4) for name in ("Fx", "Fy", "tauz"))
        ),
        GridColumn("CoP rms", lambda row: show_fixed(1e3 * row["cop_rms"], 1, "mm")),
        GridColumn("worst torque", largest_torque),
        "ddtheta_r2",
        GridColumn("offset found", lambda row: show_fixed(1e3 * row["clock_offset"], 2, "ms")),
    )
    return Page(
        name=trial,
        headline="what this trial tolerates",
        lead=f"{describe_criterion(tolerance)} The limit between two tried levels is interpolated.",
        note=style.clean(note),
        command="sensitivity",
        key_numbers=(
            KeyNumber("perturbations", str(len(tried)), f"{tried['kind'].nunique()} kinds, seed {seed}"),
            KeyNumber("tolerated", str(len(tried) - len(beyond)), "of these perturbations"),
            KeyNumber("unnoticed", str(len(silent)), "not tolerated, and no new caution"),
            KeyNumber("unperturbed verdict", verdict, trial),
        ),
        sections=(
            Section("tolerates", "Tolerated levels", items=sentences),
            Section("tornado", drawing.title, figures=(drawing.name,)),
            Section("numbers", "Numbers", (unperturbed, listed)),
        ),
        figures=Drawings(style.clean(trial), (drawing,)),
        footer=_FOOTER,
    ).render()


def describe_criterion(share: float) -> str:
    """Return a sentence that says when a perturbation is tolerated."""
    return (
        f"A perturbation is tolerated if no parameter changes by more than {show(100 * share, 2, '%')} of its size, or "
        "by its own stated standard deviation if that is larger."
    )
