"""What a model says the plate and the joints feel, and how well it can say it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.base import spanned
from mocap_id.dynamics.composite import composite
from mocap_id.dynamics.external import relief, stacked
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.kinematic_error import torque_variance
from mocap_id.dynamics.lowpass import known
from mocap_id.dynamics.model_error import ModelError, model_error
from mocap_id.dynamics.prepare import Prepared, Recorded
from mocap_id.dynamics.pressure import centre_of_pressure, centre_of_pressure_rows
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS, WRENCH_COMPONENTS, torque_regressor
from mocap_id.dynamics.uncertainty import variance

_MOMENT = WRENCH_COMPONENTS.index("tauz")  # fitted wherever the torques are told: moments of inertia enter it alone


@dataclass(frozen=True)
class Prediction:
    """A model's wrench, centre of pressure and joint torques.

    Parameters
    ----------
    wrench, wrench_sd : (T, 3) arrays
        Fx, Fy, tauz of the ground, N and N·m: what the motion needs less what other surroundings are measured to do.
    cop, cop_sd : (T,) arrays
        Centre of pressure, m; NaN where the body does not load the plate.
    torque, torque_sd : (T, n) arrays
        Joint torques, N·m.
    untold : tuple of str
        Columns (Fx, Fy, tauz, cop_x, tau_1 …) that depend on parameters which the fitted components do not tell:
        they are NaN.
    """

    wrench: FloatArray
    wrench_sd: FloatArray
    cop: FloatArray
    cop_sd: FloatArray
    torque: FloatArray
    torque_sd: FloatArray
    untold: tuple[str, ...]


@dataclass(frozen=True)
class Agreement:
    """Model less measurement over some samples.

    Parameters
    ----------
    bias, sd : float
        Mean and standard deviation of the difference.
    r2 : float
        Share of the measurement's variance that the model explains.
    """

    bias: float
    sd: float
    r2: float


@dataclass(frozen=True)
class Noise:
    """Errors of a model's wrench and torques beside those of its parameters.

    Parameters
    ----------
    wrench : (T, 3, 3) array
        Covariance, N² and (N·m)².
    torque : (T, n) array
        Variance, (N·m)².
    """

    wrench: FloatArray
    torque: FloatArray


def predict(prepared: Prepared, found: Identification, noise: Noise, threshold: float) -> Prediction:
    """Wrench, centre of pressure and joint torques of a model at every sample.

    With Fy and tauz fitted, all of them are combinations of the base parameters: what the wrench does not feel, the
    joints do not. What is outside the span of the fitted components is NaN and named.

    Parameters
    ----------
    prepared : Prepared
    found : Identification
    noise : Noise
        :func:`chain_noise` or :func:`shown_noise`.
    threshold : float
        Vertical force up to which there is no centre of pressure, N.
    """
    base, own = found.base, found.residual_covariance
    full_torque = torque_regressor(prepared.motion, prepared.regressor)
    placed = np.isfinite(prepared.motion.joint).any(axis=(0, 2))
    told, torque_told = _told(prepared.regressor, prepared), _told(full_torque, prepared) & placed
    rows = np.where(told[:, None], prepared.rows, np.nan)
    torque_rows = np.where(torque_told[:, None], full_torque[:, :, prepared.base.kept], np.nan)
    elsewhere, relieved = _relief(prepared, found.fit.offset)
    wrench, torque = rows @ base - elsewhere, torque_rows @ base - relieved
    cop_rows = centre_of_pressure_rows(rows, wrench, threshold)
    cop_own = centre_of_pressure_rows(np.broadcast_to(np.eye(3), (len(wrench), 3, 3)), wrench, threshold)
    return Prediction(
        wrench=wrench,
        wrench_sd=np.sqrt(variance(rows, own) + np.einsum("tkk->tk", noise.wrench)),
        cop=centre_of_pressure(wrench, threshold),
        cop_sd=np.sqrt(variance(cop_rows, own) + _variance_of(cop_own[:, None], noise.wrench)[:, 0]),
        torque=torque,
        torque_sd=np.sqrt(variance(torque_rows, own) + noise.torque),
        untold=_untold(told, torque_told),
    )


def chain_noise(
    prepared: Prepared, found: Identification, correlation: FloatArray, centre_sd: FloatArray | None = None
) -> Noise:
    """Noise of the accelerations of a pinned chain; those of angles and velocities are small beside it.

    The noise has its shape, over time and between the joints, from the states, and its size from the plate
    (:mod:`mocap_id.dynamics.model_error`), which also shows the part of the wrench's error that does not follow it. The
    torques are moments like tauz, and their noise takes its size from that of tauz. The wrench was fitted with this
    geometry, whose errors the parameters make up for: there the covariance from the residuals counts. The torques were
    not fitted.

    Parameters
    ----------
    prepared : Prepared
    found : Identification
    correlation : (T, n, n) array
        Of the joint accelerations' errors.
    centre_sd : (n,) array, optional
        What the gaps of joints that may give way leave open of their centres, m.
    """
    recorded, base = prepared.recorded, found.base
    needed = np.where(_told(prepared.regressor, prepared)[:, None], prepared.rows, np.nan) @ base
    noise = correlation * recorded.ddq_sd[:, :, None] * recorded.ddq_sd[:, None, :]
    wrench_gain, torque_gain = _acceleration_gains(recorded, base, prepared)
    errors = _model_errors(prepared, found, needed, _variance_of(wrench_gain, noise))
    wrench_gain *= np.sqrt([error.scale for error in errors])[:, None]
    torque_gain *= np.sqrt(errors[_MOMENT].overall)
    steady = np.diag([error.steady for error in errors])
    geometry = torque_variance(prepared, base, found.error, found.response)
    if centre_sd is not None:
        geometry = geometry + _of_centres(prepared, found.full, centre_sd)
    return Noise(
        wrench=wrench_gain @ noise @ np.swapaxes(wrench_gain, 1, 2) + steady,
        torque=geometry + _variance_of(torque_gain, noise),
    )


def shown_noise(
    prepared: Prepared,
    found: Identification,
    residual: FloatArray,
    *,
    centre_sd: FloatArray,
    of_poses: FloatArray,
    parameters: float = 0.0,
) -> Noise:
    """Noise of measured motion, of the size that residuals show.

    Parameters
    ----------
    prepared : Prepared
    found : Identification
    residual : (T, 3) array
        Measured less modelled wrench, neither of them filtered by the fit's low-pass; of repetitions that were left
        out, where there are any; NaN elsewhere. The plate's white noise is taken off.
    centre_sd : (n,) array
        Standard deviation of each joint's centre, m; it moves the torque by the force through the joint.
    of_poses : (T, n) array
        Variance of the torques from errors of the poses that repeat with the movement, (N·m)².
    parameters : float
        Share of the squared residual that the fit has absorbed; 0 for repetitions that were left out.
    """
    recorded, size = prepared.recorded, len(prepared.regressor)
    seen = known(residual)
    correlation = np.corrcoef(residual[seen].T)
    nothing = np.zeros(size)
    errors = [model_error(residual[:, k], nothing, seen, recorded.rate) for k in range(3)]
    spread = np.array([np.var(residual[seen, k]) if e is None else e.steady for k, e in enumerate(errors)])
    spread = spread + np.mean(residual[seen], axis=0) ** 2
    covariance = correlation * np.sqrt(np.outer(spread, spread)) / max(1.0 - parameters, 0.1)
    jacobian = prepared.motion.jacobian
    moment = np.einsum("tcj,cd,tdj->tj", jacobian, covariance, jacobian)
    return Noise(
        wrench=np.broadcast_to(covariance, (size, 3, 3)),
        torque=moment + _of_centres(prepared, found.base, centre_sd) + of_poses,
    )


def _of_centres(prepared: Prepared, full: FloatArray, centre_sd: FloatArray) -> FloatArray:
    """Variance (T, n) of the torques from the joints' centres: the force through a joint times its error."""
    carried = np.repeat(prepared.motion.beyond, len(PLANAR_PARAMETERS), axis=1)  # (n, 4K)
    force = np.einsum("tcp,jp->tjc", prepared.regressor[:, :2], carried * full)
    return np.asarray(centre_sd**2 * np.sum(force**2, axis=2))


