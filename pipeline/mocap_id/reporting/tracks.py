"""Markers as measured at chosen moments, out of the long table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.store import LongTable


def tracks(planar: LongTable, time: FloatArray, labels: Sequence[str]) -> FloatArray:
    """Positions in the plane of motion.

    Parameters
    ----------
    planar : LongTable
        ``planar.parquet``.
    time : (K,) array
        Moments, s; one that no frame has gives nothing.
    labels : sequence of str
        Of M markers, none twice.

    Returns
    -------
    (K, M, 2) array
        m; NaN where a marker is unseen.
    """
    found = np.full((len(time), len(labels), 2), np.nan)
    row = np.searchsorted(planar.time, time).clip(0, len(planar.time) - 1)
    own = np.flatnonzero(planar.time[row] == time)
    place = {label: k for k, label in enumerate(planar.labels)}
    known = [(k, place[label]) for k, label in enumerate(labels) if label in place]
    for to, column in known:
        for axis, name in enumerate(("x", "y")):
            found[own, to, axis] = planar.values[name][row[own], column]
    return found
