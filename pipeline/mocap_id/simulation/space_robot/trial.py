"""A simulated trial of a robot in space, in memory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import torque_regressor
from mocap_id.dynamics.space.calibration import SpatialCalibration
from mocap_id.dynamics.space.motion import SpatialMotion, move_joints, segment_regressor
from mocap_id.geometry import PlaneFrame, so3
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.simulation.body import GRAVITY
from mocap_id.simulation.plate import Sense, SimulatedPlate, draw_plate, measure_load
from mocap_id.simulation.space_robot.options import SpaceRobotOptions
from mocap_id.simulation.space_robot.robot import SpaceRobot, draw_robot

MARKER_NOISE = 5e-4  # m, each axis
FRAME = PlaneFrame(0.0)
"""Coordinate frame of a trial in space, in the laboratory."""
CLOCK_OFFSET = 0.04  # s: largest offset between cameras and plate


@dataclass(frozen=True)
class InstrumentErrors:
    """Errors of the instruments; the fields correspond to :class:`SpatialCalibration`."""

    gain: float
    moments: float
    position: FloatArray  # (3,) laboratory axes, m
    yaw: float  # rad
    lengths: float
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
    """Return the plate's channels, and the erroneous corners of the file."""
    force, moment = (wrench[:, part] @ FRAME.axes * (1 + errors.gain) for part in (slice(3), slice(3, 6)))
    signals = measure_load(rng, plate, force, (1 + errors.moments) * moment, options.analog_rate)
    placed = replace(plate, centre=plate.centre + errors.position, yaw=plate.yaw + errors.yaw)
    return replace(signals, corners=placed.corners)
