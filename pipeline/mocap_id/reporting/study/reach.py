"""``cohort.html`` of a reach study: tables (thesis 7.1), volume by person, volumes on one scale (figures 7.3, 7.4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Drawing, Drawings, Figure, Item, Line, Panel, Points, arrange_in_lines
from mocap_id.reporting.figures.skeleton import make_turnable_panel
from mocap_id.reporting.grids import UNKNOWN, show, show_estimate, to_number
from mocap_id.reporting.page import KeyNumber, Section
from mocap_id.reporting.study import CohortData, draw_separators, place_trials, render_study_page, to_floats

_SIDES = {"right": style.BLUE, "left": style.VERMILLION}
_CAPTION = (
    "Surfaces of the reachable volumes of each person about the top of the breastbone, all on one scale, for joints "
    "that are independent of each other. On the page, each panel can be rotated. The thick line is the arm at its "
    "furthest reach; the ring is its shoulder. {drawn}"
)
_FOOTER = (
    "The same numbers in SI units are in the CSV and Parquet files beside this page, which study.json describes. A "
    "left arm is mirrored, so that the numbers of both sides have the same meaning."
)
_MEANING = (
    "The volume is what the wrist can reach if each joint uses its whole range, independent of the others, as in the "
    "thesis. The visited volume uses only recorded combinations of joint angles. The surface is the reached fraction "
    "of the hemisphere in front of the shoulder. For elevation and height, the largest values are given.",
    "A person's number is the mean of both sides. Its interval is the mean interval of the trials, because the "
    "trials may have the same errors.",
)
_CORRELATION = (
    "The correlation excludes people without a score. Its interval applies to people like these; with few people it is "
    "wide even if their order is perfect."
)
_DIFFERENCES = (
    "Paired differences with 95 % intervals. The interval of a person follows from the intervals of the trials, the "
    "interval of the cohort from the differences between people (Student's t). If nobody changed between two sessions, "
    "twice the standard deviation is the smallest change of one person that repetition alone does not explain."
)


@dataclass(frozen=True)
class Shape:
    """Surface of a reachable volume, in the frame of the thorax: forward, up, to the person's right, m."""

    subject: str  # id of the person
    side: str  # right or left
    session: str  # name of the session
    wires: FloatArray  # (K, 3) lines on the surface, interrupted by NaN
    arm: FloatArray  # (3, 3) shoulder, elbow and wrist at the furthest reach


def render_reach_page(data: CohortData, shapes: Sequence[Shape]) -> bytes:
    """Return the HTML page in UTF-8, from the tables `people`, `correlation`, `differences` and `trials`.

    ``shapes`` are surfaces of reachable volumes, at most one for each person, side and session, in the order of
    sessions.
    """
    return render_study_page(
        data, _make_key_numbers(data), _make_sections(data), draw_reach_figures(data, shapes), _FOOTER
    )


def _make_key_numbers(data: CohortData) -> Iterator[KeyNumber]:
    frame = data.frame("people")
    yield KeyNumber("people", str(len(frame)), f"{len(data.trials)} trials")
    volumes = frame["volume"].dropna()
    if len(volumes):
        extremes = f"{show(volumes.min())} … {show(volumes.max())} m³"
        yield KeyNumber("volume", extremes, "smallest and largest volume of a person")
    correlation, differences = data.frame("correlation"), data.of_cohort("differences")
    for row in correlation[(correlation["measure"] == "volume") & correlation["spearman"].notna()].to_dict("records"):
        about = f"95 % interval {show(row['spearman_low'])} … {show(row['spearman_high'])}, {row['people']} people"
        yield KeyNumber("volume and score", show(row["spearman"]), f"Spearman's correlation, {about}")
    known = differences[(differences["measure"] == "volume") & differences["difference"].notna()]
    for row in known.to_dict("records"):
        yield KeyNumber(row["comparison"], show_estimate(row, "difference"), "mean difference of volume, m³")


def _make_sections(data: CohortData) -> Iterator[Section]:
    people, correlation, differences = (data.tables[name] for name in ("people", "correlation", "differences"))
    known = correlation.frame["spearman"].notna()
    thesis = "Reachable volume and clinical score (thesis table 7.1), with 95 % intervals"
    grids = [people.grid(thesis, "subject score trials volume volume_right volume_left visited")]
    if known.any():
        caption = "Correlation with the clinical score, with 95 % interval and permutation p-value"
        grids.append(correlation.grid(caption, "measure people spearman p", rows=correlation.frame[known]))
    grids.append(people.grid("Other measures of reach", "subject surface elevation height"))
    text = (*_MEANING, _CORRELATION) if known.any() else _MEANING
    yield Section("volume", "Reachable volume", tuple(grids), ("volumes",), text=text)
    yield Section(
        "shapes",
        "The volumes on one scale (thesis figures 7.3 and 7.4)",
        figures=("reach-sides", "reach-sessions"),
    )
    if len(differences.frame):
        columns = "comparison measure subject label people difference sd"
        of_cohort, of_people = data.of_cohort("differences"), data.of_people("differences")
        yield Section(
            "differences",
            "Left and right, session and session",
            (differences.grid("Mean differences over the people", columns, rows=of_cohort),),
            folded=(differences.grid("Differences of every person", columns, rows=of_people),),
            text=(_DIFFERENCES,),
        )
    columns = "trial subject side session verdict volume visited surface elevation height why"
    yield Section("trials", "Trials", (data.tables["trials"].grid("Every trial, with 95 % intervals", columns),))


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
    frame = data.frame("people")
    scores = zip(frame["subject"], to_floats(frame["score"]), strict=True)
    return {
        subject: style.clean(subject, 16) + ("" if np.isnan(score) else f" ({show_score(score)})")
        for subject, score in scores
    }


def _draw_volumes(data: CohortData) -> Figure | str:
    trials, labels = data.frame("trials"), _name_people(data)
    known = trials[trials["volume"].notna()]
    if known.empty:
        return "No reachable volume: no trial has one."
    rows = place_trials(data, known["trial"].tolist(), list(labels))
    items: list[Item] = draw_separators(data)
    for side, colour in _SIDES.items():
        own = (known["side"] == side).to_numpy(dtype=np.bool_)
        if not own.any():
            continue
        value, low, high = (to_floats(known.loc[own, f"volume{end}"]) for end in ("", "_low", "_high"))
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
    made = []
    for title, drawn in panels:
        items: list[Item] = []
        for shape, label, colour in drawn:
            for line, hue, name, width, opacity in (
                (shape.wires, colour, label, 0.5, 0.6),
                (shape.arm, style.INK, "", 2.0, 1.0),
            ):
                x, y, z = line.T
                items.append(Line(x, y, hue, name, width=width, opacity=opacity, z=z))
            x, y, z = shape.arm[:1].T
            items.append(Points(x, y, style.INK, symbol="ring", z=z))
        if drawn:
            made.append(make_turnable_panel(items, half, title, 2.6))
    return Figure(arrange_in_lines(tuple(made), 4))


def show_score(score: object) -> str:
    """Format a clinical score, such as ``2``; return a dash if it is unknown."""
    value = to_number(score)
    return UNKNOWN if value is None else f"{value:g}"
