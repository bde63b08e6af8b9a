"""A movement that was not recorded, and the covariance of the base parameters predicted for it.

The chain, the parameters, the noise and the skin model are those of an identified trial; the regressor is computed for
the other movement. The covariance has three parts: from the residuals, from the geometry (joint centres and skin) and
from the error of the plate's zero. The first two parts are scaled so that the prediction for the trial's own movement
equals the identified covariance. The derivation is in docs/concepts/predicted-covariance.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import make_interp_spline

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.base_parameters import unit_covariance
from mocap_id.dynamics.fit import compute_conditions
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.instrument_errors import KinematicError, propagate_to_parameters
from mocap_id.dynamics.preparation import LowPass, PreparedTrial, TrialData, choose_cutoff, erode
from mocap_id.dynamics.regressor import planar_regressor

_ROUNDING = 1e-9  # tolerance for rounding errors of a whole divisor of the rate
_DEGREE = 5  # degree of the splines: two more than the acceleration needs


@dataclass(frozen=True)
class Trajectory:
    """Joint angles and their derivatives, sample by sample."""

    time: FloatArray  # (T,) sample times with constant step, s
    # q, dq, ddq: (T, n) joint angles, rad, and their time derivatives; NaN where missing
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    # (T,) samples that an identification fits; None for all samples away from gaps and ends
    fitted: BoolArray | None = None

    @property
    def rate(self) -> float:
        """Samples per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def seconds(self) -> float:
        """Duration, s."""
        return float(len(self.time) / self.rate)

    @property
    def known(self) -> BoolArray:
        """Mask (T,) of the samples with angle, velocity and acceleration of every joint."""
        return np.asarray(np.isfinite(np.hstack([self.q, self.dq, self.ddq])).all(axis=1))

    def thin(self, rate: float) -> Trajectory:
        """Return every k-th sample, with the largest k that leaves at least ``rate`` samples per second."""
        return self._select(slice(None, None, max(1, int(self.rate / rate + _ROUNDING))))

    def cut(self, seconds: float) -> Trajectory:
        """Return the first part of the movement, which lasts ``seconds``."""
        return self._select(slice(None, max(2, round(seconds * self.rate))))

    def _select(self, own: slice) -> Trajectory:
        fitted = None if self.fitted is None else self.fitted[own]
        return Trajectory(self.time[own], self.q[own], self.dq[own], self.ddq[own], fitted)

    def scale(self, speed: FloatArray, size: FloatArray) -> Trajectory:
        """Return the movement with the speed and the range of each joint multiplied by factors (n,).

        ``size`` multiplies the difference of each angle from its median. If the factors of speed differ, a joint moves
        forwards and backwards through its own recording. If they are equal, they change the duration instead.
        """
        time, length = self.time - self.time[0], float(self.time[-1] - self.time[0])
        if np.all(speed == speed[0]):
            time = time / speed[0]
        clock = np.multiply.outer(time, speed)
        forth = np.floor_divide(clock, length * (1 + 1e-12)) % 2 == 0
        clock = np.where(forth, clock, 2 * length - clock)
        middle = np.asarray(np.nanmedian(self.q if self.fitted is None else self.q[self.fitted], axis=0))
        stamped = self.time - self.time[0]
        q, dq, ddq = (
            np.stack([np.interp(own, stamped, each) for own, each in zip(clock.T, values.T, strict=True)], axis=1)
            for values in (self.q, self.dq, self.ddq)
        )
        return Trajectory(
            time,
            middle + size * (q - middle),
            np.where(forth, 1.0, -1.0) * size * speed * dq,
            size * speed**2 * ddq,
            self.fitted,
        )


def get_recorded_trajectory(recorded: TrialData, fitted: BoolArray) -> Trajectory:
    """Return the recorded movement of a trial, with the samples (T,) that were fitted."""
    return Trajectory(recorded.time, recorded.q, recorded.dq, recorded.ddq, fitted)


def fit_trajectory(time: FloatArray, q: FloatArray) -> Trajectory:
    """Return the smooth movement through angles (T, n), rad, at times (T,) with constant step, s."""
    spline = make_interp_spline(time, q, k=_DEGREE)
    q, dq, ddq = (np.asarray(spline(time, order), dtype=np.float64) for order in range(3))
    return Trajectory(time, q, dq, ddq)


