"""How far each marker lies from where the chain predicts it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.reporting.views import Skeleton
from mocap_id.store import LongTable


@dataclass(frozen=True)
class Residual:
    """Of one marker: its segment (-1 = none), rms and 95 % quantile (m; NaN where never seen), share of frames seen."""

    label: str
    segment: int
    rms: float
    q95: float
    seen: float


def by_marker(markers: LongTable | None, skeleton: Skeleton | None) -> dict[str, Residual]:
    """Residuals of ``markers.parquet`` by label; nothing where there is no such table."""
    if markers is None or not markers.length:
        return {}
    segment = {} if skeleton is None else dict(zip(skeleton.markers, skeleton.marker_segment.tolist(), strict=True))
    found = {}
    for label, column in zip(markers.labels, markers.values["residual"].T, strict=True):
        seen = column[np.isfinite(column)]
        rms, q95 = (np.sqrt(np.mean(seen**2)), np.quantile(seen, 0.95)) if seen.size else (np.nan, np.nan)
        found[label] = Residual(label, segment.get(label, -1), float(rms), float(q95), seen.size / column.size)
    return found
