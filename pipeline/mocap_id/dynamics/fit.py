"""Least-squares fit of clock offset, weights and parameters, with their covariance, on chosen samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.base_parameters import triangular_factor
from mocap_id.dynamics.clock_offset import profile_offset
from mocap_id.dynamics.filtered_trial import FilteredTrial
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.left_out_samples import LEAST_SECONDS
from mocap_id.dynamics.lowpass import erode
from mocap_id.dynamics.prior_weight import REFERENCE, left_out_memory
from mocap_id.dynamics.uncertainty import block_covariance, time_blocks

Rows: TypeAlias = tuple[FloatArray, FloatArray]
"""Rows (r, b) and right-hand side (r,) of a least-squares problem."""

_ROUNDS = 2  # weights and offset depend on each other weakly: a second round changes them in the third digit
DEPENDENT = 1e8
"""Condition number with unit columns from which the columns count as linearly dependent."""
_SHARP = 0.01  # s: an offset less certain than this is not applied
_LEAST_SPREAD = 1e-4  # of a component's rms: smaller residuals are rounding and must not make a weight explode


@dataclass(frozen=True)
class Fit:
    """Unconstrained least-squares fit on chosen samples.

    Parameters
    ----------
    in_fit : (T,) bool array
        Usable samples within the gate, without the filter's reach at its edges.
    samples : (R,) int array
        Indices of the samples used in the fit: every :attr:`FilteredTrial.step`-th of ``in_fit``.
    base : int
        Number of base parameters b; the k nuisance parameters (constant errors of the plate) follow them.
    found, offset_sd : float
        Clock offset with the least residual and its standard deviation from the residuals, s. At the limit of the
        search there is no minimum.
    offset : float
        The offset used: ``found``, or 0 if it is not applied or not known.
    offset_known : bool
        Whether there is a minimum within the search's limit, with a standard deviation below 10 ms.
    applied : bool
        Whether ``offset`` is ``found``.
    weights : (c,) array
        Inverse residual spread of each component. With a prior, multiplied by the square root of the share of
        independent samples (:mod:`mocap_id.dynamics.prior_weight`), so that data and prior are weighted correctly.
    problem : CompressedProblem
        Weighted rows, b + k columns.
    design : (R, c, b + k + 1) array
        Weighted rows. The last column is the wrench's rate of change, along which a clock offset shifts the wrench.
    target : (R, c) array
        Weighted, filtered wrench at ``offset``.
    covariance : (b + k + 1, b + k + 1) array
        Covariance of base parameters, nuisance parameters and offset from the residuals.
    condition, condition_scaled : float
        Condition number of the stacked, filtered, gated minimal regressor, in SI units and with unit columns.
    prior : ((p, b + k) array, (p,) array) or None
        Rows and right-hand side of the prior; ``problem`` and ``covariance`` include it.
    """

    in_fit: BoolArray
    samples: IntArray
    base: int
    found: float
    offset_sd: float
    offset: float
    offset_known: bool
    applied: bool
    weights: FloatArray
    problem: CompressedProblem
    design: FloatArray
    target: FloatArray
    covariance: FloatArray
    condition: float
    condition_scaled: float
    prior: Rows | None = None

    def response(self, wrench: FloatArray) -> FloatArray:
        """Return the change of the solution (b + k + 1, s) that weighted errors (R, c, s) of the wrench cause."""
        rows = self.design.reshape(-1, self.design.shape[-1])
        errors = wrench.reshape(len(rows), -1)
        both = rows if self.prior is None else np.concatenate([rows, np.pad(self.prior[0], ((0, 0), (0, 1)))])
        factor = triangular_factor(both)
        half = solve_triangular(factor, rows.T @ errors, trans="T")
        return np.asarray(solve_triangular(factor, half))

    @property
    def prior_precision(self) -> FloatArray:
        """Precision matrix (b + k + 1, b + k + 1) of the prior; zeros without a prior."""
        size = self.design.shape[-1]
        own = np.zeros((0, size)) if self.prior is None else np.pad(self.prior[0], ((0, 0), (0, 1)))
        return np.asarray(own.T @ own)


def select(prepared: FilteredTrial, gate: BoolArray) -> BoolArray:
    """Return the samples to fit: usable ones within the gate, without the filter's reach at its edges."""
    return prepared.usable & erode(gate, prepared.lowpass.reach_samples)


