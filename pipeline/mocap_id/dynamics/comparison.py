"""Comparison of a model's wrench and centre of pressure with the measured ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.centre_of_pressure import centre_of_pressure
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS


@dataclass(frozen=True)
class Agreement:
    """Difference between model and measurement over some samples.

    Parameters
    ----------
    bias, sd : float
        Mean and standard deviation of model minus measurement.
    r2 : float
        Fraction of the measurement's variance that the model explains.
    """

    bias: float
    sd: float
    r2: float


@dataclass(frozen=True)
class Comparison:
    """Agreement of each wrench component and of the centre of pressure.

    Parameters
    ----------
    wrench : dict
        Agreement of each component by its name; None if fewer than two samples are known in both.
    cop_rms : float or None
        Root mean square difference of the centre of pressure, m.
    """

    wrench: dict[str, Agreement | None]
    cop_rms: float | None


def compare(wrench: FloatArray, measured: FloatArray, samples: BoolArray, threshold: float) -> Comparison:
    """Compare a model's wrench with the measured one.

    Parameters
    ----------
    wrench, measured : (T, 3) arrays
        Fx, Fy, tauz, N and N·m; NaN where unknown.
    samples : (T,) bool array
        Samples to compare: those in which the body touches only the ground.
    threshold : float
        Vertical force up to which there is no centre of pressure, N.
    """
    components = {name: agreement(wrench[:, k], measured[:, k], samples) for k, name in enumerate(WRENCH_COMPONENTS)}
    cop = agreement(centre_of_pressure(wrench, threshold), centre_of_pressure(measured, threshold), samples)
    return Comparison(components, None if cop is None else float(np.hypot(cop.bias, cop.sd)))


def agreement(model: FloatArray, measured: FloatArray, samples: BoolArray) -> Agreement | None:
    """Compare two series (T,) over the samples in which both are known; None if there are fewer than two."""
    both = samples & np.isfinite(model) & np.isfinite(measured)
    if both.sum() < 2:
        return None
    error, reference = (model - measured)[both], measured[both]
    spread = float(np.sum((reference - reference.mean()) ** 2))
    r2 = 1.0 - float(np.sum(error**2)) / spread if spread > 0.0 else float("nan")
    return Agreement(float(error.mean()), float(error.std()), r2)
