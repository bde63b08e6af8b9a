"""Smooth motions and attitudes, and a person who rises from a chair and sits down.

The centre of pressure of a sit-to-stand is prescribed. Shank and thigh follow the schedule. The trunk's lean is then
computed for the whole trial at once, so that the moments of all forces balance about the combined point of application
of ground and chair. That point is under the feet and moves towards the chair in proportion to the chair's load. The
forward lean before the rise follows from this balance.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import solve_banded
from scipy.optimize import brentq
from scipy.special import betainc

from mocap_id.arrays import GRAVITY, FloatArray
from mocap_id.errors import NumericalError
from mocap_id.geometry import planar, so3
from mocap_id_simulation.bodies import SimulatedBody
from mocap_id_simulation.options import Options, Strategy

STEP = 0.005  # s, between the samples of a motion's spline
DEGREE = 7  # six continuous derivatives: the snap of every joint is smooth
TREMOR = (1.0, 5.0)  # Hz
SWAY = (0.08, 0.6)  # Hz
_WAVES = 8  # sine waves of a tremor or sway


def smoothstep(phase: FloatArray, order: int = 6) -> FloatArray:
    """Return a step from 0 (phase ≤ 0) to 1 (phase ≥ 1); its first ``order - 1`` derivatives are continuous."""
    return np.asarray(betainc(order, order, np.clip(phase, 0.0, 1.0)))


def ramp_up(time: FloatArray, start: float) -> FloatArray:
    """Return a factor (T, 1) that rises smoothly from 0 at ``start`` to 1 one second later."""
    return smoothstep(time - start)[:, None]


def draw_tremor(rng: np.random.Generator, time: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return random angles (T, n), rad; ``acceleration`` (n,) is the rms value of their second derivatives, rad/s²."""
    frequency, phase = _draw_waves(rng, TREMOR, len(acceleration))
    omega = 2 * np.pi * frequency
    waves = np.sin(omega * time[:, None, None] + phase) / omega**2
    return np.asarray(acceleration * waves.sum(axis=1) * np.sqrt(2 / _WAVES))


def draw_sway(rng: np.random.Generator, time: FloatArray, size: FloatArray) -> FloatArray:
    """Return slow random motion (T, n) with standard deviations ``size`` (n,); slower waves have larger amplitudes."""
    frequency, phase = _draw_waves(rng, SWAY, len(size))
    weight = 1 / frequency
    waves = np.sin(2 * np.pi * frequency * time[:, None, None] + phase) * weight
    return np.asarray(size * waves.sum(axis=1) / np.sqrt((weight**2).sum(axis=0) / 2))


def _draw_waves(rng: np.random.Generator, band: tuple[float, float], count: int) -> tuple[FloatArray, FloatArray]:
    """Return random frequencies, Hz, and phases, rad, (waves, count) each."""
    return rng.uniform(*band, (_WAVES, count)), rng.uniform(0, 2 * np.pi, (_WAVES, count))


def draw_direction(rng: np.random.Generator) -> FloatArray:
    """Return a random unit vector (3,)."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


@dataclass(frozen=True)
class JointMotion:
    """Joint angles as a function of time."""

    spline: BSpline  # angles (n,), rad, at a time, s; extends beyond both ends of the trial
    duration: float  # of the trial, which starts at 0, s

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return angle, velocity, acceleration and jerk, (T, n) each, at times (T,)."""
        q, dq, ddq, dddq = (np.asarray(self.spline(time, order), dtype=np.float64) for order in range(4))
        return q, dq, ddq, dddq


def motion_through(time: FloatArray, angles: FloatArray, duration: float) -> JointMotion:
    """Return the motion that interpolates ``angles`` (T, n), rad, at evenly spaced times (T,), s."""
    return JointMotion(make_interp_spline(time, angles, k=DEGREE), duration)


