"""Movements of a simulated arm: functional reaches and curls.

The coordinates are plane of elevation, elevation, the sum of plane and axial rotation, hinge angle, pronation, wrist
flexion and wrist deviation, rad.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation.arm.options import ArmOptions
from mocap_id.simulation.joint_motion import (
    STEP,
    JointMotion,
    draw_sway,
    draw_tremor,
    motion_through,
    ramp_up,
    smoothstep,
)

COORDINATES = ("plane", "elevation", "twist", "hinge", "pronation", "wrist_flexion", "wrist_deviation")
STILL = 2.0  # s at the start
ROUGHNESS = 4  # order of the smooth step of a movement

_REST = (30.0, 22.0, 10.0, 22.0, 90.0)
_TASKS = {
    "hip": (-30.0, 46.0, 62.0, 70.0, 70.0),
    "shoulder_right": (40.0, 63.0, -42.0, 148.0, 30.0),
    "shoulder_left": (118.0, 36.0, 78.0, 117.0, 90.0),
    "mouth": (85.0, 76.0, 38.0, 128.0, 70.0),
    "head": (102.0, 120.0, 36.0, 113.0, 90.0),
}
_LOWEST = (-34.0, 15.0, -46.0, 10.0, 10.0)
_HIGHEST = (124.0, 142.0, 84.0, 149.0, 167.0)
_LOST = ((0.8, 0.0, 0.4, 0.0, 0.0), (0.2, 0.8, 0.22, 0.06, 0.0))
"""Fractions by which a severity of 1 reduces the lower and the upper limits."""
_BENCH = (89.5, 49.6, 4.0, 40.0, 90.0)
_EXTENDED, _CURL, _ATTEMPT = 21.0, 107.0, 33.0
_COMPENSATION = np.array([0.10, 0.08, 0.15])  # rad: plane, elevation, axial, in the last curl


@dataclass(frozen=True)
class ArmMovement:
    """Motion of the arm and the thorax."""

    # 13 columns: the coordinates, then rotations of the thorax about its x, y, z and its translation in the laboratory
    motion: JointMotion
    protocol: dict[str, Any]  # entries of the truth for this kind of movement, as JSON values


@dataclass
class _Course:
    """Coordinates over time, composed of smooth moves from one pose to the next."""

    time: FloatArray  # (T,) s
    pose: FloatArray  # (7,) last pose
    values: FloatArray = field(init=False)  # (T, 7)

    def __post_init__(self) -> None:
        self.values = np.tile(self.pose, (len(self.time), 1))

    def move(self, pose: FloatArray, start: float, end: float) -> None:
        step = smoothstep((self.time - start) / (end - start), ROUGHNESS)
        self.values += step[:, None] * (pose - self.pose)
        self.pose = pose


def draw_movement(rng: np.random.Generator, options: ArmOptions, tremor_size: float) -> ArmMovement:
    """Draw the movement of a trial; ``tremor_size`` is a factor on its irregularity."""
    reach = options.movement == "reach"
    course, protocol, end = (_draw_reaches if reach else _draw_curls)(rng, options)
    time = course.time
    rough = np.array([1, 1, 1, 1, 1, 0, 0]) * 0.5 * tremor_size
    if not reach:
        rough[:3] /= 2
    hand = np.radians((0, 0, 0, 0, 1.5, 3.5, 2.2)) * (1.0 if reach else (0, 0, 0, 0, 1.0, 0.4, 0.4))
    size = np.array([*np.radians((2.0, 2.0, 1.0)), 0.005, 0.004, 0.004]) * (1.0 if reach else 0.25)
    course.values += ramp_up(time, STILL) * (draw_tremor(rng, time, rough) + draw_sway(rng, time, hand))
    trunk = ramp_up(time, STILL) * draw_sway(rng, time, size)
    return ArmMovement(motion_through(time, np.hstack([course.values, trunk]), end), protocol)


def _start_course(pose: tuple[float, ...], end: float) -> _Course:
    """Return a course that stays in a pose (5,), degrees, from -1 s to 1 s after ``end``, s."""
    return _Course(np.arange(-1.0, end + 1.0, STEP), np.radians((*pose, 0.0, 0.0)))


def _draw_reaches(rng: np.random.Generator, options: ArmOptions) -> tuple[_Course, dict[str, Any], float]:
    """Return the reaches, their entries in truth.json, and the end of the trial, s."""
    left = 1 - options.severity * np.array(_LOST)
    low, high = np.array(_LOWEST) * left[0], np.array(_HIGHEST) * left[1]
    names = []
    for _ in range(options.cycles):
        for target in _TASKS:
            names += [target, "rest"] if rng.random() < 0.75 or target == "head" else [target]
    now = STILL
    tasks: list[dict[str, Any]] = []
    for name in names:
        target_pose = _REST if name == "rest" else _TASKS[name]
        pose = np.clip(np.array(target_pose) + rng.normal(0, 4, 5), low, high)
        end = now + rng.uniform(1.15, 1.7)
        tasks.append({"name": name, "start": now, "reach": end, "pose_rad": np.radians(pose).tolist()})
        now = end + rng.uniform(0.15, 0.5)
    now += 0.5
    course = _start_course(_REST, now)
    for task in tasks:
        course.move(np.array([*task["pose_rad"], 0.0, 0.0]), task["start"], task["reach"])
    limits = {"names": list(COORDINATES[:5]), "lo": np.radians(low).tolist(), "hi": np.radians(high).tolist()}
    return course, {"severity": options.severity, "limits_used_rad": limits, "tasks": tasks}, now


def _draw_curls(rng: np.random.Generator, options: ArmOptions) -> tuple[_Course, dict[str, Any], float]:
    """Return the curls, their entries in truth.json, and the end of the trial, s."""
    base = np.array(_BENCH) + rng.normal(0, (2, 1.5, 2.5, 1, 0))
    first = STILL + 1.2
    length = first + 2.6 * (options.repetitions + options.failed + 1) + 3
    course = _start_course(tuple(base), length)
    extended = course.pose.copy()
    extended[3] = np.radians(_EXTENDED)
    course.move(extended, STILL, first - 0.2)
    now, repetitions, partials = first, [], []
    plane, elevation, axial = _COMPENSATION * options.compensation * rng.choice([-1, 1], 3)
    tired = np.array([plane, abs(elevation), plane + axial, 0, 0, 0, 0])
    for index in range(options.repetitions):
        fatigue = (index / max(options.repetitions - 1, 1)) ** 1.5
        amplitude = np.radians(_CURL * rng.normal(1, 0.025) * (1 - 0.08 * fatigue))
        top = extended + tired * (0.1 + 0.9 * fatigue)
        top[3] += amplitude
        times = now + np.cumsum([0.0, rng.uniform(0.91, 1.08), rng.uniform(0.04, 0.09), rng.uniform(0.85, 1.0)])
        course.move(top, times[0], times[1])
        course.move(extended, times[2], times[3])
        moments = dict(zip(("start", "top", "top_end", "end"), times.tolist(), strict=True))
        repetitions.append({"index": index, **moments, "amplitude_rad": float(amplitude), "fatigue": fatigue})
        now = times[3] + rng.uniform(0.04, 0.08)
    for _ in range(options.failed):
        now += 0.55
        top = extended.copy()
        top[3] += np.radians(_ATTEMPT * rng.uniform(0.8, 1.2))
        course.move(top, now, now + 1)
        course.move(extended, now + 1, now + 2)
        partials.append({"start": now, "end": now + 2, "amplitude_rad": float(top[3] - extended[3])})
        now += 2.0
    protocol = {
        "curl_count": options.repetitions,
        "repetitions": repetitions,
        "partials": partials,
        "compensation": options.compensation,
    }
    return course, protocol, now + 1.0
