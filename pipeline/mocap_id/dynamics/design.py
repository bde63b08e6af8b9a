"""Which movement would tell most: a search among simple changes, and among movements of all joints together.

The search is small and repeats itself: starts drawn from a seed, each made to fit within the limits, then the best of
them changed little by little as long as that helps. What it finds is never worse than the best simple change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.excitation import changed, sizes
from mocap_id.dynamics.foresight import Foreseen, Foresight
from mocap_id.dynamics.limits import Limits
from mocap_id.dynamics.proposal import Judge, Objective, Proposal, objective_value
from mocap_id.dynamics.search import searched
from mocap_id.dynamics.simple_changes import Family, Simple, course_of, simple_changes

HELPS = 0.8  # of the objective: more is within what the foresight is off by
_KEPT = 8  # simple changes that are looked at closely
_STARTS_KNOWN = 3  # of them that the search starts from too


@dataclass(frozen=True)
class Design:
    """What to record.

    Parameters
    ----------
    objective : Objective
    size : (b,) array
        What each standard deviation counts by, SI.
    now : Foreseen
        What the present movement is worth.
    value : float
        Its objective.
    simple : tuple of Proposal
        The best simple changes, best first.
    designed : Proposal or None
        The best movement of all joints together that the search found; None where the limits allow none.
    seconds : float
        Length of the recording.
    rest : (n,) array
        Posture in which the designed movement starts and ends, rad.
    """

    objective: Objective
    size: FloatArray
    now: Foreseen
    value: float
    simple: tuple[Proposal, ...]
    designed: Proposal | None
    seconds: float
    rest: FloatArray

    @property
    def every(self) -> tuple[Proposal, ...]:
        """All that is proposed."""
        return (*self.simple, *([] if self.designed is None else [self.designed]))

    @property
    def best(self) -> Proposal | None:
        """The best of all that is proposed; None where nothing is better than the present movement."""
        better = [each for each in self.every if each.value < self.value]
        return min(better, key=lambda each: each.value, default=None)

    @property
    def made(self) -> Proposal | None:
        """The best of those that are whole movements of their own, which a robot can follow."""
        return min((each for each in self.every if each.made), key=lambda each: each.value, default=None)

    @property
    def helps(self) -> bool:
        """Whether anything takes a fifth off the objective."""
        return self.best is not None and self.best.value < HELPS * self.value


def design(
    sight: Foresight,
    limits: Limits,
    rest: FloatArray,
    joints: Sequence[str],
    *,
    objective: Objective = "intervals",
    seconds: float | None = None,
    mixed: bool = True,
    seed: int = 0,
) -> Design:
    """Search for the movement that tells most.

    Parameters
    ----------
    sight : Foresight
        Of the trial.
    limits : Limits
    rest : (n,) array
        Posture to start from and end in, rad.
    joints : sequence of str
        Names.
    objective : {"intervals", "volume", "condition", "condition-scaled"}
    seconds : float, optional
        Length of the recording; as long as the trial where not given.
    mixed : bool
        Another movement may share a recording with the trial's own: not with a chair in it.
    seed : int
        Of the starts.
    """
    body = sight.body
    size = np.maximum(sizes(body.prepared, body.found), 1e-300)
    judge = Judge(sight, limits, objective, size)
    family = Family(judge, rest, sight.own.seconds if seconds is None else seconds, tuple(joints), mixed)
    ranked = _ranked(family)
    simple = [_closely(family, each) for each in ranked[:_KEPT]]
    singles = [each for each in ranked if len(each.waves) == 1]
    starts = [(each.waves[0], each.beside) for each in singles[:_STARTS_KNOWN]]
    return Design(
        objective=objective,
        size=size,
        now=sight.now,
        value=objective_value(objective, sight.now, size),
        simple=tuple(sorted(simple, key=lambda proposal: proposal.value)),
        designed=searched(family, np.random.default_rng(seed), starts),
        seconds=family.seconds,
        rest=rest,
    )


def _ranked(family: Family) -> list[Simple]:
    """The best simple changes, each kind once, best first."""
    tried = [(family.judge.quickly(each.course, each.seconds), each) for each in simple_changes(family)]
    chosen: dict[object, Simple] = {}
    for _, each in sorted(tried, key=lambda pair: pair[0]):
        chosen.setdefault(_kind(each), each)
    return list(chosen.values())


def _kind(each: Simple) -> object:
    """Changes of one kind differ in how fast and how far alone."""
    if each.advice is not None:
        return each.advice.change, each.advice.joint
    moved = [tuple(np.flatnonzero(np.any(waves.amplitude != 0.0, axis=1)).tolist()) for waves in each.waves]
    return tuple(moved), each.beside


def _closely(family: Family, each: Simple) -> Proposal:
    """A simple change at the trial's own rate, filtered as the trial was."""
    judge, rate = family.judge, family.judge.sight.own.rate
    if each.advice is not None:
        course = changed(judge.sight.own, each.advice.change, each.advice.joint)
        return replace(judge.proposal(each.words, course, each.seconds), own=True)
    course = course_of(each.waves, family, rate, each.beside)
    return replace(judge.proposal(each.words, course), made=not each.beside)
