"""Further sensors of simulated trials: encoder and wrench sensor of a robot, and a balance board under a person."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.simulation.body import GRAVITY
from mocap_id.simulation.scene import Scene

ENCODER_RATE = 125.0  # Hz
_SENSOR_RATE = 500.0  # Hz
_FORCE_NOISE, _MOMENT_NOISE = 0.1, 0.002  # N, N·m: a small six-axis sensor with strain gauges
_FORCE_ZERO, _MOMENT_ZERO = 0.05, 0.001  # N, N·m: standard deviations of the zero
_GAIN = 0.003  # standard deviation of the relative error of the gain
_WIDTH, _DEPTH, _HEIGHT = 0.433, 0.238, 0.053  # m: distances between the cells, and their depth below the surface
_SIGNS = np.array([[-1, 1], [1, 1], [-1, -1], [1, -1]])  # right and top of the cells tl, tr, bl, br
_PERIOD, _JITTER = 0.011, 0.001  # s between samples
_STAMP, _DELAY = 0.01, 0.004  # s: resolution of the time stamps, and mean delay of the transmission
_STALLS, _STALL = 0.004, 0.06  # fraction of the samples followed by a pause, and the longest pause, s
_STEP_KG, _NOISE_KG, _TARE_KG, _CELL_GAIN = 0.1, 0.05, 0.15, 0.005
_CENTRE_M, _YAW = 0.02, 0.02  # m and rad: largest errors of position and direction
DIRECTIONS = {"forwards": 0.0, "left": np.pi / 2, "backwards": np.pi, "right": -np.pi / 2}


@dataclass(frozen=True)
class Encoder:
    """Errors of the robot's own record of its joint.

    The row at ``time_s`` contains the state at ``time_s + clock_offset`` on the markers' clock, s.
    """

    clock_offset: float
    position_sd: float = 1e-4  # standard deviations of the noise: rad
    velocity_sd: float = 1e-3  # rad/s
    torque_sd: float = 0.3  # N·m

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values for truth.json."""
        note = "the row at time_s is the state at the markers' time time_s + clock_offset_s; the torque has no friction"
        return {
            "rate_hz": ENCODER_RATE,
            "clock_offset_s": self.clock_offset,
            "position_sd": self.position_sd,
            "velocity_sd": self.velocity_sd,
            "torque_sd": self.torque_sd,
            "note": note,
        }


def draw_encoder(rng: np.random.Generator) -> Encoder:
    """Draw an encoder with a clock offset of up to 2 ms."""
    return Encoder(float(rng.uniform(-0.002, 0.002)))


def encoder_csv(rng: np.random.Generator, scene: Scene, encoder: Encoder) -> str:
    """Return CSV text with position, velocity and torque of the first joint, without friction."""
    time = np.arange(round(scene.motion.duration * ENCODER_RATE)) / ENCODER_RATE
    state = scene.at(time + encoder.clock_offset)
    exact = np.column_stack([state.q[:, 0], state.qd[:, 0], state.tau[:, 0]])
    sizes = np.array([encoder.position_sd, encoder.velocity_sd, encoder.torque_sd])
    rows = np.column_stack([time, exact + rng.normal(0, 1, exact.shape) * sizes])
    lines = [",".join(f"{value:.8f}" for value in row) for row in rows]
    return "\n".join(["time_s,position_rad,velocity_rad_s,torque_Nm", *lines]) + "\n"


def joint_position(scene: Scene) -> FloatArray:
    """Return the joint's position (3,) in the laboratory, m."""
    return scene.plane.from_plane(np.array([*scene.body.links[1].centre, scene.offset]))


def joint_sensor_csv(rng: np.random.Generator, scene: Scene) -> str:
    """Return CSV text with the measured wrench of the base on the moving part, about the joint in laboratory axes."""
    time = np.arange(round(scene.motion.duration * _SENSOR_RATE)) / _SENSOR_RATE
    state, link = scene.at(time), scene.body.links[1]
    x, y = link.com
    rows = planar_regressor(np.array([link.centre]), state.q, state.qd, state.qdd)[..., 4:]
    wrench = rows @ np.array([link.mass, link.mass * x, link.mass * y, link.about_origin])
    moment = wrench[:, 2] - link.centre[0] * wrench[:, 1] + link.centre[1] * wrench[:, 0]
    axes = scene.plane.axes
    exact = np.hstack([wrench[:, :2] @ axes[:2], moment[:, None] * axes[2]])
    noise = np.repeat([_FORCE_NOISE, _MOMENT_NOISE], 3)
    zero = rng.normal(0.0, 1.0, 6) * np.repeat([_FORCE_ZERO, _MOMENT_ZERO], 3)
    measured = exact * (1.0 + rng.normal(0.0, _GAIN)) + zero + rng.normal(0.0, 1.0, exact.shape) * noise
    lines = [f"{t:.4f}," + ",".join(f"{value:.5f}" for value in row) for t, row in zip(time, measured, strict=True)]
    return "\n".join(["time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm", *lines]) + "\n"


