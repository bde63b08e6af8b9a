"""Simple movements to compare: the trial's own faster or larger, a joint by itself, one joint after the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.course import Course, joined
from mocap_id.dynamics.excitation import Advice, changed, changes
from mocap_id.dynamics.instructions import swung
from mocap_id.dynamics.proposal import Judge
from mocap_id.dynamics.waves import Waves, pressure, still

FREQUENCIES = (0.2, 0.35, 0.5, 0.7, 1.0)  # Hz
_ABOUT = 0.4  # room to one side by that to the other, from which a joint swings about where it rests
SWAY = 0.005
"""m, of which a sway is a multiple."""
_HALVINGS = 4
HALF = "half of the recording as it was; in the other half "
COMPARED = 16.0  # s of a movement that are looked at while many are compared


@dataclass(frozen=True)
class Simple:
    """A movement that may be proposed.

    Parameters
    ----------
    words : str
    course : Course
        At the rate at which movements are compared.
    waves : tuple of Waves
        One after the other; none where it is the trial's own movement, changed.
    beside : bool
        For half of the recording, the other half as it was.
    seconds : float or None
        How much of it would be fitted, where that does not follow from it.
    advice : Advice or None
        The change of the trial's own movement.
    """

    words: str
    course: Course
    waves: tuple[Waves, ...] = ()
    beside: bool = False
    seconds: float | None = None
    advice: Advice | None = None


@dataclass(frozen=True)
class Family:
    """Where the movements start from.

    Parameters
    ----------
    judge : Judge
    rest : (n,) array
        Posture at both ends, rad.
    seconds : float
        Length of the recording.
    joints : tuple of str
        Their names.
    mixed : bool
        Another movement may share a recording with the trial's own.
    """

    judge: Judge
    rest: FloatArray
    seconds: float
    joints: tuple[str, ...]
    mixed: bool

    @property
    def balancing(self) -> bool:
        """Whether the first joint may have to keep the balance."""
        return self.judge.limits.support is not None and len(self.joints) > 1

    def fitting(self, waves: Waves, seconds: float) -> Waves | None:
        """As much of a movement as the limits allow; None where that is next to nothing."""

        def strain(scale: float) -> float:
            course = waves.sized(scale).course(self.judge.sight.body, min(seconds, COMPARED), self.judge.looked)
            return self.judge.strain(course)

        if strain(1.0) <= 1.0:
            return waves
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if strain(middle) <= 1.0 else (low, middle)
        return None if low == 0.0 else waves.sized(low)

    def reaches(self) -> tuple[FloatArray, FloatArray]:
        """How far each row of :class:`Waves` may go below and above where it rests (n,): rad, or m of the pressure."""
        limits = self.judge.limits
        below, above = self.rest - limits.low, limits.high - self.rest
        if self.balancing and limits.support is not None:
            now = float(pressure(self.judge.sight.body, self.rest[None])[0])
            below[0], above[0] = now - limits.support[0], limits.support[1] - now
        return np.maximum(below, 0.0), np.maximum(above, 0.0)

    @property
    def units(self) -> FloatArray:
        """What each row of a movement is rounded to (n,): a degree, or half a centimetre of the pressure."""
        units = np.full(len(self.rest), np.radians(1.0))
        units[0] = SWAY if self.balancing else units[0]
        return units

    def alone(self, joint: int, frequency: float, seconds: float) -> Waves | None:
        """One joint as far as the limits allow, in whole degrees; the first of those who have to balance sways."""
        below, above = (float(part[joint]) for part in self.reaches())
        one_side = min(below, above) < _ABOUT * max(below, above)
        size = max(below, above) / 2 if one_side else min(below, above)
        side = 1.0 if above > below else -1.0
        at = np.arange(len(self.rest)) == joint
        waves = replace(
            still(self.rest, self.balancing),
            centre=np.where(at, side * size if one_side else 0.0, 0.0),
            frequency=np.full(len(at), frequency),
            amplitude=np.where(at, size, 0.0)[:, None] * [1.0, 0.0],
            phase=np.where(at, -side * np.pi / 2 if one_side else 0.0, 0.0)[:, None] * [1.0, 1.0],
        )
        found = self.fitting(waves, seconds)
        size = 0.0 if found is None else float(found.amplitude[joint, 0])
        unit = float(self.units[joint])
        whole = unit * np.floor(size / unit + 1e-6)
        return None if found is None or whole < (2 * unit if unit != SWAY else unit) else found.sized(whole / size)


def simple_changes(family: Family) -> Iterator[Simple]:
    """All that are within the limits."""
    yield from _own_changed(family)
    alone = len(family.joints) == 1
    parts = len(family.joints)
    singles: list[list[Waves]] = []
    for joint in range(parts):
        found = [family.alone(joint, frequency, family.seconds / max(parts, 2)) for frequency in FREQUENCIES]
        singles.append([waves for waves in found if waves is not None])
        if alone or family.mixed:
            yield from (_by_itself(family, waves) for waves in singles[joint])
    if not alone:
        yield from _in_turn(family, singles)


def _own_changed(family: Family) -> Iterator[Simple]:
    sight = family.judge.sight
    own = sight.own.thinned(family.judge.looked)
    for change, joint in changes(len(family.joints)):
        if change != "alone":
            course = changed(own, change, joint)
            if family.judge.strain(course) <= 1.0:
                advice = Advice(change, joint, np.nan)
                words = advice.said(family.joints).removesuffix(",")
                yield Simple(words, course, seconds=sight.now.samples, advice=advice)


def _by_itself(family: Family, waves: Waves) -> Simple:
    said, judge = swung(waves, family.joints), family.judge
    if len(family.joints) == 1:
        return Simple(said, course_of((waves,), family, judge.looked), (waves,))
    words = f"{HALF}{said}"
    return Simple(words, course_of((waves,), family, judge.looked, beside=True), (waves,), beside=True)


def _in_turn(family: Family, singles: Sequence[Sequence[Waves]]) -> Iterator[Simple]:
    """One joint after the other at the same frequency."""
    for frequency in FREQUENCIES:
        chosen = [waves for several in singles for waves in several if waves.frequency[0] == frequency]
        if len(chosen) == len(family.joints):
            said = ", then ".join(swung(waves, family.joints) for waves in chosen)
            words = f"one joint after the other, each for {family.seconds / len(chosen):.0f} s: {said}"
            yield Simple(words, course_of(tuple(chosen), family, family.judge.looked), tuple(chosen))


def course_of(waves: Sequence[Waves], family: Family, rate: float, beside: bool = False) -> Course:
    """Movements one after the other, sample by sample, behind half of the trial's own where asked for."""
    sight = family.judge.sight
    seconds = family.seconds / (len(waves) + beside)
    parts = [each.course(sight.body, seconds, rate) for each in waves]
    if beside:
        own = sight.own.thinned(rate)
        first = own.until(own.seconds / 2)
        assert first.fitted is not None
        parts = [replace(first, fitted=first.fitted & sight.fitted(replace(first, fitted=None))), *parts]
    if len(parts) == 1:
        return parts[0]
    whole, *rest = (part if part.fitted is not None else replace(part, fitted=sight.fitted(part)) for part in parts)
    for part in rest:
        whole = joined(whole, part)
    return whole
