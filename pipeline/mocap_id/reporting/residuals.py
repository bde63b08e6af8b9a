"""How far each marker lies from where the chain predicts it."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray
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
    labels = markers["marker"].astype("category").cat
    codes, residual = labels.codes.to_numpy(), markers["residual"].to_numpy()
    groups = {str(label): residual[codes == code] for code, label in enumerate(labels.categories)}
    rows = {label: _told(group) for label, group in groups.items() if group.size}
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["rms", "q95", "seen"], dtype=np.float64)
    segment = {} if skeleton is None else dict(zip(skeleton.markers, skeleton.marker_segment.tolist(), strict=True))
    table["segment"] = [segment.get(label, -1) for label in table.index]
    return table


def _told(residual: FloatArray) -> tuple[float, float, float]:
    """Root mean square and 95 % quantile of a marker's residuals, m, and the share of frames that have one."""
    seen = residual[np.isfinite(residual)]
    if not seen.size:
        return np.nan, np.nan, 0.0
    return float(np.sqrt(np.mean(seen**2))), float(np.quantile(seen, 0.95)), seen.size / residual.size
