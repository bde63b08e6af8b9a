"""Movements, the predicted uncertainty after them, their limits and objectives, and recommended changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from scipy.interpolate import make_interp_spline

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.cautions import Excitation
from mocap_id.dynamics.fit import compute_conditions
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.instrument_errors import KinematicError, propagate_to_parameters
from mocap_id.dynamics.preparation import LowPass, PreparedTrial, TrialData, choose_cutoff, erode
from mocap_id.dynamics.regressor import planar_regressor, unit_covariance
from mocap_id.geometry import planar

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
        """Return the movement with the speed, and the range about the median, of each joint multiplied by factors (n,).

        If the factors of speed differ, a joint moves forwards and backwards through its own recording. If they are
        equal, they change the duration instead.
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
class CovariancePredictor:
    """An identified body, and predictor of its wrench and of the covariance of its parameters for other movements."""

    prepared: PreparedTrial  # the trial in which the body was identified
    result: Identification  # the identified parameters
    own: Trajectory  # the trial's movement
    # function from postures (T, n), rad, to the error of the geometry of a chain that is fitted to these postures. By
    # default, the error is that of the trial.
    geometry: Callable[[FloatArray], KinematicError] | None = None

    def regressor(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the base columns (T, 3, b) of the regressor of all three wrench components."""
        rows = planar_regressor(self.prepared.recorded.centres, q, dq, ddq, self.prepared.settings.gravity)
        return rows[:, :, self.prepared.base.kept]

    def wrench(self, movement: Trajectory) -> FloatArray:
        """Return the wrench of the ground (T, 3) during a movement, N and N·m."""
        return np.asarray(self.regressor(movement.q, movement.dq, movement.ddq) @ self.result.base)

    @cached_property
    def now(self) -> PredictedUncertainty:
        """The identified uncertainty of the trial itself."""
        result, fit = self.result, self.result.fit
        return PredictedUncertainty(
            sd=result.base_sd,
            covariance=result.covariance,
            condition=fit.condition,
            condition_scaled=fit.condition_scaled,
            samples=float(fit.in_fit.sum()) / self.prepared.recorded.rate,
            fixed=self._variances[2],
        )

    @cached_property
    def _variances(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Identified variances (b,) from residuals, from joint centres and skin, and from the plate's zero."""
        result = self.result
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

        ``seconds`` is the duration of the fitted samples; by default, of all samples that can be fitted. With
        ``exactly``, the condition numbers are those of the filtered regressor, as in an identification.
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
            settings = self.prepared.settings
            cutoff = settings.cutoff if settings.cutoff is not None else choose_cutoff(movement.dq, movement.rate)
            lowpass = LowPass(cutoff, movement.rate)
            regressor = lowpass(self.regressor(movement.q, movement.dq, movement.ddq))
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
        rows = self.regressor(movement.q[chosen], movement.dq[chosen], movement.ddq[chosen])
        return compute_conditions(rows[:, list(self.prepared.settings.components)])

    def find_fitted(self, movement: Trajectory) -> BoolArray:
        """Return a mask (T,) of the samples that an identification would fit, which are away from gaps and ends."""
        if movement.fitted is not None:
            return movement.fitted
        margin = self.prepared.lowpass.reach + self.prepared.settings.offset_limit
        return erode(movement.known, int(np.ceil(margin * movement.rate)) + 1)

    def _compute_parts(
        self, movement: Trajectory, fitted: BoolArray, chosen: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return unscaled covariances (b, b) from residuals of unit variance, for one sample, and from the geometry."""
        result, fit = self.result, self.result.fit
        three = np.concatenate([chosen - 1, chosen, chosen + 1])
        before, now, after = np.split(self.regressor(movement.q[three], movement.dq[three], movement.ddq[three]), 3)
        # rows of a fit, weighted as in that of the trial; the last column is the time derivative of the wrench, because
        # a clock offset shifts the wrench in time
        components = list(self.prepared.settings.components)
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
        here = replace(self.prepared.recorded, q=movement.q[chosen], dq=movement.dq[chosen], ddq=movement.ddq[chosen])
        moved, refitted = replace(self.prepared, recorded=here), replace(fit, samples=np.arange(len(rows)), design=rows)
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


_TINY = 1e-9
_FASTER = 1.5  # allowed speed, relative to the largest observed speed
_UPRIGHT = 0.9  # quantile of the highest joint's height above which the body is upright
_INSIDE = 0.01  # m: least distance of the resting posture's centre of pressure from the edge of the support


@dataclass(frozen=True)
class MovementLimits:
    """Bounds of a movement."""

    low: FloatArray  # (n,) lowest joint angles, rad
    high: FloatArray  # (n,) highest joint angles, rad
    speed: FloatArray  # (n,) largest speed of each joint, rad/s
    acceleration: FloatArray  # (n,) largest acceleration of each joint, rad/s²
    support: tuple[float, float] | None  # range of the centre of pressure, m; None for a base that is bolted down

    def clip(self, posture: FloatArray) -> FloatArray:
        """Return the allowed posture (n,) that is nearest to the given one, rad."""
        room = np.minimum(_TINY, (self.high - self.low) / 2)
        return np.asarray(np.clip(posture, self.low + room, self.high - room))

    def usage(self, movement: Trajectory, wrench: FloatArray, moment_sd: FloatArray | None = None) -> float:
        """Return the largest fraction of any limit that a movement uses; above 1 the movement is not allowed.

        If ``movement.fitted`` is given, only these samples count. ``wrench`` (T, 3) is that of the ground, with the
        standard deviation ``moment_sd`` (T,) of its moment, N·m. The result is infinite if the body leaves the ground,
        if there is no sample to check, or, without ``movement.fitted``, if any sample is missing.
        """
        counted = movement.known if movement.fitted is None else movement.fitted & movement.known
        if not counted.any() or (movement.fitted is None and not counted.all()):
            return np.inf
        middle, half = (self.low + self.high) / 2, np.maximum((self.high - self.low) / 2, _TINY)
        parts = [
            np.abs(movement.q[counted] - middle) / half,
            np.abs(movement.dq[counted]) / self.speed,
            np.abs(movement.ddq[counted]) / self.acceleration,
        ]
        worst = max(float(np.max(part)) for part in parts)
        if self.support is None:
            return worst
        sd = np.zeros(len(wrench)) if moment_sd is None else moment_sd
        force, moment, sd = wrench[counted, 1], wrench[counted, 2], sd[counted]
        if np.any(force <= 0.0):
            return np.inf
        low, high = self.support
        off = np.abs(moment / force - (low + high) / 2) + sd / force
        return max(worst, float(np.max(off)) / max((high - low) / 2, _TINY))


def derive_limits(
    movement: Trajectory,
    wrench: FloatArray,
    rest: FloatArray,
    *,
    widened: float,
    speed: tuple[float, float],
    acceleration: tuple[float, float],
    slack: float | None,
    at_rest: float,
) -> MovementLimits:
    """Return limits that are derived from a recorded movement and its wrench of the ground (T, 3), N and N·m.

    The posture ``rest`` (n,) and the centre of pressure ``at_rest``, m, are always allowed. Every joint may exceed its
    observed range by the angle ``widened``, rad, and the centre of pressure by ``slack``, m; None for a base that is
    bolted down. Between the bounds ``speed``, rad/s, and ``acceleration``, rad/s², the limit is 1.5 or 2.25 times the
    largest observed value. Observed values are always allowed.
    """
    known = movement.known
    loaded = (known if movement.fitted is None else known & movement.fitted) & (wrench[:, 1] > 0.0)
    pressure = wrench[loaded, 2] / wrench[loaded, 1]
    support = None
    if slack is not None:
        support = (
            float(min(pressure.min() - slack, at_rest - _INSIDE)),
            float(max(pressure.max() + slack, at_rest + _INSIDE)),
        )
    fastest, hardest = (np.abs(values[known]).max(axis=0) for values in (movement.dq, movement.ddq))
    return MovementLimits(
        low=np.minimum(movement.q[known].min(axis=0) - widened, rest),
        high=np.maximum(movement.q[known].max(axis=0) + widened, rest),
        speed=np.maximum(fastest, np.clip(_FASTER * fastest, *speed)),
        acceleration=np.maximum(hardest, np.clip(_FASTER**2 * hardest, *acceleration)),
        support=support,
    )


def find_resting_posture(movement: Trajectory, centres: FloatArray, upright: bool) -> FloatArray:
    """Return the posture (n,) in which a movement starts, rad: the median of the trial's fitted samples.

    With ``upright``, it is the median of only the tenth of these samples in which the highest joint is highest.
    """
    q = movement.q[movement.known if movement.fitted is None else movement.known & movement.fitted]
    if upright:
        height = planar.segment_poses(q, centres)[1][:, -1, 1]
        q = q[height >= np.quantile(height, _UPRIGHT)]
    return np.asarray(np.median(q, axis=0))


Objective: TypeAlias = Literal["intervals", "volume", "condition", "condition-scaled"]
OBJECTIVES: dict[Objective, str] = {
    "intervals": "root mean square of the standard deviations, each divided by the parameter's size (A-optimal)",
    "volume": "geometric mean of the axes of the confidence ellipsoid of these quotients (D-optimal)",
    "condition": "condition number of the regressor in SI units",
    "condition-scaled": "condition number of the regressor with unit columns",
}


@dataclass(frozen=True)
class Proposal:
    """A movement that could be recorded."""

    words: str  # instructions for the person or the robot
    trajectory: Trajectory  # the movement
    predicted: PredictedUncertainty  # uncertainty of the parameters after this movement
    value: float  # value of the objective; smaller is better
    designed: bool = False  # whether the search found it; otherwise it is a simple change
    own: bool = False  # whether it is the trial's own movement, faster or larger
    standalone: bool = False  # whether it contains no part of the recorded movement


def compute_objective(objective: Objective, predicted: PredictedUncertainty, size: FloatArray) -> float:
    """Return the value of the objective, smaller is better; infinite if the movement does not determine the parameters.

    ``size`` (b,) is the size of each parameter, SI. The variance from errors of plate and cameras is not included,
    because no movement changes it.
    """
    if objective == "condition":
        return predicted.condition
    if objective == "condition-scaled":
        return predicted.condition_scaled
    if not np.isfinite(predicted.covariance).all():
        return np.inf
    changing = predicted.covariance - np.diag(predicted.fixed)
    if objective == "intervals":
        return float(np.sqrt(np.mean(np.diag(changing) / size**2)))
    sign, logarithm = np.linalg.slogdet(changing / np.outer(size, size))
    if sign <= 0:  # rounding: the covariance is nearly singular
        return np.inf
    return float(np.exp(logarithm / (2 * len(size))))


Change: TypeAlias = Literal["faster", "larger", "alone"]

FACTOR = 1.5
"""Factor by which a movement is made faster or larger."""
_HELPS = 0.8  # largest ratio of standard deviations: a smaller reduction is within the error of the prediction
_QUICK_SAMPLES, _QUICK_ERROR = 40, 1.1  # samples of a first estimate, and factor by which this estimate may be wrong
_RATE = 40.0  # Hz: rate of the samples; movements are below 3 Hz


@dataclass(frozen=True)
class Recommendation:
    """A change of the movement that would reduce a parameter's standard deviation."""

    # faster: 1.5 times as fast; larger: 1.5 times the range; alone: half of the time with the other joints at rest
    change: Change
    joint: int | None  # index of the joint whose movement changes, from 0; None for all joints
    ratio: float  # predicted standard deviation for a recording of the same duration, divided by the present one

    def describe(self, joints: Sequence[str]) -> str:
        """Return the change in words, with the names of the joints."""
        moved = "the whole movement" if self.joint is None else f"the {joints[self.joint]}'s movement"
        if self.change == "alone":
            return f"{moved} by itself for half of the time (the other joints at rest)"
        step = ", independently of the other joints," if self.change == "faster" and self.joint is not None else ""
        return f"{moved} {FACTOR:g} times {self.change}{step}"


Recommendations: TypeAlias = tuple[Recommendation | None, ...]
"""For each base parameter the best change; None if no change reduces its standard deviation by a fifth."""


def recommend_if_doubtful(prepared: PreparedTrial, result: Identification, excited: Excitation) -> Recommendations:
    """Return recommendations for the doubtful parameters; if no parameter is doubtful, return () without a search."""
    if not excited.doubtful:
        return ()
    return recommend_changes(prepared, result, np.array(excited.verdict) != "known")


def recommend_changes(
    prepared: PreparedTrial, result: Identification, wanted: BoolArray | None = None
) -> Recommendations:
    """Return for each parameter, or for the ``wanted`` ones (b,), the change that reduces its standard deviation most.

    It is None if no change reduces the standard deviation by a fifth.
    """
    wanted = np.ones(len(result.base), dtype=np.bool_) if wanted is None else wanted
    own = get_recorded_trajectory(prepared.recorded, result.fit.in_fit).thin(_RATE)
    predictor = CovariancePredictor(prepared, result, own)

    def predict_ratios(movement: Trajectory, samples: int) -> FloatArray:
        """Return the predicted standard deviations (b,) divided by the present ones, for the same duration."""
        after = np.diag(predictor.covariance(movement, predictor.now.samples, samples))
        return np.asarray(np.sqrt(after) / np.maximum(predictor.now.sd, 1e-300))

    best: list[Recommendation | None] = [None] * len(result.base)
    for change, joint in list_changes(len(prepared.recorded.centres)):
        movement = change_movement(predictor.own, change, joint)
        if np.min(predict_ratios(movement, _QUICK_SAMPLES)[wanted]) > _QUICK_ERROR * _HELPS:
            continue
        ratios = predict_ratios(movement, SAMPLES)
        for i in np.flatnonzero(wanted):
            present = best[i]
            if ratios[i] < (_HELPS if present is None else present.ratio):
                best[i] = Recommendation(change, joint, float(ratios[i]))
    return tuple(best)


def describe_recommendations(excited: Excitation, recommendations: Recommendations, joints: Sequence[str]) -> str:
    """Return the recommended movements for the doubtful parameters, one sentence for each movement."""
    best: dict[tuple[str, int | None], list[tuple[int, Recommendation]]] = {}
    beyond = []
    for i in excited.doubtful:
        each = recommendations[i]
        if each is None:
            beyond.append(excited.names[i])
        else:
            best.setdefault((each.change, each.joint), []).append((i, each))
    sentences = []
    for group in best.values():
        words = group[0][1].describe(joints)
        falls = ", ".join(
            f"{excited.names[i]} to {100 * each.ratio * excited.relative_sd[i]:.0f} %" for i, each in group
        )
        sentences.append(f"{words[0].upper()}{words[1:]} would reduce the standard deviation of {falls}.")
    if beyond:
        sentences.append(
            f"No faster or larger movement of these joints would determine {', '.join(beyond)} better, because the "
            "error of the plate's zero, of the joint centres or of the skin remains."
        )
    return " ".join(sentences)


def list_changes(joints: int) -> list[tuple[Change, int | None]]:
    """Return the changes to try, each with the index of its joint or None for all joints together."""
    each: list[tuple[Change, int | None]] = [("faster", None), ("larger", None)]
    if joints > 1:
        each += [(change, joint) for joint in range(joints) for change in ("faster", "larger", "alone")]
    return each


def change_movement(own: Trajectory, change: Change, joint: int | None) -> Trajectory:
    """Return the trajectory in which one joint, or all joints (``joint=None``), move faster, further or alone.

    For "alone", every second sample of the recording is replaced by a sample in which only this joint moves.
    """
    joints = own.q.shape[1]
    ones, chosen = np.ones(joints), np.arange(joints) == joint if joint is not None else np.ones(joints, bool)
    if change == "alone":
        assert own.fitted is not None
        half = np.arange(len(own.time)) % 2 == 0
        alone = own.scale(ones, np.where(chosen, 1.0, 0.0))
        return concatenate(replace(own, fitted=own.fitted & half), replace(alone, fitted=own.fitted & ~half))
    more = np.where(chosen, FACTOR, 1.0)
    return own.scale(more, ones) if change == "faster" else own.scale(ones, more)
