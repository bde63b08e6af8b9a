"""When a person rises, stands and sits, in which manner, and how the chair takes over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation.motion import smoothstep

Strategy: TypeAlias = Literal["normal", "dynamic", "stable"]


@dataclass(frozen=True)
class Manner:
    """How somebody rises and sits; times in s, angles in degrees, distances in m.

    ``lean`` is the trunk's lean with which the seated body would balance over the feet at seat-off: it decides how far
    the feet are drawn back. ``seat_cop`` … ``stand_cop`` are centres of pressure under the feet, measured from the
    ankle, negative towards the toes.
    """

    rise: float
    unload: float
    sit: float
    load: float
    lean: float
    dip: float
    trunk: float
    seat_cop: float
    off_cop: float
    stand_cop: float


MANNERS: Mapping[Strategy, Manner] = {
    "normal": Manner(1.70, 0.40, 2.00, 0.35, 45.0, 3.0, 4.0, -0.02, -0.010, -0.050),
    "dynamic": Manner(1.45, 0.25, 1.90, 0.30, 48.0, 2.5, 8.0, -0.02, 0.005, -0.050),
    "stable": Manner(2.30, 0.55, 2.20, 0.45, 41.0, 5.0, 6.0, -0.03, -0.035, -0.045),
}

LOADED_ORDER = 4  # the chair's force has three continuous derivatives


@dataclass(frozen=True)
class Repetition:
    """Times of one repetition, s: the names are the truth's."""

    rise_start: float
    seat_off: float
    rise_end: float
    unload: float
    sit_start: float
    seat_on: float
    sit_end: float
    load: float

    @property
    def legs_start(self) -> float:
        """The legs begin to stretch with the unloading, so slowly that the seat hardly notices."""
        return self.seat_off - self.unload

    @property
    def legs_end(self) -> float:
        """The legs are bent again when the chair carries its share."""
        return self.seat_on + self.load


@dataclass(frozen=True)
class Attempt:
    """A rise that is broken off: the chair is released, the hips come up a little, and the person falls back.

    Times in s; ``height`` is that of the way to standing.
    """

    start: float
    top: float
    end: float
    height: float = 0.15

    @property
    def unload(self) -> float:
        """The chair is released over so long, and loaded over so long at the end, s."""
        return 0.4 * (self.top - self.start)

    def lifted(self, time: FloatArray) -> FloatArray:
        """0 with the chair fully loaded … 1 with the chair free, (T,)."""
        released = smoothstep((time - self.start) / self.unload, LOADED_ORDER)
        return released - smoothstep((time - (self.end - self.unload)) / self.unload, LOADED_ORDER)

    def risen(self, time: FloatArray) -> FloatArray:
        """Height of the hips at times (T,), of the way to standing."""
        up = smoothstep((time - self.start) / (self.top - self.start))
        return self.height * (up - smoothstep((time - self.top) / (self.end - self.top)))


@dataclass(frozen=True)
class Hold:
    """A stop in mid-rise: repetition (from 0) and length, s."""

    repetition: int
    length: float

    def up(self, time: FloatArray, begin: float, finish: float) -> FloatArray:
        """0 … 1, (T,): half-way by the first half of what is left of the time, then still, then on."""
        half = 0.5 * (finish - begin - self.length)
        first, second = smoothstep((time - begin) / half), smoothstep((time - finish + half) / half)
        return 0.5 * (first + second)


@dataclass(frozen=True)
class Schedule:
    """All repetitions of a trial and its length, s; attempts that fail, and at most one stop in mid-rise."""

    repetitions: tuple[Repetition, ...]
    duration: float
    attempts: tuple[Attempt, ...] = ()
    hold: Hold | None = None

    def risen(self, time: FloatArray, late: float = 0.0, early: float = 0.0) -> FloatArray:
        """0 seated … 1 standing, (T,); ``late`` delays the rise's start, ``early`` hastens the sitting's end, s."""
        level = sum((attempt.risen(time) for attempt in self.attempts), np.zeros_like(time))
        for k, each in enumerate(self.repetitions):
            begin, finish = each.legs_start + late, each.legs_end - early
            up = smoothstep((time - begin) / (each.rise_end - begin))
            if self.hold is not None and self.hold.repetition == k:
                up = self.hold.up(time, begin, each.rise_end)
            level += up - smoothstep((time - each.sit_start) / (finish - each.sit_start))
        return level

    def dipped(self, time: FloatArray) -> FloatArray:
        """0 … 1: a short wave that is highest about seat-off and about the chair's first touch, (T,)."""
        level = np.zeros_like(time)
        for each in self.repetitions:
            for middle, width in ((each.seat_off, each.rise_end - each.legs_start), (each.seat_on, each.load + 0.8)):
                phase = (time - middle) / width + 0.5
                level += 4 * smoothstep(phase) * (1 - smoothstep(phase))
        return level

    def seated(self, time: FloatArray) -> FloatArray:
        """1 with the chair fully loaded … 0 with the chair free, (T,), exactly 0 from seat-off to seat-on."""
        level = 1.0 - sum((attempt.lifted(time) for attempt in self.attempts), np.zeros_like(time))
        for each in self.repetitions:
            level -= smoothstep((time - (each.seat_off - each.unload)) / each.unload, LOADED_ORDER)
            level += smoothstep((time - each.seat_on) / each.load, LOADED_ORDER)
        return np.where(np.abs(level) < 1e-15, 0.0, level)


def draw_schedule(
    rng: np.random.Generator, manner: Manner, repetitions: int, *, attempts: int = 0, hold: float = 0.0
) -> Schedule:
    """Repetitions one after another, every duration off by up to 6 %.

    Before each of the last ``attempts`` repetitions a rise is broken off; the last one stops for ``hold`` s half-way.
    """

    def about(value: float) -> float:
        return value * float(rng.uniform(0.94, 1.06))

    done: list[Repetition] = []
    failed: list[Attempt] = []
    now = 1.5
    for k in range(repetitions):
        if k >= repetitions - attempts:
            failed.append(Attempt(now, now + 1.0, now + 2.0))
            now = failed[-1].end + 0.8
        rise, unload, sit, load = (about(x) for x in (manner.rise, manner.unload, manner.sit, manner.load))
        seat_off = now + about(0.8) + unload
        rise_end = seat_off - unload + rise + (hold if k == repetitions - 1 else 0.0)
        sit_start = rise_end + float(rng.uniform(0.8, 1.3))
        seat_on = sit_start + sit - load
        sit_end = seat_on + load + about(0.7)
        done.append(Repetition(now, seat_off, rise_end, unload, sit_start, seat_on, sit_end, load))
        now = sit_end + float(rng.uniform(0.8, 1.2))
    stop = Hold(repetitions - 1, hold) if hold > 0 else None
    return Schedule(tuple(done), now + 0.5, tuple(failed), stop)
