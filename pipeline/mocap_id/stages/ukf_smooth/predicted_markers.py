"""Marker positions predicted from the joint states, and their residuals: markers.parquet."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, as_complex, chunks
from mocap_id.estimation import States
from mocap_id.estimation.inverse_kinematics import MarkerChain
from mocap_id.geometry.planar import marker_positions
from mocap_id.store.views import Trajectories


def predicted_markers(
    states: States, view: Trajectories, columns: IntArray, chain: MarkerChain
) -> dict[str, FloatArray | BoolArray]:
    """Return predicted ``x``, ``y`` (eq. 3.18), ``residual`` (distance to the measurement) and ``used`` of all markers.

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
        m; NaN where an angle is not given. The residual is also NaN where the marker is not visible.
    """
    used: BoolArray = np.zeros((len(view.time), len(columns)), dtype=np.bool_)
    used[:, chain.segment > 0] = states.used
    names = ("x", "y", "residual")
    found = {name: np.empty((len(view.time), len(columns))) for name in names}
    for part in chunks(len(view.time)):
        predicted = marker_positions(states.mean[part, :, 0], chain.centres, chain.segment, chain.local)
        off = view.points(columns, part) - predicted
        residual = np.abs(as_complex(off))
        for name, values in zip(names, (predicted[..., 0], predicted[..., 1], residual), strict=True):
            found[name][part] = values
    return {**found, "used": used}
