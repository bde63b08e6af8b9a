"""Robots: sets of trials of the thesis's robot in a plane, and a random robot in space on a force plate.

All joints of the robot in space move together. Its trial is made in memory, and on disk with its exact truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from mocap_id.anatomy.frames import draw_skin_motion
from mocap_id.arrays import GRAVITY, FloatArray, IntArray
from mocap_id.dynamics.regressor import torque_regressor
from mocap_id.dynamics.space.consistency import point_mass
from mocap_id.dynamics.space.identification import SpatialCalibration, make_exact
from mocap_id.dynamics.space.preparation import (
    SpatialMotion,
    move_joints,
    name_parameters_in_space,
    segment_regressor,
    structural_base_in_space,
)
from mocap_id.errors import ConfigError
from mocap_id.geometry import PlaneFrame, se3, so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint
from mocap_id.recording.lab_plates import PlateSignals
from mocap_id.store.atomic import replace_together
from mocap_id_simulation.bodies import REFERENCE, TOTAL
from mocap_id_simulation.instruments import (
    FORCE_BIAS,
    MOMENT_BIAS,
    SIZE,
    MarkerEpisode,
    draw_occlusions,
    draw_plate,
    find_visible,
    measure_load,
    measure_positions,
)
from mocap_id_simulation.options import (
    PRESETS,
    ChainOptions,
    Difficulty,
    JointName,
    Options,
    Preset,
    Sense,
    Speed,
    check_options,
    option,
)
from mocap_id_simulation.sit_to_stand import (
    STEP,
    JointMotion,
    constant_attitude,
    draw_direction,
    draw_sway,
    motion_through,
    ramp_up,
    smoothstep,
)
from mocap_id_simulation.trial_files import (
    create_folder,
    derive_seeds,
    points_bytes,
    simulate,
    study_yaml,
    trial_contents,
    write_trial,
    yaml_head,
)

_OCCLUSIONS = 0.4 / 24  # times the usual number of bursts, for one marker


@dataclass(frozen=True)
class SimulatedSpaceTrial:
    """A trial of S segments and M markers at F frames; all vectors are in laboratory axes with z up."""

    labels: tuple[str, ...]  # names of the markers in the file
    names: tuple[str, ...]  # names of the landmarks and cluster markers, also if the recording is anonymous
    rate: float  # Hz
    time: FloatArray  # (F,) s
    positions: FloatArray  # (F, M, 3) measured positions, m; NaN where a marker was not seen
    true_positions: FloatArray  # (F, M, 3) positions with soft tissue, without noise and occlusions, m
    bursts: tuple[MarkerEpisode, ...]  # occlusions
    segments: tuple[str, ...]
    assignment: IntArray  # (M,) segment of every marker
    local: FloatArray  # (M, 3) positions in the segments' frames while the body is still at the start, m
    skin: FloatArray  # (F, M, 3) displacement by soft tissue in the segments' frames, m
    origins: FloatArray  # (F, S, 3) origins of the segments' frames, m
    rotations: FloatArray  # (F, S, 3, 3) from the segment to the laboratory
    omega: FloatArray  # (F, S, 3) angular velocities, rad/s
    alpha: FloatArray  # (F, S, 3) angular accelerations, rad/s²
    angles: Mapping[str, FloatArray]  # angles (F,) by their names in angles.parquet, rad; empty for a plain chain
    rates: Mapping[str, FloatArray]  # their first derivatives, rad/s
    accelerations: Mapping[str, FloatArray]  # their second derivatives, rad/s²
    arrays: Mapping[str, FloatArray]  # further arrays of truth.npz
    document: Mapping[str, Any]  # further entries of truth.json
    still: float  # duration of the rest at the start, s


def transform_points(origins: FloatArray, rotations: FloatArray, segment: IntArray, local: FloatArray) -> FloatArray:
    """Return points (F, M, 3) in the laboratory from positions ``local`` (F, M, 3) in their segments' frames."""
    return np.asarray(origins[:, segment] + np.einsum("fmij,fmj->fmi", rotations[:, segment], local))


