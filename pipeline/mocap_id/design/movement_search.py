"""Search for the best movement of all joints together within the limits.

The search starts from random movements and from simple ones, each scaled to the limits. The best movement is then
changed by 60 small random steps; only steps that improve it are kept. With several joints, a movement takes the whole
recording, or the half of it that follows half of the trial's own movement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.design.proposal import Proposal
from mocap_id.design.simple_movements import COMPARED, HALF, MovementFamily, compose_trajectory
from mocap_id.design.wave_movement import WaveMovement, describe_waves

_STARTS, _STEPS = 20, 60
_FASTEST, _SLOWEST = 0.8, 0.15  # Hz: range of the frequencies
_LEAST_ARC = np.radians(12.0)  # joint centres are uncertain if the rotation is smaller
_STEP, _STEP_DECAY = 0.3, 0.96  # size of the search's steps as a fraction of a joint's range, and its decay
_OVERTONE = 0.3  # largest amplitude of the overtone, relative to the wave
_SHRINK, _TRIES = 0.97, 40


@dataclass(frozen=True)
class _Candidate:
    """A movement within the limits, its objective, and whether it takes half of the recording."""

    value: float
    waves: WaveMovement
    shared: bool


def search_movement(
    family: MovementFamily, rng: np.random.Generator, starts: Sequence[tuple[WaveMovement, bool]] = ()
) -> Proposal | None:
    """Return the best movement of all joints together, or None if the limits allow none.

    ``starts`` are movements from which the search also starts. The bool says whether each takes half of the recording.
    """
    sharing = family.mixed and len(family.joints) > 1
    drawn = [(_draw_movement(family, rng), sharing and k % 2 == 1) for k in range(_STARTS)]
    tried = [_evaluate(family, *start) for start in (*starts, *drawn)]
    best = min((each for each in tried if each is not None), key=lambda each: each.value, default=None)
    if best is None:
        return None
    for step in range(_STEPS):
        near = _evaluate(family, _change_randomly(family, best.waves, rng, _STEP * _STEP_DECAY**step), best.shared)
        if near is not None and near.value < best.value:
            best = near
    final = _round_to_limits(family, best.waves, best.shared)
    if final is None:
        return None
    movement = compose_trajectory((final,), family, family.scorer.predictor.own.rate, best.shared)
    words = describe_waves(final, family.joints)
    proposal = family.scorer.propose(HALF + words if best.shared else words, movement)
    return replace(proposal, designed=True, standalone=not best.shared)


def _evaluate(family: MovementFamily, waves: WaveMovement, shared: bool) -> _Candidate | None:
    """Scale a movement to the limits and compute its objective, larger for small rotations; None if it is too small."""
    scaled = family.fit_to_limits(waves, family.seconds)
    if scaled is None or not np.any(np.abs(scaled.amplitude[:, 0]) >= family.units):
        return None
    scorer, rate = family.scorer, family.scorer.comparison_rate
    if shared:
        return _Candidate(scorer.quick_value(compose_trajectory((scaled,), family, rate, shared)), scaled, shared)
    movement = scaled.trajectory(scorer.predictor.body, min(family.seconds, COMPARED), rate)
    penalty = float(np.max(np.maximum(_LEAST_ARC / np.maximum(np.ptp(movement.q, axis=0), 1e-3), 1.0)))
    return _Candidate(scorer.quick_value(movement, family.seconds) * penalty, scaled, shared)


def _draw_movement(family: MovementFamily, rng: np.random.Generator) -> WaveMovement:
    """Draw a movement between two random angles of each joint, with overtones if the body need not keep its balance."""
    below, above = family.reaches()
    joints = len(below)
    low, high = -below * rng.uniform(0.0, 1.0, joints), above * rng.uniform(0.0, 1.0, joints)
    overtone = 0.0 if family.balancing else rng.uniform(0.0, _OVERTONE, joints)
    first = (high - low) / 2
    return WaveMovement(
        rest=family.rest,
        centre=(low + high) / 2,
        frequency=np.exp(rng.uniform(np.log(_SLOWEST), np.log(_FASTEST), joints)),
        amplitude=np.stack([first, first * overtone], axis=1),
        phase=rng.uniform(-np.pi, np.pi, (joints, 2)),
        balanced=family.balancing,
    )


def _change_randomly(
    family: MovementFamily, waves: WaveMovement, rng: np.random.Generator, step: float
) -> WaveMovement:
    """Return the movement changed by a random step, which may exceed the limits."""
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


def _round_to_limits(family: MovementFamily, waves: WaveMovement, shared: bool) -> WaveMovement | None:
    """Round a movement to whole degrees, 5 mm and 0.01 Hz, and scale it down to the limits; None if nothing remains."""
    unit, predictor = family.units, family.scorer.predictor
    for _ in range(_TRIES):
        rounded = replace(
            waves,
            centre=np.round(waves.centre / unit) * unit,
            frequency=np.round(waves.frequency, 2),
            amplitude=np.trunc(waves.amplitude / unit[:, None]) * unit[:, None],
        )
        movement = rounded.trajectory(predictor.body, family.seconds / (1 + shared), predictor.own.rate)
        if family.scorer.usage(movement) <= 1.0:
            return rounded if np.any(rounded.amplitude) else None
        waves = waves.scale(_SHRINK)
    return None
