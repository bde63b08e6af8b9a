"""Check for a wrong scale of plate, cameras or clock rates, for which the residuals are not sufficient.

Residuals hide an error of scale, because the parameters adapt to it. Three facts make the error visible. Gravity and
inertia act on the same masses. Forces and moments belong to one wrench. Nearly all mass above the shank acts at the
knee, so that ratios of the parameters are almost the same in all people (:mod:`mocap_id.dynamics.body_ratios`).

The wrench is modelled as the regressor times the parameters, plus a column for each cause of error. First, all causes
are kept near zero; then one cause at a time is free. A cause is identified if it decreases the cost by more than 6.6,
the 1 % point of χ² with one degree of freedom, and by at least 6.6 more than every other cause.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_complete_rows
from mocap_id.dynamics.body_ratios import BodyRatios
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.instrument_errors import ScaleCause, ScaleCheck
from mocap_id.dynamics.kinematic_error import propagate_to_wrench
from mocap_id.dynamics.lowpass import LowPass, erode
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import wrench_regressor
from mocap_id.dynamics.sample_choice import skip_long_rests
from mocap_id.dynamics.uncertainty import number_blocks

_CUTOFF, _POSES_CUTOFF = 2.5, 4.0  # Hz: for a chain, whose accelerations have errors above it, and for measured poses
_THINNED, _CLEAN = 25.0, 10.0  # Hz: rate of the samples, and low-pass of the wrench before thinning
_EVERY = 2  # every second of these samples is a row
_SECONDS = 1.5  # s: least duration of the rows
_SEEN = 6.6  # least decrease of χ² that is significant
_SURE = 2.58  # standard deviations of a 99 % interval
_ROUNDS = 3
_STEP = 1e-4  # step of numerical derivatives, relative or rad
_LEAST_MODE = 0.1  # least squared norm of a mode of the geometry's error, in standard deviations of the residual
_FOLLOWED = np.array([2.5, 2.0])  # N: rms residuals of Fx and Fy below which a pinned chain describes the person


@dataclass(frozen=True)
class _Size:
    """Standard deviations of a cause: kept near zero, free, and of its estimates in people without such an error."""

    held: float
    free: float
    spread: float


CAUSES: Mapping[str, _Size] = {
    "inertia": _Size(0.003, 0.5, 0.02),
    "moments": _Size(0.003, 0.5, 0.05),
    "vertical gain": _Size(0.003, 0.5, 0.05),
    "vertical force": _Size(1.5, 100.0, 30.0),
    "position": _Size(0.0015, 0.1, 0.015),
    "lengths": _Size(0.001, 0.05, 0.015),
    "tilt": _Size(0.0015, 0.1, 0.02),
    "gain": _Size(0.003, 1.0, 0.05),
}
"""Causes of a wrong scale. ``inertia`` is the factor of the inertial terms minus 1, which depends on the frame rate."""
_OF_MODEL = ("inertia", "lengths", "tilt")


def check_scales(
    prepared: PreparedTrial, gate: BoolArray, result: Identification, ratios: BodyRatios
) -> ScaleCheck | None:
    """Check for a wrong scale of plate, cameras or clock rates.

    The result is None if there are too few usable samples, or if the pinned chain does not describe the person.
    ``ratios`` are the relations between the parameters of any person.
    """
    problem = _build_problem(prepared, gate, result, ratios)
    if problem is None or (problem.pinned and not problem.followed):
        return None
    share = 0.0 if problem.pinned else 1.0
    held, start = problem.solve(None), result.base
    causes = {}
    for name, size in CAUSES.items():
        if name == "gain" and not ratios.weighed:
            continue
        free = problem.solve(name, start)
        limit = float(_SURE * np.hypot(free.sd, share * size.spread))
        causes[name] = ScaleCause(free.value, free.sd, max(held.cost - free.cost, 0.0), limit)
    return ScaleCheck(causes, _find_suspects(causes))


def _find_suspects(causes: Mapping[str, ScaleCause]) -> tuple[str, ...]:
    """Return the significant cause that explains most, then causes that explain almost as much; () if none is found."""
    significant = [name for name, each in causes.items() if each.explains > _SEEN and abs(each.value) > each.limit]
    if not significant:
        return ()
    significant.sort(key=lambda name: -causes[name].explains)
    best = causes[significant[0]].explains
    near = [name for name, each in causes.items() if name != significant[0] and best - each.explains <= _SEEN]
    return (significant[0], *sorted(near, key=lambda name: -causes[name].explains))


@dataclass(frozen=True)
class _Solution:
    """Cost of a solution, and the estimate of the free cause with its standard deviation."""

    cost: float
    value: float
    sd: float


@dataclass(frozen=True)
class _Problem:
    """Weighted rows of the check: columns of the model (R, c, b), of nuisances (R, c, k) and of every cause.

    ``of_model`` has the derivatives (R, c, b) of the model's columns with respect to a cause, ``of_data`` the columns
    (R, c) of the other causes.
    """

    model: FloatArray
    nuisance: FloatArray
    modes: int
    of_model: dict[str, FloatArray]
    of_data: dict[str, FloatArray]
    target: FloatArray
    prior: FloatArray
    prior_target: FloatArray
    start: FloatArray
    pinned: bool
    followed: bool

    def solve(self, free: str | None, start: FloatArray | None = None) -> _Solution:
        """Return cost and estimate with one cause free, or none, by Gauss-Newton steps, as the model is bilinear."""
        base = self.start if start is None else start
        value = dict.fromkeys(CAUSES, 0.0)
        solution = _Solution(np.inf, 0.0, np.inf)
        previous = np.inf
        for _ in range(_ROUNDS):
            model = self.model + sum(value[name] * self.of_model[name] for name in _OF_MODEL)
            own = {name: self.of_model[name] @ base for name in _OF_MODEL}
            known_part = sum(value[name] * own[name] for name in _OF_MODEL)
            columns = np.stack([(own | self.of_data)[name] for name in CAUSES], axis=-1)
            rows = np.concatenate([model, self.nuisance, columns], axis=-1)
            flat = np.concatenate([rows.reshape(-1, rows.shape[-1]), self.prior, self._build_limits(free)])
            aim = np.concatenate([(self.target + known_part).reshape(-1), self.prior_target, np.zeros(len(self._zero))])
            scale = np.linalg.norm(flat, axis=0)
            normal = (flat / scale).T @ (flat / scale)
            inverse = np.linalg.inv(normal)
            x = inverse @ ((flat / scale).T @ aim) / scale
            cost = float(np.sum((aim - flat @ x) ** 2))
            base = x[: model.shape[-1]]
            value = dict(zip(CAUSES, x[-len(CAUSES) :].tolist(), strict=True))
            if free is not None:
                place = list(CAUSES).index(free) - len(CAUSES)
                solution = _Solution(cost, value[free], float(np.sqrt(inverse[place, place])) / scale[place])
            else:
                solution = _Solution(cost, 0.0, 0.0)
            if abs(previous - cost) < 0.1:
                break
            previous = cost
        return solution

    @property
    def _zero(self) -> IntArray:
        """Columns whose expected value is zero: modes of the geometry's error, and causes."""
        first = self.model.shape[-1] + self.nuisance.shape[-1] - self.modes
        return np.arange(first, first + self.modes + len(CAUSES))

    def _build_limits(self, free: str | None) -> FloatArray:
        """Return rows that keep the columns :attr:`_zero` near zero, except that of the free cause."""
        sd = [size.free if name == free else size.held for name, size in CAUSES.items()]
        rows = np.zeros((len(self._zero), self._zero[-1] + 1))
        rows[np.arange(len(rows)), self._zero] = np.concatenate([np.ones(self.modes), 1.0 / np.array(sd)])
        return rows


