"""Movements to try, and the search for the best movement to record next.

A movement is the recorded one, faster or larger, a swing of single joints, or a wave of all joints. The search tries
few movements and is reproducible, because its random numbers have a fixed seed. It also starts from the best simple
changes, so its result is hardly ever worse than the best of these.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.design.proposal import (
    CovariancePredictor,
    MovementLimits,
    Objective,
    PredictedUncertainty,
    Proposal,
    Recommendation,
    Trajectory,
    change_movement,
    compute_objective,
    concatenate,
    fit_trajectory,
    list_changes,
)
from mocap_id.dynamics.cautions import measure_sizes
from mocap_id.dynamics.regressor import variance

_FREQUENCIES = (0.2, 0.35, 0.5, 0.7, 1.0)  # Hz
_SYMMETRIC = 0.4  # ratio of the ranges below and above rest from which a joint swings symmetrically about rest
_SWAY = 0.005  # m, step to which the amplitude of a sway is rounded
_HALVINGS = 4
_HALF = "for half of the recording, repeat the recorded movement; for the other half, "
_COMPARED = 16.0  # s, longest part of a movement that is sampled while many movements are compared
_QUICK_SAMPLES, _QUICK_RATE = 50, 20.0  # samples, and samples per second, while many movements are compared


@dataclass(frozen=True)
class SimpleMovement:
    """A movement that may be proposed."""

    words: str  # instructions for the person or the robot
    trajectory: Trajectory  # the movement at the rate at which movements are compared
    # movements performed one after the other; empty for a change of the trial's own movement
    waves: tuple[WaveMovement, ...] = ()
    shared: bool = False  # whether half of the recording is the trial's own movement
    seconds: float | None = None  # duration of the fitted samples, s; None for the duration in `trajectory`
    change: Recommendation | None = None  # the change of the trial's own movement; None for a new movement


@dataclass(frozen=True)
class MovementFamily:
    """The movements from which the search chooses: whether the limits allow them, and the value of the objective."""

    predictor: CovariancePredictor  # predictor of the trial
    limits: MovementLimits
    objective: Objective
    size: FloatArray  # (b,) size of each parameter, SI
    rest: FloatArray  # (n,) posture at both ends, rad
    seconds: float  # duration of the recording, s
    joints: tuple[str, ...]  # names of the joints
    mixed: bool  # whether half of the recording may repeat the trial's own movement

    @property
    def comparison_rate(self) -> float:
        """Rate at which many movements are compared: the trial's own rate divided by a whole number."""
        rate = self.predictor.own.rate
        return rate / max(1, int(rate / _QUICK_RATE))

    def usage(self, movement: Trajectory) -> float:
        """Return the largest fraction of any limit that the movement uses; above 1 the movement is not allowed."""
        body, sd = self.predictor, None
        if self.limits.support is not None:
            moment = body.regressor(movement.q, movement.dq, movement.ddq)[:, 2]
            sd = np.asarray(np.sqrt(variance(moment, body.result.covariance)))
        return self.limits.usage(movement, body.wrench(movement), sd)

    def quick_value(self, movement: Trajectory, seconds: float | None = None) -> float:
        """Return the objective, computed from few samples; ``seconds`` as for :meth:`CovariancePredictor.predict`."""
        if self.objective.startswith("condition"):
            return self.predictor.conditions(movement)[self.objective == "condition-scaled"]
        predicted = self.predictor.predict(movement, seconds, samples=_QUICK_SAMPLES, exactly=False)
        return compute_objective(self.objective, predicted, self.size)

    def propose(self, words: str, movement: Trajectory, seconds: float | None = None) -> Proposal:
        """Return the movement as a proposal; ``seconds`` as for :meth:`CovariancePredictor.predict`."""
        predicted = self.predictor.predict(movement, seconds)
        return Proposal(words, movement, predicted, compute_objective(self.objective, predicted, self.size))

    @property
    def balancing(self) -> bool:
        """Whether the first joint keeps the balance."""
        return self.limits.support is not None and len(self.joints) > 1

    def fit_to_limits(self, waves: WaveMovement, seconds: float) -> WaveMovement | None:
        """Scale a movement down until the limits allow it; return None if less than 1/16 of its range would remain."""

        def usage(scale: float) -> float:
            scaled = waves.scale(scale)
            return self.usage(scaled.trajectory(self.predictor, min(seconds, _COMPARED), self.comparison_rate))

        if usage(1.0) <= 1.0:
            return waves
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if usage(middle) <= 1.0 else (low, middle)
        return None if low == 0.0 else waves.scale(low)

    def reaches(self) -> tuple[FloatArray, FloatArray]:
        """Return the ranges (n,) of each joint below and above rest, rad; for the centre of pressure in m."""
        limits = self.limits
        below, above = self.rest - limits.low, limits.high - self.rest
        if self.balancing and limits.support is not None:
            now = float(static_centre_of_pressure(self.predictor, self.rest[None])[0])
            below[0], above[0] = now - limits.support[0], limits.support[1] - now
        return np.maximum(below, 0.0), np.maximum(above, 0.0)

    @property
    def units(self) -> FloatArray:
        """Step (n,) to which each row of a movement is rounded: 1°, or 5 mm for the centre of pressure."""
        units = np.full(len(self.rest), np.radians(1.0))
        units[0] = _SWAY if self.balancing else units[0]
        return units

    def swing(self, joint: int, frequency: float, seconds: float) -> WaveMovement | None:
        """Return the largest swing of one joint within the limits, in whole degrees; None if it is too small."""
        below, above = (float(part[joint]) for part in self.reaches())
        one_side = min(below, above) < _SYMMETRIC * max(below, above)
        size = max(below, above) / 2 if one_side else min(below, above)
        side = 1.0 if above > below else -1.0
        at = np.arange(len(self.rest)) == joint
        waves = replace(
            hold_posture(self.rest, self.balancing),
            centre=np.where(at, side * size if one_side else 0.0, 0.0),
            frequency=np.full(len(at), frequency),
            amplitude=np.where(at, size, 0.0)[:, None] * [1.0, 0.0],
            phase=np.where(at, -side * np.pi / 2 if one_side else 0.0, 0.0)[:, None] * [1.0, 1.0],
        )
        scaled = self.fit_to_limits(waves, seconds)
        if scaled is None:
            return None
        size, unit = float(scaled.amplitude[joint, 0]), float(self.units[joint])
        whole = unit * np.floor(size / unit + 1e-6)
        return None if whole < (2 * unit if unit != _SWAY else unit) else scaled.scale(whole / size)


