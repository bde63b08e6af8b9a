"""A simulated trial of a robot in space, in memory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import torque_regressor
from mocap_id.dynamics.space.calibration import SpatialCalibration
from mocap_id.dynamics.space.motion import SpatialMotion, joint_motion, segment_regressor
from mocap_id.geometry import PlaneFrame, so3
from mocap_id.recording.plate_types import PlateSignals
from mocap_id.simulation.body import GRAVITY
from mocap_id.simulation.plate import Sense, SimulatedPlate, draw_plate, measure
from mocap_id.simulation.space_robot.options import SpaceRobotOptions
from mocap_id.simulation.space_robot.robot import SpaceRobot, draw_robot

MARKER_NOISE = 5e-4  # m, each axis
FRAME = PlaneFrame(0.0)
"""The frame of a trial in space in the laboratory."""
CLOCK_OFFSET = 0.04  # s: largest offset between cameras and plate


@dataclass(frozen=True)
class InstrumentErrors:
    """Errors of the instruments; the fields are those of :class:`SpatialCalibration`.

    Parameters
    ----------
    gain, moments : float
    position : (3,) array
        Laboratory axes, m.
    yaw : float
        rad.
    lengths : float
    tilt : (2,) array
        About x and z of the trial's frame, rad.
    """

    gain: float
    moments: float
    position: FloatArray
    yaw: float
    lengths: float
    tilt: FloatArray


@dataclass(frozen=True)
class SpaceRobotTrial:
    """A trial in memory. Vectors are in the frame of a trial in space (y up) with the origin of the laboratory.

    Parameters
    ----------
    options : SpaceRobotOptions
    robot : SpaceRobot
    origin : (3,) array
        The plate's centre in that frame, m.
    time : (T,) array
        s.
    q, dq, ddq : (T, n) arrays
    motion : SpatialMotion
        True motion.
    wrench : (T, 6) array
        True force and moment of the ground, about the origin, N and N·m.
    torque : (T, n) array
        True joint torques, N·m.
    points : (T, M, 3) array
        Measured markers, laboratory axes with Z up, m.
    signals : PlateSignals
    clock_offset : float
        The plate's sample with time t was taken at t + offset, s.
    errors : InstrumentErrors
    """

    options: SpaceRobotOptions
    robot: SpaceRobot
    origin: FloatArray
    time: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    motion: SpatialMotion
    wrench: FloatArray
    torque: FloatArray
    points: FloatArray
    signals: PlateSignals
    clock_offset: float
    errors: InstrumentErrors


def generate_space_robot(options: SpaceRobotOptions) -> SpaceRobotTrial:
    """Draw a robot and measure it; the same options give the same numbers.

    Robot, movement and errors of the instruments are the same with and without a payload; noise and clocks are not.
    """
    own, lab, here = (np.random.default_rng([options.seed, k]) for k in (0, 1, 2 if options.payload == 0 else 3))
    robot = draw_robot(own, options.joints, options.payload, options.duration)
    sense: Sense = "reaction" if lab.random() < 0.5 else "action"
    plate = draw_plate(lab, sense, moved=True, flipped=False, noise=options.noise, bias=options.noise)
    errors = draw_errors(lab, options.errors)
    origin = FRAME.to_plane(plate.centre)
    time = np.arange(round(options.duration * options.rate)) / options.rate
    base = robot.base.copy()
    base[:3, 3] += origin
    states = robot.motion.at(time)[:3]
    motion = joint_motion(robot.chain, base, *states)
    regressor = segment_regressor(motion, GRAVITY)
    offset = float(here.uniform(-CLOCK_OFFSET, CLOCK_OFFSET)) * options.noise
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
        points=_measured(here, options, errors, _markers(robot, motion)),
        signals=_signals(here, options, errors, plate, loaded),
        clock_offset=offset,
        errors=errors,
    )


def draw_errors(rng: np.random.Generator, sd: SpatialCalibration) -> InstrumentErrors:
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
    own = robot.chain.segment
    turned = np.einsum("tmij,mj->tmi", motion.rotation[:, own], robot.chain.local)
    return np.asarray(motion.origin[:, own] + turned)


def _measured(
    rng: np.random.Generator, options: SpaceRobotOptions, errors: InstrumentErrors, points: FloatArray
) -> FloatArray:
    """Return the measured markers in the laboratory."""
    tilt = so3.exp(np.array([errors.tilt[0], 0.0, errors.tilt[1]]))
    noise = rng.normal(0, 1, points.shape) * MARKER_NOISE * options.noise
    return FRAME.from_plane((1 + errors.lengths) * points @ tilt.T + noise)


def _wrench(robot: SpaceRobot, time: FloatArray) -> FloatArray:
    """Return the true wrench (K, 6) of the ground about the plate's centre at times (K,), s."""
    motion = joint_motion(robot.chain, robot.base, *robot.motion.at(time)[:3])
    return np.asarray(segment_regressor(motion, GRAVITY) @ robot.parameters.ravel())


def _signals(
    rng: np.random.Generator,
    options: SpaceRobotOptions,
    errors: InstrumentErrors,
    plate: SimulatedPlate,
    wrench: FloatArray,
) -> PlateSignals:
    """Return the plate's channels, with the corners that the file gives."""
    force, moment = (wrench[:, part] @ FRAME.axes * (1 + errors.gain) for part in (slice(3), slice(3, 6)))
    signals = measure(rng, plate, force, (1 + errors.moments) * moment, options.analog_rate)
    placed = replace(plate, centre=plate.centre + errors.position, yaw=plate.yaw + errors.yaw)
    return replace(signals, corners=placed.corners)
