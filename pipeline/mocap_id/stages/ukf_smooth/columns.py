"""Columns of states.parquet and markers.parquet of a trial in the plane."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, as_complex, chunks
from mocap_id.estimation import States
from mocap_id.estimation.inverse_kinematics import MarkerChain
from mocap_id.geometry.planar import marker_positions
from mocap_id.store.views import Trajectories


def state_columns(time: FloatArray, mean: FloatArray, sd: FloatArray, observed: BoolArray) -> dict[str, Any]:
    """Return the columns of states.parquet by name.

    They are the time (F,), the states (F, n, 4), the standard deviations (F, n, 3 or 4) without that of the jerk, and
    the flags (F, n).
    """
    columns: dict[str, FloatArray | BoolArray] = {"time": time}
    for j in range(mean.shape[1]):
        for d, name in enumerate(("theta", "dtheta", "ddtheta", "dddtheta")):
            columns[f"{name}_{j + 1}"] = mean[:, j, d]
        for d, name in enumerate(("theta", "dtheta", "ddtheta")):
            columns[f"sd_{name}_{j + 1}"] = sd[:, j, d]
        columns[f"observed_{j + 1}"] = observed[:, j]
    return columns


def marker_columns(
    states: States, view: Trajectories, columns: IntArray, chain: MarkerChain
) -> dict[str, FloatArray | BoolArray]:
    """Return the marker positions ``x`` and ``y`` that the states predict (eq. 3.18), with ``residual`` and ``used``.

    ``chain`` includes the M markers of base and moving segments, and ``columns`` (M,) are the columns of these markers
    in the view. The results are (F, M). Positions, m, are NaN where an angle is missing. The residual, m, is the
    distance to the measured marker, and NaN where the marker is not visible. ``used`` marks the markers that the states
    use.
    """
    shape = (len(view.time), len(columns))
    used: BoolArray = np.zeros(shape, dtype=np.bool_)
    used[:, chain.segment > 0] = states.used
    x, y, residual = np.empty(shape), np.empty(shape), np.empty(shape)
    for part in chunks(len(view.time)):
        predicted = marker_positions(states.mean[part, :, 0], chain.centres, chain.segment, chain.local)
        x[part], y[part] = predicted[..., 0], predicted[..., 1]
        residual[part] = np.abs(as_complex(view.read_positions(columns, part, "xy", keep_bursts=True) - predicted))
    return {"x": x, "y": y, "residual": residual, "used": used}
