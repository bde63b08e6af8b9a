"""Everything about a simulated trial that is drawn before anything is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.geometry import PlaneFrame
from mocap_id.simulation import ur5
from mocap_id.simulation.body import GRAVITY, Body, person, robot
from mocap_id.simulation.forces import Exact, exact
from mocap_id.simulation.loose_body import LooseBody, loosen
from mocap_id.simulation.loose_forces import Loose, exact_loose, perform_loose
from mocap_id.simulation.loose_motion import Looseness, draw_habit, draw_occasion
from mocap_id.simulation.markers import MarkerSet, place
from mocap_id.simulation.motion import Motion, Swing
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.plate import SimulatedPlate, draw_plate
from mocap_id.simulation.rail import Rail
from mocap_id.simulation.schedule import Schedule
from mocap_id.simulation.sit_to_stand import Chair, balanced, prepare
from mocap_id.simulation.subject import Subject

_OLDEST = ("body", "motion", "place", "markers", "skin", "occlusion", "cameras", "plate", "channels", "encoder")
_LATER = ("jumps", "seat", "seat channels", "feet", "wander", "people", "people here")
_STREAMS = (*_OLDEST, *_LATER)  # what is new goes last: a seed keeps the trial that it made
_OF_SUBJECT = ("body", "markers", "skin", "people")


@dataclass(frozen=True)
class Streams:
    """One independent random generator for each purpose: another noise leaves the body and its motion alone."""

    by_purpose: Mapping[str, np.random.Generator]

    def __getitem__(self, purpose: str) -> np.random.Generator:
        return self.by_purpose[purpose]


def streams(seed: int, subject: Subject | None = None) -> Streams:
    """Fresh generators, the same for the same seed; what belongs to a subject is drawn from the subject's."""
    own = _generators(seed)
    return Streams(own if subject is None else own | {name: _generators(subject.seed)[name] for name in _OF_SUBJECT})


def _generators(seed: int) -> dict[str, np.random.Generator]:
    children = np.random.SeedSequence(seed).spawn(len(_STREAMS))
    return {name: np.random.default_rng(child) for name, child in zip(_STREAMS, children, strict=True)}


