"""Reach in the summary and on the page: volume, ranges, surface, heights and targets."""

from __future__ import annotations

from mocap_id.reporting.grids import Grid, GridColumn, millimetres, number, percent, show_ends, text, to_grid
from mocap_id.reporting.numbers import UNKNOWN, show_fixed, show_millimetres
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.space.schema import RangeEntry, WorkspaceEntry
from mocap_id.reporting.space.tables import to_words

_FILE = "events.parquet"
_VIEW_ONLY = {"mesh", "view", "why"}
_SETS = {"box": "box of independent limits", "visited": "visited region"}


def summarise_workspace(data: ReportData) -> WorkspaceEntry:
    """Return the reachable volume and the quantities about it; null with a ``why`` for other protocols."""
    facts = data.facts(_FILE).get("reach")
    if facts is None:
        where = "only `protocol: reach` has a reachable volume"
        return WorkspaceEntry(why=where if data.in_space else f"{where}, which needs `space: 3d`")
    return WorkspaceEntry(**{k: v for k, v in facts.items() if k not in _VIEW_ONLY}, why=facts.get("why") or None)


def describe_volume(found: WorkspaceEntry) -> tuple[str, ...]:
    """Return sentences on the meaning of the volumes, or on why the volume is unknown; may be empty."""
    if found.volume_m3 is None:
        return (f"The reachable volume is unknown: {found.why}.",)
    return () if found.visited is None else (found.visited.meaning,)


def list_volumes(found: WorkspaceEntry) -> Grid:
    """Return a table of the volume in both sets of angles: interval, fraction of a sphere, and convergence."""
    share = {"box": found.relative_volume}
    columns = (
        text("set", lambda row: _SETS[row[0]]),
        number("volume (m³)", lambda row: row[1].volume_m3, 4),
        GridColumn("95 % interval (m³)", lambda row: show_ends(row[1].interval_m3, 4)),
        number("fraction of a sphere with the arm's length as radius", lambda row: share.get(row[0]), 3),
        GridColumn(
            "volume on finer and finer grids (m³)",
            lambda row: ", ".join(show_fixed(volume, 4) for volume in row[1].convergence_m3 or ()),
        ),
    )
    sets = (("box", found), ("visited", found.visited))
    rows = [row for row in sets if row[1] is not None and row[1].volume_m3 is not None]
    return to_grid("Volume that the wrist can reach", rows, columns)


def list_ranges(found: WorkspaceEntry) -> Grid:
    """Return a table of the range of every angle, and of its contribution to the variance of the volume."""

    def share(row: tuple[str, RangeEntry]) -> float | None:
        parts = [share for key, share in (found.sources or {}).items() if key.startswith(row[0])]
        return sum(parts) if parts else None

    columns = (
        text("angle", lambda row: row[0].replace("_", " ")),
        number("lowest (deg)", lambda row: row[1].low_deg, 1),
        number("highest (deg)", lambda row: row[1].high_deg, 1),
        number("range (deg)", lambda row: row[1].range_deg, 1),
        GridColumn("95 % interval of the range (deg)", lambda row: show_ends(row[1].interval_deg, 1)),
        percent("samples used (%)", lambda row: row[1].used_share),
        percent("contribution to the variance of the volume (%)", share),
    )
    caption = "Ranges, robust against single samples: the angle is beyond each end for 0.05 s in total"
    return to_grid(caption, (found.ranges or {}).items(), columns)


def list_areas(found: WorkspaceEntry) -> Grid:
    """Return a table of the relative area of the surface of furthest reach, by quadrants."""
    names = ("total", "upper_medial", "upper_lateral", "lower_medial", "lower_lateral", "behind")
    caption = (
        "Relative area of the furthest reach about the shoulder. In front, 1 is half a sphere of the arm's length and "
        "0.25 a full quadrant; medial is towards the other arm"
    )
    rows = {_SETS.get(name, name): one for name, one in (found.surface or {}).items()}
    return to_grid(caption, rows, [number(name.replace("_", " "), name, 3) for name in names], "set")


def list_heights(found: WorkspaceEntry) -> Grid:
    """Return a table of the heights that wrist and hand reached; empty if they are unknown."""
    one = found.heights
    if one is None:
        return Grid()
    rows = {
        "wrist, highest": (show_millimetres(one.highest_m), show_fixed(one.highest_share, 2)),
        "wrist, lowest": (show_millimetres(one.lowest_m), show_fixed(one.lowest_share, 2)),
    }
    for name, reached in one.levels.items():
        level = "an overhead shelf" if name == "overhead" else f"the {name}"
        rows[f"hand at the height of {level}"] = (UNKNOWN if reached is None else "yes" if reached else "no", "")
    columns = (
        GridColumn("height (mm)", lambda row: row[0]),
        GridColumn("fraction of the arm's length", lambda row: row[1]),
    )
    return to_grid("Heights above the shoulder, along the thorax", rows, columns, "level")


def list_targets(found: WorkspaceEntry) -> Grid:
    """Return a table of the number of reaches to each part of the body, and the distances by which they missed it."""
    columns = (
        number("reaches", "count", 0),
        millimetres("smallest miss (mm)", "best_miss_m"),
        millimetres("median miss (mm)", "median_miss_m"),
    )
    caption = "Targets: part of the body nearest to the resting hand; positions from tables of proportions, ± 3 cm"
    return to_grid(caption, to_words(found.tasks or {}), columns, "target")


def list_reaches(data: ReportData) -> Grid:
    """Return a table with a row for every reach."""
    columns = (
        number("start (s)", "start", 2),
        number("held (s)", "top", 2),
        number("end (s)", "end", 2),
        text("target", lambda row: row["target"].replace("_", " ")),
        number("missed by (mm)", "miss_m", factor=1e3),
        text("complete", lambda row: "yes" if row["complete"] else f"no: {row['why']}"),
    )
    return to_grid("Reaches", [row for row in data.rows(_FILE) if "target" in row], columns)
