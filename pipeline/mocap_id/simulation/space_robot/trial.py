"""A simulated trial of a robot in space: in memory, and on disk with its exact truth and a configuration."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import torque_regressor
from mocap_id.dynamics.space.base_parameters import name_parameters, structural_base
from mocap_id.dynamics.space.instrument_errors import SpatialCalibration
from mocap_id.dynamics.space.motion import SpatialMotion, move_joints, segment_regressor
from mocap_id.geometry import PlaneFrame, se3, so3
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.simulation.body import GRAVITY
from mocap_id.simulation.plate import Sense, SimulatedPlate, draw_plate, measure_load
from mocap_id.simulation.space_robot.robot import SpaceRobot, SpaceRobotOptions, draw_robot
from mocap_id.simulation.trial_files import json_bytes, npz_bytes, points_bytes, write_trial

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
    robot = draw_robot(of_robot, options.joints, options.payload, options.duration)
    sense: Sense = "reaction" if of_laboratory.random() < 0.5 else "action"
    plate = draw_plate(of_laboratory, sense, moved=True, flipped=False, noise=options.noise, bias=options.noise)
    errors = _draw_errors(of_laboratory, options.errors)
    origin = FRAME.to_plane(plate.centre)
    time = np.arange(round(options.duration * options.rate)) / options.rate
    base = robot.base.copy()
    base[:3, 3] += origin
    states = robot.motion.at(time)[:3]
    motion = move_joints(robot.chain, base, *states)
    regressor = segment_regressor(motion, GRAVITY)
    offset = float(of_recording.uniform(-CLOCK_OFFSET, CLOCK_OFFSET)) * options.noise
    loaded = _wrench(robot, np.arange(round(options.duration * options.analog_rate)) / options.analog_rate + offset)
    parameters = robot.parameters.ravel()
    return SpaceRobotTrial(
        options=options,
        robot=replace(robot, base=base),
        origin=origin,
        time=time,
        q=states[0],
        dq=states[1],
        ddq=states[2],
        motion=motion,
        wrench=regressor @ parameters,
        torque=torque_regressor(motion, regressor) @ parameters,
        points=_measure_markers(of_recording, options, errors, _markers(robot, motion)),
        signals=_measure_wrench(of_recording, options, errors, plate, loaded),
        clock_offset=offset,
        errors=errors,
    )


def _draw_errors(rng: np.random.Generator, sd: SpatialCalibration) -> InstrumentErrors:
    """Draw the errors of cameras and plate."""
    return InstrumentErrors(
        gain=float(rng.normal(0, sd.gain)),
        moments=float(rng.normal(0, sd.moments)),
        position=rng.normal(0, sd.position, 3),
        yaw=float(rng.normal(0, sd.yaw)),
        lengths=float(rng.normal(0, sd.lengths)),
        tilt=rng.normal(0, sd.tilt, 2),
    )


def _markers(robot: SpaceRobot, motion: SpatialMotion) -> FloatArray:
    """Return the true positions of the markers (T, M, 3), m."""
    segment = robot.chain.segment
    rotated = np.einsum("tmij,mj->tmi", motion.rotation[:, segment], robot.chain.local)
    return np.asarray(motion.origin[:, segment] + rotated)


def _measure_markers(
    rng: np.random.Generator, options: SpaceRobotOptions, errors: InstrumentErrors, points: FloatArray
) -> FloatArray:
    """Return the measured positions of the markers (T, M, 3) in the laboratory, m."""
    tilt = so3.exp(np.array([errors.tilt[0], 0.0, errors.tilt[1]]))
    noise = rng.normal(0, 1, points.shape) * MARKER_NOISE * options.noise
    return FRAME.from_plane((1 + errors.lengths) * points @ tilt.T + noise)


def _wrench(robot: SpaceRobot, time: FloatArray) -> FloatArray:
    """Return the true wrench (K, 6) of the ground about the plate's centre at times (K,), s."""
    motion = move_joints(robot.chain, robot.base, *robot.motion.at(time)[:3])
    return np.asarray(segment_regressor(motion, GRAVITY) @ robot.parameters.ravel())


def _measure_wrench(
    rng: np.random.Generator,
    options: SpaceRobotOptions,
    errors: InstrumentErrors,
    plate: SimulatedPlate,
    wrench: FloatArray,
) -> PlateSignals:
    """Return the plate's channels with their errors, and the plate's corners with the error of the file."""
    force, moment = (wrench[:, part] @ FRAME.axes * (1 + errors.gain) for part in (slice(3), slice(3, 6)))
    signals = measure_load(rng, plate, force, (1 + errors.moments) * moment, options.analog_rate)
    placed = replace(plate, centre=plate.centre + errors.position, yaw=plate.yaw + errors.yaw)
    return replace(signals, corners=placed.corners)


_YAML = """\
# A robot of {joints} hinges in space on a force plate{load}.
# Made by `mocap-id simulate robot-in-space` with seed {seed}. The exact truth is in truth.json and truth.npz.
# Paths are relative to this file.
trial: {name}
space: 3d
protocol: free
recording: trial.c3d  # markers and force plate
{settings}"""
_SETTINGS = """\
identify-dim:  # standard deviations of the instruments' errors
  plate_gain_sd: {gain:g}
  plate_moments_sd: {moments:g}
  plate_zero_sd_n: {force:g}  # N
  plate_zero_sd_nm: {moment:g}  # N*m
  plate_position_sd_m: {position:g}  # m
  camera_scale_sd: {lengths:g}
  camera_tilt_sd_deg: {degrees:.3g}
"""
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

    The folder is created if necessary. It receives ``trial.c3d``, ``truth.json``, ``truth.npz`` and ``trial.yaml``, and
    gives the trial its name.

    StoreError is raised if the folder already contains a trial, or cannot be written.
    """
    return write_trial(folder, lambda name: _contents(generate_space_robot(options), name))


def _contents(trial: SpaceRobotTrial, name: str) -> dict[str, bytes]:
    return {
        "trial.c3d": points_bytes(trial.robot.labels, trial.points, trial.options.rate, [trial.signals]),
        "truth.json": json_bytes(_truth(trial)),
        "truth.npz": npz_bytes(_arrays(trial)),
        "trial.yaml": _yaml(trial, name).encode(),
    }


def _yaml(trial: SpaceRobotTrial, name: str) -> str:
    options, sd = trial.options, trial.options.errors
    values = asdict(sd) | {"degrees": np.degrees(sd.tilt)}
    return _YAML.format(
        joints=options.joints,
        load=f", with a payload of {options.payload:g} kg" if options.payload else "",
        seed=options.seed,
        name=json.dumps(name, ensure_ascii=False),
        settings=_SETTINGS.format(**values),
    )


def _truth(trial: SpaceRobotTrial) -> dict[str, Any]:
    robot, options = trial.robot, trial.options
    structure = structural_base(robot.chain, se3.pose(robot.base[:3, :3], np.zeros(3)))
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
        "parameters": dict(zip(name_parameters(len(robot.parameters)), robot.parameters.ravel().tolist(), strict=True)),
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
