"""View of what the wrist can reach, which the reader can rotate: surface, path of the wrist, arm and targets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Item, Line, Panel, Points
from mocap_id.reporting.report_data import ReportData

_VIEW = (60.0, 15.0)  # degrees; from the front, on the side of the right arm
_SETS = {"box_m": ("box of independent limits", style.FAINT, 0.45), "visited_m": ("visited region", style.BLUE, 0.8)}
_EVERY = 2  # every second line of longitude is drawn


def draw_reach(data: ReportData) -> Figure | str:
    """Return the surface of the reachable set with the shoulder in the middle, or a sentence if there is none."""
    facts = data.facts("events.parquet").get("reach")
    if facts is None:
        return "No reachable set to draw: only `protocol: reach` has one."
    if not facts.get("mesh"):
        return f"No reachable set to draw: {facts.get('why')}."
    mesh, view, items = facts["mesh"], facts.get("view") or {}, []

    def draw_line(points: FloatArray, colour: str, label: str, *, width: float, opacity: float) -> Line:
        x, y, z = points.T
        return Line(x, y, colour, label, width=width, opacity=opacity, z=z)

    for name, (label, colour, opacity) in _SETS.items():
        if name in mesh:
            lines = make_wires(mesh["theta_deg"], mesh["psi_deg"], mesh[name])
            items.append(draw_line(lines, colour, label, width=0.7, opacity=opacity))
    if view.get("path_m"):
        items.append(draw_line(np.array(view["path_m"]), style.ORANGE, "path of the wrist", width=0.9, opacity=0.8))
    for k, label in enumerate(("upper arm", "forearm")):
        ends = np.array(view["arm_m"])[k : k + 2]
        items.append(draw_line(ends, style.pick_colour(k + 1), label, width=4.0, opacity=0.8))
    x, y, z = np.array(list(view["targets_m"].values())).T
    names = tuple(name.replace("_", " ") for name in view["targets_m"])
    targets = Points(x, y, style.INK, "parts of the body", "x", 5.0, names=names, z=z)
    return Figure(((make_turnable_panel([*items, targets], 1.02 * float(facts["arm_length_m"]), "", 5.6),),))


def make_turnable_panel(items: list[Item], half: float, title: str, height: float) -> Panel:
    """Return a panel whose view the reader can rotate, first from the front; its ranges are ± ``half``, m."""
    ends = (-half, half)
    axes = ("across the view (m)", "up the view (m)", ends, ends)
    return Panel(tuple(items), title, *axes, equal=True, height=height, view=_VIEW)


def make_wires(polar: Sequence[float], azimuth: Sequence[float], radii: Sequence[Sequence[float | None]]) -> FloatArray:
    """Return the circles of latitude and every second line of longitude of a surface as one line (K, 3), with NaN gaps.

    ``polar`` (N,) and ``azimuth`` (M,) are the angles of the N x M points, degrees, and ``radii`` their radii, m.
    """
    theta, psi = np.radians(polar)[:, None], np.radians(azimuth)
    radius = np.array(radii, dtype=np.float64)
    along = np.broadcast_to(np.cos(theta), radius.shape)
    points = radius[..., None] * np.stack([np.sin(theta) * np.sin(psi), along, np.sin(theta) * np.cos(psi)], axis=-1)
    gap = np.full((1, 3), np.nan)
    rows = [np.concatenate([row, row[:1], gap]) for row in points]
    columns = [np.concatenate([points[:, k], gap]) for k in range(0, len(psi), _EVERY)]
    return np.concatenate([*rows, *columns])
