"""Residual of each marker as a bar."""

from __future__ import annotations

import numpy as np

from mocap_id.reporting import style
from mocap_id.reporting.figure import Bars, Figure, Item, Key, Panel, Points
from mocap_id.reporting.report_data import ReportData

_ROW = 0.155  # inches per marker
_MOST = 80  # markers in the figure; the table lists all


def draw(data: ReportData) -> Figure | str:
    """Draw bars by segment, largest first within each."""
    found = [one for one in data.residuals.values() if np.isfinite(one.rms)]
    if not found:
        return f"No residuals: {data.why_missing('markers.parquet')}."
    worst = sorted(found, key=lambda one: -one.rms)[:_MOST]
    of = sorted(worst, key=lambda one: one.segment)  # stable: the worst stay first
    rms, q95 = 1e3 * np.array([one.rms for one in of]), 1e3 * np.array([one.q95 for one in of])
    rows = np.arange(len(of), dtype=np.float64)
    labels = tuple(style.printable(one.label, 24) for one in of)
    texts = tuple(
        f"{label}: {value:.1f} mm, 95 % {most:.1f}" for label, value, most in zip(labels, rms, q95, strict=True)
    )
    names = data.segment_names
    keys = (
        Key(style.colour(k), style.printable(names[k], 20) if 0 <= k < len(names) else "no segment")
        for k in sorted({one.segment for one in of})
    )
    items: tuple[Item, ...] = (
        *keys,
        Bars(rows, np.zeros(len(of)), rms, tuple(style.colour(one.segment) for one in of), names=texts),
        Points(q95, rows, style.INK, "95 % quantile", "|", 6.0),
    )
    title = f"{len(of)} largest residuals of {len(found)} markers" if len(of) < len(found) else ""
    most = (0.0, 1.05 * float(max(rms.max(), q95.max())))
    panel = Panel(items, title, "residual (mm)", x_range=most, rows=labels, height=0.6 + _ROW * len(of))
    return Figure(((panel,),))
