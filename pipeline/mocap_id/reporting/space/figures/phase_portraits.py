"""Phase portraits of curls: acceleration against angle, of the elbow and the shoulder (thesis figures 8.6 to 8.9)."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Band, Figure, Item, Line, Panel, in_lines
from mocap_id.reporting.report_data import ReportData
from mocap_id.store.spatial_views import SpatialAngles

_ANGLES = ("elbow_flexion", "shoulder_elevation", "shoulder_plane", "shoulder_axial")
_COLOURS = (style.BLUE, style.GREEN, style.VERMILLION)  # first, middle and last third of the curls
_HEIGHT = 2.4


def draw(data: ReportData) -> Figure | str:
    """Draw all complete curls; the first and the last have a 95 % band of the acceleration."""
    angles, table = data.angles, data.table("events.parquet")
    if angles is None or table is None or "amplitude" not in table.names:
        return "only `protocol: curl` has phase portraits"
    turns = table.stack(["start", "top", "end"])[table["complete"].astype(bool)]
    names = [name for name in _ANGLES if name in angles.names]
    if not len(turns) or not names:
        return "no complete curl was found"
    panels = []
    for name in names:
        items: list[Item] = []
        for k, (start, top, end) in enumerate(turns):
            colour = _COLOURS[len(_COLOURS) * k // len(turns)]
            halves = [(angles.time >= a) & (angles.time <= b) for a, b in ((start, top), (top, end))]
            if k in {0, len(turns) - 1}:
                items += [_band(angles, name, half, colour) for half in halves]
            items.append(_line(angles, name, halves[0] | halves[1], colour))
        title = style.printable(name.replace("_", " "), 24)
        panels.append(Panel(tuple(items), title, "angle (deg)", "acceleration (rad/s²)", height=_HEIGHT))
    return Figure(in_lines(tuple(panels), 2))


def _line(angles: SpatialAngles, name: str, within: BoolArray, colour: str) -> Line:
    mean = angles.mean[within, angles.names.index(name)]
    return Line(np.degrees(mean[:, 0]), mean[:, 2], colour, width=0.8, opacity=0.7)


def _band(angles: SpatialAngles, name: str, within: BoolArray, colour: str) -> Band:
    j = angles.names.index(name)
    mean, half = angles.mean[within, j], NORMAL_95 * angles.sd[within, j, 2]
    order = np.argsort(mean[:, 0], kind="stable")
    return Band(np.degrees(mean[order, 0]), (mean[:, 2] - half)[order], (mean[:, 2] + half)[order], colour, 0.15)
