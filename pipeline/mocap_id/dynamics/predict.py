"""What a model says the plate and the joints feel, and how well it can say it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.prepare import Prepared, Recorded
from mocap_id.dynamics.pressure import centre_of_pressure, centre_of_pressure_rows
from mocap_id.dynamics.regressor import planar_regressor, planar_torque_regressor
from mocap_id.dynamics.uncertainty import variance


@dataclass(frozen=True)
class Prediction:
    """A model's wrench, centre of pressure and joint torques.

    Parameters
    ----------
    wrench, wrench_sd : (T, 3) arrays
        Fx, Fy, tauz, N and N·m.
    cop, cop_sd : (T,) arrays
        Centre of pressure, m; NaN where the body does not load the plate.
    torque, torque_sd : (T, n) arrays
        Joint torques, N·m.
    """

    wrench: FloatArray
    wrench_sd: FloatArray
    cop: FloatArray
    cop_sd: FloatArray
    torque: FloatArray
    torque_sd: FloatArray


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


def predict(prepared: Prepared, found: Identification, threshold: float) -> Prediction:
    """Wrench, centre of pressure and joint torques of a model at every sample.

    The joint torques are combinations of the base parameters too: what the wrench does not feel, the joints do not.
    Standard deviations hold the parameters' covariance and the noise of the accelerations, which no parameter can
    improve; those of angles and velocities are small beside it. The wrench was fitted with this geometry, whose
    errors the parameters make up for: there the covariance from the residuals counts. The torques were not.

    Parameters
    ----------
    prepared : Prepared
    found : Identification
    threshold : float
        Vertical force under which there is no centre of pressure, N.
    """
    recorded, kept, base = prepared.recorded, prepared.base.kept, found.base
    rows = prepared.rows
    torque_rows = planar_torque_regressor(recorded.centres, recorded.q, prepared.regressor)[:, :, kept]
    wrench = rows @ base
    wrench_gain, torque_gain = _acceleration_gains(recorded, base, prepared)
    cop_gain = centre_of_pressure_rows(wrench_gain, wrench, threshold)
    cop_rows = centre_of_pressure_rows(rows, wrench, threshold)
    noise = recorded.ddq_sd**2
    return Prediction(
        wrench=wrench,
        wrench_sd=np.sqrt(variance(rows, found.residual_covariance) + np.einsum("tij,tj->ti", wrench_gain**2, noise)),
        cop=centre_of_pressure(wrench, threshold),
        cop_sd=np.sqrt(variance(cop_rows, found.residual_covariance) + np.einsum("tj,tj->t", cop_gain**2, noise)),
        torque=torque_rows @ base,
        torque_sd=np.sqrt(variance(torque_rows, found.covariance) + np.einsum("tij,tj->ti", torque_gain**2, noise)),
    )


def agreement(model: FloatArray, measured: FloatArray, samples: BoolArray) -> Agreement | None:
    """Compare two series (T,) over the samples where both are known; None where there are fewer than two."""
    both = samples & np.isfinite(model) & np.isfinite(measured)
    if both.sum() < 2:
        return None
    error, reference = (model - measured)[both], measured[both]
    spread = float(np.sum((reference - reference.mean()) ** 2))
    r2 = 1.0 - float(np.sum(error**2)) / spread if spread > 0.0 else float("nan")
    return Agreement(float(error.mean()), float(error.std()), r2)


def _acceleration_gains(recorded: Recorded, base: FloatArray, prepared: Prepared) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the wrench (T, 3, n) and the torques (T, n, n) by the joints' accelerations.

    Both are linear in the accelerations: the regressor of unit acceleration, at rest and without gravity, is it.
    """
    still = np.zeros_like(recorded.q)
    wrench, torque = [], []
    for joint in range(recorded.q.shape[1]):
        unit = np.zeros_like(recorded.q)
        unit[:, joint] = 1.0
        regressor = planar_regressor(recorded.centres, recorded.q, still, unit, gravity=0.0)
        wrench.append(regressor[:, :, prepared.base.kept] @ base)
        torque_rows = planar_torque_regressor(recorded.centres, recorded.q, regressor)
        torque.append(torque_rows[:, :, prepared.base.kept] @ base)
    return np.stack(wrench, axis=-1), np.stack(torque, axis=-1)