def film_markers(
    rng: np.random.Generator, labels: tuple[str, ...], positions: FloatArray, rate: float, sizes: Difficulty
) -> tuple[FloatArray, tuple[MarkerEpisode, ...]]:
    """Return measured positions (F, M, 3), m, and the occlusions, in which the positions are NaN."""
    frames, count = positions.shape[:2]
    bursts = draw_occlusions(rng, labels, frames, rate, sizes.occlusions * count * _OCCLUSIONS)
    return measure_positions(rng, positions, sizes.marker_noise, find_visible(labels, bursts, frames)), bursts


# --- chains of bodies

_REST = 1.0  # s of rest at the start
_AXES = {"S": 3, "T": 2, "H": 1}
_LEAST_BETWEEN = np.radians(60.0)  # least angle between the axes of a two-axis joint
_FREQUENCIES = (0.15, 0.6)  # Hz
_TILT = 2.0  # rad of rotation of a swaying base for each metre of its sway


def simulate_chain(
    seed: int = 0, kinds: str = "SS", arc_deg: float = 40.0, preset: Preset = "default", **more: Any
) -> SimulatedSpaceTrial:
    """Simulate a chain; the same arguments give the same numbers. ``more`` are further fields of :class:`ChainOptions`.

    Examples
    --------
    >>> trial = simulate_chain(1, "SH", arc_deg=15)
    >>> trial.positions.shape, trial.segments
    ((2000, 12, 3), ('base', 'link1', 'link2'))
    """
    return generate_chain(ChainOptions(seed=seed, kinds=kinds, arc_deg=arc_deg, preset=preset, **more))


