"""Marker positions at chosen instants, and distances of the markers from their predictions by the chain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.store import LongTable
from mocap_id.store.spatial_views import SpatialSkeleton
from mocap_id.store.views import Skeleton


def read_positions(planar: LongTable, time: FloatArray, labels: Sequence[str], axes: str = "xy") -> FloatArray:
    """Return the measured marker positions at some instants, in the plane of motion or in space.

    Parameters
    ----------
    planar : LongTable
        ``planar.parquet``.
    time : (K,) array
        Instants, s; the positions at an instant are NaN if no frame has exactly this time.
    labels : sequence of str
        Distinct labels of M markers.
    axes : str
        ``xy`` in the plane or ``xyz`` in space.

    Returns
    -------
    (K, M, 2) or (K, M, 3) array
        Positions, m; NaN where a marker was not visible.
    """
    found = np.full((len(time), len(labels), len(axes)), np.nan)
    row = np.searchsorted(planar.time, time).clip(0, len(planar.time) - 1)
    own = np.flatnonzero(planar.time[row] == time)
    place = {label: k for k, label in enumerate(planar.labels)}
    known = [(k, place[label]) for k, label in enumerate(labels) if label in place]
    for to, column in known:
        for axis, name in enumerate(axes):
            found[own, to, axis] = planar.values[name][row[own], column]
    return found


@dataclass(frozen=True)
class Residual:
    """Distance of one marker from its prediction by the chain; NaN if the marker is never visible."""

    label: str
    segment: int  # -1 for a marker without a segment
    rms: float  # root mean square, m
    q95: float  # 95 % quantile, m
    seen: float  # fraction of frames in which the marker is visible


def compute_residuals(markers: LongTable | None, skeleton: Skeleton | SpatialSkeleton | None) -> dict[str, Residual]:
    """Return the residuals in ``markers.parquet`` by marker label; empty without this table or without frames."""
    if markers is None or not markers.length:
        return {}
    segment = {} if skeleton is None else dict(zip(skeleton.markers, skeleton.marker_segment.tolist(), strict=True))
    found = {}
    for label, column in zip(markers.labels, markers.values["residual"].T, strict=True):
        seen = column[np.isfinite(column)]
        rms, q95 = (np.sqrt(np.mean(seen**2)), np.quantile(seen, 0.95)) if seen.size else (np.nan, np.nan)
        found[label] = Residual(label, segment.get(label, -1), float(rms), float(q95), seen.size / column.size)
    return found