def _build_problem(
    prepared: PreparedTrial, gate: BoolArray, result: Identification, ratios: BodyRatios
) -> _Problem | None:
    """Return the problem, with filtered and thinned samples; None if there are too few."""
    recorded, kept, base = prepared.recorded, prepared.base.kept, result.base
    step = max(1, int(recorded.rate / _THINNED))
    lowpass = LowPass(_CUTOFF if prepared.prior is None else _POSES_CUTOFF, recorded.rate / step)
    clean = LowPass(min(_CLEAN, recorded.rate / 5), recorded.rate)
    measured = lowpass(clean(prepared.measured(result.fit.offset))[::step])
    motion, gravity = prepared.motion.at(slice(None, None, step)), prepared.settings.gravity
    plain = prepared.regressor[::step]
    moved = {
        "inertia": wrench_regressor(motion, 0.0),
        "lengths": (plain - wrench_regressor(motion.scale(1 + _STEP), gravity)) / _STEP,
        "tilt": (plain - wrench_regressor(motion.tilt(_STEP), gravity)) / _STEP,
    }
    model = lowpass(plain[:, :, kept])
    usable = erode(find_complete_rows(model) & find_complete_rows(measured) & gate[::step], lowpass.reach_samples)
    rows = np.flatnonzero(usable)[::_EVERY]
    rows = rows[skip_long_rests(recorded.dq[::step][rows])]
    if len(rows) * _EVERY < _SECONDS * lowpass.rate:
        return None
    components, samples = list(prepared.settings.components), rows * step
    target, time = measured[rows], recorded.time[samples]
    extra = np.zeros((len(rows), 3, 2))
    extra[:, 0, 0] = 1.0
    extra[:, :, 1] = np.gradient(measured, step / recorded.rate, axis=0)[rows]
    if not (prepared.settings.plate_bias and 0 in components):
        extra = extra[:, :, 1:]
    of_model = {name: lowpass(each[:, :, kept])[rows] for name, each in moved.items()}
    effect = propagate_to_wrench(prepared, base, result.error, samples)
    columns = np.concatenate([model[rows], extra], axis=-1)
    weights = _estimate_weights(columns, target, time, prepared)
    every = np.stack([*(each @ base for each in of_model.values()), *_build_plate_columns(target).values()], axis=-1)
    residual = _compute_residual(np.concatenate([columns, every], axis=-1), target, weights, prepared)
    effect = _reduce_modes(effect * weights[:, None]) / weights[:, None]
    own, rms = np.concatenate([extra, -effect], axis=-1), np.sqrt(np.mean(residual[:, :2] ** 2, axis=0))
    prior, prior_target = _build_prior(prepared, ratios, own.shape[-1])
    scaled = weights[:, None]
    return _Problem(
        model=(model[rows] * scaled)[:, components],
        nuisance=(own * scaled)[:, components],
        modes=effect.shape[-1],
        of_model={name: (each * scaled)[:, components] for name, each in of_model.items()},
        of_data={name: (each * weights)[:, components] for name, each in _build_plate_columns(target).items()},
        target=(target * weights)[:, components],
        prior=prior,
        prior_target=prior_target,
        start=base,
        pinned=prepared.prior is None,
        followed=bool(np.all(rms < _FOLLOWED)),
    )