def generate_chain(options: ChainOptions) -> SimulatedSpaceTrial:
    """Simulate a chain with the given options."""
    of_body, of_motion, of_skin, of_cameras = (np.random.default_rng([options.seed, 30 + i]) for i in range(4))
    lengths = of_body.uniform(0.25, 0.38, len(options.kinds))
    axes = [_draw_axes(of_body, kind) for kind in options.kinds]
    # joint centres in the parents' frames: the chain hangs from the top of the base
    centres = of_body.normal(0, 0.01, (len(lengths), 3))
    centres[1:, 2] = -lengths[:-1]
    centres[0] = (*of_body.uniform(-0.05, 0.05, 2), of_body.uniform(0.85, 1.0))
    # markers on every body: labels, segments and local positions (M, 3), m
    names: list[str] = []
    places: list[FloatArray] = []
    number = options.markers
    for k, length in enumerate((None, *lengths)):
        around = of_body.uniform(0, 2 * np.pi, number)
        if length is None:
            radius, height = of_body.uniform(0.06, 0.2, number), of_body.uniform(0.2, 0.9, number)
        else:
            radius, height = of_body.uniform(0.03, 0.09, number), -length * of_body.uniform(0.2, 0.9, number)
        places.append(np.stack([radius * np.cos(around), radius * np.sin(around), height], axis=1))
        names += [f"BAS{i + 1}" if length is None else f"L{k}M{i + 1}" for i in range(number)]
    labels, local = tuple(names), np.concatenate(places)
    segment = np.repeat(np.arange(len(lengths) + 1), number)
    time = np.arange(round(options.duration * options.rate)) / options.rate
    # the motion: first coordinate of every joint (F, n), translation of the base (F, 3), m, and all attitudes
    fine = np.arange(-1.0, options.duration + 1.0, STEP)
    count = sum(each.shape[1] for each in axes)
    # irregular waves whose largest value is the arc
    frequency = of_motion.uniform(*_FREQUENCIES, (3, count))
    weight = np.array([1.0, 0.5, 0.25])[:, None]
    phase = of_motion.uniform(0, 2 * np.pi, (3, count))
    waves = (weight * np.sin(2 * np.pi * frequency * fine[:, None, None] + phase)).sum(axis=1)
    waves = waves / np.abs(waves).max(axis=0) * np.radians(options.arc_deg)
    size = options.sway_mm / 1e3
    base = draw_sway(of_motion, fine, np.repeat([size * _TILT, size], 3))
    motion = motion_through(fine, ramp_up(fine, _REST) * np.hstack([waves, base]), options.duration)
    q, dq, ddq, _ = motion.at(time)
    all_axes = np.concatenate([*axes, np.eye(3)], 1).T
    turns = [(axis, q[:, i], dq[:, i], ddq[:, i]) for i, axis in enumerate(all_axes)]
    attitudes = [constant_attitude(np.eye(3), len(time)).rotate(turns[count:])]
    first = np.cumsum([0, *(each.shape[1] for each in axes)])
    for start, end in pairwise(first):
        attitudes.append(attitudes[-1].rotate(turns[start:end]))
    q, shift = q[:, first[:-1]], q[:, count + 3 :]
    origins = [shift]
    for attitude, centre in zip(attitudes, centres, strict=False):
        origins.append(origins[-1] + attitude.rotation @ centre)
    rotations = np.stack([each.rotation for each in attitudes], axis=1)
    placed = np.stack(origins, axis=1)
    softness = np.full(len(labels), options.soft_tissue_mm / 1e3)
    skin = draw_skin_motion(of_skin, segment, softness, q, time, wander=of_skin, middle=q[0])
    skin = np.asarray(skin - skin[0])  # zero in the first frame
    true = transform_points(placed, rotations, segment, local + skin)
    positions, bursts = film_markers(of_cameras, labels, true, options.rate, PRESETS[options.preset])
    return SimulatedSpaceTrial(
        labels=labels,
        names=labels,
        rate=options.rate,
        time=time,
        positions=positions,
        true_positions=true,
        bursts=bursts,
        segments=("base", *(f"link{k + 1}" for k in range(len(lengths)))),
        assignment=segment,
        local=local,
        skin=skin,
        origins=placed,
        rotations=rotations,
        omega=np.stack([each.omega for each in attitudes], axis=1),
        alpha=np.stack([each.alpha for each in attitudes], axis=1),
        angles={},
        rates={},
        accelerations={},
        arrays={
            "joint_lab": placed[:, 1:],
            "joint_R": np.einsum("fjba,fjbc->fjac", rotations[:, :-1], rotations[:, 1:]),
        },
        document={
            "types": options.kinds,
            "joint_in_parent_m": centres.tolist(),
            "joint_axes": [each.tolist() for each in axes],
            "lengths_m": lengths.tolist(),
        },
        still=_REST,
    )


def _draw_axes(rng: np.random.Generator, kind: str) -> FloatArray:
    """Return the d axes (3, d) of a joint: orthogonal for a ball joint, at 60 … 90° for a two-axis joint."""
    frame: FloatArray = so3.exp(rng.normal(0, 2, 3))
    if kind == "T":
        angle = rng.uniform(_LEAST_BETWEEN, np.pi / 2)
        return np.stack([frame[:, 0], np.cos(angle) * frame[:, 0] + np.sin(angle) * frame[:, 1]], axis=1)
    return frame[:, : _AXES[kind]]


ROBOT_FILE = "robot-study.yaml"
ORIENTATIONS = (0.0, 45.0)  # degrees


@dataclass(frozen=True)
class RobotSet:
    """A set of simulated robot trials; a value out of range raises ConfigError."""

    repeats: int = option(3, "Trials of each joint, speed and orientation.", (1, 99))
    joints: tuple[JointName, ...] = get_args(JointName)
    speeds: tuple[Speed, ...] = get_args(Speed)
    orientations: tuple[float, ...] = ORIENTATIONS  # degrees
    # Common options. The seed is the set's; each trial has its own seed, joint, speed and orientation.
    options: Options = field(default_factory=lambda: Options(seed=1, rate=480.0, analog_rate=2400.0))

    def __post_init__(self) -> None:
        check_options(self, "simulate robot-set")
        if not (self.joints and self.speeds and self.orientations):
            raise ConfigError("simulate robot-set: `joints`, `speeds` or `orientations` is empty; expected one or more")


