"""The scene of a simulated trial before measurement: body, motion, chair, plates and markers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import ConfigError
from mocap_id.geometry import PlaneFrame
from mocap_id.kinematics.skin_motion import draw_centred_skin_motion
from mocap_id.recording.plate_types import PlateSignals
from mocap_id_simulation.bodies import (
    GRAVITY,
    MarkerSet,
    SimulatedBody,
    Subject,
    draw_person,
    draw_robot,
    draw_subject_skin_motion,
    fix_knee_to_shank,
    make_swing,
    place_markers,
    place_ur5_markers,
    ur5_body,
)
from mocap_id_simulation.cameras import (
    Burst,
    Displacement,
    Jump,
    add_camera_faults,
    add_plate_faults,
    compute_true_positions,
    draw_bursts,
    draw_displacement,
    draw_jumps,
    draw_skin_faults,
    find_visible,
    jump_displacements,
    measure_positions,
)
from mocap_id_simulation.forces import (
    AdditionalMotion,
    DividedBody,
    DividedPerson,
    TrueState,
    balance_divided,
    compute_divided_state,
    compute_state,
    divide_body,
    draw_habit,
    draw_trial_variation,
)
from mocap_id_simulation.instruments import SimulatedPlate, draw_plate, measure_load
from mocap_id_simulation.motion import JointMotion, Swing
from mocap_id_simulation.options import Kind, Options
from mocap_id_simulation.sit_to_stand import Chair, Rail, Schedule, balance, draw_plan

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

Streams: TypeAlias = Mapping[str, np.random.Generator]
"""Independent random generators by purpose: changing the noise leaves body and motion unchanged."""


def random_streams(seed: int, subject: Subject | None = None) -> Streams:
    """Return fresh generators for a seed; the generators of a subject's properties use the subject's seed."""
    streams = _generators(seed)
    if subject is not None:
        streams |= {name: _generators(subject.seed)[name] for name in _OF_SUBJECT}
    return streams


def _generators(seed: int) -> dict[str, np.random.Generator]:
    children = np.random.SeedSequence(seed).spawn(len(_STREAMS))
    return {name: np.random.default_rng(child) for name, child in zip(_STREAMS, children, strict=True)}


@dataclass(frozen=True)
class Scene:
    """A body with its motion, markers, plates and supports in the laboratory."""

    body: SimulatedBody
    motion: JointMotion
    chair: Chair | None
    markers: MarkerSet
    plate: SimulatedPlate
    plane: PlaneFrame  # the plane of motion, with its origin at the centre of the plate's surface
    offset: float  # distance of the body's mid-plane from that origin along z, m
    protocol: Mapping[str, Any]  # entries of the truth for this kind of trial, as JSON values
    seat_plate: SimulatedPlate | None = None  # the plate under the chair
    chair_weight: float = 0.0  # weight of the chair on that plate, N
    rail: Rail | None = None
    # A person of several bodies with their motion; `body` and `motion` then describe the equivalent chain.
    divided: DividedPerson | None = None

    def at(self, time: FloatArray) -> TrueState:
        """Return state and forces at times (T,), s."""
        if self.divided is not None:
            return compute_divided_state(self.divided, self.chair, time, self.rail)
        return compute_state(self.body, self.motion, self.chair, time, self.rail)

    def load_on_plate(
        self, state: TrueState, displacement: Displacement | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the plate's force on the body and its moment about the surface's centre, (T, 3) in laboratory axes."""
        load = self._in_plane(state.wrench)
        if displacement is not None:
            com = np.column_stack([state.com, np.full(len(state.com), self.offset)])
            load = displacement.load(*load, GRAVITY * self.body.mass, com)
        return load[0] @ self.plane.axes, load[1] @ self.plane.axes

    def load_on_seat_plate(
        self, state: TrueState, displacement: Displacement | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the load on the plate under the chair, with the chair's weight, as :meth:`load_on_plate` does."""
        assert self.seat_plate is not None
        (x, y), (fx, fy) = state.chair_point.T, state.chair_force.T
        load = self._in_plane(np.column_stack([fx, fy, x * fy - y * fx]))
        if displacement is not None:
            load = displacement.load(*load, 0.0, np.zeros((len(x), 3)))
        force, moment = (part @ self.plane.axes for part in load)
        moment = moment - np.cross(self.seat_plate.centre - self.plane.origin, force)
        return force + np.array([0.0, 0.0, self.chair_weight]), moment

    def _in_plane(self, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return force and moment (T, 3) of a planar wrench (T, 3) about the plane's origin, in the plane's axes."""
        fx, fy, tauz = wrench.T
        force = np.column_stack([fx, fy, np.zeros_like(fx)])
        moment = np.column_stack([-self.offset * fy, self.offset * fx, tauz])
        return force, moment


def draw_scene(kind: Kind, options: Options, rng: Streams, given: JointMotion | None = None) -> Scene:
    """Draw the body, its motion and the laboratory; a ``given`` motion replaces the usual motion and has no chair.

    Raises
    ------
    ConfigError
        A motion is given for a person of several bodies.
    NumericalError
        No lean of the trunk balances the body.
    """
    people = kind == "sit-to-stand" and options.people.differs_from_chain
    if people and given is not None:
        raise ConfigError("simulate: `people` is set and a motion is given; expected only one of the two")
    body, ur5_joint = _draw_body(kind, options, rng), options.joint if kind == "robot" else None
    divided = None
    if people:
        divided, body = divide_body(rng["people"], body, options.people.held_mass_kg)
    movement = _Movement(given) if given else _draw_movement(kind, options, body, divided, rng)
    plate = _draw_plate(options, rng["plate"])
    if ur5_joint is not None:
        markers = place_ur5_markers(rng["markers"], ur5_joint)
    else:
        markers = place_markers(rng["markers"], body, options.marker_set, options.without)
    if options.knee_on_shank:
        markers = fix_knee_to_shank(markers, body)
    yaw = float(rng["place"].uniform(-np.pi, np.pi))
    chair = movement.chair
    scene = Scene(
        body=body,
        motion=movement.motion,
        chair=chair,
        markers=replace(markers, softness=markers.softness * options.soft_tissue),
        plate=plate,
        plane=PlaneFrame(yaw if ur5_joint is None else np.radians(options.orientation), plate.centre),
        offset=float(rng["place"].normal(0, 0.01)),
        protocol=movement.protocol,
        rail=Rail(options.rail, chair.schedule) if options.rail > 0 and chair is not None else None,
        divided=movement.divided,
    )
    return _add_seat_plate(scene, options, rng["seat"]) if options.seat_plate and chair is not None else scene


def _draw_body(kind: Kind, options: Options, rng: Streams) -> SimulatedBody:
    if kind == "robot":
        return draw_robot(rng["body"]) if options.joint is None else ur5_body(options.joint, options.speed)
    subject = options.subject
    return draw_person(rng["body"]) if subject is None else draw_person(rng["body"], subject, rng["feet"])


def _draw_swing(options: Options, rng: np.random.Generator) -> Swing:
    if options.joint is not None:
        return make_swing(options.speed, options.repetitions)
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


def _add_seat_plate(scene: Scene, options: Options, rng: np.random.Generator) -> Scene:
    """Return the scene with a plate under the chair, centred where the chair's force at rest meets the ground."""
    plate = _draw_plate(options, rng)
    seated = scene.at(np.zeros(1))
    (x, y), (fx, fy) = seated.chair_point[0], seated.chair_force[0]
    below = scene.plane.from_plane(np.array([x - y * fx / fy, 0.0, 0.0]))
    plate = replace(plate, centre=np.array([below[0], below[1], plate.centre[2]]))
    return replace(scene, seat_plate=plate, chair_weight=options.chair_mass * GRAVITY)


@dataclass(frozen=True)
class _Movement:
    """A motion with its chair, its entries in truth.json, and the separate bodies of a person of several bodies."""

    motion: JointMotion
    chair: Chair | None = None
    protocol: Mapping[str, Any] = field(default_factory=lambda: {"reps": []})
    divided: DividedPerson | None = None


def _draw_movement(
    kind: Kind, options: Options, body: SimulatedBody, divided: DividedBody | None, rng: Streams
) -> _Movement:
    if kind == "robot":
        swing = _draw_swing(options, rng["motion"])
        truth = {"freq_hz": swing.frequency, "amplitude_rad": swing.amplitude, "reps": swing.repetitions()}
        return _Movement(swing.motion(), None, truth)
    plan, person = draw_plan(rng["motion"], body, options), None
    schedule = plan.chair.schedule
    if divided is None:
        balanced = balance(body, plan)
    else:
        habit = draw_habit(rng["people"])
        variation = draw_trial_variation(rng["people here"], len(schedule.repetitions))
        foot = body.support[1] - body.support[0]
        additional = AdditionalMotion(options.people, habit, variation, schedule, foot)
        balanced, person = balance_divided(body, divided, plan, additional)
    return _Movement(balanced.motion, balanced.chair, _protocol(options, schedule, balanced.seated_deg), person)


def _protocol(options: Options, schedule: Schedule, seated_deg: Sequence[float]) -> Mapping[str, Any]:
    """Return the entries of truth.json about the sit-to-stands."""
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


@dataclass(frozen=True)
class SimulatedTrial:
    """A trial in memory, with T frames and M markers."""

    scene: Scene
    state: TrueState  # true state at the frames
    positions: FloatArray  # (T, M, 3) true marker positions in the laboratory, m
    visible: BoolArray  # (T, M) whether the cameras see each marker
    bursts: tuple[Burst, ...]
    jumps: tuple[Jump, ...]
    points: FloatArray  # (T, L, 3) measured positions of the L labels, m; NaN where not visible
    signals: PlateSignals  # channels of the plate, ``analog_rate / rate`` samples for each frame
    seat_signals: PlateSignals | None  # channels of the plate under the chair; None without it
    labels: tuple[str, ...]  # L names in the file: of the M markers, then of trajectories that belong to no marker
    fault_truth: Mapping[str, Any]  # which markers have a fault, and when


def generate(kind: Kind, options: Options, given: JointMotion | None = None) -> SimulatedTrial:
    """Draw a trial and measure it; the same options give the same numbers.

    With a ``given`` motion, the body performs it without a chair.
    """
    rng = random_streams(options.seed, options.subject)
    return measure_scene(draw_scene(kind, options, rng, given), options, rng)


def measure_scene(scene: Scene, options: Options, rng: Streams) -> SimulatedTrial:
    """Measure a scene with the simulated cameras and plates."""
    frames = round(scene.motion.duration * options.rate)
    state = scene.at(np.arange(frames) / options.rate)
    scene, skin = _draw_skin(scene, options, rng, state)
    faults, schedule = options.faults, None if scene.chair is None else scene.chair.schedule
    skin = skin + draw_skin_faults(rng["faults"], faults, scene.markers, state.time)
    seed = int(rng["displacement"].integers(2**32))
    positions = compute_true_positions(scene, state, skin, draw_displacement(seed, faults, schedule, state.time))
    labels = scene.markers.labels
    hideable = [label for label, hidden in zip(labels, scene.markers.hidden, strict=True) if hidden]
    bursts = draw_bursts(rng["occlusion"], hideable, frames, options.rate, options.occlusions)
    jumps = draw_jumps(rng["jumps"], labels, frames, options.jumps)
    visible = find_visible(labels, bursts, frames)
    samples = frames * round(options.analog_rate / options.rate)
    loaded = scene.at(np.arange(samples) / options.analog_rate + options.clock_offset)
    points = measure_positions(
        rng["cameras"], positions + jump_displacements(labels, jumps, frames), options.marker_noise, visible
    )
    labels, points, fault_truth = add_camera_faults(rng["faults"], faults, scene, points, options.rate)
    displacement = draw_displacement(seed, faults, schedule, loaded.time)
    signals = measure_load(
        rng["channels"], scene.plate, *scene.load_on_plate(loaded, displacement), options.analog_rate
    )
    seat_signals = None
    if scene.seat_plate is not None:
        load = scene.load_on_seat_plate(loaded, displacement)
        seat_signals = measure_load(rng["seat channels"], scene.seat_plate, *load, options.analog_rate)
    return SimulatedTrial(
        scene=scene,
        state=state,
        positions=positions,
        visible=visible,
        bursts=bursts,
        jumps=jumps,
        points=points,
        signals=add_plate_faults(faults, signals, scene.plane.axes[0]),
        seat_signals=seat_signals,
        labels=labels,
        fault_truth=fault_truth,
    )


def _draw_skin(scene: Scene, options: Options, rng: Streams, state: TrueState) -> tuple[Scene, FloatArray]:
    """Return the scene with the markers at their mean positions, and their displacement (T, M, 3) by the skin, m."""
    if options.subject is None:
        return scene, draw_centred_skin_motion(
            rng["skin"], scene.markers.link, scene.markers.softness, state.q, state.time
        )
    skin, markers = draw_subject_skin_motion(rng["skin"], rng["wander"], scene.markers, state.q, state.time)
    return replace(scene, markers=markers), skin
