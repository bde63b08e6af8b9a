"""How far each marker lies from where the chain predicts it."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.reporting.views import Skeleton


def by_marker(markers: pd.DataFrame | None, skeleton: Skeleton | None) -> pd.DataFrame:
    """Residuals of ``markers.parquet`` by label.

    Returns
    -------
    DataFrame
        Indexed by label: ``segment`` (-1 = none), ``rms`` and ``q95`` (m; NaN where never seen), ``seen`` (0 … 1).
    """
    if markers is None or markers.empty:
        return pd.DataFrame({"segment": [], "rms": [], "q95": [], "seen": []}, dtype=np.float64)
    residual = markers["residual"]
    groups = residual.groupby(markers["marker"], observed=True)
    table = pd.DataFrame(
        {
            "rms": np.sqrt((residual**2).groupby(markers["marker"], observed=True).mean()),
            "q95": groups.quantile(0.95),
            "seen": groups.count() / groups.size(),
        }
    )
    table.index = pd.Index([str(label) for label in table.index])
    segment = {} if skeleton is None else dict(zip(skeleton.markers, skeleton.marker_segment.tolist(), strict=True))
    table["segment"] = [segment.get(label, -1) for label in table.index]
    return table