def robot_set_trials(robot_set: RobotSet) -> Iterator[tuple[str, Options]]:
    """Yield the name and options of every trial."""
    for joint in robot_set.joints:
        for speed in robot_set.speeds:
            for orientation in robot_set.orientations:
                for repeat in range(1, robot_set.repeats + 1):
                    indices = (get_args(JointName).index(joint), get_args(Speed).index(speed), round(orientation) % 360)
                    seed, *_ = derive_seeds(robot_set.options.seed, *indices, repeat)
                    options = replace(robot_set.options, seed=seed, joint=joint, speed=speed, orientation=orientation)
                    yield f"{joint}-{speed}-{orientation:g}-{repeat}", options


def simulate_robot_set(folder: Path, robot_set: RobotSet) -> Path:
    """Simulate the trials of a set, and return the path of ``robot-study.yaml``, which is written last.

    Every trial has a folder with its exact truth. StoreError is raised if the folder is not empty or cannot be written.
    """
    create_folder(folder)
    for name, options in robot_set_trials(robot_set):
        simulate("robot", folder / name, options)
    replace_together(folder, {ROBOT_FILE: robot_set_yaml(robot_set).encode()})
    return folder / ROBOT_FILE


def reuse_robot_set(folder: Path, robot_set: RobotSet) -> Path:
    """Return the file of the simulated set in a folder; simulate the set if it is missing.

    ConfigError is raised if the folder contains a set with different options.
    """
    if not (folder / ROBOT_FILE).exists():
        return simulate_robot_set(folder, robot_set)
    if (folder / ROBOT_FILE).read_text("utf-8") != robot_set_yaml(robot_set):
        raise ConfigError(
            f"{folder} contains a set with a different seed or number of trials: give the same options as for that "
            "set, or choose a different `--out`"
        )
    return folder / ROBOT_FILE


def robot_set_yaml(robot_set: RobotSet) -> str:
    """Return the text of the set's ``robot-study.yaml``."""
    trials = list(robot_set_trials(robot_set))
    count, swings = len(trials), robot_set.options.repetitions
    head = f"""\
# {count} simulated trials of the thesis's robot, {swings} swings of one joint each (`mocap-id validate robot`).
# Made by `mocap-id simulate robot-set` with seed {robot_set.options.seed}. The exact truth stands beside each trial.
# Paths are relative to this file.
study: simulated-ur5
reference:  # table 5.2's: m, kg, kg·m, kg·m²; `base` is the joint's distance from the plate's centre
"""
    reference: dict[str, Mapping[str, float]] = {}
    for joint in robot_set.joints:
        distance, _, moment, inertia = REFERENCE[joint]
        moving = {"mx1": 0.0, "mx2": 0.0, "my2": moment, "Izz2": inertia}
        reference[joint] = {"base": distance, "mass": TOTAL, **moving}
    rows = [
        {"file": f"{name}/trial.yaml", "joint": one.joint, "speed": one.speed, "orientation": f"{one.orientation:g}"}
        for name, one in trials
    ]
    return study_yaml(head, reference, rows)


ErrorPreset = Literal["clean", "default"]
POSITION = 1e-3  # m: error of the plate's position in the default preset
SMALL_ERRORS = SpatialCalibration(
    gain=0.003,
    moments=0.003,
    force=FORCE_BIAS,
    moment=MOMENT_BIAS,
    position=POSITION,
    yaw=2 * POSITION / SIZE[0],
    lengths=0.001,
    tilt=0.002,
)
"""Standard deviations of the instruments' errors in the default preset."""


