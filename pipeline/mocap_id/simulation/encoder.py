"""The robot's own record of its joint, with its own clock and sampling rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.simulation.scene import Scene

RATE = 125.0  # Hz


@dataclass(frozen=True)
class Encoder:
    """Errors of the encoder's record.

    Parameters
    ----------
    clock_offset : float
        The row at ``time_s`` holds the state at time ``time_s + clock_offset`` on the markers' clock, s.
    position_sd, velocity_sd, torque_sd : float
        Standard deviations of the noise, rad, rad/s, N·m.
    """

    clock_offset: float
    position_sd: float = 1e-4
    velocity_sd: float = 1e-3
    torque_sd: float = 0.3

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values for truth.json."""
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
    """Draw an encoder whose clock is off by up to 2 ms."""
    return Encoder(float(rng.uniform(-0.002, 0.002)))


def encoder_csv(rng: np.random.Generator, scene: Scene, encoder: Encoder) -> str:
    """Return CSV text: time_s, position_rad, velocity_rad_s, torque_Nm of the first joint, without friction."""
    time = np.arange(round(scene.motion.duration * RATE)) / RATE
    state = scene.at(time + encoder.clock_offset)
    exact = np.column_stack([state.q[:, 0], state.qd[:, 0], state.tau[:, 0]])
    sizes = np.array([encoder.position_sd, encoder.velocity_sd, encoder.torque_sd])
    rows = np.column_stack([time, exact + rng.normal(0, 1, exact.shape) * sizes])
    lines = [",".join(f"{value:.8f}" for value in row) for row in rows]
    return "\n".join(["time_s,position_rad,velocity_rad_s,torque_Nm", *lines]) + "\n"