def _reduce_modes(effect: FloatArray) -> FloatArray:
    """Return fewer modes with nearly the same covariance as the modes (R, 3, S), in units of the residual's sd."""
    if effect.shape[-1] == 0:
        return effect
    flat = effect.reshape(-1, effect.shape[-1])
    values, vectors = np.linalg.eigh(flat.T @ flat)
    return np.asarray((flat @ vectors[:, values > _LEAST_MODE]).reshape(*effect.shape[:2], -1))


def _build_plate_columns(target: FloatArray) -> dict[str, FloatArray]:
    """Return the columns (R, 3) of the plate's errors."""
    names = ("moments", "vertical gain", "vertical force", "position", "gain")
    columns = {name: np.zeros_like(target) for name in names}
    columns["moments"][:, 2] = target[:, 2]
    columns["vertical gain"][:, 1] = target[:, 1]
    columns["vertical force"][:, 1] = 1.0
    columns["position"][:, 2] = target[:, 1]
    return columns  # the column of a common gain is zero, because it changes only the parameters; a known mass shows it


def _build_prior(prepared: PreparedTrial, ratios: BodyRatios, nuisance: int) -> tuple[FloatArray, FloatArray]:
    """Return the rows and right-hand side of the trial's prior, if it has one, and of the ratios."""
    columns = len(prepared.base.kept) + nuisance + len(CAUSES)
    causes = np.zeros((len(ratios.rows), len(CAUSES)))
    for name, column in ratios.by_cause.items():
        causes[:, list(CAUSES).index(name)] = column
    between = np.zeros((len(ratios.rows), nuisance))
    rows, aim = np.concatenate([ratios.rows, between, causes], axis=1), ratios.target
    if prepared.prior is None:
        return rows, aim
    own, its_aim = prepared.prior.rows(columns)
    return np.concatenate([own, rows]), np.concatenate([its_aim, aim])


def _compute_residual(
    columns: FloatArray, target: FloatArray, weights: FloatArray, prepared: PreparedTrial
) -> FloatArray:
    """Return the residual (R, 3) of a fit of columns (R, 3, k), with the trial's own prior."""
    prior, aim = np.zeros((0, columns.shape[-1])), np.zeros(0)
    if prepared.prior is not None:
        prior, aim = prepared.prior.rows(columns.shape[-1])
    rows = np.concatenate([(columns * weights[:, None]).reshape(-1, columns.shape[-1]), prior])
    scale = np.maximum(np.linalg.norm(rows, axis=0), np.finfo(float).tiny)
    x = np.linalg.lstsq(rows / scale, np.concatenate([(target * weights).reshape(-1), aim]), rcond=None)[0] / scale
    return np.asarray(target - columns @ x)


def _estimate_weights(columns: FloatArray, target: FloatArray, time: FloatArray, prepared: PreparedTrial) -> FloatArray:
    """Return the weights (3,) of the components, from the residual of a fit without causes.

    If the residual is correlated in time, the samples count as fewer independent samples. For each column, the products
    of column and residual are summed in blocks of time. The number of samples is divided by the sum of the squared
    block sums, relative to the sum of the squared products.
    """
    weights, residual = np.ones(3), target
    for _ in range(_ROUNDS):
        residual = _compute_residual(columns, target, weights, prepared)
        weights = 1.0 / np.maximum(residual.std(axis=0), 1e-4 * np.sqrt(np.mean(target**2, axis=0)) + 1e-9)
    block = number_blocks(time, prepared.settings.block)
    scores = columns * residual[..., None]
    sums = np.zeros((int(block.max()) + 1, *scores.shape[1:]))
    np.add.at(sums, block, scores)
    squares = np.sum(scores**2, axis=0)
    grown = np.sum(sums**2, axis=0) / np.where(squares > 0.0, squares, np.inf)
    used = np.maximum(np.count_nonzero(squares > 0.0, axis=1), 1)
    return np.asarray(weights / np.sqrt(np.maximum(np.sum(grown, axis=1) / used, 1.0)))
