"""Predicted covariance of the base parameters for a movement that was not recorded.

The chain, the parameters, the noise and the skin model are those of a trial; the regressor is computed for the other
movement. The covariance has three parts: residuals, geometry (joint centres and skin) and plate zero. The first two are
scaled so that the prediction for the trial's own movement is exactly what was identified. The derivation is in
docs/concepts/predicted-covariance.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.design.trajectory import Trajectory
from mocap_id.dynamics.fit import conditions
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.kinematic_error import KinematicError, kinematic_response
from mocap_id.dynamics.lowpass import LowPass, cutoff_from_velocity, erode
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.dynamics.uncertainty import unit_covariance, variance

SAMPLES = 200
"""Number of samples of a movement that its variances are computed from."""


@dataclass(frozen=True)
class PredictedUncertainty:
    """Predicted uncertainty of the base parameters after a movement.

    Parameters
    ----------
    sd : (b,) array
        Standard deviation of each base parameter, SI.
    covariance : (b, b) array
        Covariance of the base parameters.
    condition, condition_scaled : float
        Condition number of the stacked, gated minimal regressor, in SI units and with unit columns.
    samples : float
        Length of the fitted samples, s.
    fixed : (b,) array
        Part of the variance that no movement changes: that of the errors of plate and cameras.
    """

    sd: FloatArray
    covariance: FloatArray
    condition: float
    condition_scaled: float
    samples: float
    fixed: FloatArray


@dataclass(frozen=True)
class IdentifiedBody:
    """Properties of an identified body that do not depend on its movement.

    Parameters
    ----------
    prepared : PreparedTrial
    found : Identification
    """

    prepared: PreparedTrial
    found: Identification

    def regressor(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the base columns (T, 3, b) of all three wrench components."""
        rows = planar_regressor(self.prepared.recorded.centres, q, dq, ddq, self.prepared.settings.gravity)
        return rows[:, :, self.prepared.base.kept]

    def wrench(self, movement: Trajectory) -> FloatArray:
        """Return the wrench of the ground (T, 3), N and N·m."""
        return np.asarray(self.regressor(movement.q, movement.dq, movement.ddq) @ self.found.base)

    def moment_sd(self, movement: Trajectory) -> FloatArray:
        """Return the standard deviation (T,) of that wrench's moment from the parameters' covariance, N·m."""
        rows = self.regressor(movement.q, movement.dq, movement.ddq)[:, 2]
        return np.asarray(np.sqrt(variance(rows, self.found.covariance)))

    def weighted_rows(self, regressor: FloatArray, rate_of_change: FloatArray) -> FloatArray:
        """Return rows (R, c, b + k + 1) weighted as in the fit.

        Parameters
        ----------
        regressor, rate_of_change : (R, 3, b) arrays
            Base columns and their time derivative. A clock offset shifts the wrench along its rate of change.
        """
        fit, chosen = self.found.fit, list(self.prepared.settings.components)
        rows, rate = regressor[:, chosen], rate_of_change[:, chosen] @ self.found.base
        bias = np.zeros((*rows.shape[:2], fit.problem.factor.shape[1] - fit.base))
        if bias.shape[-1]:
            bias[:, chosen.index(0), 0] = 1.0
        return np.asarray(np.concatenate([rows, bias, rate[..., None]], axis=-1) * fit.weights[:, None])

    def response(self, states: FloatArray, rows: FloatArray, error: KinematicError) -> FloatArray:
        """Return the change (b, S) of the parameters with each mode of the geometry's error; infinite if undetermined.

        Parameters
        ----------
        states : (R, 3, n) array
        rows : (R, c, b + k + 1) array
        error : KinematicError
        """
        q, dq, ddq = np.swapaxes(states, 0, 1)
        moved = replace(self.prepared, recorded=replace(self.prepared.recorded, q=q, dq=dq, ddq=ddq))
        found = replace(self.found.fit, samples=np.arange(len(rows)), design=rows)
        try:
            return kinematic_response(moved, found, self.found.base, error)[: found.base]
        except np.linalg.LinAlgError:
            return np.full((found.base, 1), np.inf)


@dataclass(frozen=True)
class _UnscaledCovariance:
    """Parts of the covariance before they are scaled by those of the trial."""

    noise: FloatArray  # (b, b), for unit residuals over one second
    geometry: FloatArray  # (b, b)


