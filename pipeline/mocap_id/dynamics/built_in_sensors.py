"""Two-sensor identification (thesis 9.3): a wrench sensor built into a joint, in addition to the sensor in the ground.

The heavy segments dominate the ground's wrench, so it determines the parameters of a light distal segment badly. A
sensor in the joint before this segment measures W = Σ_{k ≥ s} Y_k φ_k - Σ_{i: s_i ≥ s} W_i. The first sum is the wrench
that the segment s and all segments beyond it require. W_i are measured external wrenches on these segments, such as the
wrench of a handle. The results of both sensors are combined with weights from their covariances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import BoolArray, FloatArray, find_complete_rows
from mocap_id.dynamics.consistency import Consistency, PointGrid, fit_consistent
from mocap_id.dynamics.fit import select_samples
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import (
    PLANAR_PARAMETERS,
    CompressedProblem,
    ExternalWrench,
    estimate_covariance,
    number_blocks,
    planar_regressor,
    regroup_columns,
)
from mocap_id.geometry.planar import marker_positions

_ZEROS = (0, 2)  # components whose constant error is fitted; that of Fy cannot be separated from the weight
_ROUNDS = 2  # number of rounds; the weights follow from the residuals of the previous round
_LEAST_SAMPLES = 50
_COMMON = 1e-6  # relative distance below which the ground's base parameters determine a parameter of the sensor
_GAIN_SD = 0.005  # relative error of a sensor's scale
_FORCE_NOISE, _MOMENT_NOISE = 0.1, 0.002  # N, N·m: standard deviations of a sample of each force, and of the moment
_SEED = 1  # seed of the noise of a predicted sensor


SensorFit: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Result of one sensor: linear functions of the full parameters, with their covariance.

Matrix (d, 4(n + 1)) from the full parameters to the base parameters of the part beyond the joint, the fitted base
parameters (d,) of this part, and their covariance (d, d).
"""


def fit_sensor(prepared: PreparedTrial, gate: BoolArray, sensor: ExternalWrench) -> SensorFit | None:
    """Fit the base parameters of the part of the body beyond a joint; return None if there are too few samples.

    The trial is prepared with the motion of the chain, not with measured poses. ``sensor`` is about the plane's origin.
    """
    size, first = prepared.regressor.shape[-1], len(PLANAR_PARAMETERS) * sensor.segment
    to_joint = _move_to_joint(prepared, sensor.segment)
    parts = [sensor.wrench, *_list_wrenches_beyond(prepared, sensor.segment)]
    there = find_complete_rows(sum(parts[1:], parts[0]))[:, None]
    filtered = [prepared.lowpass(np.einsum("tij,tj->ti", to_joint, np.where(there, each, np.nan))) for each in parts]
    wrench = sum(filtered[1:], filtered[0])
    samples = np.flatnonzero(select_samples(prepared, gate) & find_complete_rows(wrench))[:: prepared.lowpass.step]
    if len(samples) < _LEAST_SAMPLES:
        return None
    rows = prepared.lowpass(to_joint @ prepared.regressor[:, :, first:])[samples]
    base = regroup_columns(rows.reshape(-1, size - first))
    zero = np.broadcast_to(np.eye(3)[:, list(_ZEROS)], (len(samples), 3, len(_ZEROS)))
    design, target, weights = np.concatenate([rows[..., base.kept], zero], axis=-1), wrench[samples], np.ones(3)
    own, values = slice(len(base.kept)), np.zeros(design.shape[-1])
    for _ in range(_ROUNDS):
        fitted_with = weights
        values = _solve(design, target, weights)
        weights = 1.0 / np.maximum((target - design @ values).std(axis=0), 1e-9)
    weighted, residual = design * weights[:, None], (target - design @ values) * weights
    blocks = number_blocks(prepared.recorded.time[samples], prepared.settings.block)
    by_scale = [_solve(design, each[samples], fitted_with) for each in filtered]  # each has its own error of scale
    covariance = estimate_covariance(weighted, residual, blocks)
    covariance += sum(np.outer(each, each) for each in by_scale) * _GAIN_SD**2
    whole = np.zeros((len(base.kept), size))
    whole[:, first:] = base.regrouping
    return whole, values[own], covariance[own, own]