@dataclass(frozen=True)
class Scene:
    """A body, its motion and where it all takes place.

    Parameters
    ----------
    body, motion, chair, markers, plate
    plane : PlaneFrame
        The plane of motion; its origin is the centre of the plate's surface.
    offset : float
        Distance of the body's mid-plane from that origin along z, m.
    protocol : dict
        JSON values for the truth that belong to the kind of trial.
    seat_plate : SimulatedPlate or None
        Under the chair.
    chair_weight : float
        What that plate carries beside the person, N.
    rail : Rail or None
        Carries a part of the person while rising, unmeasured.
    loose : Loose or None
        The person's true bodies and motion, where these are more than the chain; ``body`` and ``motion`` are then the
        chain that stands for them.
    """

    body: Body
    motion: Motion
    chair: Chair | None
    markers: MarkerSet
    plate: SimulatedPlate
    plane: PlaneFrame
    offset: float
    protocol: Mapping[str, Any]
    seat_plate: SimulatedPlate | None = None
    chair_weight: float = 0.0
    rail: Rail | None = None
    loose: Loose | None = None

    def at(self, time: FloatArray) -> Exact:
        """State and forces at times (T,), s."""
        if self.loose is not None:
            return exact_loose(self.loose, self.chair, time, self.rail)
        return exact(self.body, self.motion, self.chair, time, self.rail)

    def load_on_plate(self, state: Exact) -> tuple[FloatArray, FloatArray]:
        """Force of the plate on the body and its moment about the surface's centre, (T, 3) each, laboratory axes."""
        return self._in_laboratory(state.wrench)

    def load_on_seat_plate(self, state: Exact) -> tuple[FloatArray, FloatArray]:
        """As :meth:`load_on_plate`, of the plate under the chair: what the person puts on it and the chair's weight."""
        assert self.seat_plate is not None
        (x, y), (fx, fy) = state.chair_point.T, state.chair_force.T
        force, moment = self._in_laboratory(np.column_stack([fx, fy, x * fy - y * fx]))
        moment = moment - np.cross(self.seat_plate.centre - self.plane.origin, force)
        return force + np.array([0.0, 0.0, self.chair_weight]), moment

    def _in_laboratory(self, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Force and moment about the plane's origin (T, 3), laboratory axes, of a wrench (T, 3) in the plane."""
        fx, fy, tauz = wrench.T
        still = np.zeros_like(fx)
        force = np.column_stack([fx, fy, still])
        moment = np.column_stack([-self.offset * fy, self.offset * fx, tauz])
        return force @ self.plane.axes, moment @ self.plane.axes


def draw_scene(kind: Kind, options: Options, rng: Streams, given: Motion | None = None) -> Scene:
    """Draw the body, its motion and the laboratory.

    With a motion ``given`` the body makes that, without a chair.

    Raises
    ------
    ConfigError
        A motion is given to a person of several bodies.
    NumericalError
        No lean of the trunk balances the body.
    """
    people = kind == "sit-to-stand" and options.people.differ
    if people and given is not None:
        raise ConfigError("simulate: people is set and a motion is given; expected one or the other")
    body, ur5_joint = _body(kind, options, rng), options.joint if kind == "robot" else None
    apart = None
    if people:
        apart, body = loosen(rng["people"], body, options.people.held_mass_kg)
    played = _Played(given) if given else _performance(kind, options, body, apart, rng)
    plate = draw_plate(
        rng["plate"],
        options.plate_sense,
        moved=options.plate_moved,
        flipped=options.plate_origin_flipped,
        noise=options.plate_noise,
        bias=options.plate_bias,
    )
    markers = place(rng["markers"], body) if ur5_joint is None else ur5.place(rng["markers"], ur5_joint)
    drawn = float(rng["place"].uniform(-np.pi, np.pi))
    scene = Scene(
        body=body,
        motion=played.motion,
        chair=played.chair,
        markers=replace(markers, softness=markers.softness * options.soft_tissue),
        plate=plate,
        plane=PlaneFrame(drawn if ur5_joint is None else np.radians(options.orientation), plate.centre),
        offset=float(rng["place"].normal(0, 0.01)),
        protocol=played.protocol,
        rail=Rail(options.rail, played.chair.schedule) if options.rail > 0 and played.chair is not None else None,
        loose=played.loose,
    )
    return _with_seat_plate(scene, options, rng["seat"]) if options.seat_plate and played.chair is not None else scene


def _body(kind: Kind, options: Options, rng: Streams) -> Body:
    if kind == "robot":
        return robot(rng["body"]) if options.joint is None else ur5.ur5(options.joint, options.speed)
    subject = options.subject
    return person(rng["body"]) if subject is None else person(rng["body"], subject, rng["feet"])


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


def _with_seat_plate(scene: Scene, options: Options, rng: np.random.Generator) -> Scene:
    """The chair on a plate of its own, whose centre lies under the force of somebody seated."""
    plate = draw_plate(
        rng,
        options.plate_sense,
        moved=options.plate_moved,
        flipped=options.plate_origin_flipped,
        noise=options.plate_noise,
        bias=options.plate_bias,
    )
    seated = scene.at(np.zeros(1))
    (x, y), (fx, fy) = seated.chair_point[0], seated.chair_force[0]
    below = scene.plane.from_plane(np.array([x - y * fx / fy, 0.0, 0.0]))
    plate = replace(plate, centre=np.array([below[0], below[1], plate.centre[2]]))
    return replace(scene, seat_plate=plate, chair_weight=options.chair_mass * GRAVITY)


@dataclass(frozen=True)
class _Played:
    """A motion, the chair's part in it, what the truth says of both, and the bodies that a person is."""

    motion: Motion
    chair: Chair | None = None
    protocol: Mapping[str, Any] = field(default_factory=lambda: {"reps": []})
    loose: Loose | None = None


def _performance(kind: Kind, options: Options, body: Body, apart: LooseBody | None, rng: Streams) -> _Played:
    if kind == "robot":
        swing = _swing(options, rng["motion"])
        told = {"freq_hz": swing.frequency, "amplitude_rad": swing.amplitude, "reps": swing.repetitions()}
        return _Played(swing.motion(), None, told)
    plan, loose = prepare(rng["motion"], body, options), None
    schedule = plan.chair.schedule
    if apart is None:
        played = balanced(body, plan)
    else:
        habit, here = draw_habit(rng["people"]), draw_occasion(rng["people here"], len(schedule.repetitions))
        foot = body.support[1] - body.support[0]
        played, loose = perform_loose(body, apart, plan, Looseness(options.people, habit, here, schedule, foot))
    return _Played(played.motion, played.chair, _told(options, schedule, played.seated_deg), loose)


def _told(options: Options, schedule: Schedule, seated_deg: Sequence[float]) -> Mapping[str, Any]:
    repetitions = [vars(each) for each in schedule.repetitions]
    told: dict[str, Any] = {
        "strategy": options.strategy,
        "reps": repetitions,
        "seat_off_s": [each["seat_off"] for each in repetitions],
        "seat_on_s": [each["seat_on"] for each in repetitions],
        "motion_shapes": {"seated_deg": list(seated_deg)},
    }
    if schedule.attempts:
        told["attempts"] = [vars(each) for each in schedule.attempts]
    if schedule.hold is not None:
        told["hold"] = vars(schedule.hold)
    if options.rail > 0:
        told["rail_share"] = options.rail
    return told
