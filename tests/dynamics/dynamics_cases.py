"""Chains, bodies and movements to try the dynamics on."""

from __future__ import annotations

import numpy as np

from mocap_id.dynamics.preparation import TrialData
from mocap_id.dynamics.regressor import planar_regressor

CENTRES = np.array([[-0.02, 0.08], [0.0, 0.43], [0.0, 0.41]])
"""Ankle, knee, hip of a person who faces -x."""

BODY = np.array(
    [
        [2.1, -0.15, 0.08, 0.03],
        [6.5, 0.05, 1.55, 0.50],
        [14.2, 0.10, 3.40, 1.10],
        [55.0, -0.60, 16.5, 8.60],
    ]
)
"""m, mx, my, Izz of foot, shank, thigh, torso."""


def random_chain(rng: np.random.Generator, joints: int) -> np.ndarray:
    """Joint centres, of metre size."""
    return rng.uniform(-0.6, 0.6, size=(joints, 2))


def waves(time: np.ndarray, joints: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smooth joint angles of about a radian with their exact derivatives, from 0.2 to 1.2 Hz."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * rng.uniform(0.2, 1.2, size=(3, joints))
    phase, size = rng.uniform(0, 2 * np.pi, size=(3, joints)), rng.uniform(0.1, 0.4, size=(3, joints))
    argument = omega * time[:, None, None] + phase
    q = np.sum(size * np.sin(argument), axis=1)
    dq = np.sum(size * omega * np.cos(argument), axis=1)
    ddq = -np.sum(size * omega**2 * np.sin(argument), axis=1)
    return q, dq, ddq


def independent(recorded: TrialData) -> np.ndarray:
    """Correlation (T, n, n) of independent acceleration errors."""
    return np.broadcast_to(np.eye(recorded.q.shape[1]), (*recorded.q.shape, recorded.q.shape[1]))


def moving_body(
    seconds: float = 12.0, rate: float = 100.0, seed: int = 0, noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> TrialData:
    """A recording of a body that moves all joints, with white noise of the plate (sd of Fx, Fy, tauz)."""
    time = np.arange(0, seconds, 1 / rate)
    q, dq, ddq = waves(time, len(CENTRES), seed)
    wrench = planar_regressor(CENTRES, q, dq, ddq) @ BODY.ravel()
    wrench = wrench + np.random.default_rng(seed + 1).normal(size=wrench.shape) * noise
    return TrialData(time, q, dq, ddq, np.zeros_like(q), np.ones(len(time), dtype=bool), wrench, CENTRES)
