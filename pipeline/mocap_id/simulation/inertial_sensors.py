"""Inertial sensors of simulated trials: gyroscope and accelerometer on the skin, each sensor on its own clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.recording.imu_log import ImuLog, format_imu_csv
from mocap_id.simulation.body import GRAVITY
from mocap_id.simulation.forces import TrueState
from mocap_id.simulation.scene import Scene
from mocap_id.simulation.skin import draw_skin_rotation

RATE = 100.0
"""Samples per second of a sensor's own clock."""
SEED = 30
"""Number that, together with the seed of the trial, seeds the errors of the sensors."""
_STEPS = (0.001065, 0.00958)  # rad/s and m/s²; 16 bits of ±2000 °/s and ±16 g
_DENSITIES = (1.745e-4, 1.96e-3)  # rad/s/√Hz and m/s²/√Hz
_BIASES = (0.0105, 0.12)  # rad/s and m/s²; standard deviations
_DRIFTS = (5e-5, 1.3e-3)  # rad/s/√s and m/s²/√s
_SCALE = 0.004
_OFFSET = 0.05  # s
_PPM = 30.0
_SKIN_ROTATION = 0.03  # rad, of the skin at the ends of the motion, in any direction
_SWITCHED_ON = 0.3  # fraction of a bias that changes from one recording to the next
_FORWARDS, _ALONG, _ACROSS = 0.06, 0.6, 0.05  # m, fraction of the length, m: mean position from the segment's origin


@dataclass(frozen=True)
class SimulatedSensor:
    """Log and truth of one sensor, with K samples."""

    time: FloatArray  # (K,) time stamps on the sensor's clock, s
    gyro: FloatArray  # (K, 3) angular velocity in the sensor's axes, rad/s
    acc: FloatArray  # (K, 3) specific force in the sensor's axes, m/s²
    truth: Mapping[str, Any]  # clock, mounting, position and errors, for truth.json


def simulate_plane_sensors(
    seed: int, scene: Scene, state: TrueState, softness: float, person: int | None = None
) -> dict[str, SimulatedSensor]:
    """Return one sensor for each moving segment, by segment name; the person must not have separate bodies.

    ``state`` is the true state at the frames. ``softness`` is a factor on the rotation of the skin, which follows the
    joints at both ends of the segment. With the seed ``person``, position and mounting are the same in all trials.
    """
    sensors = {}
    axes = scene.plane.axes.T
    for s, link in enumerate(scene.body.links[1:]):
        rng = np.random.default_rng([seed, SEED, s])
        kept = None if person is None else np.random.default_rng([person, SEED, s])
        position = np.array([-_FORWARDS, _ALONG * link.length, _ACROSS]) * (kept or rng).uniform(0.6, 1.4, 3)
        skin = draw_skin_rotation(rng, s + 1, softness * _SKIN_ROTATION, state.q, state.time, kept)
        segment = so3.exp(state.seg_angle[:, s, None] * np.array([0.0, 0.0, 1.0]))
        points = np.column_stack([state.joint_xy[:, s], np.full(len(segment), scene.offset)]) + segment @ position
        truth = {"position_in_segment_m": position.tolist(), "skin_turn_rad": float(np.ptp(skin[:, 2]))}
        rotations, points = axes @ segment @ so3.exp(skin), scene.plane.from_plane(points)
        sensors[link.name] = measure_motion(
            rng, state.time, rotations, points, error_factor=1.0, truth=truth, kept=kept
        )
    return sensors


def measure_motion(
    rng: np.random.Generator,
    time: FloatArray,
    rotations: FloatArray,
    positions: FloatArray,
    *,
    error_factor: float,
    truth: Mapping[str, Any],
    kept: np.random.Generator | None = None,
) -> SimulatedSensor:
    """Return the measurement of a motion by a sensor with its own clock, mounting and errors.

    Parameters
    ----------
    rng : Generator
    time : (F,) array
        Times of the frames, s.
    rotations : (F, 3, 3) array
        Rotations from the skin under the sensor to the laboratory, z up.
    positions : (F, 3) array
        Positions of the sensor in the laboratory, m.
    error_factor : float
        Factor on all errors.
    truth : mapping
        Further entries of the truth.
    kept : Generator, optional
        Generator of the properties that are the same in all trials: mounting, scale and the larger part of the biases.
    """
    own = kept or rng
    mount = so3.exp(own.uniform(0, np.pi) * _draw_direction(own))
    offset, ppm = error_factor * _OFFSET * rng.standard_normal(), error_factor * _PPM * rng.standard_normal()
    first = np.ceil((time[0] - offset) * RATE)
    stamps = np.arange(first, (time[-1] - offset) / (1 + 1e-6 * ppm) * RATE) / RATE
    at = offset + stamps * (1 + 1e-6 * ppm)
    attitude = make_interp_spline(time, rotations.reshape(-1, 9), k=5)
    turn = attitude(at).reshape(-1, 3, 3)
    spin = np.swapaxes(turn, 1, 2) @ attitude(at, 1).reshape(-1, 3, 3)
    omega = np.stack([spin[:, 2, 1] - spin[:, 1, 2], spin[:, 0, 2] - spin[:, 2, 0], spin[:, 1, 0] - spin[:, 0, 1]], 1)
    force = make_interp_spline(time, positions, k=5)(at, 2) + np.array([0.0, 0.0, GRAVITY])
    signals: list[FloatArray] = []
    errors: dict[str, Any] = {}
    for k, (name, pure) in enumerate(
        (("gyro", omega / 2 @ mount), ("acc", np.einsum("fji,fj->fi", turn, force) @ mount))
    ):
        scale = 1 + error_factor * _SCALE * own.standard_normal(3)
        walk = np.cumsum(rng.standard_normal((len(at), 3)), axis=0) * error_factor * _DRIFTS[k] / np.sqrt(RATE)
        bias = error_factor * _BIASES[k] * own.standard_normal(3) + walk
        if kept is not None:
            bias += error_factor * _SWITCHED_ON * _BIASES[k] * rng.standard_normal(3)
        density = error_factor * _DENSITIES[k] * rng.uniform(0.8, 1.5)
        noisy = scale * pure + bias + density * np.sqrt(RATE / 2) * rng.standard_normal(pure.shape)
        signals.append(np.round(noisy / _STEPS[k]) * _STEPS[k] if error_factor else noisy)
        errors |= {f"{name}_bias_start": bias[0].tolist(), f"{name}_bias_end": bias[-1].tolist()}
        errors |= {f"{name}_scale": scale.tolist(), f"{name}_nd": density}
    clock = {"offset_s": offset, "ppm": ppm, "mount_R_sensor_to_segment": mount.tolist(), "n": len(at)}
    return SimulatedSensor(stamps, signals[0], signals[1], clock | dict(truth) | errors)


def csv_bytes(sensor: SimulatedSensor) -> bytes:
    """Return the log as a CSV file."""
    return format_imu_csv(ImuLog(sensor.time, sensor.gyro, sensor.acc))


def _draw_direction(rng: np.random.Generator) -> FloatArray:
    """Return a random unit vector (3,)."""
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))