def list_simple_movements(family: MovementFamily) -> Iterator[SimpleMovement]:
    """Yield all simple movements within the limits."""
    predictor, rate, joints = family.predictor, family.comparison_rate, len(family.joints)
    # the trial's own movement, faster or larger
    own = predictor.own.thin(rate)
    for change, joint in list_changes(joints):
        if change != "alone":
            movement = change_movement(own, change, joint)
            if family.usage(movement) <= 1.0:
                changed = Recommendation(change, joint, np.nan)
                words = changed.describe(family.joints).removesuffix(",")
                yield SimpleMovement(words, movement, seconds=predictor.now.samples, change=changed)
    # one joint; if there are other joints, after half of the trial's own movement
    singles: list[WaveMovement] = []
    for joint in range(joints):
        swings = [family.swing(joint, frequency, family.seconds / max(joints, 2)) for frequency in _FREQUENCIES]
        found = [waves for waves in swings if waves is not None]
        singles += found
        for waves in found if joints == 1 or family.mixed else ():
            words, shared = describe_waves(waves, family.joints), joints > 1
            words = _HALF + words if shared else words
            yield SimpleMovement(words, compose_trajectory((waves,), family, rate, shared), (waves,), shared)
    # one joint after the other, all at the same frequency
    for frequency in _FREQUENCIES if joints > 1 else ():
        chosen = [waves for waves in singles if waves.frequency[0] == frequency]
        if len(chosen) == joints:
            phrases = ", then ".join(describe_waves(waves, family.joints) for waves in chosen)
            words = f"one joint after the other, each for {family.seconds / len(chosen):.0f} s: {phrases}"
            yield SimpleMovement(words, compose_trajectory(chosen, family, rate), tuple(chosen))