def agreement(model: FloatArray, measured: FloatArray, samples: BoolArray) -> Agreement | None:
    """Compare two series (T,) over the samples where both are known; None where there are fewer than two."""
    both = samples & np.isfinite(model) & np.isfinite(measured)
    if both.sum() < 2:
        return None
    error, reference = (model - measured)[both], measured[both]
    spread = float(np.sum((reference - reference.mean()) ** 2))
    r2 = 1.0 - float(np.sum(error**2)) / spread if spread > 0.0 else float("nan")
    return Agreement(float(error.mean()), float(error.std()), r2)


def _relief(prepared: Prepared, offset: float) -> tuple[FloatArray, FloatArray]:
    """What external wrenches take off the ground (T, 3) and off the joints (T, n)."""
    recorded = prepared.recorded
    wrenches, segment = stacked(recorded.external, prepared.external(offset), len(recorded.time))
    return relief(prepared.motion.jacobian, np.arange(1, recorded.q.shape[1] + 1), wrenches, segment)


def _told(regressor: FloatArray, prepared: Prepared) -> BoolArray:
    """Rows (k,) of a full regressor (T, k, p) that the base parameters decide."""
    return np.array([spanned(regressor[:, k], prepared.base) for k in range(regressor.shape[1])], dtype=np.bool_)


