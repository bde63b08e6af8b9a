"""Reach in the summary and on the page: volume, ranges, surface, heights and targets."""

from __future__ import annotations

import numpy as np

from mocap_id.reporting.numbers import UNKNOWN, known, show, show_fixed
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.space.schema import WorkspaceEntry
from mocap_id.reporting.tables import Grid, grid, millimetres, percent

_FILE = "events.parquet"
_VIEW_ONLY = {"mesh", "view", "why"}
_SETS = {"box": "box of independent limits", "visited": "visited region"}


def workspace(data: ReportData) -> WorkspaceEntry:
    """Return the reachable volume and what belongs to it; null with a ``why`` for other protocols."""
    facts = data.facts(_FILE).get("reach")
    if facts is None:
        where = "only `protocol: reach` has a reachable volume"
        return WorkspaceEntry(why=where if data.in_space else f"{where}, which needs `space: 3d`")
    return WorkspaceEntry(**{k: v for k, v in facts.items() if k not in _VIEW_ONLY}, why=facts.get("why") or None)


def text(found: WorkspaceEntry) -> tuple[str, ...]:
    """Return what the volumes mean, or why there is none."""
    if found.volume_m3 is None:
        return (f"The reachable volume is unknown: {found.why}.",)
    return () if found.visited is None else (found.visited.meaning,)


def volumes(found: WorkspaceEntry) -> Grid:
    """Return the volume within both sets with interval, discretisation and convergence."""
    rows = []
    for name, one in (("box", found), ("visited", found.visited)):
        if one is not None and one.volume_m3 is not None:
            share = show_fixed(found.relative_volume, 3) if name == "box" else UNKNOWN
            steps = ", ".join(show_fixed(each, 4) for each in one.convergence_m3 or ())
            rows.append((_SETS[name], show_fixed(one.volume_m3, 4), _span(one.interval_m3, 4), share, steps))
    head = (
        "set",
        "volume (m³)",
        "95 % interval (m³)",
        "share of a sphere, radius: arm's length",
        "on finer and finer grids (m³)",
    )
    return grid("Volume that the wrist can reach", head, rows)


def ranges(found: WorkspaceEntry) -> Grid:
    """Return the robust range of every angle, and its share in the variance of the volume."""
    rows = []
    for name, one in (found.ranges or {}).items():
        parts = [share for key, share in (found.sources or {}).items() if key.startswith(name)]
        rows.append(
            (
                name.replace("_", " "),
                *(show_fixed(value, 1) for value in (one.low_deg, one.high_deg, one.range_deg)),
                _span(one.interval_deg, 1),
                percent(one.used_share),
                percent(sum(parts)) if parts else UNKNOWN,
            )
        )
    head = (
        *("angle", "lowest (deg)", "highest (deg)", "range (deg)", "95 % interval of the range (deg)"),
        *("samples used (%)", "share in the variance of the volume (%)"),
    )
    caption = "Ranges, robust against single samples: an end counts if the angle is beyond it for 0.05 s in all"
    return grid(caption, head, rows)


def areas(found: WorkspaceEntry) -> Grid:
    """Return the relative area of the surface by quadrants."""
    names = ("total", "upper_medial", "upper_lateral", "lower_medial", "lower_lateral", "behind")
    rows = [
        (_SETS.get(name, name), *(show_fixed(one.get(each), 3) for each in names))
        for name, one in (found.surface or {}).items()
    ]
    caption = (
        "Relative area of the furthest reach about the shoulder. In front, 1 is half a sphere of the arm's length and "
        "0.25 a full quadrant; medial is towards the other arm"
    )
    return grid(caption, ("set", *(name.replace("_", " ") for name in names)), rows)


def heights(found: WorkspaceEntry) -> Grid:
    """Return the heights that the hand reached."""
    one = found.heights
    if one is None:
        return grid("", (), [])
    levels = ((f"hand at the height of the {name}", "yes" if there else "no", "") for name, there in one.levels.items())
    rows = [
        ("wrist, highest", millimetres(one.highest_m), show_fixed(one.highest_share, 2)),
        ("wrist, lowest", millimetres(one.lowest_m), show_fixed(one.lowest_share, 2)),
        *((name.replace("height of the overhead", "height of an overhead shelf"), yes, no) for name, yes, no in levels),
    ]
    head = ("what", "height (mm)", "share of the arm's length")
    return grid("Heights above the shoulder, along the thorax", head, rows)


def targets(found: WorkspaceEntry) -> Grid:
    """Return the number of reaches to each part of the body, and the distances by which they missed it."""
    rows = [
        (name.replace("_", " "), str(one.count), millimetres(one.best_miss_m), millimetres(one.median_miss_m))
        for name, one in (found.tasks or {}).items()
    ]
    caption = "Targets: the part of the body nearest to the held hand. Tables of proportions give their places, ± 3 cm"
    return grid(caption, ("target", "reaches", "smallest miss (mm)", "median miss (mm)"), rows)


def list_reaches(data: ReportData) -> Grid:
    """Return one row for every reach."""
    table, rows = data.table(_FILE), []
    if table is not None and "target" in table.names:
        columns = [table[name] for name in ("start", "top", "end", "target", "miss_m", "complete", "why")]
        for start, top, end, target, miss, complete, why in zip(*columns, strict=True):
            times = [show_fixed(known(time), 2) for time in (start, top, end)]
            missed = show(known(1e3 * miss)) if np.isfinite(miss) else UNKNOWN
            rows.append((*times, str(target).replace("_", " "), missed, "yes" if complete else f"no: {why}"))
    head = ("start (s)", "held (s)", "end (s)", "target", "missed by (mm)", "complete")
    return grid("Reaches", head, rows, (3, 5))


def _span(ends: list[float] | None, decimals: int) -> str:
    return UNKNOWN if ends is None else " … ".join(show_fixed(end, decimals) for end in ends)
