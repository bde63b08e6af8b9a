"""Two-sensor identification (thesis 9.3): a wrench sensor built into a joint, beside the ground's.

The ground's wrench is dominated by the heavy segments, so it determines the parameters of a light distal segment badly.
A sensor in the joint before it carries that segment and everything beyond, less the measured external wrenches W_i that
act there, such as that of a handle: W = Σ_{k ≥ s} Y_k φ_k - Σ_{i: s_i ≥ s} W_i. Its fit is combined with that of the
ground by their covariances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.base_parameters import base_set
from mocap_id.dynamics.consistency import Consistency, fit_consistent
from mocap_id.dynamics.external_wrenches import ExternalWrench
from mocap_id.dynamics.fit import select
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.lowpass import known
from mocap_id.dynamics.point_grid import PointGrid
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS, planar_regressor
from mocap_id.dynamics.uncertainty import block_covariance, time_blocks
from mocap_id.geometry.planar import marker_positions

_ZEROS = (0, 2)  # components whose constant error is fitted too; that of Fy is the weight
_ROUNDS = 2  # weights from the residuals of the round before
_LEAST_SAMPLES = 50
_COMMON = 1e-6  # a parameter of the sensor that the ground's base parameters determine
_GAIN_SD = 0.005  # relative error of a sensor's scale
_SEED = 1  # of the noise of a sensor that is predicted


@dataclass(frozen=True)
class SensorFit:
    """Result of one built-in sensor: linear functions of the full parameters, with their covariance.

    Parameters
    ----------
    name : str
    rows : (d, 4(n + 1)) array
        From the full parameters to the base parameters of the part beyond the joint.
    values : (d,) array
    covariance : (d, d) array
    """

    name: str
    rows: FloatArray
    values: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of a wrench sensor's samples at the frames.

    Parameters
    ----------
    force : float
        N.
    moment : float
        About the joint, N·m.
    """

    force: float = 0.1
    moment: float = 0.002


def fit_sensor(prepared: PreparedTrial, gate: BoolArray, sensor: ExternalWrench) -> SensorFit | None:
    """Fit the part of the body beyond a joint to the wrench through the joint; None with too few samples.

    Parameters
    ----------
    prepared : PreparedTrial
        On the pinned chain.
    gate : (T,) bool array
        Samples without an unmeasured contact.
    sensor : ExternalWrench
        Its wrench on the segment, about the plane's origin.
    """
    size, first = prepared.regressor.shape[-1], len(PLANAR_PARAMETERS) * sensor.segment
    to_joint = _to_joint(prepared, sensor.segment)
    parts = [sensor.wrench, *_held_beyond(prepared, sensor.segment)]
    there = known(sum(parts[1:], parts[0]))[:, None]
    filtered = [prepared.lowpass(np.einsum("tij,tj->ti", to_joint, np.where(there, each, np.nan))) for each in parts]
    wrench = sum(filtered[1:], filtered[0])
    samples = np.flatnonzero(select(prepared, gate) & known(wrench))[:: prepared.step]
    if len(samples) < _LEAST_SAMPLES:
        return None
    rows = prepared.lowpass(to_joint @ prepared.regressor[:, :, first:])[samples]
    base = base_set(rows.reshape(-1, size - first))
    zero = np.broadcast_to(np.eye(3)[:, list(_ZEROS)], (len(samples), 3, len(_ZEROS)))
    design, target, weights = np.concatenate([rows[..., base.kept], zero], axis=-1), wrench[samples], np.ones(3)
    own, values = slice(len(base.kept)), np.zeros(design.shape[-1])
    for _ in range(_ROUNDS):
        fitted_with = weights
        values = _solve(design, target, weights)
        weights = 1.0 / np.maximum((target - design @ values).std(axis=0), 1e-9)
    weighted, residual = design * weights[:, None], (target - design @ values) * weights
    blocks = time_blocks(prepared.recorded.time[samples], prepared.settings.block)
    by_scale = [_solve(design, each[samples], fitted_with) for each in filtered]  # each sensor has a scale of its own
    covariance = block_covariance(weighted, residual, blocks)
    covariance += sum(np.outer(each, each) for each in by_scale) * _GAIN_SD**2
    whole = np.zeros((len(base.kept), size))
    whole[:, first:] = base.regrouping
    return SensorFit(sensor.name, whole, values[own], covariance[own, own])