def concatenate(first: Trajectory, then: Trajectory) -> Trajectory:
    """Return two movements one after the other. Both must have ``fitted``, which must exclude the transition."""
    assert first.fitted is not None and then.fitted is not None
    time = np.concatenate([first.time, first.time[-1] + 1.0 / first.rate + then.time - then.time[0]])
    pairs = ((first.q, then.q), (first.dq, then.dq), (first.ddq, then.ddq))
    q, dq, ddq = (np.concatenate(pair) for pair in pairs)
    return Trajectory(time, q, dq, ddq, np.concatenate([first.fitted, then.fitted]))


SAMPLES = 200
"""Approximate number of samples of a movement from which the variances of the parameters are computed."""


@dataclass(frozen=True)
class PredictedUncertainty:
    """Predicted uncertainty of the base parameters after a movement."""

    sd: FloatArray  # (b,) standard deviation of each base parameter, SI
    covariance: FloatArray  # (b, b) covariance of the base parameters, SI
    # condition number of the regressor's rows in the fit, in SI units and with unit columns
    condition: float
    condition_scaled: float
    samples: float  # duration of the fitted samples, s
    fixed: FloatArray  # (b,) part of the variances from errors of plate and cameras, which no movement changes


@dataclass(frozen=True)
class IdentifiedBody:
    """An identified body, whose wrench can be computed for other movements."""

    prepared: PreparedTrial  # the trial in which the body was identified
    result: Identification  # the identified parameters

    def regressor(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the base columns (T, 3, b) of the regressor of all three wrench components."""
        rows = planar_regressor(self.prepared.recorded.centres, q, dq, ddq, self.prepared.settings.gravity)
        return rows[:, :, self.prepared.base.kept]

    def wrench(self, movement: Trajectory) -> FloatArray:
        """Return the wrench of the ground (T, 3) during a movement, N and N·m."""
        return np.asarray(self.regressor(movement.q, movement.dq, movement.ddq) @ self.result.base)


@dataclass(frozen=True)
class CovariancePredictor:
    """Predictor of the covariance of a trial's parameters for other movements."""

    body: IdentifiedBody  # the body identified in the trial
    own: Trajectory  # the trial's movement
    # function from postures (T, n), rad, to the error of the geometry of a chain that is fitted to these postures. By
    # default, the error is that of the trial.
    geometry: Callable[[FloatArray], KinematicError] | None = None

    @cached_property
    def now(self) -> PredictedUncertainty:
        """The identified uncertainty of the trial itself."""
        result, fit = self.body.result, self.body.result.fit
        return PredictedUncertainty(
            sd=result.base_sd,
            covariance=result.covariance,
            condition=fit.condition,
            condition_scaled=fit.condition_scaled,
            samples=float(fit.in_fit.sum()) / self.body.prepared.recorded.rate,
            fixed=self._variances[2],
        )

    @cached_property
    def _variances(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Identified variances (b,) from residuals, from joint centres and skin, and from the plate's zero."""
        result = self.body.result
        residual = np.diag(result.residual_covariance)
        rest = np.maximum(np.diag(result.covariance) - residual, 0.0)
        geometry = np.minimum(np.sum(result.response**2, axis=1), rest)
        return residual, geometry, rest - geometry

    @cached_property
    def _own_parts(self) -> tuple[FloatArray, FloatArray]:
        fitted = self.find_fitted(self.own)
        return self._compute_parts(self.own, fitted, _choose_samples(self.own, fitted, SAMPLES))

    def predict(
        self, movement: Trajectory, seconds: float | None = None, samples: int = SAMPLES, exactly: bool = True
    ) -> PredictedUncertainty:
        """Predict the uncertainty of the parameters after a movement.

        ``seconds`` is the duration of the fitted samples; by default, of all samples that can be fitted. The variances
        are computed from about ``samples`` samples; a smaller number is faster. With ``exactly``, the condition numbers
        are those of the filtered regressor, as in an identification, which takes longer.
        """
        fitted = self.find_fitted(movement)
        seconds = float(fitted.sum()) / movement.rate if seconds is None else seconds
        covariance = self.covariance(movement, seconds, samples)
        sd = np.sqrt(np.diag(covariance))
        if not np.isfinite(covariance).any():
            return PredictedUncertainty(sd, covariance, np.inf, np.inf, 0.0, self.now.fixed)
        if not exactly:
            condition, scaled = self.conditions(movement)
        elif movement is self.own:
            condition, scaled = self.now.condition, self.now.condition_scaled
        else:
            settings = self.body.prepared.settings
            cutoff = settings.cutoff if settings.cutoff is not None else choose_cutoff(movement.dq, movement.rate)
            lowpass = LowPass(cutoff, movement.rate)
            regressor = lowpass(self.body.regressor(movement.q, movement.dq, movement.ddq))
            rows = regressor[fitted & np.isfinite(regressor).all(axis=(1, 2))][:: lowpass.step]
            condition, scaled = compute_conditions(rows[:, list(settings.components)])
        return PredictedUncertainty(sd, covariance, condition, scaled, seconds, self.now.fixed)

    def covariance(self, movement: Trajectory, seconds: float, samples: int = SAMPLES) -> FloatArray:
        """Predict only the covariance (b, b); infinite if no sample can be fitted. Arguments as for :meth:`predict`.

        It is the sum of its parts, scaled to those of the trial (predicted-covariance.md, eq. 3).
        """
        fitted = self.find_fitted(movement)
        chosen = _choose_samples(movement, fitted, samples)
        if not len(chosen):
            return np.full_like(self.now.covariance, np.inf)
        parts = self._compute_parts(movement, fitted, chosen)
        residual, geometry, fixed = self._variances
        noise_scale = np.sqrt(residual / np.diag(self._own_parts[0]))
        geometry_scale = np.sqrt(geometry / np.maximum(np.diag(self._own_parts[1]), 1e-300))
        length = self.now.samples / seconds
        return np.asarray(
            length * parts[0] * np.outer(noise_scale, noise_scale)
            + parts[1] * np.outer(geometry_scale, geometry_scale)
            + np.diag(fixed)
        )

    def conditions(self, movement: Trajectory) -> tuple[float, float]:
        """Return the condition numbers of about 200 unfiltered rows, in SI units and with unit columns."""
        chosen = _choose_samples(movement, self.find_fitted(movement), SAMPLES)
        if not len(chosen):
            return np.inf, np.inf
        rows = self.body.regressor(movement.q[chosen], movement.dq[chosen], movement.ddq[chosen])
        return compute_conditions(rows[:, list(self.body.prepared.settings.components)])

    def find_fitted(self, movement: Trajectory) -> BoolArray:
        """Return a mask (T,) of the samples that an identification would fit, which are away from gaps and ends."""
        if movement.fitted is not None:
            return movement.fitted
        margin = self.body.prepared.lowpass.reach + self.body.prepared.settings.offset_limit
        return erode(movement.known, int(np.ceil(margin * movement.rate)) + 1)

    def _compute_parts(
        self, movement: Trajectory, fitted: BoolArray, chosen: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return unscaled covariances (b, b) from residuals of unit variance, for one sample, and from the geometry."""
        body, result, fit = self.body, self.body.result, self.body.result.fit
        three = np.concatenate([chosen - 1, chosen, chosen + 1])
        before, now, after = np.split(body.regressor(movement.q[three], movement.dq[three], movement.ddq[three]), 3)
        # rows of a fit, weighted as in that of the trial; the last column is the time derivative of the wrench, because
        # a clock offset shifts the wrench in time
        components = list(body.prepared.settings.components)
        regressor = now[:, components]
        rate = ((after - before) * movement.rate / 2)[:, components] @ result.base
        bias = np.zeros((*regressor.shape[:2], fit.problem.factor.shape[1] - fit.base))
        if bias.shape[-1]:
            bias[:, components.index(0), 0] = 1.0
        rows = np.asarray(np.concatenate([regressor, bias, rate[..., None]], axis=-1) * fit.weights[:, None])
        count = len(self.now.sd)
        noise = unit_covariance(rows.reshape(-1, rows.shape[-1]))[:count, :count]
        # change (b, S) of the parameters with each error mode of the geometry; infinite if not determined
        error = result.error if self.geometry is None else self.geometry(movement.q[fitted & movement.known])
        here = replace(body.prepared.recorded, q=movement.q[chosen], dq=movement.dq[chosen], ddq=movement.ddq[chosen])
        moved, refitted = replace(body.prepared, recorded=here), replace(fit, samples=np.arange(len(rows)), design=rows)
        try:
            response = propagate_to_parameters(moved, refitted, result.base, error)[: fit.base]
        except np.linalg.LinAlgError:
            response = np.full((fit.base, 1), np.inf)
        return noise * len(chosen), response @ response.T


def _choose_samples(movement: Trajectory, fitted: BoolArray, samples: int) -> IntArray:
    """Return the indices of about ``samples`` evenly spaced fitted samples whose neighbours also have values."""
    known = movement.known
    inner = fitted & known
    inner[1:-1] &= known[:-2] & known[2:]
    inner[[0, -1]] = False
    chosen = np.flatnonzero(inner)
    return chosen[:: max(1, len(chosen) // samples)]
