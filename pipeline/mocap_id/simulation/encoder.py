"""The robot's own record of its joint, on a clock and at a rate of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.simulation.scene import Scene

RATE = 125.0  # Hz


@dataclass(frozen=True)
class Encoder:
    """What the record is off by.

    Parameters
    ----------
    clock_offset : float
        The row at ``time_s`` is the state at the markers' time ``time_s + clock_offset``, s.
    position_sd, velocity_sd, torque_sd : float
        rad, rad/s, N·m.
    """

    clock_offset: float
    position_sd: float = 1e-4
    velocity_sd: float = 1e-3
    torque_sd: float = 0.3

    def as_dict(self) -> dict[str, Any]:
        """JSON values for the truth."""
        note = "the row at time_s is the state at the markers' time time_s + clock_offset_s; the torque has no friction"
        return {
            "rate_hz": RATE,
            "clock_offset_s": self.clock_offset,
            "position_sd": self.position_sd,
            "velocity_sd": self.velocity_sd,
            "torque_sd": self.torque_sd,
            "note": note,
        }


def draw_encoder(rng: np.random.Generator) -> Encoder:
    """An encoder whose clock is off by up to 2 ms."""
    return Encoder(float(rng.uniform(-0.002, 0.002)))


def table(rng: np.random.Generator, scene: Scene, encoder: Encoder) -> str:
    """CSV text: time_s, position_rad, velocity_rad_s, torque_Nm of the first joint; the torque without friction."""
    time = np.arange(round(scene.motion.duration * RATE)) / RATE
    state = scene.at(time + encoder.clock_offset)
    exact = np.column_stack([state.q[:, 0], state.qd[:, 0], state.tau[:, 0]])
    sizes = np.array([encoder.position_sd, encoder.velocity_sd, encoder.torque_sd])
    rows = np.column_stack([time, exact + rng.normal(0, 1, exact.shape) * sizes])
    lines = [",".join(f"{value:.8f}" for value in row) for row in rows]
    return "\n".join(["time_s,position_rad,velocity_rad_s,torque_Nm", *lines]) + "\n"