@dataclass(frozen=True)
class CovariancePredictor:
    """Predicts the covariance of a trial's parameters for other movements.

    Parameters
    ----------
    body : IdentifiedBody
    geometry : callable
        From postures (T, n), rad, to the geometry's error for a chain that is fitted to these postures.
    own : Trajectory
        The trial's movement.
    now : PredictedUncertainty
        The identified uncertainty of the trial itself.
    """

    body: IdentifiedBody
    geometry: Callable[[FloatArray], KinematicError]
    own: Trajectory
    now: PredictedUncertainty
    _own_parts: _UnscaledCovariance

    @classmethod
    def from_trial(
        cls,
        body: IdentifiedBody,
        own: Trajectory,
        geometry: Callable[[FloatArray], KinematicError] | None = None,
    ) -> CovariancePredictor:
        """Build the predictor of a trial.

        Parameters
        ----------
        body : IdentifiedBody
        own : Trajectory
            The recorded movement.
        geometry : callable, optional
            As in :class:`CovariancePredictor`; by default the geometry's error is that of the trial.
        """
        found, fit = body.found, body.found.fit
        known = found.error
        of_postures = (lambda q: known) if geometry is None else geometry
        now = PredictedUncertainty(
            sd=found.base_sd,
            covariance=found.covariance,
            condition=fit.condition,
            condition_scaled=fit.condition_scaled,
            samples=float(fit.in_fit.sum()) / body.prepared.recorded.rate,
            fixed=_variance_parts(found)[2],
        )
        empty = _UnscaledCovariance(np.zeros((0, 0)), np.zeros((0, 0)))
        unscaled = cls(body, of_postures, own, now, empty)
        return replace(unscaled, _own_parts=unscaled._parts(own, unscaled.fitted(own), SAMPLES))

    def predict(
        self, movement: Trajectory, seconds: float | None = None, samples: int = SAMPLES, exactly: bool = True
    ) -> PredictedUncertainty:
        """Predict the uncertainty of the parameters after a movement.

        Parameters
        ----------
        movement : Trajectory
        seconds : float, optional
            Length of the fitted samples, s; by default all of the movement that can be fitted.
        samples : int
            Number of samples to compute the variances from: fewer are faster.
        exactly : bool
            Filter as the identification does before computing the condition number; this takes longer.
        """
        fitted = self.fitted(movement)
        seconds = float(fitted.sum()) / movement.rate if seconds is None else seconds
        covariance = self.covariance(movement, seconds, samples)
        sd = np.sqrt(np.diag(covariance))
        if not np.isfinite(covariance).any():
            return PredictedUncertainty(sd, covariance, np.inf, np.inf, 0.0, self.now.fixed)
        condition, scaled = self._filtered_conditions(movement, fitted) if exactly else self.conditions(movement)
        return PredictedUncertainty(sd, covariance, condition, scaled, seconds, self.now.fixed)

    def covariance(self, movement: Trajectory, seconds: float, samples: int = SAMPLES) -> FloatArray:
        """Predict only the covariance (b, b); infinite if no sample can be fitted. Arguments as for `predict`."""
        fitted = self.fitted(movement)
        if not len(_thinned_samples(movement, fitted, samples)):
            return np.full_like(self.now.covariance, np.inf)
        return self._scaled(self._parts(movement, fitted, samples), seconds)

    def conditions(self, movement: Trajectory, samples: int = SAMPLES) -> tuple[float, float]:
        """Return condition numbers in SI units and with unit columns, from some samples and without the filter."""
        chosen = _thinned_samples(movement, self.fitted(movement), samples)
        if not len(chosen):
            return np.inf, np.inf
        rows = self.body.regressor(movement.q[chosen], movement.dq[chosen], movement.ddq[chosen])
        return conditions(rows[:, list(self.body.prepared.settings.components)])

    def fitted(self, movement: Trajectory) -> BoolArray:
        """Return the samples (T,) that an identification would use: known, and away from gaps and ends."""
        if movement.fitted is not None:
            return movement.fitted
        lost = self.body.prepared.lowpass.reach + self.body.prepared.settings.offset_limit
        return erode(movement.known, int(np.ceil(lost * movement.rate)) + 1)

    def _parts(self, movement: Trajectory, fitted: BoolArray, samples: int) -> _UnscaledCovariance:
        body, chosen = self.body, _thinned_samples(movement, fitted, samples)
        three = np.concatenate([chosen - 1, chosen, chosen + 1])
        before, now, after = np.split(body.regressor(movement.q[three], movement.dq[three], movement.ddq[three]), 3)
        rows = body.weighted_rows(now, (after - before) * movement.rate / 2)
        states = np.stack([movement.q[chosen], movement.dq[chosen], movement.ddq[chosen]], axis=1)
        noise = unit_covariance(rows.reshape(-1, rows.shape[-1]))[: len(self.now.sd), : len(self.now.sd)]
        response = body.response(states, rows, self.geometry(movement.q[fitted & movement.known]))
        return _UnscaledCovariance(noise * len(chosen), response @ response.T)

    def _scaled(self, parts: _UnscaledCovariance, seconds: float) -> FloatArray:
        """Return the covariance with its parts scaled by those of the trial (predicted-covariance.md, eq. 3)."""
        residual, geometry, fixed = _variance_parts(self.body.found)
        noise_scale = np.sqrt(residual / np.diag(self._own_parts.noise))
        geometry_scale = np.sqrt(geometry / np.maximum(np.diag(self._own_parts.geometry), 1e-300))
        length = self.now.samples / seconds
        return np.asarray(
            length * parts.noise * np.outer(noise_scale, noise_scale)
            + parts.geometry * np.outer(geometry_scale, geometry_scale)
            + np.diag(fixed)
        )

    def _filtered_conditions(self, movement: Trajectory, fitted: BoolArray) -> tuple[float, float]:
        if movement is self.own:
            return self.now.condition, self.now.condition_scaled
        settings = self.body.prepared.settings
        cutoff = settings.cutoff if settings.cutoff is not None else cutoff_from_velocity(movement.dq, movement.rate)
        lowpass = LowPass(cutoff, movement.rate)
        regressor = lowpass(self.body.regressor(movement.q, movement.dq, movement.ddq))
        rows = regressor[fitted & np.isfinite(regressor).all(axis=(1, 2))][:: lowpass.step]
        return conditions(rows[:, list(settings.components)])


def _variance_parts(found: Identification) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the variances (b,) from residuals, from joint centres and skin, and from the plate's zero."""
    residual = np.diag(found.residual_covariance)
    rest = np.maximum(np.diag(found.covariance) - residual, 0.0)
    geometry = np.minimum(np.sum(found.response**2, axis=1), rest)
    return residual, geometry, rest - geometry


def _thinned_samples(movement: Trajectory, fitted: BoolArray, samples: int) -> IntArray:
    """Return the evenly spaced fitted samples whose neighbours are known too."""
    known = movement.known
    inner = fitted & known
    inner[1:-1] &= known[:-2] & known[2:]
    inner[[0, -1]] = False
    chosen = np.flatnonzero(inner)
    return chosen[:: max(1, len(chosen) // samples)]
