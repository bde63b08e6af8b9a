"""Search for the best movement to record next: a simple change of the recorded movement, or a new movement.

The search tries few movements and is reproducible, because its random numbers have a fixed seed. It also starts from
the best simple changes, so its result is hardly ever worse than the best of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.design.movements import (
    COMPARED,
    HALF,
    MovementFamily,
    SimpleMovement,
    WaveMovement,
    compose_trajectory,
    describe_waves,
    list_simple_movements,
)
from mocap_id.design.predicted_covariance import CovariancePredictor, PredictedUncertainty
from mocap_id.design.proposal import MovementLimits, Objective, Proposal, change_movement, compute_objective
from mocap_id.dynamics.cautions import measure_sizes

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
        movement = rounded.trajectory(predictor.body, family.seconds / (1 + shared), predictor.own.rate)
        if family.usage(movement) <= 1.0:
            break
        waves = waves.scale(_SHRINK)
    else:
        return None
    if not np.any(rounded.amplitude):
        return None
    words = describe_waves(rounded, family.joints)
    movement = compose_trajectory((rounded,), family, predictor.own.rate, shared)
    proposal = family.propose(HALF + words if shared else words, movement)
    return replace(proposal, designed=True, standalone=not shared)


def _evaluate(family: MovementFamily, waves: WaveMovement, shared: bool) -> tuple[float, WaveMovement, bool] | None:
    """Scale a movement to the limits; return its objective, larger for small rotations, with it; None if too small."""
    scaled = family.fit_to_limits(waves, family.seconds)
    if scaled is None or not np.any(np.abs(scaled.amplitude[:, 0]) >= family.units):
        return None
    rate = family.comparison_rate
    if shared:
        return family.quick_value(compose_trajectory((scaled,), family, rate, shared)), scaled, shared
    movement = scaled.trajectory(family.predictor.body, min(family.seconds, COMPARED), rate)
    penalty = float(np.max(np.maximum(_LEAST_ARC / np.maximum(np.ptp(movement.q, axis=0), 1e-3), 1.0)))
    return family.quick_value(movement, family.seconds) * penalty, scaled, shared


HELPS = 0.8
"""A movement helps if it reduces the objective to this fraction. Less is within the error of the prediction."""
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
        if self.best is None or self.best.value >= HELPS * self.value:
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
    """Search for the movement that determines the parameters best.

    Parameters
    ----------
    rest : (n,) array
        Posture at the start and the end, rad.
    objective : Objective
        Name of the objective to minimise (:data:`~mocap_id.design.proposal.OBJECTIVES`).
    seconds : float, optional
        Duration of the recording, s; by default that of the trial.
    mixed : bool
        Whether half of the recording may repeat the trial's own movement; not possible with a chair.
    seed : int
        Seed of the search's random starts.
    """
    body = predictor.body
    family = MovementFamily(
        predictor=predictor,
        limits=limits,
        objective=objective,
        size=np.maximum(measure_sizes(body.prepared, body.result), 1e-300),
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
