"""A simulated trial in the plane: the scene with body, motion, chair, plates and markers, and its measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from mocap_id.anatomy.frames import draw_centred_skin_motion
from mocap_id.arrays import GRAVITY, BoolArray, FloatArray
from mocap_id.errors import ConfigError
from mocap_id.geometry import PlaneFrame, planar
from mocap_id.recording.lab_plates import PlateSignals
from mocap_id_simulation.bodies import (
    AMPLITUDE,
    FREQUENCY,
    LEAD,
    MarkerSet,
    SimulatedBody,
    draw_person,
    draw_robot,
    draw_subject_skin_motion,
    place_body_markers,
    ur5_body,
)
from mocap_id_simulation.forces import (
    DividedBody,
    TrueState,
    balance_divided,
    compute_divided_state,
    compute_state,
    divide_body,
    draw_additional_motion,
)
from mocap_id_simulation.instruments import (
    JUMP,
    JUMP_LENGTH,
    Displacement,
    MarkerEpisode,
    SimulatedPlate,
    add_camera_faults,
    draw_displacement,
    draw_occlusions,
    draw_plate,
    draw_skin_faults,
    find_visible,
    measure_load,
    measure_positions,
)
from mocap_id_simulation.options import Kind, Options, SimulatedSubject
from mocap_id_simulation.sit_to_stand import Chair, JointMotion, Swing, balance_lean, draw_plan

_STREAMS = (
    *("body", "motion", "place", "markers", "skin", "occlusion", "cameras", "plate", "channels", "encoder", "jumps"),
    *("seat", "seat channels", "feet", "wander", "people", "people here", "faults", "displacement", "board"),
)  # append new streams at the end, so that a seed always gives the same trial
_OF_SUBJECT = ("body", "markers", "skin", "people")

Streams: TypeAlias = Mapping[str, np.random.Generator]
"""Independent random generators by purpose: changing the noise leaves body and motion unchanged."""


def random_streams(seed: int, subject: SimulatedSubject | None = None) -> Streams:
    """Return fresh generators for a seed; the generators of a subject's properties use the subject's seed."""

    def spawn(seed: int) -> dict[str, np.random.Generator]:
        children = np.random.SeedSequence(seed).spawn(len(_STREAMS))
        return {name: np.random.default_rng(child) for name, child in zip(_STREAMS, children, strict=True)}

    streams = spawn(seed)
    if subject is not None:
        own = spawn(subject.seed)
        streams |= {name: own[name] for name in _OF_SUBJECT}
    return streams


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
    # A person of several bodies, and their motion; `body` and `motion` then describe the equivalent chain.
    divided: tuple[DividedBody, JointMotion] | None = None

    def at(self, time: FloatArray) -> TrueState:
        """Return state and forces at times (T,), s."""
        if self.divided is not None:
            return compute_divided_state(*self.divided, self.chair, time)
        return compute_state(self.body, self.motion, self.chair, time)

    def marker_positions(
        self, state: TrueState, skin: FloatArray, displacement: Displacement | None = None
    ) -> FloatArray:
        """Return marker positions (T, M, 3) in the laboratory without measurement error, m.

        ``skin`` (T, M, 3) is the displacement of the markers in their links' frames, m. ``displacement`` moves all
        markers except those on the plate.
        """
        if self.divided is None or state.bodies is None:
            link, local = self.markers.link, self.markers.local
            angle, origin = planar.segment_poses(state.q, self.body.centres)
        else:
            pose, body = state.bodies.pose, self.divided[0]
            pose = np.concatenate([np.zeros_like(pose[:, :1]), pose], axis=1)  # the plate first
            link, local = body.part_of(self.markers) + 1, body.local(self.markers)
            angle, origin = pose[..., 2], pose[..., :2]
        local = local + skin
        flat = origin[:, link] + planar.rotate(angle[:, link], local[..., :2])
        positions = np.concatenate([flat, local[..., 2:] + self.offset], axis=-1)
        if displacement is not None:
            positions = np.where(self.markers.on_plate[:, None], positions, displacement.positions(positions))
        return self.plane.from_plane(positions)

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
    # the body
    ur5_joint = options.joint if kind == "robot" else None
    if ur5_joint is not None:
        body = ur5_body(ur5_joint, options.speed)
    elif kind == "robot":
        body = draw_robot(rng["body"])
    elif options.subject is None:
        body = draw_person(rng["body"])
    else:
        body = draw_person(rng["body"], options.subject, rng["feet"])
    # its motion, the chair, and entries of truth.json
    chair: Chair | None = None
    divided: tuple[DividedBody, JointMotion] | None = None
    protocol: dict[str, Any] = {"reps": []}
    if given is not None:
        motion = given
    elif kind == "robot":
        if options.joint is not None:
            swing = Swing(FREQUENCY[options.speed], AMPLITUDE, 0.0, options.repetitions, LEAD)
        else:
            frequency, amplitude, centre = (
                float(rng["motion"].uniform(*limits)) for limits in ((0.4, 0.5), (0.75, 1.0), (-0.4, 0.4))
            )
            swing = Swing(frequency, amplitude, centre, options.repetitions, lead=1.0)
        motion = swing.motion()
        protocol = {"freq_hz": swing.frequency, "amplitude_rad": swing.amplitude, "reps": swing.repetitions()}
    else:
        if people:
            parts, body = divide_body(rng["people"], body, options.people.held_mass_kg)
        plan = draw_plan(rng["motion"], body, options)
        chair = plan.chair
        if people:
            foot = body.support[1] - body.support[0]
            additional = draw_additional_motion(rng["people"], rng["people here"], options.people, chair.schedule, foot)
            motion, seated_deg, apart = balance_divided(body, parts, plan, additional)
            divided = parts, apart
        else:
            motion, seated_deg = balance_lean(body, plan)
        repetitions = [vars(each) for each in chair.schedule.repetitions]
        protocol = {
            "strategy": options.strategy,
            "reps": repetitions,
            "seat_off_s": [each["seat_off"] for each in repetitions],
            "seat_on_s": [each["seat_on"] for each in repetitions],
            "motion_shapes": {"seated_deg": list(seated_deg)},
        }
        if chair.schedule.attempts:
            protocol["attempts"] = [vars(each) for each in chair.schedule.attempts]
        if chair.schedule.hold > 0:
            protocol["hold"] = {"repetition": len(repetitions) - 1, "length": chair.schedule.hold}
        if options.rail > 0:
            protocol["rail_share"] = options.rail
    # the laboratory
    plate = _draw_plate(options, rng["plate"])
    markers = place_body_markers(rng["markers"], body, options.marker_set, options.without, ur5_joint)
    if options.knee_on_shank:
        at_knee = np.array([joint == "knee" for joint in markers.at_joint])
        local = markers.local.copy()
        local[at_knee, :2] += body.links[2].centre
        markers = replace(markers, link=markers.link - at_knee, local=local)
    yaw = float(rng["place"].uniform(-np.pi, np.pi))
    scene = Scene(
        body=body,
        motion=motion,
        chair=chair,
        markers=replace(markers, softness=markers.softness * options.soft_tissue),
        plate=plate,
        plane=PlaneFrame(yaw if ur5_joint is None else np.radians(options.orientation), plate.centre),
        offset=float(rng["place"].normal(0, 0.01)),
        protocol=protocol,
        divided=divided,
    )
    if not options.seat_plate or chair is None:
        return scene
    # a plate under the chair, centred where the chair's force at rest meets the ground
    seat_plate = _draw_plate(options, rng["seat"])
    seated = scene.at(np.zeros(1))
    (x, y), (fx, fy) = seated.chair_point[0], seated.chair_force[0]
    below = scene.plane.from_plane(np.array([x - y * fx / fy, 0.0, 0.0]))
    seat_plate = replace(seat_plate, centre=np.array([below[0], below[1], seat_plate.centre[2]]))
    return replace(scene, seat_plate=seat_plate, chair_weight=options.chair_mass * GRAVITY)


def _draw_plate(options: Options, rng: np.random.Generator) -> SimulatedPlate:
    return draw_plate(
        rng,
        options.plate_sense,
        moved=options.plate_moved,
        flipped=options.plate_origin_flipped,
        noise=options.plate_noise,
        bias=options.plate_bias,
    )


@dataclass(frozen=True)
class SimulatedTrial:
    """A trial in memory, with T frames and M markers."""

    scene: Scene
    state: TrueState  # true state at the frames
    positions: FloatArray  # (T, M, 3) true marker positions in the laboratory, m
    visible: BoolArray  # (T, M) whether the cameras see each marker
    bursts: tuple[MarkerEpisode, ...]  # occlusions
    jumps: tuple[tuple[MarkerEpisode, FloatArray], ...]  # with their shifts (3,), m
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
    markers, labels = scene.markers, scene.markers.labels
    if options.subject is None:
        skin = draw_centred_skin_motion(rng["skin"], markers.link, markers.softness, state.q, state.time)
    else:  # the markers are then at their mean positions
        skin, markers = draw_subject_skin_motion(rng["skin"], rng["wander"], markers, state.q, state.time)
        scene = replace(scene, markers=markers)
    faults, schedule = options.faults, None if scene.chair is None else scene.chair.schedule
    skin = skin + draw_skin_faults(rng["faults"], faults, markers, state.time)
    seed = int(rng["displacement"].integers(2**32))
    positions = scene.marker_positions(state, skin, draw_displacement(seed, faults, schedule, state.time))
    hideable = [label for label, hidden in zip(labels, markers.hidden, strict=True) if hidden]
    bursts = draw_occlusions(rng["occlusion"], hideable, frames, options.rate, options.occlusions)
    # jumps of random markers at random times, shifted in a random direction
    jumps: list[tuple[MarkerEpisode, FloatArray]] = []
    of = rng["jumps"]
    for _ in range(options.jumps):
        count = int(of.integers(JUMP_LENGTH[0], min(JUMP_LENGTH[1], frames // 2) + 1))
        direction = of.normal(0, 1, 3)
        shift = of.uniform(*JUMP) * direction / np.linalg.norm(direction)
        jumps.append((MarkerEpisode(str(of.choice(labels)), int(of.integers(frames - count)), count), shift))
    visible = find_visible(labels, bursts, frames)
    samples = frames * round(options.analog_rate / options.rate)
    loaded = scene.at(np.arange(samples) / options.analog_rate + options.clock_offset)
    jumped = np.zeros_like(positions)
    for jump, shift in jumps:
        jumped[jump.frames, labels.index(jump.label)] += shift
    points = measure_positions(rng["cameras"], positions + jumped, options.marker_noise, visible)
    labels, points, fault_truth = add_camera_faults(rng["faults"], faults, scene, points, options.rate)
    displacement = draw_displacement(seed, faults, schedule, loaded.time)
    load = scene.load_on_plate(loaded, displacement)
    signals = measure_load(rng["channels"], scene.plate, *load, options.analog_rate)
    gains = (1 + faults.gain) * np.array([1, 1, 1 + faults.gain_fz, *[1 + faults.gain_moments] * 3])
    channels = signals.channels * gains + np.array([0, 0, faults.offset_fz_N, 0, 0, 0])
    corners = signals.corners + faults.corners_mm / 1e3 * scene.plane.axes[0]
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
        jumps=tuple(jumps),
        points=points,
        signals=replace(signals, channels=channels, corners=corners),
        seat_signals=seat_signals,
        labels=labels,
        fault_truth=fault_truth,
    )