@dataclass(frozen=True)
class SimulatedBoard:
    """Position and errors of a board.

    On average, the row with time stamp ``time_s`` was measured at ``time_s + clock_offset`` on the markers' clock, s.
    """

    clock_offset: float
    top: str  # direction of the board's top, seen by the person
    centre: tuple[float, float]  # position of its centre relative to the plate's, forwards and to the left, m
    yaw: float  # error of its direction, rad
    tare: tuple[float, ...]  # reading of the cells tl, tr, bl, br without load, kg
    gain: tuple[float, ...]  # factor on the load of these cells

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values for truth.json."""
        return asdict(self) | {"cells_below_surface_m": _HEIGHT}


def draw_board(rng: np.random.Generator, clock_offset: float) -> SimulatedBoard:
    """Draw a board with small errors of its position and direction, and of the zero and gain of its cells."""
    return SimulatedBoard(
        clock_offset,
        str(rng.choice(list(DIRECTIONS))),
        (float(rng.uniform(-_CENTRE_M, _CENTRE_M)), float(rng.uniform(-_CENTRE_M, _CENTRE_M))),
        float(rng.uniform(-_YAW, _YAW)),
        tuple(rng.normal(0.0, _TARE_KG, 4).tolist()),
        tuple((1.0 + rng.normal(0.0, _CELL_GAIN, 4)).tolist()),
    )


def board_csv(rng: np.random.Generator, scene: Scene, board: SimulatedBoard) -> str:
    """Return CSV text with the time stamps, s, and the readings of the cells, kg."""
    steps = np.maximum(rng.normal(_PERIOD, _JITTER, int(scene.motion.duration / _PERIOD) + 1), _PERIOD / 2)
    steps += np.where(rng.random(len(steps)) < _STALLS, rng.uniform(0.0, _STALL, len(steps)), 0.0)
    time = np.cumsum(steps)
    time = time[time < scene.motion.duration]
    received = np.maximum.accumulate(time + rng.exponential(_DELAY, len(time)))
    stamps = np.round(received / _STAMP) * _STAMP
    stamps -= np.mean(stamps - time) + board.clock_offset
    cells = _cell_loads(*scene.load_on_plate(scene.at(time)), scene, board)
    readings = cells * board.gain + board.tare + rng.normal(0.0, _NOISE_KG, cells.shape)
    rows = np.column_stack([stamps, np.round(readings / _STEP_KG) * _STEP_KG])
    lines = [",".join((f"{row[0]:.4f}", *(f"{value:.1f}" for value in row[1:]))) for row in rows]
    return "\n".join(["time_s,tl_kg,tr_kg,bl_kg,br_kg", *lines]) + "\n"


def _cell_loads(force: FloatArray, moment: FloatArray, scene: Scene, board: SimulatedBoard) -> FloatArray:
    """Return the loads (T, 4) of the cells, kg, from force and moment about the plate's centre in laboratory axes."""
    forwards = -scene.plane.axes[0, :2]  # people face the plane's -x
    left = np.array([-forwards[1], forwards[0]])
    angle = DIRECTIONS[board.top] + board.yaw
    top = np.cos(angle) * forwards + np.sin(angle) * left
    right = np.array([top[1], -top[0]])
    at = np.array([*(board.centre[0] * forwards + board.centre[1] * left), -_HEIGHT])
    about = moment - np.cross(at, force)
    pressure = np.column_stack([-about[:, 1], about[:, 0]]) / force[:, 2:]
    share = np.stack([pressure @ right / (_WIDTH / 2), pressure @ top / (_DEPTH / 2)], axis=1)
    return np.asarray(force[:, 2:] / 4 * np.prod(1.0 + _SIGNS * share[:, None], axis=2) / GRAVITY)
