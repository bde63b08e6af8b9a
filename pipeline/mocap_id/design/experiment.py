"""Search for the best movement to record next: a simple change of the recorded movement, or a new movement.

The search tries few movements and is reproducible, because its random numbers have a fixed seed. It also starts from
the best simple changes, so its result is hardly ever worse than the best of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.design.movement_limits import MovementLimits
from mocap_id.design.movement_search import search_movement
from mocap_id.design.predicted_covariance import CovariancePredictor, PredictedUncertainty
from mocap_id.design.proposal import MovementScorer, Objective, Proposal, compute_objective
from mocap_id.design.recommendation import change_movement
from mocap_id.design.simple_movements import MovementFamily, SimpleMovement, compose_trajectory, list_simple_movements
from mocap_id.dynamics.excitation import measure_sizes

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
    size = np.maximum(measure_sizes(body.prepared, body.result), 1e-300)
    scorer = MovementScorer(predictor, limits, objective, size)
    family = MovementFamily(scorer, rest, predictor.own.seconds if seconds is None else seconds, tuple(joints), mixed)
    ranked = _rank_simple_movements(family)
    simple = [_evaluate_exactly(family, each) for each in ranked[:_KEPT]]
    singles = [each for each in ranked if len(each.waves) == 1]
    starts = [(each.waves[0], each.shared) for each in singles[:_STARTS_KNOWN]]
    return ExperimentDesign(
        objective=objective,
        size=size,
        now=predictor.now,
        value=compute_objective(objective, predictor.now, size),
        simple=tuple(sorted(simple, key=lambda proposal: proposal.value)),
        designed=search_movement(family, np.random.default_rng(seed), starts),
        seconds=family.seconds,
        rest=rest,
    )


def _rank_simple_movements(family: MovementFamily) -> list[SimpleMovement]:
    """Return the best simple change of each kind, best first."""
    chosen: dict[object, SimpleMovement] = {}
    scorer = family.scorer
    for each in sorted(
        list_simple_movements(family), key=lambda each: scorer.quick_value(each.trajectory, each.seconds)
    ):
        chosen.setdefault(_identify_kind(each), each)
    return list(chosen.values())


def _identify_kind(each: SimpleMovement) -> object:
    """Return a key that is the same for changes that differ only in speed and amplitude."""
    if each.change is not None:
        return each.change.change, each.change.joint
    moved = [tuple(np.flatnonzero(np.any(waves.amplitude != 0.0, axis=1)).tolist()) for waves in each.waves]
    return tuple(moved), each.shared


def _evaluate_exactly(family: MovementFamily, each: SimpleMovement) -> Proposal:
    """Return a simple change as a proposal, evaluated at the rate of the trial and with the filter of the trial."""
    scorer, rate = family.scorer, family.scorer.predictor.own.rate
    if each.change is not None:
        movement = change_movement(scorer.predictor.own, each.change.change, each.change.joint)
        return replace(scorer.propose(each.words, movement, each.seconds), own=True)
    movement = compose_trajectory(each.waves, family, rate, each.shared)
    return replace(scorer.propose(each.words, movement), standalone=not each.shared)
