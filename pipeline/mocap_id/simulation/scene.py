"""The scene of a simulated trial before measurement: body, motion, chair, plates and markers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.geometry import PlaneFrame
from mocap_id.simulation import ur5
from mocap_id.simulation.body import GRAVITY, SimulatedBody, draw_person, draw_robot
from mocap_id.simulation.faults import Displacement
from mocap_id.simulation.forces import TrueState, true_state
from mocap_id.simulation.joint_motion import JointMotion, Swing
from mocap_id.simulation.markers import MarkerSet, knee_to_shank, place_markers
from mocap_id.simulation.multibody import LooseBody, divide_body
from mocap_id.simulation.multibody_forces import LoosePerson, perform_loose, true_loose_state
from mocap_id.simulation.multibody_motion import Looseness, draw_habit, draw_trial_variation
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.plate import SimulatedPlate, draw_plate
from mocap_id.simulation.schedule import Schedule
from mocap_id.simulation.sit_to_stand import balance, draw_plan
from mocap_id.simulation.subject import Subject
from mocap_id.simulation.supports import Chair, Rail

_OLDEST = ("body", "motion", "place", "markers", "skin", "occlusion", "cameras", "plate", "channels", "encoder")
_LATER = (
    "jumps",
    "seat",
    "seat channels",
    "feet",
    "wander",
    "people",
    "people here",
    "faults",
    "displacement",
    "board",
)
_STREAMS = (*_OLDEST, *_LATER)  # append new streams at the end, so that a seed always gives the same trial
_OF_SUBJECT = ("body", "markers", "skin", "people")


@dataclass(frozen=True)
class Streams:
    """Independent random generators for each purpose: changing the noise leaves body and motion unchanged."""

    by_purpose: Mapping[str, np.random.Generator]

    def __getitem__(self, purpose: str) -> np.random.Generator:
        return self.by_purpose[purpose]


def streams(seed: int, subject: Subject | None = None) -> Streams:
    """Return fresh generators for a seed; those of a subject's own properties use the subject's seed."""
    own = _generators(seed)
    return Streams(own if subject is None else own | {name: _generators(subject.seed)[name] for name in _OF_SUBJECT})


def _generators(seed: int) -> dict[str, np.random.Generator]:
    children = np.random.SeedSequence(seed).spawn(len(_STREAMS))
    return {name: np.random.default_rng(child) for name, child in zip(_STREAMS, children, strict=True)}


@dataclass(frozen=True)
class Scene:
    """A body with its motion, markers, plates and supports in the laboratory.

    Parameters
    ----------
    body, motion, chair, markers, plate
    plane : PlaneFrame
        The plane of motion, with its origin at the centre of the plate's surface.
    offset : float
        Distance of the body's mid-plane from that origin along z, m.
    protocol : dict
        Entries of the truth for this kind of trial, as JSON values.
    seat_plate : SimulatedPlate or None
        The plate under the chair.
    chair_weight : float
        Weight of the chair on that plate, N.
    rail : Rail or None
        A rail that carries an unmeasured share while the person rises.
    loose : LoosePerson or None
        The person's separate bodies and their motion, if any; ``body`` and ``motion`` then describe the equivalent
        chain.
    """

    body: SimulatedBody
    motion: JointMotion
    chair: Chair | None
    markers: MarkerSet
    plate: SimulatedPlate
    plane: PlaneFrame
    offset: float
    protocol: Mapping[str, Any]
    seat_plate: SimulatedPlate | None = None
    chair_weight: float = 0.0
    rail: Rail | None = None
    loose: LoosePerson | None = None

    def at(self, time: FloatArray) -> TrueState:
        """Return state and forces at times (T,), s."""
        if self.loose is not None:
            return true_loose_state(self.loose, self.chair, time, self.rail)
        return true_state(self.body, self.motion, self.chair, time, self.rail)

    def load_on_plate(
        self, state: TrueState, displacement: Displacement | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the plate's force on the body and moment about the surface's centre, (T, 3) each, laboratory axes."""
        if displacement is None:
            return self._in_laboratory(state.wrench)
        com = np.column_stack([state.com, np.full(len(state.com), self.offset)])
        force, moment = displacement.load(*self._in_plane(state.wrench), GRAVITY * self.body.mass, com)
        return force @ self.plane.axes, moment @ self.plane.axes

    def load_on_seat_plate(
        self, state: TrueState, displacement: Displacement | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the load as :meth:`load_on_plate` for the plate under the chair, including the chair's weight."""
        assert self.seat_plate is not None
        (x, y), (fx, fy) = state.chair_point.T, state.chair_force.T
        wrench = np.column_stack([fx, fy, x * fy - y * fx])
        force, moment = self._in_laboratory(wrench)
        if displacement is not None:
            force, moment = displacement.load(*self._in_plane(wrench), 0.0, np.zeros((len(wrench), 3)))
            force, moment = force @ self.plane.axes, moment @ self.plane.axes
        moment = moment - np.cross(self.seat_plate.centre - self.plane.origin, force)
        return force + np.array([0.0, 0.0, self.chair_weight]), moment

    def _in_laboratory(self, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return force and moment about the plane's origin in laboratory axes (T, 3) of a planar wrench (T, 3)."""
        force, moment = self._in_plane(wrench)
        return force @ self.plane.axes, moment @ self.plane.axes

    def _in_plane(self, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return force and moment about the plane's origin in its axes (T, 3) of a planar wrench (T, 3)."""
        fx, fy, tauz = wrench.T
        still = np.zeros_like(fx)
        force = np.column_stack([fx, fy, still])
        moment = np.column_stack([-self.offset * fy, self.offset * fx, tauz])
        return force, moment


def draw_scene(kind: Kind, options: Options, rng: Streams, given: JointMotion | None = None) -> Scene:
    """Draw the body, its motion and the laboratory.

    With a ``given`` motion, the body performs it without a chair.

    Raises
    ------
    ConfigError
        A motion is given for a person of several bodies.
    NumericalError
        No lean of the trunk balances the body.
    """
    people = kind == "sit-to-stand" and options.people.differ
    if people and given is not None:
        raise ConfigError("simulate: people is set and a motion is given; expected only one of them")
    body, ur5_joint = _body(kind, options, rng), options.joint if kind == "robot" else None
    apart = None
    if people:
        apart, body = divide_body(rng["people"], body, options.people.held_mass_kg)
    played = _Performance(given) if given else _performance(kind, options, body, apart, rng)
    plate = _draw_plate(options, rng["plate"])
    if ur5_joint is not None:
        markers = ur5.place_markers(rng["markers"], ur5_joint)
    else:
        markers = place_markers(rng["markers"], body, options.marker_set, options.without)
    if options.knee_on_shank:
        markers = knee_to_shank(markers, body)
    yaw = float(rng["place"].uniform(-np.pi, np.pi))
    scene = Scene(
        body=body,
        motion=played.motion,
        chair=played.chair,
        markers=replace(markers, softness=markers.softness * options.soft_tissue),
        plate=plate,
        plane=PlaneFrame(yaw if ur5_joint is None else np.radians(options.orientation), plate.centre),
        offset=float(rng["place"].normal(0, 0.01)),
        protocol=played.protocol,
        rail=Rail(options.rail, played.chair.schedule) if options.rail > 0 and played.chair is not None else None,
        loose=played.loose,
    )
    return _with_seat_plate(scene, options, rng["seat"]) if options.seat_plate and played.chair is not None else scene


def _body(kind: Kind, options: Options, rng: Streams) -> SimulatedBody:
    if kind == "robot":
        return draw_robot(rng["body"]) if options.joint is None else ur5.ur5_body(options.joint, options.speed)
    subject = options.subject
    return draw_person(rng["body"]) if subject is None else draw_person(rng["body"], subject, rng["feet"])


def _swing(options: Options, rng: np.random.Generator) -> Swing:
    if options.joint is not None:
        return ur5.swing(options.speed, options.repetitions)
    return Swing(
        frequency=float(rng.uniform(0.4, 0.5)),
        amplitude=float(rng.uniform(0.75, 1.0)),
        centre=float(rng.uniform(-0.4, 0.4)),
        periods=options.repetitions,
        lead=1.0,
    )


def _draw_plate(options: Options, rng: np.random.Generator) -> SimulatedPlate:
    return draw_plate(
        rng,
        options.plate_sense,
        moved=options.plate_moved,
        flipped=options.plate_origin_flipped,
        noise=options.plate_noise,
        bias=options.plate_bias,
    )


def _with_seat_plate(scene: Scene, options: Options, rng: np.random.Generator) -> Scene:
    """Add a plate under the chair, with its centre below the force of the seated person."""
    plate = _draw_plate(options, rng)
    seated = scene.at(np.zeros(1))
    (x, y), (fx, fy) = seated.chair_point[0], seated.chair_force[0]
    below = scene.plane.from_plane(np.array([x - y * fx / fy, 0.0, 0.0]))
    plate = replace(plate, centre=np.array([below[0], below[1], plate.centre[2]]))
    return replace(scene, seat_plate=plate, chair_weight=options.chair_mass * GRAVITY)


@dataclass(frozen=True)
class _Performance:
    """A motion with its chair, its entries in truth.json, and the separate bodies of a person that has them."""

    motion: JointMotion
    chair: Chair | None = None
    protocol: Mapping[str, Any] = field(default_factory=lambda: {"reps": []})
    loose: LoosePerson | None = None


def _performance(
    kind: Kind, options: Options, body: SimulatedBody, apart: LooseBody | None, rng: Streams
) -> _Performance:
    if kind == "robot":
        swing = _swing(options, rng["motion"])
        truth = {"freq_hz": swing.frequency, "amplitude_rad": swing.amplitude, "reps": swing.repetitions()}
        return _Performance(swing.motion(), None, truth)
    plan, loose = draw_plan(rng["motion"], body, options), None
    schedule = plan.chair.schedule
    if apart is None:
        played = balance(body, plan)
    else:
        habit, variation = (
            draw_habit(rng["people"]),
            draw_trial_variation(rng["people here"], len(schedule.repetitions)),
        )
        foot = body.support[1] - body.support[0]
        played, loose = perform_loose(body, apart, plan, Looseness(options.people, habit, variation, schedule, foot))
    return _Performance(played.motion, played.chair, _truth(options, schedule, played.seated_deg), loose)


def _truth(options: Options, schedule: Schedule, seated_deg: Sequence[float]) -> Mapping[str, Any]:
    repetitions = [vars(each) for each in schedule.repetitions]
    truth: dict[str, Any] = {
        "strategy": options.strategy,
        "reps": repetitions,
        "seat_off_s": [each["seat_off"] for each in repetitions],
        "seat_on_s": [each["seat_on"] for each in repetitions],
        "motion_shapes": {"seated_deg": list(seated_deg)},
    }
    if schedule.attempts:
        truth["attempts"] = [vars(each) for each in schedule.attempts]
    if schedule.hold is not None:
        truth["hold"] = vars(schedule.hold)
    if options.rail > 0:
        truth["rail_share"] = options.rail
    return truth