def determined(prepared: FilteredTrial, gate: BoolArray) -> bool:
    """Return whether the gated samples determine the base parameters: a second of them, and no dependent columns.

    Columns are dependent if a joint rests throughout the gated samples.
    """
    chosen = select(prepared, gate)
    if chosen.sum() < LEAST_SECONDS * prepared.recorded.rate:
        return False
    if prepared.prior is not None:
        return True
    rows = prepared.filtered[np.flatnonzero(chosen)[:: prepared.step]]
    return conditions(rows[:, list(prepared.settings.components)])[1] < DEPENDENT


def fit(prepared: FilteredTrial, gate: BoolArray, like: Fit | None = None) -> Fit:
    """Fit base parameters, plate bias and clock offset to the gated samples.

    Parameters
    ----------
    prepared : FilteredTrial
    gate : (T,) bool array
        Samples in which the body touches only the ground.
    like : Fit, optional
        A fit of the same trial whose clock offset and weights are reused.
    """
    settings = prepared.settings
    in_fit = select(prepared, gate)
    samples = np.flatnonzero(in_fit)[:: prepared.step]
    time = prepared.recorded.time[samples]
    design = _design(prepared, samples)
    prior = _prior_rows(prepared, design)
    if like is not None:
        spread, weights, found, known = like.weights, like.weights, like.found, like.offset_known
    else:
        spread, weights, found, known = _searched(prepared, gate, samples, design)
    extended, covariance = _covariance(prepared, samples, found, design, weights)
    offset, offset_sd = found, float(np.sqrt(covariance[-1, -1]))
    known = known and offset_sd < _SHARP
    applied = known and settings.apply_offset
    if not applied:
        offset = 0.0
        target = _measured(prepared, samples, time)
        spread = _weights(prepared, design, target, spread)
        weights = _counted(prepared, gate, samples, design, target, weights=spread)
        extended, covariance = _covariance(prepared, samples, offset, design, weights)
    base = prepared.filtered.shape[-1]
    target = _measured(prepared, samples, time - offset) * weights
    condition, condition_scaled = conditions(design[..., :base])
    return Fit(
        in_fit=in_fit,
        samples=samples,
        base=base,
        found=found,
        offset_sd=offset_sd,
        offset=offset,
        offset_known=known,
        applied=applied,
        weights=weights,
        problem=_problem(extended[..., :-1], target, prior),
        design=extended,
        target=target,
        covariance=covariance,
        condition=condition,
        condition_scaled=condition_scaled,
        prior=prior,
    )


def _searched(
    prepared: FilteredTrial, gate: BoolArray, samples: IntArray, design: FloatArray
) -> tuple[FloatArray, FloatArray, float, bool]:
    """Return weights (without, with the share of independent samples), clock offset, whether it is a minimum."""
    prior, time = _prior_rows(prepared, design), prepared.recorded.time[samples]
    weights = spread = np.ones(len(prepared.settings.components))
    found, at_edge = 0.0, True
    for _ in range(_ROUNDS):
        found, at_edge = profile_offset(
            design,
            lambda times: _measured(prepared, samples, times),
            time,
            weights,
            prepared.settings.offset_limit,
            prior=prior,
        )
        target = _measured(prepared, samples, time - found)
        spread = _weights(prepared, design, target, spread)
        weights = _counted(prepared, gate, samples, design, target, weights=spread)
    return spread, weights, found, not at_edge


def _problem(design: FloatArray, target: FloatArray, prior: Rows | None) -> CompressedProblem:
    """Return the least-squares problem of weighted rows (R, c, b + k) and the prior."""
    rows, aim = design.reshape(-1, design.shape[-1]), target.reshape(-1)
    if prior is not None:
        rows, aim = np.concatenate([rows, prior[0]]), np.concatenate([aim, prior[1]])
    return CompressedProblem.of(rows, aim)