@dataclass(frozen=True)
class Swing:
    """Sinusoidal motion of a robot's joint."""

    frequency: float  # Hz
    amplitude: float  # rad
    centre: float  # mean angle, rad
    periods: int
    lead: float  # rest before and after the motion, s

    @property
    def duration(self) -> float:
        return self.periods / self.frequency + 2 * self.lead

    def repetitions(self) -> list[dict[str, Any]]:
        """Return start and end of each period, s."""
        starts = self.lead + np.arange(self.periods) / self.frequency
        return [{"start": float(start), "end": float(start + 1 / self.frequency)} for start in starts]

    def motion(self) -> JointMotion:
        """Return the motion from rest to rest: the amplitude grows in the first half period and fades in the last."""
        time = np.arange(-1.0, self.duration + 1.0, STEP)
        phase = (time - self.lead) * self.frequency
        envelope = smoothstep(2 * phase) * smoothstep(2 * (self.periods - phase))
        angle = self.centre + self.amplitude * envelope * np.sin(2 * np.pi * phase)
        return motion_through(time, angle[:, None], self.duration)


# --- rotations with exact angular velocity and acceleration, composed of rotations about given axes

X, Y, Z = np.eye(3)


AxisRotation: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""A rotation about a unit axis (3,), fixed in the frame that the previous rotations reach: axis, and angle, rate and
acceleration (F,), rad."""


@dataclass(frozen=True)
class Attitude:
    """Attitude of a coordinate frame relative to a reference over time."""

    rotation: FloatArray  # (F, 3, 3) from the frame to the reference
    omega: FloatArray  # (F, 3) angular velocity in the axes of the reference, rad/s
    alpha: FloatArray  # (F, 3) angular acceleration in the axes of the reference, rad/s²

    def rotate(self, rotations: Iterable[AxisRotation]) -> Attitude:
        """Return the attitude after the given rotations."""
        rotation, omega, alpha = self.rotation, self.omega, self.alpha
        for own, angle, speed, acceleration in rotations:
            axis, rate = rotation @ own, speed[:, None]
            alpha = alpha + np.cross(omega, axis) * rate + axis * acceleration[:, None]
            omega = omega + axis * rate
            rotation = rotation @ so3.exp(angle[:, None] * own)
        return Attitude(rotation, omega, alpha)


def constant_attitude(rotation: FloatArray, frames: int) -> Attitude:
    """Return a constant attitude, given by a ``rotation`` (3, 3), at ``frames`` frames."""
    zero = np.zeros((frames, 3))
    return Attitude(np.broadcast_to(rotation, (frames, 3, 3)), zero, zero)


def decompose_elbow(forearm: Attitude) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return flexion, carrying angle and pronation (F, 3), rad, with their rates and accelerations (F, 3) each.

    ``forearm`` is the attitude of the forearm in the upper arm: ``R_z(flexion) R_x(carrying) R_y(pronation)``.
    """
    rotation = forearm.rotation
    flexion = np.arctan2(-rotation[:, 0, 1], rotation[:, 1, 1])
    carrying = np.arcsin(np.clip(rotation[:, 2, 1], -1, 1))
    pronation = np.arctan2(-rotation[:, 2, 0], rotation[:, 2, 2])
    first = so3.exp(flexion[:, None] * Z)
    second = first @ so3.exp(carrying[:, None] * X)
    axes = np.stack([np.broadcast_to(Z, (len(flexion), 3)), first @ X, second @ Y], axis=-1)
    rates = np.linalg.solve(axes, forearm.omega[..., None])[..., 0]
    after_first = Z * rates[:, :1]
    after_second = after_first + axes[..., 1] * rates[:, 1:2]
    of_axes = np.cross(after_first, axes[..., 1]) * rates[:, 1:2] + np.cross(after_second, axes[..., 2]) * rates[:, 2:]
    accelerations = np.linalg.solve(axes, (forearm.alpha - of_axes)[..., None])[..., 0]
    angles: FloatArray = np.unwrap(np.stack([flexion, carrying, pronation], axis=1), axis=0)
    return angles, np.asarray(rates), np.asarray(accelerations)


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
class SitToStand:
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
class FailedRise:
    """A failed rise: the chair is unloaded, the hips rise a little, and the person falls back; times in s."""

    start: float
    top: float
    end: float
    height: float = 0.15  # height of the hips at the top: 0 seated, 1 standing

    @property
    def unload(self) -> float:
        """Duration of unloading the chair, s; loading it again takes equally long."""
        return 0.4 * (self.top - self.start)


