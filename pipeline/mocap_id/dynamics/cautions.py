"""Checks of external wrenches and of scales, excitation of each base parameter, and cautions for the verdict."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_complete_rows
from mocap_id.dynamics.consistency import PROVEN
from mocap_id.dynamics.fit import DEPENDENT, Fit, estimate_drift, skip_long_rests
from mocap_id.dynamics.identification import Identification, Identified
from mocap_id.dynamics.instrument_errors import (
    MASS_APART,
    PlanarCalibration,
    ScaleCause,
    ScaleCheck,
    propagate_to_wrench,
)
from mocap_id.dynamics.preparation import AnyTrial, LowPass, PreparedTrial, erode
from mocap_id.dynamics.regressor import (
    WRENCH_COMPONENTS,
    BaseSet,
    base_names,
    estimate_covariance,
    number_blocks,
    triangularise,
    unit_covariance,
    wrench_regressor,
)
from mocap_id.verdict import Reason

_FOOT = (1, 0.003)  # column of the full parameters, and standard deviation, m
# column, standard deviation relative to the segment's length, and joint at the segment's end
_SEGMENTS = ((5, 0.0056, 1), (6, 0.007, 1), (9, 0.0064, 2), (10, 0.022, 2))


Ratios: TypeAlias = tuple[FloatArray, FloatArray, dict[str, FloatArray]]
"""Linear relations between the parameters of any person, each divided by its standard deviation.