def _design(prepared: FilteredTrial, samples: IntArray) -> FloatArray:
    """Return the rows (R, c, b + k): filtered base columns and the nuisance columns.

    A constant error of Fx can be estimated, since gravity causes no constant Fx. A constant error of Fy or tauz has the
    same column as m1 or mx1; it cannot be separated and remains in these parameters.
    """
    components = prepared.settings.components
    rows = prepared.filtered[samples][:, list(components), :]
    if not prepared.constants:
        return rows
    bias = np.zeros((*rows.shape[:2], len(prepared.constants)))
    for column, component in enumerate(prepared.constants):
        bias[:, components.index(component), column] = 1.0
    return np.concatenate([rows, bias], axis=-1)


def _measured(prepared: FilteredTrial, samples: IntArray, stamped: FloatArray) -> FloatArray:
    return prepared.filtered_measured(samples, stamped)[..., list(prepared.settings.components)]


def _prior_rows(prepared: FilteredTrial, design: FloatArray) -> Rows | None:
    return None if prepared.prior is None else prepared.prior.rows(design.shape[-1])


def _residual(design: FloatArray, target: FloatArray, prior: Rows | None) -> FloatArray:
    """Return the least-squares residual (R, c) of the data."""
    return target - design @ _problem(design, target, prior).free_solution()


def _weights(prepared: FilteredTrial, design: FloatArray, target: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the inverse residual spread of each component after a fit; with a prior, at :data:`REFERENCE`."""
    residual = _residual(design * weights[:, None], target * weights, _prior_rows(prepared, design)) / weights
    floor = _LEAST_SPREAD * np.sqrt(np.mean(target**2, axis=0))
    found = np.asarray(1.0 / np.maximum(residual.std(axis=0), floor))
    return found if prepared.prior is None else found * np.sqrt(_share(prepared, REFERENCE))


def _share(prepared: FilteredTrial, seconds: float) -> float:
    """Return the share of the fit's samples that are independent if this time counts as one sample."""
    return min(1.0, prepared.step / prepared.recorded.rate / seconds)


def _counted(
    prepared: FilteredTrial,
    gate: BoolArray,
    samples: IntArray,
    design: FloatArray,
    target: FloatArray,
    *,
    weights: FloatArray,
) -> FloatArray:
    """Return the weights times the share of independent samples that predicts left-out repetitions well."""
    prior = _prior_rows(prepared, design)
    if prior is None or prepared.prior is None:
        return weights
    inverse = weights / np.sqrt(_share(prepared, REFERENCE))
    seconds = left_out_memory(
        prepared, gate, samples, rows=design * inverse[:, None], target=target * inverse, prior=prior
    )
    return np.asarray(inverse * np.sqrt(_share(prepared, seconds)))


def _covariance(
    prepared: FilteredTrial, samples: IntArray, offset: float, design: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return weighted rows with the column of the offset, and the parameters' covariance from the residuals."""
    time = prepared.recorded.time[samples]
    rate = prepared.filtered_wrench.rate_of_change(time - offset)[:, list(prepared.settings.components)]
    prior = _prior_rows(prepared, design)
    weighted = design * weights[:, None]
    extended = np.concatenate([weighted, (rate * weights)[..., None]], axis=-1)
    residual = _residual(weighted, _measured(prepared, samples, time - offset) * weights, prior)
    blocks = time_blocks(time, prepared.settings.block)
    more = None if prior is None else np.pad(prior[0], ((0, 0), (0, 1)))
    loose = 1.0 if prepared.prior is None else prepared.prior.spread
    return extended, block_covariance(extended, residual, blocks, more, loose)


def conditions(rows: FloatArray) -> tuple[float, float]:
    """Return the 2-norm condition number of stacked rows (R, c, b), in SI units and with unit columns."""
    factor = triangular_factor(rows.reshape(-1, rows.shape[-1]))
    size = np.linalg.norm(factor, axis=0)
    return float(np.linalg.cond(factor)), float(np.linalg.cond(factor / np.where(size > 0.0, size, 1.0)))
