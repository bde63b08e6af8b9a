"""A simulated wrench sensor in a robot's joint, which carries the moving part."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.simulation.scene import Scene

_RATE = 500.0  # Hz
_FORCE_NOISE, _MOMENT_NOISE = 0.1, 0.002  # N, N·m: a small six-axis sensor with strain gauges
_FORCE_ZERO, _MOMENT_ZERO = 0.05, 0.001
_GAIN = 0.003
_HEADER = "time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm"


def joint_place(scene: Scene) -> FloatArray:
    """Return the joint's place (3,) in the laboratory, m."""
    return scene.plane.from_plane(np.array([*scene.body.links[1].centre, scene.offset]))


def joint_sensor_csv(rng: np.random.Generator, scene: Scene) -> str:
    """Return CSV text of the wrench of the base on the moving part about the joint, in the laboratory's axes."""
    time = np.arange(round(scene.motion.duration * _RATE)) / _RATE
    state, link = scene.at(time), scene.body.links[1]
    x, y = link.com
    rows = planar_regressor(np.array([link.centre]), state.q, state.qd, state.qdd)[..., 4:]
    wrench = rows @ np.array([link.mass, link.mass * x, link.mass * y, link.about_origin])
    moment = wrench[:, 2] - link.centre[0] * wrench[:, 1] + link.centre[1] * wrench[:, 0]
    axes = scene.plane.axes
    exact = np.hstack([wrench[:, :2] @ axes[:2], moment[:, None] * axes[2]])
    noise = np.repeat([_FORCE_NOISE, _MOMENT_NOISE], 3)
    zero = rng.normal(0.0, 1.0, 6) * np.repeat([_FORCE_ZERO, _MOMENT_ZERO], 3)
    read = exact * (1.0 + rng.normal(0.0, _GAIN)) + zero + rng.normal(0.0, 1.0, exact.shape) * noise
    lines = [f"{t:.4f}," + ",".join(f"{value:.5f}" for value in row) for t, row in zip(time, read, strict=True)]
    return "\n".join([_HEADER, *lines]) + "\n"
