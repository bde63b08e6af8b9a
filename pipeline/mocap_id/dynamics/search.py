"""The search for a movement of all joints together that tells most, within the limits.

Starts are drawn from a seed, or are simple changes; each is made to fit within the limits; the best is then changed
little by little as long as that helps. With several joints a movement may take the whole recording, or half
of it beside the trial's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.dynamics.instructions import swung
from mocap_id.dynamics.proposal import Proposal
from mocap_id.dynamics.simple_changes import COMPARED, HALF, Family, course_of
from mocap_id.dynamics.waves import Waves

_STARTS, _STEPS = 20, 60
_FASTEST, _SLOWEST = 0.8, 0.15  # Hz
_LEAST_ARC = np.radians(12.0)  # a joint that turns less is hard to find
_REACH, _CALMER = 0.3, 0.96  # of a joint's room: how far the search steps, and how that shrinks
_OVERTONE = 0.3  # of a wave, at most
_SHRINK, _TRIES = 0.97, 40


@dataclass(frozen=True)
class _Found:
    value: float
    waves: Waves
    beside: bool


def searched(family: Family, rng: np.random.Generator, starts: Sequence[tuple[Waves, bool]] = ()) -> Proposal | None:
    """The best movement of all joints together, or None where the limits allow none.

    Parameters
    ----------
    family : Family
    rng : Generator
    starts : sequence of (Waves, bool)
        Movements to start from beside those at random, and whether they take half of the recording.
    """
    sharing = family.mixed and len(family.joints) > 1
    drawn = [(_drawn(family, rng), sharing and k % 2 == 1) for k in range(_STARTS)]
    tried = [_worth(family, *start) for start in (*starts, *drawn)]
    best = min((each for each in tried if each is not None), key=lambda each: each.value, default=None)
    if best is None:
        return None
    for step in range(_STEPS):
        near = _worth(family, _nudged(family, best.waves, rng, _REACH * _CALMER**step), best.beside)
        if near is not None and near.value < best.value:
            best = near
    final = _settled(family, best.waves, best.beside)
    if final is None:
        return None
    course = course_of((final,), family, family.judge.sight.own.rate, best.beside)
    words = swung(final, family.joints)
    proposal = family.judge.proposal(HALF + words if best.beside else words, course)
    return replace(proposal, designed=True, made=not best.beside)


def _worth(family: Family, waves: Waves, beside: bool) -> _Found | None:
    """What a movement is worth as far as the limits allow it, with more for joints that hardly turn."""
    found = family.fitting(waves, family.seconds)
    if found is None or not np.any(np.abs(found.amplitude[:, 0]) >= family.units):
        return None
    judge, rate = family.judge, family.judge.looked
    if beside:
        return _Found(judge.quickly(course_of((found,), family, rate, beside)), found, beside)
    course = found.course(judge.sight.body, min(family.seconds, COMPARED), rate)
    hidden = float(np.max(np.maximum(_LEAST_ARC / np.maximum(np.ptp(course.q, axis=0), 1e-3), 1.0)))
    return _Found(judge.quickly(course, family.seconds) * hidden, found, beside)


def _drawn(family: Family, rng: np.random.Generator) -> Waves:
    """A movement at random: between two postures of each joint, with an overtone where nobody has to balance."""
    below, above = family.reaches()
    joints = len(below)
    low, high = -below * rng.uniform(0.0, 1.0, joints), above * rng.uniform(0.0, 1.0, joints)
    overtone = 0.0 if family.balancing else rng.uniform(0.0, _OVERTONE, joints)
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
    below, above = family.reaches()
    room, joints = (below + above) / 2, len(below)
    overtones = np.array([1.0, 0.0 if family.balancing else _OVERTONE])
    amplitude = waves.amplitude + step * room[:, None] * overtones * rng.normal(size=(joints, 2))
    return replace(
        waves,
        centre=np.clip(waves.centre + step * room * rng.normal(size=joints), -below, above),
        frequency=np.clip(waves.frequency * np.exp(step * rng.normal(size=joints)), _SLOWEST, _FASTEST),
        amplitude=amplitude,
        phase=waves.phase + step * np.pi * rng.normal(size=(joints, 2)),
    )


def _settled(family: Family, waves: Waves, beside: bool) -> Waves | None:
    """In whole degrees, half centimetres and hundredths of a hertz, and within the limits as it is then."""
    unit, sight = family.units, family.judge.sight
    for _ in range(_TRIES):
        rounded = replace(
            waves,
            centre=np.round(waves.centre / unit) * unit,
            frequency=np.round(waves.frequency, 2),
            amplitude=np.trunc(waves.amplitude / unit[:, None]) * unit[:, None],
        )
        course = rounded.course(sight.body, family.seconds / (1 + beside), sight.own.rate)
        if family.judge.strain(course) <= 1.0:
            return rounded if np.any(rounded.amplitude) else None
        waves = waves.sized(_SHRINK)
    return None
