"""Whether an external wrench is what the body feels: the factor that the movement would give it.

A plate read with the wrong sign, with its corners in the wrong place, or a sensor that tells what the body does to it,
fits no body: where it pushes, the forces do not add up. With a factor of its own for each component of the wrench, the
best fit tells what it should have been. A right one comes out at 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.base import triangular_factor
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.prepare import Prepared
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.dynamics.uncertainty import block_covariance, time_blocks

_MATERIAL = 0.05  # of the weight: a smaller error of a force is one of its calibration
_LEVER = 0.5  # m, by which a force that matters makes a moment that does
_SPREADS = 4.0
_LOADED = 95.0  # percentile of a force's size that stands for its load
_DEPENDENT = 1e8  # condition number of unit columns that stands for linear dependence
_OWN = 0.25  # of what matters: less that is not like the body's own share is noise and the model's error


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


@dataclass(frozen=True)
class _Column:
    """A component of an external wrench as a column of the fit: ``values`` (R, c), weighted, with a minus."""

    name: str
    component: str
    size: float
    limit: float
    weight: float
    values: FloatArray


def gains(prepared: Prepared, found: Fit) -> tuple[Gain, ...]:
    """Factors of the external wrenches' components, but of those that are too small or too like the body's own share.

    Parameters
    ----------
    prepared : Prepared
    found : Fit
        On samples that hold the external wrenches.

    Returns
    -------
    tuple of Gain
        Empty where the movement tells none.
    """
    candidates = _candidates(prepared, found)
    if not candidates:
        return ()
    finite = np.isfinite(np.stack([column.values for column in candidates]))
    known: BoolArray = np.all(finite, axis=(0, 2))
    body = found.design[known, :, :-1]
    told = [column for column, own in zip(candidates, _own_parts(body, candidates, known), strict=True) if own]
    if not told:
        return ()
    more, sd = _solve(prepared, found, told, known)
    return tuple(
        Gain(column.name, column.component, 1.0 + float(away), float(spread), column.size, column.limit)
        for column, away, spread in zip(told, more, sd, strict=True)
    )


def _candidates(prepared: Prepared, found: Fit) -> list[_Column]:
    """Components that are large enough to be judged."""
    weight = float(np.nanpercentile(np.abs(prepared.recorded.wrench[:, 1]), _LOADED))
    limits = _MATERIAL * weight * np.array([1.0, 1.0, _LEVER])
    columns = []
    for external, wrench in zip(prepared.recorded.external, prepared.external(found.offset, True), strict=True):
        for row, component in enumerate(prepared.settings.components):
            force, limit = wrench[found.samples, component], float(limits[component])
            size = float(np.nanpercentile(np.abs(force), _LOADED))
            if size > limit / 2:  # of half that size not even a wrong sign would matter
                values = np.zeros(found.design.shape[:2])
                values[:, row] = -force * found.weights[row]
                name = WRENCH_COMPONENTS[component]
                columns.append(_Column(external.name, name, size, limit, float(found.weights[row]), values))
    return columns


def _own_parts(body: FloatArray, columns: list[_Column], known: BoolArray) -> list[bool]:
    """Whether enough of each column is its own, which no parameter nor another column could explain."""
    rows = np.concatenate([body, np.stack([column.values[known] for column in columns], axis=-1)], axis=-1)
    flat = rows.reshape(-1, rows.shape[-1])
    norm = np.maximum(np.linalg.norm(flat, axis=0), np.finfo(float).tiny)
    left, size, right = np.linalg.svd(triangular_factor(flat / norm))
    inverse = (right.T / np.maximum(size, 1.0 / _DEPENDENT)) @ left.T
    own = (norm / np.linalg.norm(inverse, axis=1))[-len(columns) :] / np.sqrt(len(rows))
    return [
        bool(part / column.weight > _OWN * column.limit) for part, column in zip(own.tolist(), columns, strict=True)
    ]


def _solve(prepared: Prepared, found: Fit, columns: list[_Column], known: BoolArray) -> tuple[FloatArray, FloatArray]:
    """What the factors (k,) of the columns exceed 1 by, and standard deviations."""
    samples = found.samples[known]
    time = prepared.recorded.time[samples]
    added = np.stack([column.values[known] for column in columns], axis=-1)
    design = np.concatenate([found.design[known, :, :-1], added], axis=-1)
    total = prepared.filtered_measured(samples, time - found.offset)[:, list(prepared.settings.components)]
    target = (total * found.weights).reshape(-1)
    rows = design.reshape(len(target), -1)
    scale = np.linalg.norm(rows, axis=0)
    solution = np.linalg.lstsq(rows / scale, target, rcond=None)[0] / scale
    residual = (target - rows @ solution).reshape(len(time), -1)
    covariance = block_covariance(design, residual, time_blocks(time, prepared.settings.block))
    return solution[-len(columns) :], np.sqrt(np.diag(covariance)[-len(columns) :])
