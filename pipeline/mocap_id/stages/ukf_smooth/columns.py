"""Columns of states.parquet and markers.parquet of a trial in the plane."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, as_complex, chunks
from mocap_id.estimation import States
from mocap_id.estimation.inverse_kinematics import MarkerChain
from mocap_id.geometry.planar import marker_positions
from mocap_id.store.views import Trajectories


def state_columns(
    time: FloatArray, mean: FloatArray, sd: FloatArray, observed: BoolArray
) -> dict[str, FloatArray | BoolArray]:
    """Return time (F,), states (F, n, 4), standard deviations (F, n, 3 or 4) and flags (F, n) as columns."""
    columns: dict[str, FloatArray | BoolArray] = {"time": time}
    for j in range(mean.shape[1]):
        for d, name in enumerate(("theta", "dtheta", "ddtheta", "dddtheta")):
            columns[f"{name}_{j + 1}"] = mean[:, j, d]
        for d, name in enumerate(("theta", "dtheta", "ddtheta")):
            columns[f"sd_{name}_{j + 1}"] = sd[:, j, d]
        columns[f"observed_{j + 1}"] = observed[:, j]
    return columns


def predicted_markers(
    states: States, view: Trajectories, columns: IntArray, chain: MarkerChain
) -> dict[str, FloatArray | BoolArray]:
    """Return the markers that the joint states predict, ``x`` and ``y`` (eq. 3.18), with ``residual`` and ``used``.

    Parameters
    ----------
    states : States
    view : Trajectories
        Measured markers.
    columns : (M,) int array
        Columns of the chain's markers in the view.
    chain : Chain
        Including the markers of the base.

    Returns
    -------
    dict of str to (F, M) array
        m; NaN where an angle is not given. The residual is the distance to the measurement, NaN where the marker is not
        visible.
    """
    used: BoolArray = np.zeros((len(view.time), len(columns)), dtype=np.bool_)
    used[:, chain.segment > 0] = states.used
    names = ("x", "y", "residual")
    found = {name: np.empty((len(view.time), len(columns))) for name in names}
    for part in chunks(len(view.time)):
        predicted = marker_positions(states.mean[part, :, 0], chain.centres, chain.segment, chain.local)
        off = view.read_positions(columns, part, "xy", keep_bursts=True) - predicted
        residual = np.abs(as_complex(off))
        for name, values in zip(names, (predicted[..., 0], predicted[..., 1], residual), strict=True):
            found[name][part] = values
    return {**found, "used": used}