@dataclass(frozen=True)
class SpaceRobotOptions:
    """Options of a simulated robot in space, whose base stands on a force plate.

    A value out of range raises ConfigError.
    """

    seed: int = option(0, "Seed of robot and movement; a payload does not change them.")
    preset: ErrorPreset = option("default", "clean: exact instruments; default: small errors.")
    joints: int = option(2, "Number of hinges, 1 to 6.", (1, 6))
    payload: float = option(0.0, "Mass at the end of the last segment, kg.", (0, 100), "kg")
    duration: float = option(30.0, "Duration, s.", (5, 600), "s")
    rate: float = option(120.0, "Frames per second.", (30, 2000), "Hz")
    analog_rate: float = option(1200.0, "Plate samples per second, a multiple of the frame rate.")

    def __post_init__(self) -> None:
        check_options(self, "simulate robot-in-space")
        if not (self.analog_rate / self.rate).is_integer():
            raise ConfigError(
                f"simulate robot-in-space: `analog_rate` is {self.analog_rate:g} Hz; expected a multiple of `rate`, "
                f"{self.rate:g} Hz"
            )

    @property
    def noise(self) -> float:
        """Factor on the noise of cameras and plate: 0 or 1."""
        return 0.0 if self.preset == "clean" else 1.0

    @property
    def errors(self) -> SpatialCalibration:
        """Standard deviations of the instruments' errors."""
        return make_exact() if self.preset == "clean" else SMALL_ERRORS


_LENGTH = (0.42, 0.39, 0.30, 0.22, 0.18, 0.15)  # m, of the moving segments
_MASS = (12.0, 8.0, 5.0, 3.0, 2.0, 1.2, 0.8)  # kg, base first
_PEDESTAL = 0.30  # m: height of the first joint above the plate
_LEAST_ANGLE = 0.6  # rad, between neighbouring axes
_POINTS = 40  # number of point masses of a segment
_MARKERS = 6  # number of markers on every segment
_ROBOT_FREQUENCIES = (0.1, 0.6)  # Hz, of the movement
_WAVES, _AMPLITUDE, _ROBOT_REST = 4, 0.55, 1.0  # waves per joint, rad, s