@dataclass(frozen=True)
class Schedule:
    """Repetitions of a trial and its duration, s, with failed attempts and a pause half-way through the last rise."""

    repetitions: tuple[SitToStand, ...]
    duration: float
    attempts: tuple[FailedRise, ...] = ()
    hold: float = 0.0  # duration of the pause, s; 0 without it

    def height_at(self, time: FloatArray, late: float = 0.0, early: float = 0.0) -> FloatArray:
        """Return the relative height of the hips at times (T,): 0 seated, 1 standing.

        ``late`` delays the start of the rise and ``early`` advances the end of sitting down, s.
        """
        level = np.zeros_like(time)
        for failed in self.attempts:
            up = smoothstep((time - failed.start) / (failed.top - failed.start))
            level += failed.height * (up - smoothstep((time - failed.top) / (failed.end - failed.top)))
        for k, each in enumerate(self.repetitions):
            begin, finish = each.legs_start + late, each.legs_end - early
            up = smoothstep((time - begin) / (each.rise_end - begin))
            if self.hold > 0 and k == len(self.repetitions) - 1:
                half = 0.5 * (each.rise_end - begin - self.hold)
                up = 0.5 * (smoothstep((time - begin) / half) + smoothstep((time - each.rise_end + half) / half))
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
        released = np.zeros_like(time)
        for failed in self.attempts:
            off = smoothstep((time - failed.start) / failed.unload, LOADED_ORDER)
            on = smoothstep((time - (failed.end - failed.unload)) / failed.unload, LOADED_ORDER)
            released += off - on
        level = 1.0 - released
        for each in self.repetitions:
            level -= smoothstep((time - (each.seat_off - each.unload)) / each.unload, LOADED_ORDER)
            level += smoothstep((time - each.seat_on) / each.load, LOADED_ORDER)
        return np.where(np.abs(level) < 1e-15, 0.0, level)


def _draw_schedule(rng: np.random.Generator, options: Options) -> Schedule:
    """Draw a sequence of repetitions whose durations vary by up to 6 %.

    A failed rise precedes each of the last ``attempts`` repetitions; the last rise stops half-way for ``hold`` seconds.
    """
    strategy, repetitions, hold = STRATEGIES[options.strategy], options.repetitions, options.hold

    def vary(value: float) -> float:
        return value * float(rng.uniform(0.94, 1.06))

    completed: list[SitToStand] = []
    failed: list[FailedRise] = []
    now = 1.5 + options.rest_before
    for k in range(repetitions):
        if k >= repetitions - options.attempts:
            failed.append(FailedRise(now, now + 1.0, now + 2.0))
            now = failed[-1].end + 0.8
        rise, unload, sit, load = (vary(x) for x in (strategy.rise, strategy.unload, strategy.sit, strategy.load))
        seat_off = now + vary(0.8) + unload
        rise_end = seat_off - unload + rise + (hold if k == repetitions - 1 else 0.0)
        sit_start = rise_end + float(rng.uniform(0.8, 1.3)) + (options.rest_standing if k == 0 else 0.0)
        seat_on = sit_start + sit - load
        sit_end = seat_on + load + vary(0.7)
        completed.append(SitToStand(now, seat_off, rise_end, unload, sit_start, seat_on, sit_end, load))
        now = sit_end + float(rng.uniform(0.8, 1.2))
    return Schedule(tuple(completed), now + 0.5 + options.rest_after, tuple(failed), hold)


# --- the motion, with a prescribed centre of pressure

SEATED_THIGH = -np.pi / 2  # horizontal, pointing backwards
STANDING_KNEE = np.radians(4.0)
STANDING_TRUNK = np.radians(1.5)
MARGIN = 2.0  # s of rest beyond both ends of the trial


@dataclass(frozen=True)
class Chair:
    """A chair that pushes on a point of the thigh and carries a fraction of the total vertical force."""

    point: tuple[float, float]  # point on the underside of the thigh, near the hip, in the thigh's frame, m
    share: float  # fraction of the total vertical force while the person sits still
    friction: float  # horizontal force divided by vertical force
    schedule: Schedule
    rail: float = 0.0  # largest fraction of the total vertical force on a rail that the person holds while rising

    def load(self, time: FloatArray) -> FloatArray:
        """Return the fraction (T,) of the total vertical force that the chair carries at times (T,)."""
        return self.share * self.schedule.chair_load(time)

    def rail_load(self, time: FloatArray) -> FloatArray:
        """Return the fraction (T,) that the rail carries, from the start of each rise until shortly before its end.

        No plate measures its force.
        """
        level = np.zeros_like(time)
        for each in self.schedule.repetitions:
            length = each.rise_end - each.rise_start
            level += smoothstep((time - each.rise_start) / (0.4 * length))
            level -= smoothstep((time - each.rise_start - 0.75 * length) / (0.25 * length))
        return self.rail * level


