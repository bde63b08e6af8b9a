"""Markers as measured at chosen moments, out of the long table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray


def tracks(planar: pd.DataFrame, time: FloatArray, labels: Sequence[str]) -> FloatArray:
    """Positions in the plane of motion.

    Parameters
    ----------
    planar : DataFrame
        ``planar.parquet``, sorted by time.
    time : (K,) array
        Moments, s; a moment that is in no row gives nothing.
    labels : sequence of str
        Of M markers, none twice.

    Returns
    -------
    (K, M, 2) array
        m; NaN where a marker is unseen.
    """
    own = planar["time"].to_numpy(dtype=np.float64)
    first, last = np.searchsorted(own, time), np.searchsorted(own, time, side="right")
    size = last - first
    moment = np.repeat(np.arange(len(time)), size)
    row = np.arange(size.sum()) + np.repeat(first - np.concatenate([[0], np.cumsum(size)[:-1]]), size)
    place = {label: k for k, label in enumerate(labels)}
    column = np.array([place.get(str(label), -1) for label in planar["marker"].cat.categories], dtype=np.int64)
    code = column[planar["marker"].cat.codes.to_numpy()[row]]
    wanted = code >= 0
    found = np.full((len(time), len(labels), 2), np.nan)
    for k, axis in enumerate(("x", "y")):
        found[moment[wanted], code[wanted], k] = planar[axis].to_numpy(dtype=np.float64)[row[wanted]]
    return found
