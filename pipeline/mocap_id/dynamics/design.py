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
from mocap_id.dynamics.instructions import swung
from mocap_id.dynamics.limits import Limits
from mocap_id.dynamics.proposal import Judge, Objective, Proposal, objective_value
from mocap_id.dynamics.simple_changes import COMPARED, Family, Simple, course_of, simple_changes
from mocap_id.dynamics.waves import Waves, pressure

HELPS = 0.8  # of the objective: more is within what the foresight is off by
_KEPT = 8  # simple changes that are looked at closely
_STARTS, _STEPS = 30, 60
_FASTEST = 0.8  # Hz
_SLOWEST = 0.15
_LEAST_ARC = np.radians(12.0)  # a joint that turns less is hard to find
_REACH, _CALMER = 0.3, 0.96  # of a joint's room: how far the search steps, and how that shrinks
_SWAY = 0.005  # m
_SHRINK, _TRIES = 0.97, 40


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
    best : Proposal
        The best movement of all.
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
    best: Proposal
    seconds: float
    rest: FloatArray

    @property
    def helps(self) -> bool:
        """Whether anything takes a fifth off the objective."""
        return self.best.value < HELPS * self.value


def design(
    sight: Foresight,
    limits: Limits,
    rest: FloatArray,
    joints: Sequence[str],
    *,
    objective: Objective = "intervals",
    seconds: float | None = None,
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
    seed : int
        Of the starts.
    """
    body = sight.body
    size = np.maximum(sizes(body.prepared, body.found), 1e-300)
    judge = Judge(sight, limits, objective, size)
    family = Family(judge, rest, sight.own.seconds if seconds is None else seconds, tuple(joints))
    simple = _ranked(family)
    found = _searched(family, np.random.default_rng(seed))
    candidates = [*simple, *([] if found is None else [found])]
    value = objective_value(objective, sight.now, size)
    present = Proposal("the movement as it was", sight.own, sight.now, value)
    best = min([*candidates, present], key=lambda each: each.value)
    return Design(objective, size, sight.now, value, tuple(simple), best, family.seconds, rest)


def _ranked(family: Family) -> list[Proposal]:
    """The best simple changes, each kind once."""
    judge, rate = family.judge, family.judge.sight.own.rate
    tried: list[tuple[float, Simple]] = []
    for each in simple_changes(family):
        tried.append((judge.quickly(each.course, each.seconds), each))
    chosen: dict[object, tuple[float, Simple]] = {}
    for value, each in sorted(tried, key=lambda pair: pair[0]):
        chosen.setdefault(_kind(each), (value, each))
    proposals = [_closely(family, each, rate) for _, each in list(chosen.values())[:_KEPT]]
    return sorted(proposals, key=lambda proposal: proposal.value)


def _kind(each: Simple) -> object:
    """Changes of one kind differ in how fast and how far alone."""
    if each.advice is not None:
        return each.advice.change, each.advice.joint
    moved = [tuple(np.flatnonzero(np.any(waves.amplitude != 0.0, axis=1)).tolist()) for waves in each.waves]
    return tuple(moved), each.beside, len(each.waves) == 1 and each.waves[0].balanced


def _closely(family: Family, each: Simple, rate: float) -> Proposal:
    """A simple change at the trial's own rate, filtered as the trial was."""
    judge = family.judge
    if each.advice is not None:
        course = changed(judge.sight.own, each.advice.change, each.advice.joint)
        return judge.proposal(each.words, course, each.seconds)
    return judge.proposal(each.words, course_of(each.waves, family, rate, each.beside))


def _searched(family: Family, rng: np.random.Generator) -> Proposal | None:
    """The best movement of all joints together, or None where the limits allow none."""
    tried = [_worth(family, _drawn(family, rng)) for _ in range(_STARTS)]
    best = min((each for each in tried if each is not None), key=lambda each: each[0], default=None)
    if best is None:
        return None
    for step in range(_STEPS):
        near = _worth(family, _nudged(family, best[1], rng, _REACH * _CALMER**step))
        if near is not None and near[0] < best[0]:
            best = near
    final = _settled(family, best[1])
    if final is None:
        return None
    course = final.course(family.judge.sight.body, family.seconds, family.judge.sight.own.rate)
    return family.judge.proposal(swung(final, family.joints), course, designed=True)


def _worth(family: Family, waves: Waves) -> tuple[float, Waves] | None:
    """What a movement is worth as far as the limits allow it, with more for joints that hardly turn."""
    found = family.fitting(waves, family.seconds)
    if found is None:
        return None
    course = found.course(family.judge.sight.body, min(family.seconds, COMPARED), family.judge.looked)
    arc = np.ptp(course.q, axis=0)
    hidden = float(np.max(np.maximum(_LEAST_ARC / np.maximum(arc, 1e-3), 1.0)))
    return family.judge.quickly(course, family.seconds) * hidden, found


def _reaches(family: Family) -> tuple[FloatArray, FloatArray]:
    """How far each row of a movement may go below and above where it rests (n,): rad, or m of the pressure."""
    limits = family.judge.limits
    below, above = family.rest - limits.low, limits.high - family.rest
    if family.balancing and limits.support is not None:
        now = float(pressure(family.judge.sight.body, family.rest[None])[0])
        below[0], above[0] = now - limits.support[0], limits.support[1] - now
    return np.maximum(below, 0.0), np.maximum(above, 0.0)


def _drawn(family: Family, rng: np.random.Generator) -> Waves:
    """A movement at random: between two postures of each joint, with an overtone where nobody has to balance."""
    below, above = _reaches(family)
    joints = len(below)
    low, high = -below * rng.uniform(0.0, 1.0, joints), above * rng.uniform(0.0, 1.0, joints)
    overtone = 0.0 if family.balancing else rng.uniform(0.0, 0.3, joints)
    first = (high - low) / 2
    return Waves(
        rest=family.rest,
        centre=(low + high) / 2,
        frequency=np.exp(rng.uniform(np.log(_SLOWEST), np.log(_FASTEST), joints)),
        amplitude=np.stack([first, first * overtone], axis=1),
        phase=rng.uniform(-np.pi, np.pi, (joints, 2)),
        balanced=family.balancing,
    )


def _nudged(family: Family, waves: Waves, rng: np.random.Generator, step: float) -> Waves:
    """One near it; what is too much the limits take back."""
    below, above = _reaches(family)
    room, joints = (below + above) / 2, len(below)
    overtones = np.array([1.0, 0.0 if family.balancing else 0.3])
    amplitude = waves.amplitude + step * room[:, None] * overtones * rng.normal(size=(joints, 2))
    return replace(
        waves,
        centre=np.clip(waves.centre + step * room * rng.normal(size=joints), -below, above),
        frequency=np.clip(waves.frequency * np.exp(step * rng.normal(size=joints)), _SLOWEST, _FASTEST),
        amplitude=amplitude,
        phase=waves.phase + step * np.pi * rng.normal(size=(joints, 2)),
    )


def _settled(family: Family, waves: Waves) -> Waves | None:
    """In whole degrees, half centimetres and hundredths of a hertz, and within the limits as it is then."""
    unit = np.full(len(waves.rest), np.radians(1.0))
    unit[0] = _SWAY if waves.balanced else unit[0]
    sight = family.judge.sight
    for _ in range(_TRIES):
        rounded = replace(
            waves,
            centre=np.round(waves.centre / unit) * unit,
            frequency=np.round(waves.frequency, 2),
            amplitude=np.trunc(waves.amplitude / unit[:, None]) * unit[:, None],
        )
        course = rounded.course(sight.body, family.seconds, sight.own.rate)
        if family.judge.strain(course) <= 1.0:
            return rounded
        waves = waves.sized(_SHRINK)
    return None
