"""The figures of a reach study: volume by person, and the reachable volumes on one scale (thesis 7.3 and 7.4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Drawing, Drawings, Figure, Item, Line, Panel, Points, arrange_in_lines
from mocap_id.reporting.figures.reach import make_turnable_panel
from mocap_id.reporting.reach_study.tables import show_score
from mocap_id.reporting.study import people_rows
from mocap_id.reporting.study.page_data import CohortData

_SIDES = {"right": style.BLUE, "left": style.VERMILLION}
_CAPTION = (
    "Surfaces of the reachable volumes of each person about the top of the breastbone, all on one scale, for joints "
    "that are independent of each other. On the page, each panel can be rotated. The thick line is the arm at its "
    "furthest reach; the ring is its shoulder. {drawn}"
)


@dataclass(frozen=True)
class Shape:
    """Surface of a reachable volume, in the frame of the thorax: forward, up, to the person's right, m."""

    subject: str  # id of the person
    side: str  # right or left
    session: str  # name of the session
    wires: FloatArray  # (K, 3) lines on the surface, interrupted by NaN
    arm: FloatArray  # (3, 3) shoulder, elbow and wrist at the furthest reach


def draw_reach_figures(data: CohortData, shapes: Sequence[Shape]) -> Drawings:
    """Return all figures of the page."""
    volumes = Drawing(
        "volumes",
        "Reachable volume by person",
        "A dot for each trial with its 95 % interval, coloured by side. People are in the order of the table.",
        _draw_volumes(data),
    )
    sides = Drawing(
        "reach-sides",
        "Reachable volumes, left and right",
        _CAPTION.format(drawn="If there are several sessions, the last is drawn."),
        _draw_sides(data, shapes),
    )
    sessions = Drawing(
        "reach-sessions",
        "Reachable volumes by session",
        _CAPTION.format(drawn="A panel for each side, a colour for each session."),
        _draw_sessions(data, shapes),
    )
    return Drawings(style.clean(data.study), (volumes, sides, sessions))


def _name_people(data: CohortData) -> dict[str, str]:
    """Return the labels of all people by id, with the clinical score if known, in the order of table 7.1."""
    frame = data.tables["people"]
    scores = zip(frame["subject"], frame["score"].to_numpy(dtype=np.float64), strict=True)
    return {
        subject: style.clean(subject, 16) + ("" if np.isnan(score) else f" ({show_score(score)})")
        for subject, score in scores
    }


def _draw_volumes(data: CohortData) -> Figure | str:
    trials, labels = data.tables["trials"], _name_people(data)
    known = trials[trials["volume"].notna()]
    if known.empty:
        return "No reachable volume: no trial has one."
    rows = people_rows.place_trials(data, known["trial"].tolist(), list(labels))
    items: list[Item] = people_rows.draw_separators(data)
    for side, colour in _SIDES.items():
        own = (known["side"] == side).to_numpy(dtype=np.bool_)
        if not own.any():
            continue
        value, low, high = (known.loc[own, f"volume{end}"].to_numpy(dtype=np.float64) for end in ("", "_low", "_high"))
        ends = np.column_stack([low, high, np.full(int(own.sum()), np.nan)]).ravel()
        names = tuple(style.clean(name, 30) for name in known.loc[own, "trial"])
        items += [Line(ends, np.repeat(rows[own], 3), colour), Points(value, rows[own], colour, side, names=names)]
    height = 0.7 + 0.3 * len(labels)
    return Figure(((Panel(tuple(items), x="reachable volume (m³)", rows=tuple(labels.values()), height=height),),))


def _draw_sides(data: CohortData, shapes: Sequence[Shape]) -> Figure | str:
    """Return a panel for each person with the last session of each side."""
    last = {(shape.subject, shape.side): shape for shape in shapes}
    panels = [
        (label, [(last[subject, side], side, colour) for side, colour in _SIDES.items() if (subject, side) in last])
        for subject, label in _name_people(data).items()
    ]
    return _draw_shapes(shapes, panels)


def _draw_sessions(data: CohortData, shapes: Sequence[Shape]) -> Figure | str:
    """Return a panel for each person and side with all sessions."""
    sessions = list(dict.fromkeys(shape.session for shape in shapes))
    if len(sessions) == 1:
        return "Every trial belongs to the same session."
    panels = []
    for subject, label in _name_people(data).items():
        for side in _SIDES:
            own = [
                (shape, style.clean(shape.session, 16), style.pick_colour(sessions.index(shape.session) + 1))
                for shape in shapes
                if (shape.subject, shape.side) == (subject, side)
            ]
            panels.append((f"{label}, {side}", own))
    return _draw_shapes(shapes, panels)


def _draw_shapes(shapes: Sequence[Shape], panels: Sequence[tuple[str, list[tuple[Shape, str, str]]]]) -> Figure | str:
    """Return panels that the reader can rotate, all on one scale.

    ``panels`` has the title of each panel, and its shapes with their labels and colours.
    """
    if not shapes:
        return "No reachable volume: no trial has one."
    points = np.concatenate([part for shape in shapes for part in (shape.wires, shape.arm)])
    half = 1.02 * float(np.nanmax(np.linalg.norm(points, axis=1)))
    made = (
        make_turnable_panel([item for one in drawn for item in _draw_items(*one)], half, title, 2.6)
        for title, drawn in panels
        if drawn
    )
    return Figure(arrange_in_lines(tuple(made), 4))


def _draw_items(shape: Shape, label: str, colour: str) -> Iterator[Item]:
    """Yield surface, arm and shoulder of a shape as items of a panel."""
    for points, hue, name, width, opacity in (
        (shape.wires, colour, label, 0.5, 0.6),
        (shape.arm, style.INK, "", 2.0, 1.0),
    ):
        x, y, z = points.T
        yield Line(x, y, hue, name, width=width, opacity=opacity, z=z)
    x, y, z = shape.arm[:1].T
    yield Points(x, y, style.INK, symbol="ring", z=z)