@dataclass(frozen=True)
class SpaceRobot:
    """A robot in space on a base at rest."""

    chain: SpatialChain  # n hinges, and the markers
    base: FloatArray  # (4, 4) pose of the base in a frame with y up and its origin at the plate's centre, m
    parameters: FloatArray  # (n + 1, 10) inertial parameters of every segment in its frame, with the payload, SI units
    payload: FloatArray  # (10,) parameters of the payload in the frame of the last segment; zeros without a payload
    motion: JointMotion

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the markers: B1 … on the base, then S1_1 … on segment 1."""
        numbers = [int(np.sum(self.chain.segment[:k] == s)) + 1 for k, s in enumerate(self.chain.segment)]
        return tuple(
            f"B{n}" if s == 0 else f"S{s}_{n}" for s, n in zip(self.chain.segment.tolist(), numbers, strict=True)
        )


def draw_space_robot(rng: np.random.Generator, joints: int, payload: float, duration: float) -> SpaceRobot:
    """Draw a robot with hinges in general directions, and its movement for a duration, s.

    The payload, kg, and the duration do not change the robot.
    """
    along = np.array([0.0, 1.0, 0.0])  # long axis of a segment in its frame
    base = se3.pose(so3.exp(rng.normal(0, 0.5, 3) * [0, 1, 0]), np.array([*rng.uniform(-0.05, 0.05, 3)]) * [1, 0, 1])
    axis, links, parameters = draw_direction(rng), [], [_draw_parameters(rng, _MASS[0], _PEDESTAL, 0.12)]
    for k in range(joints):
        before = axis
        while np.linalg.norm(np.cross(before, axis)) < np.sin(_LEAST_ANGLE) or abs(axis @ along) > np.cos(_LEAST_ANGLE):
            axis = draw_direction(rng)
        height = _PEDESTAL if k == 0 else _LENGTH[k - 1]
        centre = height * along + rng.normal(0, 0.02, 3)
        offset = so3.exp(rng.normal(0, 0.35, 3))
        links.append(SpatialJoint("hinge", k, centre, first_axis=axis, offset=offset))
        parameters.append(_draw_parameters(rng, _MASS[k + 1], _LENGTH[k], 0.05))
        axis = offset.T @ axis
    # markers around the long axis of every segment
    local = []
    for length in (_PEDESTAL, *_LENGTH[:joints]):
        angle = np.arange(_MARKERS) * 2.4 + rng.uniform(0, 2 * np.pi)
        radius = rng.uniform(0.06, 0.11, _MARKERS)
        heights = length * (0.15 + 0.75 * np.arange(_MARKERS) / (_MARKERS - 1)) + rng.normal(0, 0.01, _MARKERS)
        local.append(np.column_stack([radius * np.cos(angle), heights, radius * np.sin(angle)]))
    segment = np.repeat(np.arange(joints + 1), _MARKERS)
    chain = SpatialChain(tuple(links), segment, np.concatenate(local), np.zeros(len(segment), dtype=np.bool_))
    # a movement of all joints together, at rest in the first and last second
    time = np.arange(-1.0, duration + 1.0, STEP)
    envelope = smoothstep((time - _ROBOT_REST) / 2) * smoothstep((duration - _ROBOT_REST - time) / 2)
    angles = np.zeros((len(time), joints))
    for j in range(joints):
        frequency, phase = rng.uniform(*_ROBOT_FREQUENCIES, _WAVES), rng.uniform(0, 2 * np.pi, _WAVES)
        share = rng.dirichlet(np.full(_WAVES, 3.0)) * _WAVES
        waves = np.sin(2 * np.pi * frequency * time[:, None] + phase) * share
        angles[:, j] = _AMPLITUDE / np.sqrt(_WAVES / 2) * waves.sum(axis=1)
    motion = motion_through(time, envelope[:, None] * angles, duration)
    load = payload * _draw_parameters(rng, 1.0, 0.08, 0.05, _LENGTH[joints - 1])
    parameters[-1] = parameters[-1] + load
    return SpaceRobot(chain, base, np.array(parameters), load, motion)


def _draw_parameters(
    rng: np.random.Generator, mass: float, length: float, width: float, start: float = 0.0
) -> FloatArray:
    """Return the inertial parameters (10,) of random point masses along y, beginning at ``start``, m."""
    positions = rng.uniform(-1, 1, (_POINTS, 3)) * [width, length / 2, width] + [0, start + length / 2, 0]
    share = rng.dirichlet(np.full(_POINTS, 2.0))
    return np.asarray(sum(mass * part * point_mass(position) for part, position in zip(share, positions, strict=True)))


MARKER_NOISE = 5e-4  # m, each axis
FRAME = PlaneFrame(0.0)
"""Coordinate frame of a trial in space, in the laboratory."""
CLOCK_OFFSET = 0.04  # s: largest offset between cameras and plate


@dataclass(frozen=True)
class InstrumentErrors:
    """Errors of the instruments; the fields correspond to :class:`SpatialCalibration`."""

    gain: float  # relative error of the plate's forces and moments
    moments: float  # further relative error of the plate's moments
    position: FloatArray  # (3,) laboratory axes, m
    yaw: float  # rad
    lengths: float  # relative error of the cameras' lengths
    tilt: FloatArray  # (2,) about x and z of the trial's frame, rad


@dataclass(frozen=True)
class SpaceRobotTrial:
    """A trial in memory. Vectors are in the frame of a trial in space (y up) with the origin of the laboratory."""

    options: SpaceRobotOptions
    robot: SpaceRobot
    origin: FloatArray  # (3,) the plate's centre in that frame, m
    time: FloatArray  # (T,) s
    q: FloatArray  # (T, n) rad
    dq: FloatArray  # (T, n) rad/s
    ddq: FloatArray  # (T, n) rad/s²
    motion: SpatialMotion  # true motion
    wrench: FloatArray  # (T, 6) true force and moment of the ground about the origin, N and N·m
    torque: FloatArray  # (T, n) true joint torques, N·m
    points: FloatArray  # (T, M, 3) measured markers, laboratory axes with z up, m
    signals: PlateSignals
    clock_offset: float  # the plate's sample with time t was measured at t + offset, s
    errors: InstrumentErrors


def generate_space_robot(options: SpaceRobotOptions) -> SpaceRobotTrial:
    """Draw a robot and measure it; the same options give the same numbers.

    A payload changes the noise and the clock offset, but not the robot, its movement and the errors of the instruments.
    """
    of_robot, of_laboratory, of_recording = (
        np.random.default_rng([options.seed, k]) for k in (0, 1, 2 if options.payload == 0 else 3)
    )
    robot = draw_space_robot(of_robot, options.joints, options.payload, options.duration)
    sense: Sense = "reaction" if of_laboratory.random() < 0.5 else "action"
    plate = draw_plate(of_laboratory, sense, moved=True, flipped=False, noise=options.noise, bias=options.noise)
    sd = options.errors
    errors = InstrumentErrors(
        gain=float(of_laboratory.normal(0, sd.gain)),
        moments=float(of_laboratory.normal(0, sd.moments)),
        position=of_laboratory.normal(0, sd.position, 3),
        yaw=float(of_laboratory.normal(0, sd.yaw)),
        lengths=float(of_laboratory.normal(0, sd.lengths)),
        tilt=of_laboratory.normal(0, sd.tilt, 2),
    )
    # the true motion and forces
    origin = FRAME.to_plane(plate.centre)
    time = np.arange(round(options.duration * options.rate)) / options.rate
    base = robot.base.copy()
    base[:3, 3] += origin
    q, dq, ddq, _ = robot.motion.at(time)
    motion = move_joints(robot.chain, base, q, dq, ddq)
    regressor = segment_regressor(motion, GRAVITY)
    parameters = robot.parameters.ravel()
    # the plate's samples have their own clock; the wrench is about the plate's centre
    offset = float(of_recording.uniform(-CLOCK_OFFSET, CLOCK_OFFSET)) * options.noise
    at = np.arange(round(options.duration * options.analog_rate)) / options.analog_rate + offset
    loaded = segment_regressor(move_joints(robot.chain, robot.base, *robot.motion.at(at)[:3]), GRAVITY) @ parameters
    # markers in the laboratory
    segment = robot.chain.segment
    rotated = np.einsum("tmij,mj->tmi", motion.rotation[:, segment], robot.chain.local)
    true = np.asarray(motion.origin[:, segment] + rotated)
    tilt = so3.exp(np.array([errors.tilt[0], 0.0, errors.tilt[1]]))
    noise = of_recording.normal(0, 1, true.shape) * MARKER_NOISE * options.noise
    points = FRAME.from_plane((1 + errors.lengths) * true @ tilt.T + noise)
    # the plate's channels with their errors, and its corners with the error of the file
    force, moment = (loaded[:, part] @ FRAME.axes * (1 + errors.gain) for part in (slice(3), slice(3, 6)))
    signals = measure_load(of_recording, plate, force, (1 + errors.moments) * moment, options.analog_rate)
    placed = replace(plate, centre=plate.centre + errors.position, yaw=plate.yaw + errors.yaw)
    return SpaceRobotTrial(
        options=options,
        robot=replace(robot, base=base),
        origin=origin,
        time=time,
        q=q,
        dq=dq,
        ddq=ddq,
        motion=motion,
        wrench=regressor @ parameters,
        torque=torque_regressor(motion, regressor) @ parameters,
        points=points,
        signals=replace(signals, corners=placed.corners),
        clock_offset=offset,
        errors=errors,
    )


_CONVENTIONS = (
    "Laboratory axes, Z up, SI. seg_R takes segment axes to the laboratory; seg_origin is the segment's joint, or the "
    "base's origin. Ten parameters of a segment in its own frame about its origin: m, mx, my, mz, Ixx, Iyy, Izz, Ixy, "
    "Ixz, Iyz. wrench: true force and moment of the ground about the laboratory's origin at the frames. torque: about "
    "each joint's axis. joint_axes: axis in the frame of the parent, then in the frame of the child. A plate sample "
    "with time t was measured at t + clock_offset_s. base_parameters: in frames with z along the hinge (the base: "
    "laboratory axes X, Z, -Y), with the moments of the base about its origin."
)


def simulate_space_robot(folder: Path, options: SpaceRobotOptions) -> Path:
    """Simulate a robot in space, write it with its exact truth, and return the path of ``trial.yaml``.

    The folder is created if necessary, and gives the trial its name. StoreError is raised if the folder already
    contains a trial, or cannot be written.
    """

    def make(name: str) -> dict[str, bytes]:
        trial, sd = generate_space_robot(options), options.errors
        load = f", with a payload of {options.payload:g} kg" if options.payload else ""
        what = f"A robot of {options.joints} hinges in space on a force plate{load}."
        text = yaml_head(what, "mocap-id simulate robot-in-space", options.seed, name)
        text += f"""\