def compose_trajectory(
    waves: Sequence[WaveMovement], family: MovementFamily, rate: float, shared: bool = False
) -> Trajectory:
    """Sample several movements in sequence; if ``shared``, they follow the first half of the trial's own movement."""
    predictor = family.predictor
    seconds = family.seconds / (len(waves) + shared)
    parts = [each.trajectory(predictor, seconds, rate) for each in waves]
    if shared:
        own = predictor.own.thin(rate)
        first = own.cut(own.seconds / 2)
        assert first.fitted is not None
        parts = [replace(first, fitted=first.fitted & predictor.find_fitted(replace(first, fitted=None))), *parts]
    if len(parts) == 1:
        return parts[0]
    whole, *rest = (
        part if part.fitted is not None else replace(part, fitted=predictor.find_fitted(part)) for part in parts
    )
    for part in rest:
        whole = concatenate(whole, part)
    return whole


_LEAST_SWING = np.radians(0.5)  # smaller swings are not mentioned
_LEAST_SWAY = 0.0025  # m: smaller sways are not mentioned
_LEAD, _RAMP = 0.5, 1.5  # s: rest at both ends, and time over which the movement grows and fades


@dataclass(frozen=True)
class WaveMovement:
    """Parameters of a wave movement of n joints."""

    rest: FloatArray  # (n,) angles at both ends, rad
    centre: FloatArray  # (n,) centre of each swing relative to `rest`, rad
    frequency: FloatArray  # (n,) frequency of each joint's wave, Hz
    amplitude: FloatArray  # (n, 2) of the wave and of its first overtone, rad
    phase: FloatArray  # (n, 2) of the wave and of its first overtone, rad
    balanced: bool = False  # whether the first row is the centre of pressure, m, instead of the first joint's angle

    def scale(self, scale: float) -> WaveMovement:
        """Return the movement with its amplitudes and its centres multiplied by ``scale``."""
        return replace(self, centre=scale * self.centre, amplitude=scale * self.amplitude)

    def trajectory(self, body: CovariancePredictor, seconds: float, rate: float) -> Trajectory:
        """Return the movement of a body, sampled for a duration (s) at a rate.

        The angle of the first joint is NaN in samples in which it cannot keep the balance. No derivative is valid then.
        """
        time = np.arange(round(seconds * rate)) / rate
        angle = 2 * np.pi * np.multiply.outer(time, self.frequency)  # (T, n)
        swing = sum(self.amplitude[:, k] * np.sin((k + 1) * angle + self.phase[:, k]) for k in range(2))
        # weights that rise from 0 at both ends to 1, with three continuous derivatives
        side = np.clip((np.minimum(time, time[-1] - time) - _LEAD) / min(_RAMP, seconds / 4), 0.0, 1.0)
        envelope = np.asarray(side**4 * (35.0 - 84.0 * side + 70.0 * side**2 - 20.0 * side**3))
        moved = envelope[:, None] * (self.centre + swing)
        q = self.rest + moved
        if self.balanced:
            q[:, 0] = balance(body, q, static_centre_of_pressure(body, self.rest[None])[0] + moved[:, 0], self.rest[0])
        if not np.isfinite(q).all():
            return Trajectory(time, q, q, q)
        return fit_trajectory(time, q)


def hold_posture(rest: FloatArray, balanced: bool = False) -> WaveMovement:
    """Return a movement that stays in the posture ``rest`` (n,), rad."""
    none = np.zeros((len(rest), 2))
    return WaveMovement(rest, np.zeros(len(rest)), np.full(len(rest), 0.5), none, none, balanced)


def static_centre_of_pressure(body: CovariancePredictor, q: FloatArray) -> FloatArray:
    """Return the centre of pressure (T,), m, of a body at rest in postures (T, n), rad."""
    wrench = body.regressor(q, np.zeros_like(q), np.zeros_like(q)) @ body.result.base
    return np.asarray(wrench[:, 2] / wrench[:, 1])