def _untold(told: BoolArray, torque_told: BoolArray) -> tuple[str, ...]:
    lost = [name for name, known in zip(WRENCH_COMPONENTS, told, strict=True) if not known]
    if {"Fy", "tauz"} & set(lost):
        lost.append("cop_x")
    return (*lost, *(f"tau_{j}" for j, known in enumerate(torque_told, start=1) if not known))


def _model_errors(
    prepared: Prepared, found: Identification, needed: FloatArray, noise: FloatArray
) -> tuple[ModelError, ...]:
    """Size of the model's error in each component; as the states say where the plate does not show it."""
    recorded = prepared.recorded
    residual = prepared.measured(found.fit.offset) - needed
    shown = [model_error(residual[:, k], noise[:, k], found.fit.in_fit, recorded.rate) for k in range(3)]
    found_errors = [error for error in shown if error is not None]
    usual = ModelError(0.0, 1.0, max((error.overall for error in found_errors), default=1.0))
    return tuple(usual if error is None else error for error in shown)


def _variance_of(gain: FloatArray, covariance: FloatArray) -> FloatArray:
    """Variance (T, k) of linear functions with gains (T, k, n) of errors with covariance (T, n, n)."""
    values: FloatArray = np.einsum("tki,tij,tkj->tk", gain, covariance, gain, optimize=True)
    return np.maximum(values, 0.0)


def _acceleration_gains(recorded: Recorded, base: FloatArray, prepared: Prepared) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the wrench (T, 3, n) and the torques (T, n, n) by the joints' accelerations.

    The base parameters stand for a body: the one whose other parameters, which were regrouped into them, are zero.
    """
    full = np.zeros(prepared.regressor.shape[-1])
    full[prepared.base.kept] = base
    mass, mx, my, inertia = full.reshape(-1, len(PLANAR_PARAMETERS)).T
    gains = composite(recorded.q, recorded.centres, mass, np.column_stack([mx, my]), inertia)
    return gains.wrench, gains.torque