space: 3d
protocol: free
recording: trial.c3d  # markers and force plate
identify-dim:  # standard deviations of the instruments' errors
  plate_gain_sd: {sd.gain:g}
  plate_moments_sd: {sd.moments:g}
  plate_zero_sd_n: {sd.force:g}  # N
  plate_zero_sd_nm: {sd.moment:g}  # N*m
  plate_position_sd_m: {sd.position:g}  # m
  camera_scale_sd: {sd.lengths:g}
  camera_tilt_sd_deg: {np.degrees(sd.tilt):.3g}
"""
        recording = points_bytes(trial.robot.labels, trial.points, options.rate, [trial.signals])
        return trial_contents(recording, _describe(trial), _arrays(trial), text)

    return write_trial(folder, make)


def _describe(trial: SpaceRobotTrial) -> dict[str, Any]:
    """Return JSON values for ``truth.json``."""
    robot, options = trial.robot, trial.options
    structure = structural_base_in_space(robot.chain, se3.pose(robot.base[:3, :3], np.zeros(3)))
    joints = robot.chain.joints
    return {
        "kind": "robot-in-space",
        "conventions": _CONVENTIONS,
        "options": asdict(options),
        "rate_hz": options.rate,
        "static_s": 1.0,
        "marker_noise_m": MARKER_NOISE * options.noise,
        "segments": ["base", *(f"segment_{k}" for k in range(1, len(joints) + 1))],
        "joints": [f"joint_{k}" for k in range(1, len(joints) + 1)],
        "joint_kinds": [joint.kind for joint in joints],
        "joint_centres_m": [joint.centre.tolist() for joint in joints],
        "joint_axes": [[joint.first_axis.tolist(), (joint.offset.T @ joint.first_axis).tolist()] for joint in joints],
        "assignment": dict(zip(robot.labels, robot.chain.segment.tolist(), strict=True)),
        "local_xyz_m": dict(zip(robot.labels, robot.chain.local.tolist(), strict=True)),
        "clock_offset_s": trial.clock_offset,
        "instrument_errors": {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(trial.errors).items()
        },
        "parameters": dict(
            zip(name_parameters_in_space(len(robot.parameters)), robot.parameters.ravel().tolist(), strict=True)
        ),
        "payload": {"segment": len(joints), "parameters": robot.payload.tolist()},
        "base_parameters": {
            "names": list(structure.names),
            "units": list(structure.units),
            "values": (structure.mapping @ robot.parameters.ravel()).tolist(),
        },
    }


def _arrays(trial: SpaceRobotTrial) -> dict[str, FloatArray]:
    to_lab, motion = FRAME.axes.T, trial.motion

    def vectors(values: FloatArray) -> FloatArray:
        return np.asarray(values @ to_lab.T)

    return {
        "t": trial.time,
        "q": trial.q,
        "dq": trial.dq,
        "ddq": trial.ddq,
        "seg_R": to_lab @ motion.rotation,
        "seg_origin": vectors(motion.origin),
        "omega": vectors(motion.omega),
        "alpha": vectors(motion.alpha),
        "joint_lab": vectors(motion.joint),
        "wrench": np.concatenate([vectors(trial.wrench[:, :3]), vectors(trial.wrench[:, 3:])], axis=1),
        "torque": trial.torque,
    }
