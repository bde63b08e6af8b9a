"""A random robot in space: options, chain, inertial parameters, markers and movement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.space.instrument_errors import SpatialCalibration, make_exact
from mocap_id.dynamics.space.pseudo_inertia import point_mass
from mocap_id.errors import ConfigError
from mocap_id.geometry import se3, so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint
from mocap_id.simulation.joint_motion import STEP, JointMotion, motion_through, smoothstep
from mocap_id.simulation.options import check_options, option
from mocap_id.simulation.plate import FORCE_BIAS, MOMENT_BIAS, SIZE

Preset = Literal["clean", "default"]
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
    preset: Preset = option("default", "clean: exact instruments; default: small errors.", choices=get_args(Preset))
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
_FREQUENCIES = (0.1, 0.6)  # Hz, of the movement
_WAVES, _AMPLITUDE, _REST = 4, 0.55, 1.0  # waves per joint, rad, s


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


def draw_robot(rng: np.random.Generator, joints: int, payload: float, duration: float) -> SpaceRobot:
    """Draw a robot with hinges in general directions, and its movement for a duration, s.

    The payload, kg, and the duration do not change the robot.
    """
    along = np.array([0.0, 1.0, 0.0])  # long axis of a segment in its frame
    base = se3.pose(so3.exp(rng.normal(0, 0.5, 3) * [0, 1, 0]), np.array([*rng.uniform(-0.05, 0.05, 3)]) * [1, 0, 1])
    axis, links, parameters = _draw_direction(rng), [], [_draw_parameters(rng, _MASS[0], _PEDESTAL, 0.12)]
    for k in range(joints):
        before = axis
        while np.linalg.norm(np.cross(before, axis)) < np.sin(_LEAST_ANGLE) or abs(axis @ along) > np.cos(_LEAST_ANGLE):
            axis = _draw_direction(rng)
        height = _PEDESTAL if k == 0 else _LENGTH[k - 1]
        centre = height * along + rng.normal(0, 0.02, 3)
        offset = so3.exp(rng.normal(0, 0.35, 3))
        links.append(SpatialJoint("hinge", k, centre, first_axis=axis, offset=offset))
        parameters.append(_draw_parameters(rng, _MASS[k + 1], _LENGTH[k], 0.05))
        axis = offset.T @ axis
    segment = np.repeat(np.arange(joints + 1), _MARKERS)
    local = np.concatenate([_draw_positions(rng, length) for length in (_PEDESTAL, *_LENGTH[:joints])])
    chain = SpatialChain(tuple(links), segment, local, np.zeros(len(segment), dtype=np.bool_))
    motion = _draw_movement(rng, joints, duration)
    load = payload * _draw_parameters(rng, 1.0, 0.08, 0.05, _LENGTH[joints - 1])
    parameters[-1] = parameters[-1] + load
    return SpaceRobot(chain, base, np.array(parameters), load, motion)


def _draw_direction(rng: np.random.Generator) -> FloatArray:
    """Return a random unit vector (3,)."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _draw_parameters(
    rng: np.random.Generator, mass: float, length: float, width: float, start: float = 0.0
) -> FloatArray:
    """Return the inertial parameters (10,) of random point masses along y, beginning at ``start``, m."""
    positions = rng.uniform(-1, 1, (_POINTS, 3)) * [width, length / 2, width] + [0, start + length / 2, 0]
    share = rng.dirichlet(np.full(_POINTS, 2.0))
    return np.asarray(sum(mass * part * point_mass(position) for part, position in zip(share, positions, strict=True)))


def _draw_positions(rng: np.random.Generator, length: float) -> FloatArray:
    """Return the positions (M, 3) of a segment's markers, around its long axis, m."""
    angle = np.arange(_MARKERS) * 2.4 + rng.uniform(0, 2 * np.pi)
    radius = rng.uniform(0.06, 0.11, _MARKERS)
    height = length * (0.15 + 0.75 * np.arange(_MARKERS) / (_MARKERS - 1)) + rng.normal(0, 0.01, _MARKERS)
    return np.column_stack([radius * np.cos(angle), height, radius * np.sin(angle)])


def _draw_movement(rng: np.random.Generator, joints: int, duration: float) -> JointMotion:
    """Return a movement of all joints together, at rest in the first and last second."""
    time = np.arange(-1.0, duration + 1.0, STEP)
    envelope = smoothstep((time - _REST) / 2) * smoothstep((duration - _REST - time) / 2)
    angles = np.zeros((len(time), joints))
    for j in range(joints):
        frequency, phase = rng.uniform(*_FREQUENCIES, _WAVES), rng.uniform(0, 2 * np.pi, _WAVES)
        share = rng.dirichlet(np.full(_WAVES, 3.0)) * _WAVES
        waves = np.sin(2 * np.pi * frequency * time[:, None] + phase) * share
        angles[:, j] = _AMPLITUDE / np.sqrt(_WAVES / 2) * waves.sum(axis=1)
    return motion_through(time, envelope[:, None] * angles, duration)
