"""How far a model's wrench and centre of pressure are from what the plates measure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.predict import Agreement, agreement
from mocap_id.dynamics.pressure import centre_of_pressure
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS


@dataclass(frozen=True)
class Comparison:
    """Model less measurement over some samples.

    Parameters
    ----------
    wrench : dict
        Of each component by its name; None where fewer than two samples are known on both sides.
    cop_rms : float or None
        Of the centre of pressure, m.
    """

    wrench: dict[str, Agreement | None]
    cop_rms: float | None


def compare(wrench: FloatArray, measured: FloatArray, samples: BoolArray, threshold: float) -> Comparison:
    """Compare a model's wrench (T, 3) with the measured one (T, 3).

    Parameters
    ----------
    wrench, measured : (T, 3) arrays
        Fx, Fy, tauz, N and N·m; NaN where unknown.
    samples : (T,) bool array
        Those that count: off the seat, where the ground is all that the body touches.
    threshold : float
        Vertical force up to which there is no centre of pressure, N.
    """
    components = {name: agreement(wrench[:, k], measured[:, k], samples) for k, name in enumerate(WRENCH_COMPONENTS)}
    cop = agreement(centre_of_pressure(wrench, threshold), centre_of_pressure(measured, threshold), samples)
    return Comparison(components, None if cop is None else float(np.hypot(cop.bias, cop.sd)))
