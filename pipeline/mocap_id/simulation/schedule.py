"""Timing of a simulated sit-to-stand: strategies, repetitions, failed attempts and the load of the chair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation.joint_motion import smoothstep

Strategy: TypeAlias = Literal["normal", "dynamic", "stable"]


@dataclass(frozen=True)
class StrategyParameters:
    """Parameters of a strategy for rising and sitting; times in s, angles in degrees.

    Centres of pressure are under the feet, measured from the ankle, negative towards the toes, m.
    """

    rise: float  # duration of the rise
    unload: float  # duration of unloading the chair
    sit: float  # duration of sitting down
    load: float  # duration of loading the chair
    lean: float  # lean of the trunk at which the seated body balances at seat-off; determines the feet's position
    dip: float  # additional rotation of the shank around seat-off and seat-on
    trunk: float  # lean of the trunk at rest
    seat_cop: float  # centre of pressure while seated
    off_cop: float  # centre of pressure at seat-off
    stand_cop: float  # centre of pressure while standing


STRATEGIES: Mapping[Strategy, StrategyParameters] = {
    "normal": StrategyParameters(1.70, 0.40, 2.00, 0.35, 45.0, 3.0, 4.0, -0.02, -0.010, -0.050),
    "dynamic": StrategyParameters(1.45, 0.25, 1.90, 0.30, 48.0, 2.5, 8.0, -0.02, 0.005, -0.050),
    "stable": StrategyParameters(2.30, 0.55, 2.20, 0.45, 41.0, 5.0, 6.0, -0.03, -0.035, -0.045),
}

LOADED_ORDER = 4  # the chair's force has three continuous derivatives


@dataclass(frozen=True)
class Repetition:
    """Times of one repetition, s, named as in truth.json."""

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
        """Time at which the legs begin to extend and the load of the chair begins to decrease, s."""
        return self.seat_off - self.unload

    @property
    def legs_end(self) -> float:
        """Time at which the legs are bent again and the chair is fully loaded, s."""
        return self.seat_on + self.load


@dataclass(frozen=True)
class Attempt:
    """A failed rise: the chair is unloaded, the hips rise a little, and the person falls back; times in s."""

    start: float
    top: float
    end: float
    height: float = 0.15  # height of the hips at the top: 0 seated, 1 standing

    @property
    def unload(self) -> float:
        """Duration of unloading the chair, s; loading it again takes equally long."""
        return 0.4 * (self.top - self.start)

    def chair_release(self, time: FloatArray) -> FloatArray:
        """Return the relative decrease of the chair's load at times (T,): 0 if fully loaded, 1 if free."""
        released = smoothstep((time - self.start) / self.unload, LOADED_ORDER)
        return released - smoothstep((time - (self.end - self.unload)) / self.unload, LOADED_ORDER)

    def height_at(self, time: FloatArray) -> FloatArray:
        """Return the relative height of the hips at times (T,): 0 seated, 1 standing."""
        up = smoothstep((time - self.start) / (self.top - self.start))
        return self.height * (up - smoothstep((time - self.top) / (self.end - self.top)))


@dataclass(frozen=True)
class Hold:
    """A pause half-way through a rise."""

    repetition: int  # counted from 0
    length: float  # duration, s

    def progress(self, time: FloatArray, begin: float, finish: float) -> FloatArray:
        """Return the progress of the rise at times (T,), from 0 at ``begin`` to 1 at ``finish``; it pauses at 0.5."""
        half = 0.5 * (finish - begin - self.length)
        first, second = smoothstep((time - begin) / half), smoothstep((time - finish + half) / half)
        return 0.5 * (first + second)


@dataclass(frozen=True)
class Schedule:
    """Repetitions of a trial and its duration, s, with failed attempts and at most one pause."""

    repetitions: tuple[Repetition, ...]
    duration: float
    attempts: tuple[Attempt, ...] = ()
    hold: Hold | None = None

    def height_at(self, time: FloatArray, late: float = 0.0, early: float = 0.0) -> FloatArray:
        """Return the relative height of the hips at times (T,): 0 seated, 1 standing.

        ``late`` delays the start of the rise and ``early`` advances the end of sitting down, s.
        """
        level = sum((attempt.height_at(time) for attempt in self.attempts), np.zeros_like(time))
        for k, each in enumerate(self.repetitions):
            begin, finish = each.legs_start + late, each.legs_end - early
            up = smoothstep((time - begin) / (each.rise_end - begin))
            if self.hold is not None and self.hold.repetition == k:
                up = self.hold.progress(time, begin, each.rise_end)
            level += up - smoothstep((time - each.sit_start) / (finish - each.sit_start))
        return level

    def bumps(self, time: FloatArray) -> FloatArray:
        """Return the sum (T,) of short bumps of height 1 around each seat-off and seat-on, at times (T,)."""
        level = np.zeros_like(time)
        for each in self.repetitions:
            for middle, width in ((each.seat_off, each.rise_end - each.legs_start), (each.seat_on, each.load + 0.8)):
                phase = (time - middle) / width + 0.5
                level += 4 * smoothstep(phase) * (1 - smoothstep(phase))
        return level

    def chair_load(self, time: FloatArray) -> FloatArray:
        """Return the relative load of the chair at times (T,): 1 seated at rest, exactly 0 from seat-off to seat-on."""
        level = 1.0 - sum((attempt.chair_release(time) for attempt in self.attempts), np.zeros_like(time))
        for each in self.repetitions:
            level -= smoothstep((time - (each.seat_off - each.unload)) / each.unload, LOADED_ORDER)
            level += smoothstep((time - each.seat_on) / each.load, LOADED_ORDER)
        return np.where(np.abs(level) < 1e-15, 0.0, level)


def draw_schedule(
    rng: np.random.Generator,
    strategy: StrategyParameters,
    repetitions: int,
    *,
    attempts: int = 0,
    hold: float = 0.0,
    rests: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Schedule:
    """Draw a sequence of repetitions whose durations vary by up to 6 %.

    A failed rise precedes each of the last ``attempts`` repetitions; the last rise stops half-way for ``hold`` seconds.
    ``rests`` are additional rests before the first rise, while first standing and after the last repetition, s.
    """

    def vary(value: float) -> float:
        return value * float(rng.uniform(0.94, 1.06))

    completed: list[Repetition] = []
    failed: list[Attempt] = []
    now = 1.5 + rests[0]
    for k in range(repetitions):
        if k >= repetitions - attempts:
            failed.append(Attempt(now, now + 1.0, now + 2.0))
            now = failed[-1].end + 0.8
        rise, unload, sit, load = (vary(x) for x in (strategy.rise, strategy.unload, strategy.sit, strategy.load))
        seat_off = now + vary(0.8) + unload
        rise_end = seat_off - unload + rise + (hold if k == repetitions - 1 else 0.0)
        sit_start = rise_end + float(rng.uniform(0.8, 1.3)) + (rests[1] if k == 0 else 0.0)
        seat_on = sit_start + sit - load
        sit_end = seat_on + load + vary(0.7)
        completed.append(Repetition(now, seat_off, rise_end, unload, sit_start, seat_on, sit_end, load))
        now = sit_end + float(rng.uniform(0.8, 1.2))
    stop = Hold(repetitions - 1, hold) if hold > 0 else None
    return Schedule(tuple(completed), now + 0.5 + rests[2], tuple(failed), stop)
