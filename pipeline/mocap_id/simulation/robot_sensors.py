"""Sensors of a simulated robot: the encoder of its joint, and a wrench sensor in the joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.simulation.scene import Scene

ENCODER_RATE = 125.0  # Hz
_SENSOR_RATE = 500.0  # Hz
_FORCE_NOISE, _MOMENT_NOISE = 0.1, 0.002  # N, N·m: a small six-axis sensor with strain gauges
_FORCE_ZERO, _MOMENT_ZERO = 0.05, 0.001  # N, N·m: standard deviations of the zero
_GAIN = 0.003  # standard deviation of the relative error of the gain


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
    """Return CSV text of the wrench of the base on the moving part about the joint, in laboratory axes."""
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