def _solve(design: FloatArray, target: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the least squares of a design (R, 3, p) for wrenches (R, 3), with weights (3,) of the components."""
    weighted = design * weights[:, None]
    return CompressedProblem.of(weighted.reshape(-1, design.shape[-1]), (target * weights).reshape(-1)).free_solution()


def _held_beyond(prepared: PreparedTrial, segment: int) -> list[FloatArray]:
    """Return the external wrenches (T, 3) on a segment and beyond it."""
    each = zip(prepared.recorded.external, prepared.external(0.0), strict=True)
    return [wrench for external, wrench in each if external.segment >= segment]


def _to_joint(prepared: PreparedTrial, segment: int) -> FloatArray:
    """Return the matrices (T, 3, 3) that take wrenches about the plane's origin to the joint before a segment.

    There the moment has no part of the force's noise, whose lever about the origin is the height of the joint.
    """
    recorded, before = prepared.recorded, np.array([segment - 1])
    place = marker_positions(recorded.q, recorded.centres, before, recorded.centres[before])[:, 0]
    found = np.tile(np.eye(3), (len(place), 1, 1))
    found[:, 2, 0], found[:, 2, 1] = place[:, 1], -place[:, 0]
    return found


def with_sensors(
    alone: Identification,
    prepared: PreparedTrial,
    gate: BoolArray,
    grid: PointGrid,
    reference: FloatArray,
    *,
    consistency: Consistency = "grid",
) -> Identification:
    """Return the identification by the ground's wrench and by built-in sensors together.

    Parameters
    ----------
    alone : Identification
        By the ground's wrench; returned unchanged if there are no such sensors.
    prepared, gate, grid, reference, consistency
        As for :func:`mocap_id.dynamics.identification.identify`.
    """
    fits = (fit_sensor(prepared, gate, each) for each in prepared.recorded.built_in)
    sensors, regrouping = [each for each in fits if each is not None], prepared.base.regrouping
    if not sensors:
        return alone
    own = alone.covariance + sum(_disagreement(alone, regrouping, one) for one in sensors)
    base, covariance = _together([SensorFit("ground", regrouping, alone.base, own), *sensors])
    half = _half(covariance)
    problem = CompressedProblem.of(
        solve_triangular(half, np.eye(len(base)), lower=True), solve_triangular(half, base, lower=True)
    )
    solution = fit_consistent(problem, regrouping, grid=grid, reference=reference, consistency=consistency)
    gain = np.linalg.solve(own, covariance).T  # of the ground's values in the result
    return replace(
        alone,
        base=solution.parameters,
        gain=np.asarray(gain if alone.gain is None else gain @ alone.gain, dtype=np.float64),
        base_sd=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        residual_covariance=gain @ alone.residual_covariance @ gain.T,
        response=gain @ alone.response,
        solution=solution,
        masses=solution.masses,
        full=solution.full,
        with_foot=None,
    )


def _together(parts: Sequence[SensorFit]) -> tuple[FloatArray, FloatArray]:
    """Return the first part's base parameters (b,) and their covariance (b, b) from all parts together."""
    halves = [_half(each.covariance) for each in parts]
    rows = [solve_triangular(half, each.rows, lower=True) for half, each in zip(halves, parts, strict=True)]
    target = [solve_triangular(half, each.values, lower=True) for half, each in zip(halves, parts, strict=True)]
    spread = parts[0].rows @ np.linalg.pinv(np.concatenate(rows))
    return spread @ np.concatenate(target), spread @ spread.T


def predict_with_sensor(
    alone: Identification, prepared: PreparedTrial, gate: BoolArray, segment: int, noise: SensorNoise
) -> FloatArray | None:
    """Return the covariance (b, b) that the base parameters would have with a sensor that the trial does not have.

    The sensor's wrench is that of the identified body, with noise and with the torque of wrong accelerations. Errors
    that do not show in residuals, such as a plate's zero, cannot be predicted: with them, the real gain is larger.

    Parameters
    ----------
    alone : Identification
        By the ground's wrench.
    prepared, gate
        As for :func:`fit_sensor`.
    segment : int
        The sensor is in the joint before it.
    noise : SensorNoise

    Returns
    -------
    array or None
        None with too few samples.
    """
    recorded, rng = prepared.recorded, np.random.default_rng(_SEED)
    ddq = prepared.lowpass(rng.standard_normal(recorded.ddq.shape))
    moved = recorded.ddq + ddq * recorded.ddq_sd / np.nanstd(ddq, axis=0)
    rows = planar_regressor(recorded.centres, recorded.q, recorded.dq, moved, prepared.settings.gravity)
    first = len(PLANAR_PARAMETERS) * segment
    errors = rng.standard_normal((len(rows), 3)) * [noise.force, noise.force, noise.moment]
    about_origin = np.linalg.solve(_to_joint(prepared, segment), errors[..., None])[..., 0]
    wrench = rows[:, :, first:] @ alone.full[first:] + about_origin - sum(_held_beyond(prepared, segment))
    found = fit_sensor(prepared, gate, ExternalWrench("predicted", segment, wrench, by_plates=False))
    if found is None:
        return None
    return _together([SensorFit("ground", prepared.base.regrouping, alone.base, alone.covariance), found])[1]


def _disagreement(alone: Identification, regrouping: FloatArray, sensor: SensorFit) -> FloatArray:
    """Return what must be added to the ground's covariance (b, b) so that it agrees with a sensor.

    A constant error of a plate does not show in its residuals, but it moves the first moments of a light segment.
    """
    to_sensor = sensor.rows @ np.linalg.pinv(regrouping)
    size = np.abs(sensor.rows).max(axis=1)
    common = np.abs(to_sensor @ regrouping - sensor.rows).max(axis=1) < _COMMON * size
    to_sensor = to_sensor[common]
    if not common.any():
        return np.zeros_like(alone.covariance)
    away, seen = to_sensor @ alone.base - sensor.values[common], to_sensor @ alone.covariance @ to_sensor.T
    spread = seen + sensor.covariance[np.ix_(common, common)]
    factor = max(1.0, float(away @ np.linalg.solve(spread, away)) / len(away))
    back = np.linalg.pinv(to_sensor)
    return np.asarray((factor - 1.0) * back @ seen @ back.T)


def _half(covariance: FloatArray) -> FloatArray:
    """Return the lower triangular root of a covariance; rounding must not make it singular."""
    size = np.sqrt(np.diag(covariance))
    scaled = covariance / np.outer(size, size) + 1e-9 * np.eye(len(size))
    return np.asarray(size[:, None] * np.linalg.cholesky(scaled))
