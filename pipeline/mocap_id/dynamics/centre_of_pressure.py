"""Centre of pressure: the point at which the line of the ground's force crosses the plate's surface."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray


def centre_of_pressure(wrench: FloatArray, threshold: float) -> FloatArray:
    """Return the x coordinate of the centre of pressure on the plane y = 0.

    Parameters
    ----------
    wrench : (..., 3) array
        (Fx, Fy, tauz) about the plane-frame origin, N, N·m.
    threshold : float
        Vertical force up to which there is no meaningful centre of pressure, N.

    Returns
    -------
    (...) array
        tauz / Fy, m; NaN up to the threshold.
    """
    vertical = wrench[..., 1]
    loaded = vertical > threshold
    return np.where(loaded, wrench[..., 2] / np.where(loaded, vertical, 1.0), np.nan)


def centre_of_pressure_rows(rows: FloatArray, wrench: FloatArray, threshold: float) -> FloatArray:
    """Return the derivative of the centre of pressure with respect to the parameters of a linear wrench model.

    Parameters
    ----------
    rows : (..., 3, b) array
        Regressor of the wrench.
    wrench : (..., 3) array
        The model's wrench at the parameters.
    threshold : float
        As in :func:`centre_of_pressure`.

    Returns
    -------
    (..., b) array
        m per unit of the parameter; NaN up to the threshold.
    """
    cop = centre_of_pressure(wrench, threshold)
    vertical = np.where(np.isfinite(cop), wrench[..., 1], np.nan)
    return (rows[..., 2, :] - cop[..., None] * rows[..., 1, :]) / vertical[..., None]
