"""The figures of a reach study: volume by person, and the reachable volumes on one scale (thesis 7.3 and 7.4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.figure import Drawing, Drawings, Figure, Item, Line, Panel, Points, in_lines
from mocap_id.reporting.reach_study.page_data import Shape
from mocap_id.reporting.reach_study.tables import show_score
from mocap_id.reporting.study.figures import people
from mocap_id.reporting.study.page_data import CohortData

_SIDES = {"right": style.BLUE, "left": style.VERMILLION}
_VIEW = (60.0, 15.0)  # degrees; from the front, on the side of the right arm
_CAPTION = (
    "Surfaces of the reachable volumes of each person about the top of the breastbone, all on one scale, for joints "
    "that are independent of each other. On the page, each panel can be turned. The thick line is the arm at its "
    "furthest reach, the ring its shoulder. {drawn}"
)


def reach_figures(data: CohortData, shapes: Sequence[Shape]) -> Drawings:
    """Return every figure of the page."""
    volumes = Drawing(
        "volumes",
        "Reachable volume by person",
        "A dot for each trial with its 95 % interval, coloured by side. People are in the order of the table.",
        _volumes(data),
    )
    sides = Drawing(
        "reach-sides",
        "Reachable volumes, left and right",
        _CAPTION.format(drawn="Of several sessions, the last is drawn."),
        _sides(data, shapes),
    )
    sessions = Drawing(
        "reach-sessions",
        "Reachable volumes, session and session",
        _CAPTION.format(drawn="A panel for each side, a colour for each session."),
        _sessions(data, shapes),
    )
    return Drawings(style.printable(data.study), (volumes, sides, sessions))


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


def _sides(data: CohortData, shapes: Sequence[Shape]) -> Figure | str:
    """Draw a panel for each person with the last session of each side."""
    last = {(one.subject, one.side): one for one in shapes}
    return _figure(
        shapes,
        [
            (label, [(one, side, _SIDES[side]) for side in _SIDES if (one := last.get((subject, side)))])
            for subject, label in _named(data).items()
        ],
    )


def _sessions(data: CohortData, shapes: Sequence[Shape]) -> Figure | str:
    """Draw a panel for each person and side with all sessions."""
    names = list(dict.fromkeys(one.session for one in shapes))
    if len(names) == 1:
        return "Every trial belongs to the same session."
    panels = []
    for subject, label in _named(data).items():
        for side in _SIDES:
            own = [one for one in shapes if (one.subject, one.side) == (subject, side)]
            drawn = [(one, style.printable(one.session, 16), style.colour(names.index(one.session) + 1)) for one in own]
            panels.append((f"{label}, {side}", drawn))
    return _figure(shapes, panels)


def _figure(shapes: Sequence[Shape], panels: Sequence[tuple[str, list[tuple[Shape, str, str]]]]) -> Figure | str:
    """Return turnable panels on one scale: titles, and shapes with their labels and colours."""
    if not shapes:
        return "No reachable volume: no trial has one."
    points = np.concatenate([part for one in shapes for part in (one.wires, one.arm)])
    half = 1.02 * float(np.nanmax(np.linalg.norm(points, axis=1)))
    made = (
        Panel(
            tuple(item for one in drawn for item in _items(*one)),
            title,
            "across the view (m)",
            "up the view (m)",
            (-half, half),
            (-half, half),
            equal=True,
            height=2.6,
            view=_VIEW,
        )
        for title, drawn in panels
        if drawn
    )
    return Figure(in_lines(tuple(made), 4))


def _items(shape: Shape, label: str, colour: str) -> Iterator[Item]:
    for points, hue, name, width, opacity in (
        (shape.wires, colour, label, 0.5, 0.6),
        (shape.arm, style.INK, "", 2.0, 1.0),
    ):
        x, y, z = points.T
        yield Line(x, y, hue, name, width=width, opacity=opacity, z=z)
    x, y, z = shape.arm[:1].T
    yield Points(x, y, style.INK, symbol="ring", z=z)