def _solve(design: FloatArray, target: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the least-squares solution of a design (R, 3, p) for wrenches (R, 3), with weights (3,)."""
    weighted = design * weights[:, None]
    return CompressedProblem.of(weighted.reshape(-1, design.shape[-1]), (target * weights).reshape(-1)).free_solution()


def _list_wrenches_beyond(prepared: PreparedTrial, segment: int) -> list[FloatArray]:
    """Return the external wrenches (T, 3) on a segment and on all segments beyond it."""
    each = zip(prepared.recorded.external, prepared.external(0.0), strict=True)
    return [wrench for external, wrench in each if external.segment >= segment]


def _move_to_joint(prepared: PreparedTrial, segment: int) -> FloatArray:
    """Return matrices (T, 3, 3) from wrenches about the origin to wrenches about the joint before a segment.

    The noise of the force does not affect the moment about the joint, but it affects the moment about the origin, in
    proportion to the joint's height.
    """
    recorded, before = prepared.recorded, np.array([segment - 1])
    place = marker_positions(recorded.q, recorded.centres, before, recorded.centres[before])[:, 0]
    matrices = np.tile(np.eye(3), (len(place), 1, 1))
    matrices[:, 2, 0], matrices[:, 2, 1] = place[:, 1], -place[:, 0]
    return matrices


def combine_with_sensors(
    alone: Identification,
    prepared: PreparedTrial,
    gate: BoolArray,
    grid: PointGrid,
    reference: FloatArray,
    *,
    consistency: Consistency = "grid",
) -> Identification:
    """Return the identification from the ground's wrench and the built-in sensors that have enough samples."""
    fits = (fit_sensor(prepared, gate, each) for each in prepared.recorded.built_in)
    sensors, regrouping = [each for each in fits if each is not None], prepared.base.regrouping
    if not sensors:
        return alone
    # The residuals of a plate do not contain its constant error, but this error changes the first moments of a light
    # segment. The covariance of the ground's result grows until this result agrees with each sensor.
    added: FloatArray | int = 0
    for rows, values, spread_of in sensors:
        to_sensor = rows @ np.linalg.pinv(regrouping)
        size = np.abs(rows).max(axis=1)
        common = np.abs(to_sensor @ regrouping - rows).max(axis=1) < _COMMON * size
        if not common.any():
            continue
        to_sensor = to_sensor[common]
        away, seen = to_sensor @ alone.base - values[common], to_sensor @ alone.covariance @ to_sensor.T
        spread = seen + spread_of[np.ix_(common, common)]
        factor = max(1.0, float(away @ np.linalg.solve(spread, away)) / len(away))
        back = np.linalg.pinv(to_sensor)
        added = added + (factor - 1.0) * back @ seen @ back.T
    own = alone.covariance + added
    base, covariance = _combine([(regrouping, alone.base, own), *sensors])
    half = _factorise(covariance)
    whitened, target = (solve_triangular(half, each, lower=True) for each in (np.eye(len(base)), base))
    problem = CompressedProblem.of(whitened, target)
    solution = fit_consistent(problem, regrouping, grid=grid, reference=reference, consistency=consistency)
    gain = np.linalg.solve(own, covariance).T  # weight of the ground's values in the result
    return replace(
        alone,
        base=solution.parameters,
        gain=np.asarray(gain if alone.gain is None else gain @ alone.gain, dtype=np.float64),
        base_sd=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        residual_covariance=gain @ alone.residual_covariance @ gain.T,
        response=gain @ alone.response,
        solution=solution,
        with_foot=None,
    )


def _combine(parts: Sequence[SensorFit]) -> tuple[FloatArray, FloatArray]:
    """Estimate the base parameters (b,) of the first part, and their covariance (b, b), from all parts together."""
    rows, target = [], []
    for own, values, covariance in parts:
        half = _factorise(covariance)
        rows.append(solve_triangular(half, own, lower=True))
        target.append(solve_triangular(half, values, lower=True))
    spread = parts[0][0] @ np.linalg.pinv(np.concatenate(rows))
    return spread @ np.concatenate(target), spread @ spread.T


def predict_with_sensor(
    alone: Identification, prepared: PreparedTrial, gate: BoolArray, segment: int
) -> FloatArray | None:
    """Predict the covariance (b, b) of the base parameters if a sensor were also built into a joint of the chain.

    It is the joint before ``segment``. The sensor's wrench is computed from the identified body, with noise and with
    the effect of wrong accelerations. Errors that residuals do not contain, such as that of a plate's zero, cannot be
    predicted, so the real improvement is larger. The result is None if there are too few samples.
    """
    recorded, rng = prepared.recorded, np.random.default_rng(_SEED)
    ddq = prepared.lowpass(rng.standard_normal(recorded.ddq.shape))
    moved = recorded.ddq + ddq * recorded.ddq_sd / np.nanstd(ddq, axis=0)
    rows = planar_regressor(recorded.centres, recorded.q, recorded.dq, moved, prepared.settings.gravity)
    first = len(PLANAR_PARAMETERS) * segment
    errors = rng.standard_normal((len(rows), 3)) * [_FORCE_NOISE, _FORCE_NOISE, _MOMENT_NOISE]
    about_origin = np.linalg.solve(_move_to_joint(prepared, segment), errors[..., None])[..., 0]
    wrench = rows[:, :, first:] @ alone.full[first:] + about_origin - sum(_list_wrenches_beyond(prepared, segment))
    predicted = fit_sensor(prepared, gate, ExternalWrench("predicted", segment, wrench, by_plates=False))
    if predicted is None:
        return None
    return _combine([(prepared.base.regrouping, alone.base, alone.covariance), predicted])[1]


def _factorise(covariance: FloatArray) -> FloatArray:
    """Return the lower triangular root of a covariance, regularised against rounding errors."""
    size = np.sqrt(np.diag(covariance))
    scaled = covariance / np.outer(size, size) + 1e-9 * np.eye(len(size))
    return np.asarray(size[:, None] * np.linalg.cholesky(scaled))