Coefficients of the parameters (r, b), value of each relation (r,), and the effect (r,) of errors of scale on the
relations, by cause. Only if the person's mass is known from a scale, the gain is one of the causes.
"""


def find_body_ratios(
    base: BaseSet,
    centres: FloatArray,
    reference: FloatArray,
    mass: float,
    calibration: PlanarCalibration,
    *,
    chain: tuple[FloatArray, FloatArray] | None = None,
) -> Ratios:
    """Return the relations between the parameters of a person with the identified ``mass``, kg.

    ``reference`` (4(n + 1),) are full parameters of a reference table on the chain, which give the ratios.
    ``calibration`` contains the errors of the instruments, and the mass from a scale if the person was weighed.
    ``chain``, a matrix (4(n + 1), p) and a constant (4(n + 1),), maps the fitted parameters to full parameters of the
    chain; by default, the base parameters are fitted.
    """
    usual, place = base.regrouping @ reference, {int(column): i for i, column in enumerate(base.kept)}
    matrix, constant = np.eye(len(base.kept)), np.zeros(len(base.kept))
    if chain is not None:
        matrix, constant = base.regrouping @ chain[0], base.regrouping @ chain[1]
    ratios = [(_FOOT[0], _FOOT[1], 1.0, -float(centres[0, 1]))]
    ratios += [(column, sd, float(np.linalg.norm(centres[k])), 0.0) for column, sd, k in _SEGMENTS if k < len(centres)]
    rows, target, lengths, tilt = [], [], [], []
    for column, sd, length, tilted in ratios:
        if column not in place or 0 not in place:
            continue
        own, ratio = place[column], float(usual[place[column]] / usual[place[0]])
        size = sd * length * mass
        rows.append((matrix[own] - ratio * matrix[place[0]]) / size)
        target.append(-(constant[own] - ratio * constant[place[0]]) / size)
        lengths.append(ratio * mass / size)
        tilt.append(tilted * mass / size)
    of_weight = {}
    if calibration.mass is not None and 0 in place:
        of_weight["gain"] = np.append(np.zeros(len(rows)), -calibration.mass / calibration.mass_sd)
        rows.append(matrix[place[0]] / calibration.mass_sd)
        target.append((calibration.mass - constant[place[0]]) / calibration.mass_sd)
        lengths, tilt = [*lengths, 0.0], [*tilt, 0.0]
    by_cause = {"lengths": np.array(lengths), "tilt": np.array(tilt), **of_weight}
    return np.array(rows).reshape(-1, matrix.shape[1]), np.array(target), by_cause


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


def estimate_gains(prepared: PreparedTrial, result: Fit) -> tuple[WrenchGain, ...]:
    """Return the factors of the components of the external wrenches; empty if the movement determines none.

    Components that are too small, or too similar to the effect of the parameters, have no factor. ``result`` is a fit
    to samples with external wrenches.
    """
    # components that are large enough to be tested, and their weighted columns (R, c) in the fit, with a minus sign
    weight = float(np.nanpercentile(np.abs(prepared.recorded.wrench[:, 1]), _LOADED))
    limits = _MATERIAL * weight * np.array([1.0, 1.0, _LEVER])
    candidates, columns = [], []
    for external, wrench in zip(prepared.recorded.external, prepared.external(result.offset, True), strict=True):
        for row, component in enumerate(prepared.settings.components):
            force, limit = wrench[result.samples, component], float(limits[component])
            size = float(np.nanpercentile(np.abs(force), _LOADED))
            if size > limit / 2:  # for a smaller component, not even a wrong sign would exceed the limit
                values = np.zeros(result.design.shape[:2])
                values[:, row] = -force * result.weights[row]
                candidates.append((external.name, WRENCH_COMPONENTS[component], size, limit, result.weights[row]))
                columns.append(values)
    if not candidates:
        return ()
    known: BoolArray = np.all(np.isfinite(np.stack(columns)), axis=(0, 2))
    body, columns = result.design[known, :, :-1], [values[known] for values in columns]

    # a sufficient part of a column must be independent of all parameters and of the other columns
    rows = np.concatenate([body, np.stack(columns, axis=-1)], axis=-1)
    flat = rows.reshape(-1, rows.shape[-1])
    norm = np.maximum(np.linalg.norm(flat, axis=0), np.finfo(float).tiny)
    left, spread, right = np.linalg.svd(triangularise(flat / norm))
    inverse = (right.T / np.maximum(spread, 1.0 / DEPENDENT)) @ left.T
    own = (norm / np.linalg.norm(inverse, axis=1))[-len(candidates) :] / np.sqrt(len(rows))
    kept = [k for k, (*_, limit, scale) in enumerate(candidates) if own[k] / scale > _OWN * limit]
    if not kept:
        return ()

    # fit of these columns together with the parameters: factor minus 1, with its standard deviation
    samples = result.samples[known]
    time = prepared.recorded.time[samples]
    design = np.concatenate([body, np.stack([columns[k] for k in kept], axis=-1)], axis=-1)
    total = prepared.filtered_measured(samples, time - result.offset)[:, list(prepared.settings.components)]
    target = (total * result.weights).reshape(-1)
    flat = design.reshape(len(target), -1)
    norm = np.linalg.norm(flat, axis=0)
    solution = np.linalg.lstsq(flat / norm, target, rcond=None)[0] / norm
    residual = (target - flat @ solution).reshape(len(time), -1)
    covariance = estimate_covariance(design, residual, number_blocks(time, prepared.settings.block))
    sd = np.sqrt(np.diag(covariance))
    return tuple(
        WrenchGain(name, component, 1.0 + float(solution[place]), float(sd[place]), size, limit)
        for place, (name, component, size, limit, _) in enumerate((candidates[k] for k in kept), -len(kept))
    )


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


# Causes of a wrong scale, and their standard deviations: kept near zero, free, and of their estimates in people without
# such an error. `inertia` is the factor of the inertial terms minus 1, which depends on the frame rate.
CAUSES: Mapping[str, tuple[float, float, float]] = {
    "inertia": (0.003, 0.5, 0.02),
    "moments": (0.003, 0.5, 0.05),
    "vertical gain": (0.003, 0.5, 0.05),
    "vertical force": (1.5, 100.0, 30.0),
    "position": (0.0015, 0.1, 0.015),
    "lengths": (0.001, 0.05, 0.015),
    "tilt": (0.0015, 0.1, 0.02),
    "gain": (0.003, 1.0, 0.05),
}
_OF_MODEL = ("inertia", "lengths", "tilt")


def check_scales(prepared: PreparedTrial, gate: BoolArray, result: Identification, ratios: Ratios) -> ScaleCheck | None:
    """Check for a wrong scale of plate, cameras or clock rates.

    The result is None if there are too few usable samples, or if the pinned chain does not describe the person.
    """
    recorded, kept, base = prepared.recorded, prepared.base.kept, result.base
    pinned, gravity = prepared.prior is None, prepared.settings.gravity

    # filtered and thinned samples
    step = max(1, int(recorded.rate / _THINNED))
    lowpass = LowPass(_CUTOFF if pinned else _POSES_CUTOFF, recorded.rate / step)
    clean = LowPass(min(_CLEAN, recorded.rate / 5), recorded.rate)
    measured = lowpass(clean(prepared.measured(result.fit.offset))[::step])
    motion, plain = prepared.motion.at(slice(None, None, step)), prepared.regressor[::step]
    model = lowpass(plain[:, :, kept])
    usable = erode(find_complete_rows(model) & find_complete_rows(measured) & gate[::step], lowpass.reach_samples)
    rows = np.flatnonzero(usable)[::_EVERY]
    rows = rows[skip_long_rests(recorded.dq[::step][rows])]
    if len(rows) * _EVERY < _SECONDS * lowpass.rate:
        return None
    model, target, components, samples = model[rows], measured[rows], list(prepared.settings.components), rows * step

    # Derivatives with respect to the causes: of the model's columns (R, 3, b), or of the plate's wrench (R, 3). That
    # for a common gain is zero, because it changes only the parameters; a known mass shows it.
    moved = {
        "inertia": wrench_regressor(motion, 0.0),
        "lengths": (plain - wrench_regressor(motion.scale(1 + _STEP), gravity)) / _STEP,
        "tilt": (plain - wrench_regressor(motion.tilt(_STEP), gravity)) / _STEP,
    }
    of_model = {name: lowpass(each[:, :, kept])[rows] for name, each in moved.items()}
    names = ("moments", "vertical gain", "vertical force", "position", "gain")
    of_data = {name: np.zeros_like(target) for name in names}
    of_data["moments"][:, 2] = target[:, 2]
    of_data["vertical gain"][:, 1] = target[:, 1]
    of_data["vertical force"][:, 1] = 1.0
    of_data["position"][:, 2] = target[:, 1]

    # nuisance columns (R, 3, k): a constant error of Fx, the clock offset, and modes of the geometry's error
    extra = np.zeros((len(rows), 3, 2))
    extra[:, 0, 0] = 1.0
    extra[:, :, 1] = np.gradient(measured, step / recorded.rate, axis=0)[rows]
    if not (prepared.settings.plate_bias and 0 in components):
        extra = extra[:, :, 1:]
    columns = np.concatenate([model, extra], axis=-1)
    weights = _estimate_weights(columns, target, recorded.time[samples], prepared)
    every = np.stack([*(each @ base for each in of_model.values()), *of_data.values()], axis=-1)
    residual = _compute_residual(np.concatenate([columns, every], axis=-1), target, weights, prepared)
    if pinned and not np.all(np.sqrt(np.mean(residual[:, :2] ** 2, axis=0)) < _FOLLOWED):
        return None
    scaled, effect = weights[:, None], propagate_to_wrench(prepared, base, result.error, samples)
    if effect.shape[-1]:  # fewer modes with nearly the same covariance
        weighted = effect * scaled
        flat = weighted.reshape(-1, effect.shape[-1])
        values, vectors = np.linalg.eigh(flat.T @ flat)
        effect = (flat @ vectors[:, values > _LEAST_MODE]).reshape(*effect.shape[:2], -1) / scaled
    nuisance, modes = np.concatenate([extra, -effect], axis=-1), effect.shape[-1]

    # the ratios, and before them the trial's own prior if it has one
    prior, prior_target, by_cause = ratios
    of_causes = np.zeros((len(prior), len(CAUSES)))
    for name, column in by_cause.items():
        of_causes[:, list(CAUSES).index(name)] = column
    prior = np.concatenate([prior, np.zeros((len(prior), nuisance.shape[-1])), of_causes], axis=1)
    if prepared.prior is not None:
        own_rows, own_aim = prepared.prior.rows(len(kept) + nuisance.shape[-1] + len(CAUSES))
        prior, prior_target = np.concatenate([own_rows, prior]), np.concatenate([own_aim, prior_target])

    # everything weighted, for the components that are fitted
    model, nuisance = (model * scaled)[:, components], (nuisance * scaled)[:, components]
    of_model = {name: (each * scaled)[:, components] for name, each in of_model.items()}
    of_data = {name: (each * weights)[:, components] for name, each in of_data.items()}
    target = (target * weights)[:, components]

    def solve(free: str | None) -> tuple[float, float, float]:
        """Return the cost, and the estimate of one free cause with its standard deviation; 0 and 0 if none is free.

        The model is bilinear and is solved by Gauss-Newton steps.
        """
        # columns whose expected value is zero, modes of the geometry's error and causes, and rows that keep them near
        first = model.shape[-1] + nuisance.shape[-1] - modes
        zero = np.arange(first, first + modes + len(CAUSES))
        limits = np.zeros((len(zero), zero[-1] + 1))
        held = [open_sd if name == free else held_sd for name, (held_sd, open_sd, _) in CAUSES.items()]
        limits[np.arange(len(zero)), zero] = np.concatenate([np.ones(modes), 1.0 / np.array(held)])
        parameters, value = base, dict.fromkeys(CAUSES, 0.0)
        solution, previous = (np.inf, 0.0, np.inf), np.inf
        for _ in range(_ROUNDS):
            changed = model + sum(value[name] * of_model[name] for name in _OF_MODEL)
            own = {name: of_model[name] @ parameters for name in _OF_MODEL}
            known_part = sum(value[name] * own[name] for name in _OF_MODEL)
            causes = np.stack([(own | of_data)[name] for name in CAUSES], axis=-1)
            together = np.concatenate([changed, nuisance, causes], axis=-1)
            flat = np.concatenate([together.reshape(-1, together.shape[-1]), prior, limits])
            aim = np.concatenate([(target + known_part).reshape(-1), prior_target, np.zeros(len(zero))])
            scale = np.linalg.norm(flat, axis=0)
            normal = (flat / scale).T @ (flat / scale)
            inverse = np.linalg.inv(normal)
            x = inverse @ ((flat / scale).T @ aim) / scale
            cost = float(np.sum((aim - flat @ x) ** 2))
            parameters = x[: model.shape[-1]]
            value = dict(zip(CAUSES, x[-len(CAUSES) :].tolist(), strict=True))
            solution = (cost, 0.0, 0.0)
            if free is not None:
                place = list(CAUSES).index(free) - len(CAUSES)
                solution = (cost, value[free], float(np.sqrt(inverse[place, place])) / scale[place])
            if abs(previous - cost) < 0.1:
                break
            previous = cost
        return solution

    # all causes are kept near zero, then one after the other is free
    held, found = solve(None)[0], {}
    for name, (_, _, spread) in CAUSES.items():
        if name == "gain" and name not in by_cause:
            continue
        cost, value, sd = solve(name)
        limit = float(_SURE * np.hypot(sd, (0.0 if pinned else 1.0) * spread))
        found[name] = ScaleCause(value, sd, max(held - cost, 0.0), limit)

    # the significant cause that explains most is first, then come causes that explain almost as much
    order = sorted(found, key=lambda name: -found[name].explains)
    significant = (n for n in order if found[n].explains > _SEEN and abs(found[n].value) > found[n].limit)
    best = next(significant, None)
    if best is None:
        return found, ()
    near = (n for n in order if n != best and found[best].explains - found[n].explains <= _SEEN)
    return found, (best, *near)


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


Identifiability: TypeAlias = Literal["known", "weak", "not identifiable"]

# relative standard deviation above which a parameter is weak by default, also of a robot, and not identifiable
WEAK, WEAK_ROBOT, NOT_IDENTIFIABLE = 0.2, 0.05, 1.0
LEAST_LEVER = 0.05  # m: least lever of the base's first moment


@dataclass(frozen=True)
class Excitation:
    """Accuracy of each base parameter, and how strongly the movement excites the parameter."""

    names: tuple[str, ...]  # names of the base parameters
    verdict: tuple[Identifiability, ...]  # class of each parameter
    size: FloatArray  # (b,) size of each parameter, with which its standard deviation is compared, SI
    relative_sd: FloatArray  # (b,) standard deviation divided by the size
    # (b,) norm of the part of the column that is orthogonal to all others, in standard deviations of the residual per
    # SI unit of the parameter
    own: FloatArray
    share: FloatArray  # (b,) `own` as a fraction of the norm of the whole column, 0 to 1
    weak: float = WEAK  # relative standard deviation above which a parameter is weak

    @property
    def doubtful(self) -> tuple[int, ...]:
        """Indices of the parameters that are weak or not identifiable."""
        return tuple(i for i, verdict in enumerate(self.verdict) if verdict != "known")


def measure_excitation(prepared: PreparedTrial, result: Identification, weak: float = WEAK) -> Excitation:
    """Measure the excitation of every base parameter; a relative standard deviation above ``weak`` makes it weak."""
    names = base_names(prepared.base, prepared.recorded.centres)
    return classify_parameters(names, result.fit, result.base_sd, measure_sizes(prepared, result), weak)


def classify_parameters(
    names: tuple[str, ...], result: Fit, base_sd: FloatArray, size: FloatArray, weak: float = WEAK
) -> Excitation:
    """Classify the base parameters of a fit; ``base_sd`` and ``size`` (b,) are in SI units."""
    relative = base_sd / np.maximum(size, 1e-300)
    # norm (b,) of the independent part of each base column, and this norm divided by the column's norm
    rows = result.design.reshape(-1, result.design.shape[-1])
    own = 1.0 / np.sqrt(np.diag(unit_covariance(rows))[: result.base])
    share = own / np.maximum(np.linalg.norm(rows, axis=0)[: result.base], 1e-300)
    verdict: tuple[Identifiability, ...] = tuple(
        "not identifiable" if s < 1.0 / DEPENDENT else classify(r, weak) for r, s in zip(relative, share, strict=True)
    )
    return Excitation(names, verdict, size, relative, own, share, weak)


def measure_sizes(prepared: PreparedTrial, result: Identification) -> FloatArray:
    """Return the size of each base parameter (b,), SI, with which its standard deviation is compared.

    The size of a first moment is the norm of (mx, my), because mx alone may be zero. The base segment has no my, and
    its mx is the body's mass times the centre of pressure in the upright posture; its size is at least the mass times 5
    cm. The size of any other parameter is its absolute value.
    """
    kept = prepared.base.kept
    segment, kind = kept // 4, kept % 4
    mass = float(result.full[::4].sum()) if 1 in prepared.settings.components else 0.0
    size = np.abs(result.base)
    for i in np.flatnonzero((kind == 1) | (kind == 2)):
        pair = result.base[(segment == segment[i]) & ((kind == 1) | (kind == 2))]
        size[i] = np.linalg.norm(pair) if segment[i] else max(size[i], LEAST_LEVER * mass)
    return np.asarray(size)


def classify(relative_sd: float, weak: float = WEAK) -> Identifiability:
    """Return the class of a parameter; a relative standard deviation above ``weak``, up to 1, makes it weak."""
    if not np.isfinite(relative_sd) or relative_sd > NOT_IDENTIFIABLE:
        return "not identifiable"
    return "weak" if relative_sd > weak else "known"


OFFSET_LARGE = 0.02  # s: largest clock offset of synchronised devices
_BOUNDED = 0.05  # relative increase of the cost because of physical consistency
_OFFSET_OF_DELAYS = 0.15  # s, largest offset by filters, export and a late start; only a note, because it is corrected
_DRIFT_SEEN, _DRIFT_LEAST = 5.0, 0.005  # significant change of the offset in a trial: in standard deviations, and in s
_OFFSET_SEEN, _OFFSET_LEAST = 3.0, 5e-4  # significant clock offset: in standard deviations, and in s


def find_cautions(
    prepared: PreparedTrial,
    result: Identification,
    excited: Excitation,
    recommendation: str,
    *,
    given: float | None,
    standing: float | None,
    calibration: PlanarCalibration,
) -> tuple[Reason, ...]:
    """Return the cautions about a trial in the plane: those of :func:`find_cautions_in_space`, and about the mass.

    The masses from the movement, from standing and from the configuration are compared. ``given`` is the mass of the
    person from the configuration, kg, and ``standing`` the mass that the plates measure while the person stands, kg;
    None if not given or not measured. ``calibration`` are the errors of plate and scale, which give the allowed
    difference of these masses.
    """
    reasons = list(find_cautions_in_space(prepared, result, excited, recommendation))
    # if movement and standing give different masses, something else carries weight
    total = get_identified_mass(prepared, result)
    if total is not None and standing is not None and not abs(total / standing - 1) <= MASS_APART:
        unknown = ". Until then, the joint torques are unknown (NaN)" if total < standing else ""
        reasons.append(
            Reason(
                "load-shared",
                f"the movement gives a mass of {total:.1f} kg, but the plates measure {standing:.1f} kg while the "
                "person stands: in some of the fitted samples, something other than the plates carries a part of the "
                "body. If a chair is used, set `protocol: sit-to-stand`, which leaves its contact out; otherwise look "
                f"for a hand on a support, or exclude the contact with `window:`{unknown}",
                value=total,
                limit=standing,
            )
        )
    measured = total if standing is None else standing
    if given is not None and measured is not None and not abs(measured / given - 1) <= calibration.mass_limit(measured):
        reasons.append(
            Reason(
                "mass-contradiction",
                f"the plates measure {measured:.1f} kg, but `subject: {{mass: …}}` is {given:g} kg: check the mass, "
                "the calibration of the plates, and whether anything else stands on them or carries a part of the "
                "body (a chair needs `protocol: sit-to-stand`)",
                value=measured,
                limit=given,
            )
        )
    return tuple(reasons)


def find_cautions_in_space(
    trial: AnyTrial, result: Identified, excited: Excitation, recommendation: str
) -> Iterator[Reason]:
    """Yield the cautions about clock, solver, consistency and weak parameters, in the plane or in space."""
    yield from _check_clock(trial, result)

    # the solver, and a wrench that possible bodies fit badly
    solution, answer = result.solution, result.solution.answer
    if solution.consistency != solution.requested:
        yield Reason(
            "cone-unproven",
            f"`identify-dim: {{consistency: {solution.requested}}}` was set, but Clarabel's solution does not pass the "
            f"optimality check; the solution on the grid (`{solution.consistency}`) is used instead, which "
            + ("passes the check" if answer.optimality.proven else "does not pass the check either"),
        )
    if not answer.optimality.proven:
        yield Reason(
            "solver-unproven",
            f"no solver's solution passes the optimality check; the solution of {answer.solver} ({answer.status}) is "
            f"used, although its cost may exceed the least cost by a fraction of {answer.optimality.excess:.1e}",
            value=answer.optimality.excess,
            limit=PROVEN,
        )
    elif answer.solver == "osqp":
        yield Reason(
            "solver-fallback",
            "the solution of non-negative least squares does not pass the optimality check; the solution of OSQP "
            "passes the check and is used",
            level="ok",
        )
    price = solution.price
    if not price <= _BOUNDED:
        worse = f"{100 * price:.0f} % worse" if price < 1 else f"{1 + price:.3g} times worse"
        yield Reason(
            "parameters-bounded",
            f"physically possible parameters fit the wrench {worse} than unconstrained parameters: check "
            "joints, markers and plate, and whether a part of the mass is far from the markers",
            value=price,
            limit=_BOUNDED,
        )

    # parameters that the movement hardly excites
    doubtful = excited.doubtful
    if not doubtful:
        return
    unknown = [excited.names[i] for i in doubtful if excited.verdict[i] == "not identifiable"]
    listed = ", ".join(f"{excited.names[i]} ({100 * excited.relative_sd[i]:.0f} %)" for i in doubtful)
    none = f"; not identifiable (above {100 * NOT_IDENTIFIABLE:.0f} %): {', '.join(unknown)}" if unknown else ""
    yield Reason(
        "parameters-weak",
        f"these base parameters have a standard deviation above {100 * excited.weak:.0f} % of their size: "
        f"{listed}{none}. " + recommendation,
        value=float(len(doubtful)),
    )


def get_identified_mass(prepared: PreparedTrial, result: Identification) -> float | None:
    """Return the identified mass of the body, kg; None if Fy was not fitted, because only Fy determines it."""
    return float(result.full[::4].sum()) if 1 in prepared.settings.components else None


def _check_clock(prepared: AnyTrial, result: Identified) -> Iterator[Reason]:
    """Yield reasons about a clock offset that is unknown, large or left in the data, and about a drift."""
    clock, fit, limit = prepared.recorded.clock, result.fit, prepared.settings.offset_limit
    if clock.doubt is not None:
        yield Reason(
            "clock-offset-unknown",
            f"the clock offset between cameras and plate is not known: {clock.doubt}. The forces were used with an "
            f"offset of {1e3 * (clock.offset + fit.offset):+.0f} ms, and all results are right only if this is right: "
            "check that markers and forces belong to the same recording, and synchronise the clocks, or correct the "
            "times of the forces in the file",
            value=fit.total_offset,
            limit=limit,
        )
        return
    if not fit.offset_known:
        around = f" around {clock.offset:+.2f} s" if clock.offset else ""
        yield Reason(
            "clock-offset-unknown",
            f"the clock offset between cameras and plate is not within ± {limit:g} s{around}, or this movement does "
            f"not determine it (standard deviation {1e3 * result.offset_sd:.0f} ms). "
            f"{f'Only {clock.offset:+.2f} s was' if clock.offset else 'No offset was'} corrected: check that markers "
            "and forces belong to the same recording, or increase `identify-dim: {clock_offset_limit_s: …}`",
            value=fit.total_offset,
            limit=limit,
        )
        return
    # one offset is corrected for the whole trial, so it should not change
    drift, sd = estimate_drift(prepared, fit)
    time = prepared.recorded.time[fit.samples]
    seconds = float(time[-1] - time[0])
    change, most = drift * seconds, max(_DRIFT_SEEN * sd * seconds, _DRIFT_LEAST)
    if abs(change) > most:
        yield Reason(
            "clock-drift",
            f"the clock offset between cameras and plate changes by {1e3 * change:+.0f} ms during the trial "
            f"({1e3 * drift:+.2f} ± {1e3 * sd:.2f} ms/s), expected at most {1e3 * most:.0f} ms. One offset is "
            "corrected for the whole trial: the devices do not share a clock, or a frame rate is not exactly as the "
            "file says",
            value=change,
            limit=most,
        )
    if not prepared.settings.apply_offset:
        offset, seen = abs(fit.total_offset), max(_OFFSET_SEEN * result.offset_sd, _OFFSET_LEAST)
        if not offset <= seen:
            yield Reason(
                "clock-offset-kept",
                f"the clocks of cameras and plate are {1e3 * fit.total_offset:.2f} ms apart (standard deviation "
                f"{1e3 * result.offset_sd:.2f} ms), but `identify-dim: {{apply_clock_offset: false}}` prevents the "
                "correction. In a person's movement, one millisecond changes a parameter by up to a third: remove the "
                "setting, or synchronise the clocks",
                value=offset,
                limit=seen,
            )
        return
    if abs(fit.total_offset) <= OFFSET_LARGE:
        return
    board = isinstance(prepared, PreparedTrial) and len(prepared.recorded.measures) < prepared.recorded.wrench.shape[1]
    late = "late" if fit.total_offset < 0 else "early"
    yield Reason(
        "clock-offset-large",
        f"the forces come {1e3 * abs(fit.total_offset):.0f} ms too {late} in relation to the cameras (standard "
        f"deviation {1e3 * result.offset_sd:.1f} ms), expected at most {1e3 * OFFSET_LARGE:.0f} ms. This was corrected"
        + ("" if board else ", but the clocks are not synchronised: check trigger, delays and export of the plates")
        + (". At the ends of the trial, frames without force are left out" if clock.offset else ""),
        value=fit.total_offset,
        limit=OFFSET_LARGE,
        level="ok" if board or abs(fit.total_offset) <= _OFFSET_OF_DELAYS else "caution",
    )