def balance(body: CovariancePredictor, q: FloatArray, target: FloatArray, near: float) -> FloatArray:
    """Return the angles (T,) of the first joint, rad, with which a body at rest has the centre of pressure ``target``.

    All segments above the first joint rotate with it, so the centre of pressure is a constant plus a sine of its angle.
    Of the two solutions, the one closer to ``near`` is returned; NaN if no angle gives the ``target`` (T,), m. The
    postures ``q`` (T, n) give the other angles.
    """
    ahead, across = q.copy(), q.copy()
    ahead[:, 0], across[:, 0] = 0.0, np.pi / 2
    at_zero, at_right = np.split(static_centre_of_pressure(body, np.concatenate([ahead, across])), 2)
    opposite = q[:1].copy()
    opposite[:, 0] = np.pi
    # the part of the base, which does not rotate, is the same in every posture
    constant = float((at_zero[0] + static_centre_of_pressure(body, opposite)[0]) / 2)
    cosine, sine = at_zero - constant, at_right - constant
    reach = (target - constant) / np.hypot(cosine, sine)
    with np.errstate(invalid="ignore"):  # NaN if no angle reaches the target
        half = np.arccos(np.where(np.abs(reach) <= 1.0, reach, np.nan))
    both = np.arctan2(sine, cosine) + np.array([[1.0], [-1.0]]) * half
    off = (both - near + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(near + np.where(np.abs(off[0]) <= np.abs(off[1]), off[0], off[1]))


def describe_waves(waves: WaveMovement, joints: Sequence[str]) -> str:
    """Return the movement as instructions, one phrase for each of the named joints that moves or is held."""
    phrases = []
    for joint in range(int(waves.balanced), len(joints)):
        name, middle = _add_article(joints[joint]), waves.rest[joint] + waves.centre[joint]
        if float(np.hypot(*waves.amplitude[joint])) < _LEAST_SWING:
            if abs(waves.centre[joint]) >= _LEAST_SWING:
                phrases.append(f"hold {name} at {_format_degrees(middle)}")
            continue
        first, overtone = np.abs(waves.amplitude[joint]).tolist()
        ends = f"from {_format_degrees(middle - first)} to {_format_degrees(middle + first)}"
        second = f", and {_format_degrees(overtone)} at twice this frequency" if overtone >= _LEAST_SWING else ""
        phrases.append(f"swing {name} by ±{_format_degrees(first)} ({ends}) at {waves.frequency[joint]:.2f} Hz{second}")
    text = "; ".join(phrases)
    if not waves.balanced:
        return text
    sway = float(waves.amplitude[0, 0])
    keeping = f"let {_add_article(joints[0])} keep the balance"
    if abs(sway) < _LEAST_SWAY:
        return f"{text}; {keeping}"
    swaying = f"sway to and fro by {100 * abs(sway):.1f} cm at {waves.frequency[0]:.2f} Hz"
    return "; ".join(part for part in (text, f"{swaying} and {keeping}") if part)


def _add_article(name: str) -> str:
    """Return a joint's name as used within a sentence: ``the hip``, but ``joint 2``."""
    return name if name[-1:].isdigit() else f"the {name}"


def _format_degrees(angle: float) -> str:
    return f"{round(float(np.degrees(angle))):d}°"


_STARTS, _STEPS = 20, 60
_FASTEST, _SLOWEST = 0.8, 0.15  # Hz: range of the frequencies
_LEAST_ARC = np.radians(12.0)  # joint centres are uncertain if the rotation is smaller
_STEP, _STEP_DECAY = 0.3, 0.96  # size of the search's steps as a fraction of a joint's range, and its decay
_OVERTONE = 0.3  # largest amplitude of the overtone, relative to the wave
_SHRINK, _TRIES = 0.97, 40


def search_movement(
    family: MovementFamily, rng: np.random.Generator, starts: Sequence[tuple[WaveMovement, bool]]
) -> Proposal | None:
    """Return the best movement of all joints together, or None if the limits allow none.

    ``starts`` are movements from which the search also starts. The bool says whether each takes half of the recording.
    """
    predictor, joints = family.predictor, len(family.joints)
    below, above = family.reaches()
    tried = [_evaluate(family, *start) for start in starts]
    # draw movements between two random angles of each joint, with overtones if the body need not keep its balance
    drawn = []
    for k in range(_STARTS):
        low, high = -below * rng.uniform(0.0, 1.0, joints), above * rng.uniform(0.0, 1.0, joints)
        overtone = 0.0 if family.balancing else rng.uniform(0.0, _OVERTONE, joints)
        first = (high - low) / 2
        waves = WaveMovement(
            rest=family.rest,
            centre=(low + high) / 2,
            frequency=np.exp(rng.uniform(np.log(_SLOWEST), np.log(_FASTEST), joints)),
            amplitude=np.stack([first, first * overtone], axis=1),
            phase=rng.uniform(-np.pi, np.pi, (joints, 2)),
            balanced=family.balancing,
        )
        drawn.append((waves, family.mixed and joints > 1 and k % 2 == 1))
    tried += [_evaluate(family, *start) for start in drawn]
    best = min((each for each in tried if each is not None), key=lambda each: each[0], default=None)
    if best is None:
        return None
    # try random steps, which may exceed the limits and become smaller
    room, overtones = (below + above) / 2, np.array([1.0, 0.0 if family.balancing else _OVERTONE])
    for k in range(_STEPS):
        step, (value, waves, shared) = _STEP * _STEP_DECAY**k, best
        amplitude = waves.amplitude + step * room[:, None] * overtones * rng.normal(size=(joints, 2))
        changed = replace(
            waves,
            centre=np.clip(waves.centre + step * room * rng.normal(size=joints), -below, above),
            frequency=np.clip(waves.frequency * np.exp(step * rng.normal(size=joints)), _SLOWEST, _FASTEST),
            amplitude=amplitude,
            phase=waves.phase + step * np.pi * rng.normal(size=(joints, 2)),
        )
        near = _evaluate(family, changed, shared)
        if near is not None and near[0] < value:
            best = near
    # round to whole degrees, 5 mm and 0.01 Hz, and scale down to the limits; None if nothing remains
    (_, waves, shared), unit = best, family.units
    for _ in range(_TRIES):
        rounded = replace(
            waves,
            centre=np.round(waves.centre / unit) * unit,
            frequency=np.round(waves.frequency, 2),
            amplitude=np.trunc(waves.amplitude / unit[:, None]) * unit[:, None],
        )
        movement = rounded.trajectory(predictor, family.seconds / (1 + shared), predictor.own.rate)
        if family.usage(movement) <= 1.0:
            break
        waves = waves.scale(_SHRINK)
    else:
        return None
    if not np.any(rounded.amplitude):
        return None
    words = describe_waves(rounded, family.joints)
    movement = compose_trajectory((rounded,), family, predictor.own.rate, shared)
    proposal = family.propose(_HALF + words if shared else words, movement)
    return replace(proposal, designed=True, standalone=not shared)


def _evaluate(family: MovementFamily, waves: WaveMovement, shared: bool) -> tuple[float, WaveMovement, bool] | None:
    """Scale a movement to the limits; return its objective, larger for small rotations, with it; None if too small."""
    scaled = family.fit_to_limits(waves, family.seconds)
    if scaled is None or not np.any(np.abs(scaled.amplitude[:, 0]) >= family.units):
        return None
    rate = family.comparison_rate
    if shared:
        return family.quick_value(compose_trajectory((scaled,), family, rate, shared)), scaled, shared
    movement = scaled.trajectory(family.predictor, min(family.seconds, _COMPARED), rate)
    penalty = float(np.max(np.maximum(_LEAST_ARC / np.maximum(np.ptp(movement.q, axis=0), 1e-3), 1.0)))
    return family.quick_value(movement, family.seconds) * penalty, scaled, shared


_HELPS = 0.8  # a movement helps if it reduces the objective to this fraction; less is within the prediction's error
SMALLER = 0.95
"""A standard deviation counts as smaller below this fraction. Errors of plate and cameras may hide a smaller gain."""
_KEPT = 8  # number of simple changes that are evaluated exactly
_STARTS_KNOWN = 3  # number of simple changes from which the search also starts


@dataclass(frozen=True)
class ExperimentDesign:
    """Proposed movements, and the present movement for comparison."""

    objective: Objective  # name of the objective
    size: FloatArray  # (b,) size of each parameter, by which its standard deviation is divided, SI
    now: PredictedUncertainty  # uncertainty of the present movement
    value: float  # objective of the present movement
    simple: tuple[Proposal, ...]  # the best simple changes, best first
    designed: Proposal | None  # the best movement of all joints that the search found; None if the limits allow none
    seconds: float  # duration of the recording, s
    rest: FloatArray  # (n,) posture in which the designed movement starts and ends, rad

    @property
    def proposals(self) -> tuple[Proposal, ...]:
        """All proposals: the simple changes, then the designed movement if there is one."""
        return (*self.simple, *([] if self.designed is None else [self.designed]))

    @property
    def best(self) -> Proposal | None:
        """The best proposal; None if none is better than the present movement."""
        better = [each for each in self.proposals if each.value < self.value]
        return min(better, key=lambda each: each.value, default=None)

    @property
    def best_standalone(self) -> Proposal | None:
        """The best proposal for a robot, without any part of the recorded movement; None if there is none."""
        return min((each for each in self.proposals if each.standalone), key=lambda each: each.value, default=None)

    @property
    def helps(self) -> bool:
        """Whether the best proposal reduces the objective by a fifth, and a standard deviation by 5 %.

        The second condition does not apply if the objective is a condition number.
        """
        if self.best is None or self.best.value >= _HELPS * self.value:
            return False
        return self.objective.startswith("condition") or bool(np.any(self.best.predicted.sd < SMALLER * self.now.sd))


def design_experiment(
    predictor: CovariancePredictor,
    limits: MovementLimits,
    rest: FloatArray,
    joints: Sequence[str],
    *,
    objective: Objective = "intervals",
    seconds: float | None = None,
    mixed: bool = True,
    seed: int = 0,
) -> ExperimentDesign:
    """Search for the movement that determines the parameters best, from and to the posture ``rest`` (n,), rad.

    The recording lasts ``seconds``, by default as long as the trial. With ``mixed``, half of it may repeat the trial's
    own movement; not possible with a chair. ``seed`` is that of the search's random starts.
    """
    family = MovementFamily(
        predictor=predictor,
        limits=limits,
        objective=objective,
        size=np.maximum(measure_sizes(predictor.prepared, predictor.result), 1e-300),
        rest=rest,
        seconds=predictor.own.seconds if seconds is None else seconds,
        joints=tuple(joints),
        mixed=mixed,
    )
    # the best simple change of each kind; changes that differ only in speed and amplitude are of one kind
    chosen: dict[object, SimpleMovement] = {}
    for each in sorted(
        list_simple_movements(family), key=lambda each: family.quick_value(each.trajectory, each.seconds)
    ):
        kind: object
        if each.change is not None:
            kind = each.change.change, each.change.joint
        else:
            moved = [tuple(np.flatnonzero(np.any(waves.amplitude != 0.0, axis=1)).tolist()) for waves in each.waves]
            kind = tuple(moved), each.shared
        chosen.setdefault(kind, each)
    ranked = list(chosen.values())
    # the best of them at the rate of the trial and with the filter of the trial
    simple = []
    for each in ranked[:_KEPT]:
        if each.change is not None:
            movement = change_movement(predictor.own, each.change.change, each.change.joint)
            simple.append(replace(family.propose(each.words, movement, each.seconds), own=True))
        else:
            movement = compose_trajectory(each.waves, family, predictor.own.rate, each.shared)
            simple.append(replace(family.propose(each.words, movement), standalone=not each.shared))
    starts = [(each.waves[0], each.shared) for each in ranked if len(each.waves) == 1][:_STARTS_KNOWN]
    return ExperimentDesign(
        objective=objective,
        size=family.size,
        now=predictor.now,
        value=compute_objective(objective, predictor.now, family.size),
        simple=tuple(sorted(simple, key=lambda proposal: proposal.value)),
        designed=search_movement(family, np.random.default_rng(seed), starts),
        seconds=family.seconds,
        rest=rest,
    )
