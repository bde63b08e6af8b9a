"""Centre of pressure, and agreement of a model's wrench and centre of pressure with the measured ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS


@dataclass(frozen=True)
class Agreement:
    """Difference between model and measurement over some samples."""

    # bias, sd: mean and standard deviation of model minus measurement
    bias: float
    sd: float
    r2: float  # fraction of the measurement's variance that the model explains


@dataclass(frozen=True)
class Comparison:
    """Agreement of each wrench component and of the centre of pressure."""

    # agreement of each component by its name; None if there are fewer than two common samples
    wrench: dict[str, Agreement | None]
    cop_rms: float | None  # rms difference of the centre of pressure, m; None with fewer than two common samples


def centre_of_pressure(wrench: FloatArray, threshold: float) -> FloatArray:
    """Return the x coordinate (...), m, at which the line of the ground's force crosses the plane y = 0.

    ``wrench`` (..., 3) is (Fx, Fy, tauz) about the origin of the plane frame, N and N·m. The result is NaN where Fy is
    at most ``threshold``, N.
    """
    vertical = wrench[..., 1]
    loaded = vertical > threshold
    return np.where(loaded, wrench[..., 2] / np.where(loaded, vertical, 1.0), np.nan)


def centre_of_pressure_rows(rows: FloatArray, wrench: FloatArray, threshold: float) -> FloatArray:
    """Return the derivative (..., b) of the centre of pressure with respect to the parameters of a linear wrench model.

    ``rows`` (..., 3, b) is the regressor of the wrench; the other arguments are as for :func:`centre_of_pressure`.
    """
    cop = centre_of_pressure(wrench, threshold)
    vertical = np.where(np.isfinite(cop), wrench[..., 1], np.nan)
    return (rows[..., 2, :] - cop[..., None] * rows[..., 1, :]) / vertical[..., None]


def compare(wrench: FloatArray, measured: FloatArray, samples: BoolArray, threshold: float) -> Comparison:
    """Compare a model's wrench (T, 3) with the measured wrench (T, 3) over the samples marked in ``samples`` (T,).

    Missing values are NaN. ``threshold`` and the components are as for :func:`centre_of_pressure`.
    """
    components = {name: agreement(wrench[:, k], measured[:, k], samples) for k, name in enumerate(WRENCH_COMPONENTS)}
    cop = agreement(centre_of_pressure(wrench, threshold), centre_of_pressure(measured, threshold), samples)
    return Comparison(components, None if cop is None else float(np.hypot(cop.bias, cop.sd)))


def agreement(model: FloatArray, measured: FloatArray, samples: BoolArray) -> Agreement | None:
    """Compare two series (T,) over the marked samples in which both have values; return None for fewer than two."""
    both = samples & np.isfinite(model) & np.isfinite(measured)
    if both.sum() < 2:
        return None
    error, reference = (model - measured)[both], measured[both]
    spread = float(np.sum((reference - reference.mean()) ** 2))
    r2 = 1.0 - float(np.sum(error**2)) / spread if spread > 0.0 else float("nan")
    return Agreement(float(error.mean()), float(error.std()), r2)
