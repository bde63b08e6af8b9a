"""Motion of a person in addition to the chain's three angles: hip gap, bending spine, swinging arms and lifted heels.

The motion that depends on the posture belongs to the person: it is the same at the same angles in all trials.
Variations between repetitions, and drifts, belong to the trial.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation.joint_motion import JointMotion, motion_through, smoothstep
from mocap_id.simulation.options import PersonOptions
from mocap_id.simulation.schedule import Schedule

SEATED_KNEE, SEATED_HIP = -1.9, 2.2  # rad, typical extremes of a sit-to-stand
LEANING = 0.8  # rad, typical largest lean of the trunk
DRIFTS = ("gap x", "gap y", "lumbar", "arms")
PERIODS = (0.8, 6.0)  # s, periods of the drift's sine waves
WAVES = 5


@dataclass(frozen=True)
class Habit:
    """Dependence of a person's hip gap and spine on the posture."""

    sink: float  # unevenness of the torso's sinking during the rise, -0.3 … 0.3
    ripple: FloatArray  # (2,) number of periods over the rise of the gap's oscillation in x and y
    phase: FloatArray  # (2,) initial phase of this oscillation, rad
    forward: float  # amplitude of the gap along the thigh's x, as a fraction of the gap's range
    slump: float  # fraction of the spine's bend that depends on the knee; the rest depends on the lean


def draw_habit(rng: np.random.Generator) -> Habit:
    """Draw the dependence of a person's hip gap and spine on the posture."""
    return Habit(
        sink=float(rng.uniform(-0.3, 0.3)),
        ripple=rng.uniform(1.0, 1.8, 2),
        phase=rng.uniform(0, 2 * np.pi, 2),
        forward=float(rng.uniform(0.3, 0.5)),
        slump=float(rng.uniform(0.4, 0.6)),
    )


@dataclass(frozen=True)
class TrialVariation:
    """Variations of one trial with R repetitions, relative to the usual size 1, and its drifts of W sine waves each."""

    swing: FloatArray  # (R, 3) size of the arms' swing while rising, while sitting down, and while standing
    late: FloatArray  # (R, 2) delay of the first two swings, s
    heel: FloatArray  # (R,) size of the heel's lift
    frequency: FloatArray  # (4, W) frequency of the sine waves of the DRIFTS, Hz
    phase: FloatArray  # (4, W) phase of these waves, rad

    def drift(self, name: str, time: FloatArray) -> FloatArray:
        """Return the drift (T,) of one of the :data:`DRIFTS`, with unit variance."""
        i = DRIFTS.index(name)
        waves = np.sin(2 * np.pi * self.frequency[i] * time[:, None] + self.phase[i])
        return np.asarray(waves.sum(axis=1) * np.sqrt(2 / WAVES))


def draw_trial_variation(rng: np.random.Generator, repetitions: int) -> TrialVariation:
    """Draw the variations of a trial with this number of repetitions."""
    shape = (len(DRIFTS), WAVES)
    return TrialVariation(
        swing=rng.uniform(0.75, 1.25, (repetitions, 3)),
        late=rng.uniform(-0.12, 0.12, (repetitions, 2)),
        heel=rng.uniform(0.8, 1.2, repetitions),
        frequency=1 / np.exp(rng.uniform(np.log(PERIODS[0]), np.log(PERIODS[1]), shape)),
        phase=rng.uniform(0, 2 * np.pi, shape),
    )


@dataclass(frozen=True)
class AdditionalMotion:
    """Conversion of the pinned chain's angles into the coordinates of a divided body."""

    people: PersonOptions
    habit: Habit
    variation: TrialVariation
    schedule: Schedule
    foot: float  # length from toe to heel, m

    def motion(self, time: FloatArray, angles: FloatArray, duration: float) -> JointMotion:
        """Return the divided body's motion for ankle, knee and hip angles (T, 3) at evenly spaced times (T,)."""
        foot, gap, bend = self._foot(time), self._gap(time, angles), self._bend(time, angles)
        columns = [foot, angles[:, 0] - foot, angles[:, 1], gap[:, 0], gap[:, 1], angles[:, 2] - bend, bend]
        return motion_through(time, np.column_stack([*columns, self._arms(time)]), duration)

    def _gap(self, time: FloatArray, angles: FloatArray) -> FloatArray:
        """Return the hip gap along the thigh's axes, (T, 2) m: the torso sinks and oscillates during the rise."""
        habit, size = self.habit, 1e-3 * self.people.hip_gap_mm
        risen, bent = 1 - angles[:, 1] / SEATED_KNEE, angles[:, 2] / SEATED_HIP
        (periods_x, periods_y), (phase_x, phase_y) = habit.ripple, habit.phase
        sinking = risen + habit.sink * risen * (1 - risen)
        y = -0.7 * sinking + 0.1 * np.sin(2 * np.pi * periods_y * risen + phase_y)
        x = habit.forward * np.sin(np.pi * periods_x * bent + phase_x)
        drift = [0.05 * self.variation.drift(name, time) for name in ("gap x", "gap y")]
        return size * (np.column_stack([x, y]) + np.column_stack(drift))

    def _bend(self, time: FloatArray, angles: FloatArray) -> FloatArray:
        """Return the trunk's rotation relative to the pelvis, forwards positive, (T,) rad."""
        seated, lean = angles[:, 1] / SEATED_KNEE, angles.sum(axis=1) / LEANING
        slump = self.habit.slump
        shape = slump * seated + (1 - slump) * np.tanh(lean) / np.tanh(1.0)
        bend: FloatArray = np.radians(self.people.lumbar_deg) * (
            0.9 * shape + 0.04 * self.variation.drift("lumbar", time)
        )
        return bend

    def _arms(self, time: FloatArray) -> FloatArray:
        """Return the arms' swing (T,), rad: forwards (negative) on rising and sitting down, backwards in between."""
        level = 0.02 * self.variation.drift("arms", time)
        for each, (up, down, rest), (late_up, late_down) in zip(
            self.schedule.repetitions, self.variation.swing, self.variation.late, strict=True
        ):
            rise, sit = each.rise_end - each.legs_start, each.legs_end - each.sit_start
            level -= 0.6 * up * _bump(time, (each.legs_start + each.rise_end) / 2 + late_up, 1.6 * rise)
            level -= 0.35 * down * _bump(time, (each.sit_start + each.legs_end) / 2 + late_down, 1.6 * sit)
            standing = smoothstep((time - each.seat_off) / rise) - smoothstep((time - each.sit_start) / sit)
            level += 0.25 * rest * standing
        return np.asarray(np.radians(self.people.arm_swing_deg) * level)

    def _foot(self, time: FloatArray) -> FloatArray:
        """Return the foot's rotation about the toe, (T,) rad, largest between seat-off and standing."""
        level = np.zeros_like(time)
        for each, size in zip(self.schedule.repetitions, self.variation.heel, strict=True):
            length = each.rise_end - each.seat_off
            level += size * _bump(time, each.seat_off + length / 2, 1.3 * length)
        return np.asarray(np.arcsin(1e-3 * self.people.heel_lift_mm / self.foot * level))


def _bump(time: FloatArray, middle: float, width: float) -> FloatArray:
    """Return a smooth bump (T,) of height 1 around ``middle``, s, with the total duration ``width``, s."""
    step = smoothstep((time - middle) / width + 0.5)
    return 4 * step * (1 - step)