@dataclass(frozen=True)
class Plan:
    """A trial before the trunk's lean is computed, on the solver's grid of K times."""

    time: FloatArray  # (K,) evenly spaced times, s
    legs: FloatArray  # (K, 2) angles of shank and thigh from the vertical, rad
    push: FloatArray  # (K,) combined point of application of the forces of ground and chair at ground level, m
    chair: Chair
    trunk: float  # initial guess of the lean, rad


def draw_plan(rng: np.random.Generator, body: SimulatedBody, options: Options) -> Plan:
    """Draw the motion of the legs, the chair and the point ``push``; the trunk's lean is computed later."""
    strategy = STRATEGIES[options.strategy]
    schedule = _draw_schedule(rng, options)
    time = np.arange(-MARGIN, schedule.duration + MARGIN, STEP)
    # angles of shank and thigh from the vertical, (K, 2) rad
    ankle = body.links[1].centre[0]

    def standing_error(shank: float) -> float:
        return _com_x(body, shank, shank - STANDING_KNEE, STANDING_TRUNK) - (ankle + strategy.stand_cop)

    def seated_error(shank: float) -> float:
        return _com_x(body, shank, SEATED_THIGH, np.radians(strategy.lean)) - (ankle + strategy.off_cop)

    standing, seated = brentq(standing_error, -0.4, 0.4), brentq(seated_error, -0.2, 1.2)
    late = 0.08 * strategy.rise
    lowered = seated + (standing - seated) * schedule.height_at(time, late, 0.1 * strategy.sit)
    lowered = lowered + np.radians(strategy.dip) * schedule.bumps(time)
    upper = SEATED_THIGH + (standing - STANDING_KNEE - SEATED_THIGH) * schedule.height_at(time)
    legs = np.column_stack([lowered, upper])
    # the centre of pressure under the feet, (K,) m, with some millimetres of sway
    shift = np.full_like(time, strategy.seat_cop)
    for each in schedule.repetitions:
        for begin, end, change in (
            (each.rise_start, each.seat_off, strategy.off_cop - strategy.seat_cop),
            (each.seat_off, each.rise_end, strategy.stand_cop - strategy.off_cop),
            (each.sit_start, each.sit_end, strategy.seat_cop - strategy.stand_cop),
        ):
            shift += change * smoothstep((time - begin) / (end - begin))
    frequency, phase = rng.uniform(0.08, 0.5, 4), rng.uniform(0, 2 * np.pi, 4)
    sway = np.sin(2 * np.pi * frequency * time[:, None] + phase) @ rng.uniform(0.0008, 0.0022, 4)
    under_feet = body.links[1].centre[0] + shift + np.asarray(sway)
    trunk, thigh = np.radians(strategy.trunk), body.links[2].length
    point = (rng.uniform(0.05, 0.08), thigh * rng.uniform(0.90, 0.97))
    friction = rng.uniform(-0.05, 0.05)
    # position at which the line of the chair's force meets the ground
    _, origin = planar.segment_poses(np.column_stack([legs[:, 0], legs[:, 1] - legs[:, 0]]), body.centres[:2])
    contact = origin[:, 2] + planar.rotate(legs[:, 1], np.array(point))
    seat = contact[:, 0] - friction * contact[:, 1]
    # the chair's share of the load follows from the balance at rest
    at_rest = _com_x(body, legs[0, 0], legs[0, 1], trunk)
    share = float((at_rest - under_feet[0]) / (seat[0] - under_feet[0]))
    chair = Chair(point, share, friction, schedule, options.rail)
    push = under_feet + chair.load(time) * (seat - under_feet)
    return Plan(time, legs, push, chair, trunk)


