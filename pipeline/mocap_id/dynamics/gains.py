"""Whether an external wrench is what the body feels: the factor that the movement would give it.

A plate read with the wrong sign, with its corners in the wrong place, or a sensor that tells what the body does to it,
fits no body: where it pushes, the forces do not add up. With a factor of its own for each component of the wrench, the
best fit tells what it should have been. A right one comes out at 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.prepare import Prepared
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.dynamics.uncertainty import block_covariance, time_blocks

_MATERIAL = 0.05  # of the weight: a smaller error of a force is one of its calibration
_LEVER = 0.5  # m, by which a force that matters makes a moment that does
_SPREADS = 4.0
_LOADED = 95.0  # percentile of a force's size that stands for its load
_DEPENDENT = 1e8  # condition number of unit columns that stands for linear dependence


@dataclass(frozen=True)
class Gain:
    """The factor of one component of one external wrench.

    Parameters
    ----------
    name : str
        The external wrench.
    component : str
        Fx, Fy or tauz.
    value, sd : float
        Factor with which the forces add up, 1 for a right wrench, and its standard deviation.
    size : float
        The component when it is loaded, N or N·m.
    limit : float
        An error of this size matters, N or N·m.
    """

    name: str
    component: str
    value: float
    sd: float
    size: float
    limit: float

    @property
    def contradicts(self) -> bool:
        """The wrench is wrong by what matters, beyond doubt."""
        away = abs(self.value - 1.0)
        return away > _SPREADS * self.sd and away * self.size > self.limit


def gains(prepared: Prepared, found: Fit) -> tuple[Gain, ...]:
    """Factors of the external wrenches' components, those left out that are too small to tell or to matter.

    Parameters
    ----------
    prepared : Prepared
    found : Fit
        On samples that hold the external wrenches.

    Returns
    -------
    tuple of Gain
        Empty where the movement does not tell them.
    """
    components = prepared.settings.components
    weight = float(np.nanpercentile(np.abs(prepared.recorded.wrench[:, 1]), _LOADED))
    limits = _MATERIAL * weight * np.array([1.0, 1.0, _LEVER])
    columns, asked = [], []
    for external, wrench in zip(prepared.recorded.external, prepared.external(found.offset, True), strict=True):
        at_samples = wrench[found.samples]
        for row, component in enumerate(components):
            size = float(np.nanpercentile(np.abs(at_samples[:, component]), _LOADED))
            if size > limits[component] / 2:  # of half that size not even a wrong sign would matter
                column = np.zeros(found.design.shape[:2])
                column[:, row] = -at_samples[:, component] * found.weights[row]
                columns.append(column)
                asked.append((external.name, WRENCH_COMPONENTS[component], size, float(limits[component])))
    if not columns:
        return ()
    solved = _solve(prepared, found, np.stack(columns, axis=-1))
    if solved is None:
        return ()
    return tuple(
        Gain(name, component, 1.0 + float(more), float(sd), size, limit)
        for (name, component, size, limit), more, sd in zip(asked, *solved, strict=True)
    )


def _solve(prepared: Prepared, found: Fit, columns: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """What the factors (k,) of weighted columns (R, c, k) exceed 1 by, and standard deviations.

    None where the columns cannot be told from the parameters' own.
    """
    time = prepared.recorded.time[found.samples]
    design = np.concatenate([found.design[..., :-1], columns], axis=-1)
    known = np.isfinite(design).all(axis=(1, 2))
    design, time, samples = design[known], time[known], found.samples[known]
    rows = design.reshape(-1, design.shape[-1])
    scale = np.linalg.norm(rows, axis=0)
    if not (scale > 0).all() or np.linalg.cond(rows / scale) > _DEPENDENT:
        return None
    total = prepared.filtered_measured(samples, time - found.offset)[:, list(prepared.settings.components)]
    target = (total * found.weights).reshape(-1)
    solution = np.linalg.lstsq(rows / scale, target, rcond=None)[0] / scale
    residual = (target - rows @ solution).reshape(len(time), -1)
    covariance = block_covariance(design, residual, time_blocks(time, prepared.settings.block))
    count = columns.shape[-1]
    return solution[-count:], np.sqrt(np.diag(covariance)[-count:])
