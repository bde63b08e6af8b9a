"""The figures of a reach study: volume by person, and the reachable volumes on one scale (thesis 7.3 and 7.4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.cohort.figures import people
from mocap_id.reporting.cohort.page_data import CohortData
from mocap_id.reporting.figure import Drawing, Drawings, Figure, Item, Line, Panel, Points, in_lines
from mocap_id.reporting.reach_cohort.page_data import Shape
from mocap_id.reporting.reach_cohort.tables import show_score

_SIDES = {"right": style.BLUE, "left": style.VERMILLION}
_VIEWS = (
    ("front", "seen from the front", 2, 1, "to the person's right (m)", "up (m)"),
    ("side", "seen from the person's right", 0, 1, "forward (m)", "up (m)"),
    ("top", "seen from above", 2, 0, "to the person's right (m)", "forward (m)"),
)
_CAPTION = (
    "Surface of the reachable volume of each person about the top of the breastbone, {view}, all on one scale, for "
    "joints that are independent of each other. The thick line is the arm at its furthest reach, the ring its "
    "shoulder. Of several trials of a side, the last is drawn."
)


def reach_figures(data: CohortData, shapes: Sequence[Shape]) -> Drawings:
    """Return every figure of the page."""
    volumes = Drawing(
        "volumes",
        "Reachable volume by person",
        "A dot for each trial with its 95 % interval, coloured by side. People are in the order of the table.",
        _volumes(data),
    )
    views = (
        Drawing(f"reach-{name}", f"Reachable volumes, {view}", _CAPTION.format(view=view), _shapes(data, shapes, k))
        for k, (name, view, *_) in enumerate(_VIEWS)
    )
    return Drawings(style.printable(data.study), (volumes, *views))


def _named(data: CohortData) -> dict[str, str]:
    """Return the label of every person, with the score, in the order of table 7.1."""
    frame = data.tables["people"]
    scored = {subject: "" if np.isnan(score) else f" ({show_score(score)})" for subject, score in _scores(frame)}
    return {subject: f"{style.printable(subject, 16)}{score}" for subject, score in scored.items()}


def _scores(frame: pd.DataFrame) -> Iterator[tuple[str, float]]:
    return zip(frame["subject"], frame["score"].to_numpy(dtype=np.float64), strict=True)


def _volumes(data: CohortData) -> Figure | str:
    trials, named = data.tables["trials"], _named(data)
    known = trials[trials["volume"].notna()]
    if known.empty:
        return "No reachable volume: no trial has one."
    place = people.trial_places(data, known["trial"].tolist(), list(named))
    items: list[Item] = people.separators(data)
    for side, colour in _SIDES.items():
        own = (known["side"] == side).to_numpy(dtype=np.bool_)
        if not own.any():
            continue
        value, low, high = (known.loc[own, f"volume{end}"].to_numpy(dtype=np.float64) for end in ("", "_low", "_high"))
        y, gap = place[own], np.full(int(own.sum()), np.nan)
        ends = np.column_stack([low, high, gap]).ravel()
        names = tuple(style.printable(name, 30) for name in known.loc[own, "trial"])
        items += [
            Line(ends, np.repeat(y, 3), colour),
            Points(value, y, colour, side, names=names),
        ]
    height = 0.7 + 0.3 * len(named)
    return Figure(((Panel(tuple(items), x="reachable volume (m³)", rows=tuple(named.values()), height=height),),))


def _shapes(data: CohortData, shapes: Sequence[Shape], view: int) -> Figure | str:
    if not shapes:
        return "No reachable volume: no trial has one."
    _, _, across, up, x, y = _VIEWS[view]
    low, high = (f(np.concatenate([part for one in shapes for part in (one.wires, one.arm)]), axis=0) for f in _ENDS)
    margin = 0.05 * float((high - low).max())
    x_range, y_range = ((float(low[k]) - margin, float(high[k]) + margin) for k in (across, up))
    height = float(np.clip(0.7 + 1.5 * (y_range[1] - y_range[0]) / (x_range[1] - x_range[0]), 1.5, 4.0))
    panels = []
    for subject, label in _named(data).items():
        own = [one for one in shapes if one.subject == subject]
        if own:
            panels.append(
                Panel(tuple(_drawn(own, across, up)), label, x, y, x_range, y_range, equal=True, height=height)
            )
    return Figure(in_lines(tuple(panels), 4))


_ENDS = (np.nanmin, np.nanmax)


def _drawn(shapes: Sequence[Shape], across: int, up: int) -> Iterator[Item]:
    for one in shapes:
        surface, arm = one.wires, one.arm
        yield Line(surface[:, across], surface[:, up], _SIDES[one.side], one.side, width=0.5, opacity=0.6)
        yield Line(arm[:, across], arm[:, up], style.INK, width=2.0)
        yield Points(arm[:1, across], arm[:1, up], style.INK, symbol="ring")
