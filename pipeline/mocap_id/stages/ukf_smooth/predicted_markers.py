"""Where the states put the markers, beside where they were seen."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.estimation import States
from mocap_id.estimation.inverse import Chain
from mocap_id.geometry.planar import marker_positions
from mocap_id.stages.trajectories import PlanarView


def beside_measured(
    states: States, view: PlanarView, columns: IntArray, chain: Chain
) -> dict[str, FloatArray | BoolArray]:
    """All markers of a chain: ``x``, ``y`` predicted (eq. 3.18), ``residual``, distance to the measurement, ``used``.

    Parameters
    ----------
    states : States
    view : PlanarView
        The measurement.
    columns : (M,) int array
        The chain's markers in the view.
    chain : Chain
        With the base's markers.

    Returns
    -------
    dict of str to (F, M) array
        m; NaN where an angle is not given, the residual where the marker is not seen either.
    """
    used: BoolArray = np.zeros((len(view.time), len(columns)), dtype=np.bool_)
    used[:, chain.segment > 0] = states.used
    names = ("x", "y", "residual")
    found = {name: np.empty((len(view.time), len(columns))) for name in names}
    for part in chunks(len(view.time)):
        predicted = marker_positions(states.mean[part, :, 0], chain.centres, chain.segment, chain.local)
        off = view.points(columns, part) - predicted
        residual = np.abs(off.view(np.complex128)[..., 0])
        for name, values in zip(names, (predicted[..., 0], predicted[..., 1], residual), strict=True):
            found[name][part] = values
    return {**found, "used": used}
