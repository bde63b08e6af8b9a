"""Simple movements to compare: the recorded one faster or larger, one joint alone, or the joints in turn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.design.instructions import describe_waves
from mocap_id.design.proposal import MovementScorer
from mocap_id.design.recommendation import Recommendation, change_movement, possible_changes
from mocap_id.design.trajectory import Trajectory, concatenate
from mocap_id.design.wave_movement import WaveMovement, rest_movement, static_pressure

FREQUENCIES = (0.2, 0.35, 0.5, 0.7, 1.0)  # Hz
_SYMMETRIC = 0.4  # ratio of the smaller to the larger range on both sides, from which a joint swings about its rest
SWAY = 0.005
"""Step of the amplitude of a sway, m."""
_HALVINGS = 4
HALF = "half of the recording as it was; in the other half "
COMPARED = 16.0
"""Duration of a movement that is sampled while many are compared, s."""


@dataclass(frozen=True)
class SimpleMovement:
    """A movement that may be proposed.

    Parameters
    ----------
    words : str
        Instructions.
    trajectory : Trajectory
        At the rate at which movements are compared.
    waves : tuple of WaveMovement
        Performed one after the other; empty for a change of the trial's own movement.
    shared : bool
        Half of the recording is the trial's own movement.
    seconds : float or None
        Length of the fitted samples, s; None to take it from the trajectory.
    change : Recommendation or None
        The change of the trial's own movement.
    """

    words: str
    trajectory: Trajectory
    waves: tuple[WaveMovement, ...] = ()
    shared: bool = False
    seconds: float | None = None
    change: Recommendation | None = None


@dataclass(frozen=True)
class MovementFamily:
    """The movements that the search chooses from.

    Parameters
    ----------
    scorer : MovementScorer
    rest : (n,) array
        Posture at both ends, rad.
    seconds : float
        Length of the recording, s.
    joints : tuple of str
        Names of the joints.
    mixed : bool
        A recording may contain the trial's own movement and another one.
    """

    scorer: MovementScorer
    rest: FloatArray
    seconds: float
    joints: tuple[str, ...]
    mixed: bool

    @property
    def balancing(self) -> bool:
        """Whether the first joint keeps the balance."""
        return self.scorer.limits.support is not None and len(self.joints) > 1

    def fit_to_limits(self, waves: WaveMovement, seconds: float) -> WaveMovement | None:
        """Scale a movement down until the limits allow it; None if less than a sixteenth would be left."""

        def usage(scale: float) -> float:
            body, scorer = self.scorer.predictor.body, self.scorer
            return scorer.usage(waves.sized(scale).trajectory(body, min(seconds, COMPARED), scorer.comparison_rate))

        if usage(1.0) <= 1.0:
            return waves
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if usage(middle) <= 1.0 else (low, middle)
        return None if low == 0.0 else waves.sized(low)

    def reaches(self) -> tuple[FloatArray, FloatArray]:
        """Return how far each row of a :class:`WaveMovement` may go below and above rest (n,), rad or m."""
        limits = self.scorer.limits
        below, above = self.rest - limits.low, limits.high - self.rest
        if self.balancing and limits.support is not None:
            now = float(static_pressure(self.scorer.predictor.body, self.rest[None])[0])
            below[0], above[0] = now - limits.support[0], limits.support[1] - now
        return np.maximum(below, 0.0), np.maximum(above, 0.0)

    @property
    def units(self) -> FloatArray:
        """Step (n,) that each row of a movement is rounded to: a degree, or half a centimetre of pressure."""
        units = np.full(len(self.rest), np.radians(1.0))
        units[0] = SWAY if self.balancing else units[0]
        return units

    def single_joint(self, joint: int, frequency: float, seconds: float) -> WaveMovement | None:
        """Swing one joint as far as the limits allow, in whole degrees; a person who balances sways instead."""
        below, above = (float(part[joint]) for part in self.reaches())
        one_side = min(below, above) < _SYMMETRIC * max(below, above)
        size = max(below, above) / 2 if one_side else min(below, above)
        side = 1.0 if above > below else -1.0
        at = np.arange(len(self.rest)) == joint
        waves = replace(
            rest_movement(self.rest, self.balancing),
            centre=np.where(at, side * size if one_side else 0.0, 0.0),
            frequency=np.full(len(at), frequency),
            amplitude=np.where(at, size, 0.0)[:, None] * [1.0, 0.0],
            phase=np.where(at, -side * np.pi / 2 if one_side else 0.0, 0.0)[:, None] * [1.0, 1.0],
        )
        found = self.fit_to_limits(waves, seconds)
        size = 0.0 if found is None else float(found.amplitude[joint, 0])
        unit = float(self.units[joint])
        whole = unit * np.floor(size / unit + 1e-6)
        return None if found is None or whole < (2 * unit if unit != SWAY else unit) else found.sized(whole / size)


def simple_movements(family: MovementFamily) -> Iterator[SimpleMovement]:
    """Yield all simple movements within the limits."""
    yield from _own_changed(family)
    one_joint = len(family.joints) == 1
    parts = len(family.joints)
    singles: list[list[WaveMovement]] = []
    for joint in range(parts):
        found = [family.single_joint(joint, frequency, family.seconds / max(parts, 2)) for frequency in FREQUENCIES]
        singles.append([waves for waves in found if waves is not None])
        if one_joint or family.mixed:
            yield from (_by_itself(family, waves) for waves in singles[joint])
    if not one_joint:
        yield from _in_turn(family, singles)


def _own_changed(family: MovementFamily) -> Iterator[SimpleMovement]:
    predictor = family.scorer.predictor
    own = predictor.own.thinned(family.scorer.comparison_rate)
    for change, joint in possible_changes(len(family.joints)):
        if change != "alone":
            movement = change_movement(own, change, joint)
            if family.scorer.usage(movement) <= 1.0:
                changed = Recommendation(change, joint, np.nan)
                words = changed.describe(family.joints).removesuffix(",")
                yield SimpleMovement(words, movement, seconds=predictor.now.samples, change=changed)


def _by_itself(family: MovementFamily, waves: WaveMovement) -> SimpleMovement:
    words, rate = describe_waves(waves, family.joints), family.scorer.comparison_rate
    if len(family.joints) == 1:
        return SimpleMovement(words, compose_trajectory((waves,), family, rate), (waves,))
    movement = compose_trajectory((waves,), family, rate, shared=True)
    return SimpleMovement(f"{HALF}{words}", movement, (waves,), shared=True)


def _in_turn(family: MovementFamily, singles: Sequence[Sequence[WaveMovement]]) -> Iterator[SimpleMovement]:
    """Yield movements of one joint after the other, all joints at the same frequency."""
    for frequency in FREQUENCIES:
        chosen = [waves for several in singles for waves in several if waves.frequency[0] == frequency]
        if len(chosen) == len(family.joints):
            phrases = ", then ".join(describe_waves(waves, family.joints) for waves in chosen)
            words = f"one joint after the other, each for {family.seconds / len(chosen):.0f} s: {phrases}"
            movement = compose_trajectory(tuple(chosen), family, family.scorer.comparison_rate)
            yield SimpleMovement(words, movement, tuple(chosen))


def compose_trajectory(
    waves: Sequence[WaveMovement], family: MovementFamily, rate: float, shared: bool = False
) -> Trajectory:
    """Sample movements one after the other; if ``shared``, the first half of the trial's own movement comes first."""
    predictor = family.scorer.predictor
    seconds = family.seconds / (len(waves) + shared)
    parts = [each.trajectory(predictor.body, seconds, rate) for each in waves]
    if shared:
        own = predictor.own.thinned(rate)
        first = own.until(own.seconds / 2)
        assert first.fitted is not None
        parts = [replace(first, fitted=first.fitted & predictor.fitted(replace(first, fitted=None))), *parts]
    if len(parts) == 1:
        return parts[0]
    whole, *rest = (part if part.fitted is not None else replace(part, fitted=predictor.fitted(part)) for part in parts)
    for part in rest:
        whole = concatenate(whole, part)
    return whole