def balance_lean(
    body: SimulatedBody, plan: Plan, additional: FloatArray | None = None
) -> tuple[JointMotion, tuple[float, ...]]:
    """Return the motion with the lean that balances a plan, and the seated angles of shank, thigh and trunk.

    ``additional`` (K,) is another moment about ``push``, N·m. The angles are from the vertical, degrees.
    NumericalError is raised if no lean of the trunk balances the body.
    """
    legs = plan.legs
    # the moment (K,) of foot and legs about `push`, N·m, which the trunk has to balance, and the hip (K, 2), m
    q = np.column_stack([legs[:, 0], legs[:, 1] - legs[:, 0], -legs[:, 1]])
    _, origin = planar.segment_poses(q, body.centres)
    coms = planar.marker_positions(q, body.centres, np.arange(3), body.coms[:3])
    change = _second_difference(coms)
    moment = np.zeros(len(plan.push))
    for i in range(3):
        arm = coms[:, i, 0] - plan.push
        moment += body.masses[i] * (arm * (change[:, i, 1] + GRAVITY) - coms[:, i, 1] * change[:, i, 0])
    for i in (1, 2):
        moment += body.links[i].inertia * _second_difference(legs[:, i - 1])
    hip = origin[:, 3]
    lean = _solve_lean(body, moment if additional is None else moment + additional, plan, hip)
    angles = np.column_stack([legs[:, 0], legs[:, 1] - legs[:, 0], lean - legs[:, 1]])
    seated = tuple(float(x) for x in np.degrees([legs[0, 0], legs[0, 1], lean[0]]))
    return motion_through(plan.time, angles, plan.chair.schedule.duration), seated


def _com_x(body: SimulatedBody, shank: float, thigh: float, trunk: float) -> float:
    """Return the horizontal position of the centre of mass, m, given the segments' angles from the vertical."""
    q = np.array([shank, thigh - shank, trunk - thigh])
    coms = planar.marker_positions(q, body.centres, np.arange(4), body.coms)
    return float(body.masses @ coms[:, 0] / body.mass)


def _second_difference(values: FloatArray) -> FloatArray:
    """Return the second derivative along the first axis (time); beyond both ends, the values are constant."""
    padded = np.concatenate([values[:1], values, values[-1:]])
    return np.asarray((padded[2:] - 2 * values + padded[:-2]) / STEP**2)


def _solve_lean(body: SimulatedBody, moment: FloatArray, plan: Plan, hip: FloatArray) -> FloatArray:
    """Return the trunk's lean (K,), rad, with which the moments about ``push`` vanish (tridiagonal Newton steps).

    The residual is the moment of trunk, foot and legs. It depends on the lean at the same and both neighbouring times.
    """
    mass, com, inertia = body.links[3].mass, body.coms[3], body.links[3].inertia
    lean = np.full(len(plan.push), plan.trunk)
    for _ in range(50):
        arm = planar.rotate(lean, com)  # from the hip to the trunk's centre of mass
        centre = hip + arm
        change, rotation = _second_difference(centre), _second_difference(lean)
        x, y, rise = centre[:, 0] - plan.push, centre[:, 1], change[:, 1] + GRAVITY
        error = moment + mass * (x * rise - y * change[:, 0]) + inertia * rotation
        dx, dy = -arm[:, 1], arm[:, 0]  # derivative of the arm with respect to the lean
        jacobian = np.zeros((3, len(lean)))  # bands
        jacobian[0, 1:] = (mass * (x[:-1] * dy[1:] - y[:-1] * dx[1:]) + inertia) / STEP**2
        jacobian[2, :-1] = (mass * (x[1:] * dy[:-1] - y[1:] * dx[:-1]) + inertia) / STEP**2
        own = (mass * (x * dy - y * dx) + inertia) / STEP**2
        jacobian[1] = mass * (dx * rise - dy * change[:, 0]) - 2 * own
        jacobian[1, [0, -1]] += own[[0, -1]]
        step = solve_banded((1, 1), jacobian, -error)
        largest = float(np.abs(step).max())
        lean += step * min(1.0, 0.3 / max(largest, 1e-300))
        if largest < 1e-10:
            return lean
    raise NumericalError(
        f"the lean of the trunk that balances the simulated body was not found: the last iteration changed it by "
        f"{largest:.2g} rad"
    )
