"""Check of external wrenches: a fit with a factor on each component, which is 1 for a correct wrench.

A plate may have the wrong sign or wrong corners, or a sensor may report the force of the body on the sensor instead of
the opposite force. Then no inertial parameters fit the samples in which the plate or sensor is loaded. The fitted
factors reveal the wrong component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.base_parameters import triangularise
from mocap_id.dynamics.fit import DEPENDENT, Fit
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.dynamics.uncertainty import estimate_covariance, number_blocks

_MATERIAL = 0.05  # fraction of the weight: a smaller error of a force may be due to its calibration
_LEVER = 0.5  # m: converts this error of a force to that of a moment
_SPREADS = 4.0
_LOADED = 95.0  # percentile of a component's size that counts as its load
_OWN = 0.25  # fraction of this error: a smaller independent part of a column is noise and error of the model


@dataclass(frozen=True)
class WrenchGain:
    """The factor of one component of one external wrench."""

    name: str  # name of the external wrench
    component: str  # Fx, Fy or tauz
    # value, sd: fitted factor of the component, 1 for a correct wrench, and its standard deviation
    value: float
    sd: float
    size: float  # magnitude of the component under load, N or N·m
    limit: float  # smallest error that is large enough for a caution, N or N·m

    @property
    def contradicts(self) -> bool:
        """Whether the error of the component is significant and larger than the limit."""
        away = abs(self.value - 1.0)
        return away > _SPREADS * self.sd and away * self.size > self.limit


@dataclass(frozen=True)
class _Column:
    """A component of an external wrench; ``values`` (R, c) are its weighted column in the fit, with a minus sign."""

    name: str
    component: str
    size: float
    limit: float
    weight: float
    values: FloatArray


def estimate_gains(prepared: PreparedTrial, result: Fit) -> tuple[WrenchGain, ...]:
    """Return the factors of the components of the external wrenches; empty if the movement determines none.

    Components that are too small, or too similar to the effect of the parameters, have no factor. ``result`` is a fit
    to samples with external wrenches.
    """
    candidates = _list_candidates(prepared, result)
    if not candidates:
        return ()
    finite = np.isfinite(np.stack([column.values for column in candidates]))
    known: BoolArray = np.all(finite, axis=(0, 2))
    body = result.design[known, :, :-1]
    columns = [column for column, own in zip(candidates, _have_own_parts(body, candidates, known), strict=True) if own]
    if not columns:
        return ()
    excess, sd = _solve(prepared, result, columns, known)
    return tuple(
        WrenchGain(column.name, column.component, 1.0 + float(away), float(spread), column.size, column.limit)
        for column, away, spread in zip(columns, excess, sd, strict=True)
    )


def _list_candidates(prepared: PreparedTrial, result: Fit) -> list[_Column]:
    """Return the components that are large enough to be tested."""
    weight = float(np.nanpercentile(np.abs(prepared.recorded.wrench[:, 1]), _LOADED))
    limits = _MATERIAL * weight * np.array([1.0, 1.0, _LEVER])
    columns = []
    for external, wrench in zip(prepared.recorded.external, prepared.external(result.offset, True), strict=True):
        for row, component in enumerate(prepared.settings.components):
            force, limit = wrench[result.samples, component], float(limits[component])
            size = float(np.nanpercentile(np.abs(force), _LOADED))
            if size > limit / 2:  # for a smaller component, not even a wrong sign would exceed the limit
                values = np.zeros(result.design.shape[:2])
                values[:, row] = -force * result.weights[row]
                name = WRENCH_COMPONENTS[component]
                columns.append(_Column(external.name, name, size, limit, float(result.weights[row]), values))
    return columns


def _have_own_parts(body: FloatArray, columns: list[_Column], known: BoolArray) -> list[bool]:
    """Return whether a sufficient part of each column is independent of all parameters and of the other columns."""
    rows = np.concatenate([body, np.stack([column.values[known] for column in columns], axis=-1)], axis=-1)
    flat = rows.reshape(-1, rows.shape[-1])
    norm = np.maximum(np.linalg.norm(flat, axis=0), np.finfo(float).tiny)
    left, size, right = np.linalg.svd(triangularise(flat / norm))
    inverse = (right.T / np.maximum(size, 1.0 / DEPENDENT)) @ left.T
    own = (norm / np.linalg.norm(inverse, axis=1))[-len(columns) :] / np.sqrt(len(rows))
    return [
        bool(part / column.weight > _OWN * column.limit) for part, column in zip(own.tolist(), columns, strict=True)
    ]


def _solve(
    prepared: PreparedTrial, result: Fit, columns: list[_Column], known: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the fitted factors minus 1 (k,) of the k columns, and their standard deviations (k,)."""
    samples = result.samples[known]
    time = prepared.recorded.time[samples]
    added = np.stack([column.values[known] for column in columns], axis=-1)
    design = np.concatenate([result.design[known, :, :-1], added], axis=-1)
    total = prepared.filtered_measured(samples, time - result.offset)[:, list(prepared.settings.components)]
    target = (total * result.weights).reshape(-1)
    rows = design.reshape(len(target), -1)
    scale = np.linalg.norm(rows, axis=0)
    solution = np.linalg.lstsq(rows / scale, target, rcond=None)[0] / scale
    residual = (target - rows @ solution).reshape(len(time), -1)
    covariance = estimate_covariance(design, residual, number_blocks(time, prepared.settings.block))
    return solution[-len(columns) :], np.sqrt(np.diag(covariance)[-len(columns) :])
