"""Bodies on poses of their own: a chain whose hip may give way, and an arm that swings by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from dynamics_cases import BODY, CENTRES, waves

from mocap_id.dynamics.measured_motion import BodyPoses
from mocap_id.dynamics.preparation import TrialData
from mocap_id.dynamics.regressor import PlanarMotion, move_chain, wrench_regressor
from mocap_id.geometry import planar

SHOULDER = np.array([0.03, 0.42])
HIP = 2
ARM = np.array([7.0, 0.1, -0.3, 0.3])
BODIES = np.vstack([BODY[:3], BODY[3] - [7.0, 0.6, 3.0, 1.6], ARM])
"""m, mx, my, Izz of foot, shank, thigh, torso, arm, each about its frame's origin."""
CENTROID = np.array([[-0.1, 0.05], [0.02, 0.2], [-0.03, 0.22], [0.04, 0.3], [0.02, -0.15]])
"""Of each body's markers in its frame, m."""
INFORMATION = np.array([[4e6, 4e5], [3e6, 6e5], [3e6, 6e5], [5e6, 2e6], [4e6, 8e5]])
OF_SEGMENT = np.array([0, 1, 2, 3])


def slow(time: np.ndarray, joints: int = 4, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles from 0.1 to 0.6 Hz, which the low-pass does not change, with exact derivatives."""
    q, dq, ddq = waves(0.5 * time, joints, seed)
    return q, 0.5 * dq, 0.25 * ddq


def hip_gap(time: np.ndarray, size: float = 0.012) -> tuple[np.ndarray, np.ndarray]:
    """Gap between thigh and torso (T, 2) in the plane frame, m, and its second derivative."""
    rates, phase = 2 * np.pi * np.array([0.45, 0.3]), np.array([0.4, 1.9])
    gap = size * np.sin(rates * time[:, None] + phase)
    return gap, -(rates**2) * gap


def moving(time: np.ndarray, *, size: float = 0.012, swing: float = 1.0, seed: int = 0) -> PlanarMotion:
    """Exact motion of the five bodies; the arm turns about the shoulder."""
    states = slow(time, seed=seed)
    for values in states:
        values[:, 3] *= swing
    whole = move_chain(np.vstack([CENTRES, SHOULDER]), *states)
    gap, acceleration = hip_gap(time, size)
    origin, rise = whole.origin.copy(), whole.acceleration.copy()
    origin[:, HIP + 1 :] += gap[:, None]
    rise[:, HIP + 1 :] += acceleration[:, None]
    joint = whole.joint[:, :3].copy()
    joint[:, HIP] += gap / 2
    return replace(whole, origin=origin, acceleration=rise, joint=joint, beyond=whole.beyond[:3])


def poses_of(time: np.ndarray, motion: PlanarMotion, noise: float = 0.0, seed: int = 0) -> BodyPoses:
    """Measured poses of clusters with these centroids, with noise according to their information."""
    rng = np.random.default_rng(seed)
    position = motion.origin + planar.rotate(motion.angle, CENTROID)
    return BodyPoses(
        time=time,
        position=position + noise * rng.normal(size=position.shape) / np.sqrt(INFORMATION[:, :1]),
        angle=motion.angle + noise * rng.normal(size=motion.angle.shape) / np.sqrt(INFORMATION[:, 1]),
        centroid=CENTROID,
        information=INFORMATION,
        body=OF_SEGMENT,
        centres=CENTRES,
        camera=max(noise, 1e-3) ** 2 / INFORMATION,
    )


def recorded_of(
    time: np.ndarray,
    motion: PlanarMotion,
    *,
    noise: tuple[float, float, float] = (0.0, 0.0, 0.0),
    bodies: np.ndarray = BODIES,
    seed: int = 0,
) -> TrialData:
    """Trial data of the chain with the wrench of these bodies and their measured motion."""
    angles = slow(time, seed=seed)
    q, dq, ddq = (values[:, :3] for values in angles)
    wrench = wrench_regressor(motion) @ bodies.ravel()
    wrench = wrench + np.random.default_rng(seed + 1).normal(size=wrench.shape) * noise
    seen = np.ones(len(time), dtype=bool)
    return TrialData(time, q, dq, ddq, np.full_like(q, 0.05), seen, wrench, CENTRES, measured=motion)
