"""A small recording, a link that swings on a fixed base, for the tests to spoil."""

from __future__ import annotations

import numpy as np

from mocap_id.recording.lab_plates import PlateSignals

RATE = 100.0
LABELS = ("B1", "B2", "B3", "B4", "L1", "L2", "L3", "L4")


def pendulum(seconds: float = 6.0, swing_deg: float = 45.0) -> np.ndarray:
    """(F, 8, 3) m, Z up: four markers on the ground, four on a link that swings in the x-z plane about (0, 0, 0.3)."""
    rng = np.random.default_rng(3)
    time = np.arange(int(seconds * RATE)) / RATE
    angle = np.radians(swing_deg) * np.sin(2 * np.pi * 0.5 * time)
    base = np.array([[0.2, 0.1, 0.0], [-0.2, 0.1, 0.02], [0.2, -0.1, 0.05], [-0.2, -0.1, 0.0]])
    local = np.array([[0.03, 0.1], [-0.03, 0.2], [0.04, 0.35], [-0.02, 0.45]])
    x = local[:, 0] * np.cos(angle)[:, None] + local[:, 1] * np.sin(angle)[:, None]
    z = 0.3 - local[:, 0] * np.sin(angle)[:, None] + local[:, 1] * np.cos(angle)[:, None]
    y = np.broadcast_to([0.03, -0.02, 0.01, -0.03], x.shape)
    points = np.concatenate([np.broadcast_to(base, (len(time), 4, 3)), np.stack([x, y, z], axis=-1)], axis=1)
    return points + rng.normal(scale=3e-4, size=points.shape)


def plate_under(frames: int, newtons: float = 200.0) -> PlateSignals:
    """A plate that carries a constant weight at its centre."""
    corners = np.array([[0.3, -0.3, 0], [-0.3, -0.3, 0], [-0.3, 0.3, 0], [0.3, 0.3, 0]])  # the plate's z points down
    channels = np.tile([0.0, 0.0, -newtons, 0.0, 0.0, 0.0], (frames * 10, 1))
    return PlateSignals(2, channels, np.array([0.0, 0.0, -0.02]), corners, 10 * RATE)
