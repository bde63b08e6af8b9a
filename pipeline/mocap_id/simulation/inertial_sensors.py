"""Inertial sensors of simulated trials: gyroscope and accelerometer on the skin, each sensor on its own clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.recording.imu_log import ImuLog, imu_csv
from mocap_id.simulation.body import GRAVITY
from mocap_id.simulation.forces import TrueState
from mocap_id.simulation.scene import Scene
from mocap_id.simulation.skin import turning

RATE = 100.0
"""Samples per second of a sensor's own clock."""
SEED = 30
"""Added to the seed of the trial for the errors of the sensors."""
_STEPS = (0.001065, 0.00958)  # rad/s and m/s²; 16 bits of ±2000 °/s and ±16 g
_DENSITIES = (1.745e-4, 1.96e-3)  # rad/s/√Hz and m/s²/√Hz
_BIASES = (0.0105, 0.12)  # rad/s and m/s²; standard deviations
_DRIFTS = (5e-5, 1.3e-3)  # rad/s/√s and m/s²/√s
_SCALE = 0.004
_OFFSET = 0.05  # s
_PPM = 30.0
_TURN = 0.03  # rad, by which the skin turns at the ends of the motion, in any direction
_SWITCHED_ON = 0.3  # of a bias changes from one recording to the next
_FORWARDS, _ALONG, _ACROSS = 0.06, 0.6, 0.05  # m, share of the length, m: mean distance from the segment's origin


@dataclass(frozen=True)
class SimulatedSensor:
    """Log and truth of one sensor.

    Parameters
    ----------
    time : (K,) array
        Time stamps, s, on the sensor's clock.
    gyro, acc : (K, 3) arrays
        Angular velocity, rad/s, and specific force, m/s², in the sensor's axes.
    truth : mapping
        Clock, mounting, position and errors, for ``truth.json``.
    """

    time: FloatArray
    gyro: FloatArray
    acc: FloatArray
    truth: Mapping[str, Any]


def sensors_in_plane(
    seed: int, scene: Scene, state: TrueState, softness: float, person: int | None = None
) -> dict[str, SimulatedSensor]:
    """Return a sensor on every moving segment of a simulated person without separate bodies.

    Parameters
    ----------
    seed : int
    scene : Scene
    state : TrueState
        At the frames.
    softness : float
        Factor on the turn of the skin, which follows the joints above and below the segment.
    person : int, optional
        Seed of a person who wears the same sensors at the same places in all trials.
    """
    found = {}
    axes = scene.plane.axes.T
    for s, link in enumerate(scene.body.links[1:]):
        rng = np.random.default_rng([seed, SEED, s])
        worn = None if person is None else np.random.default_rng([person, SEED, s])
        place = np.array([-_FORWARDS, _ALONG * link.length, _ACROSS]) * (worn or rng).uniform(0.6, 1.4, 3)
        skin = turning(rng, s + 1, softness * _TURN, state.q, state.time, worn)
        own = so3.exp(state.seg_angle[:, s, None] * np.array([0.0, 0.0, 1.0]))
        at = np.column_stack([state.joint_xy[:, s], np.full(len(own), scene.offset)]) + own @ place
        truth = {"position_in_segment_m": place.tolist(), "skin_turn_rad": float(np.ptp(skin[:, 2]))}
        found[link.name] = measure_motion(
            rng, state.time, axes @ own @ so3.exp(skin), scene.plane.from_plane(at), worse=1.0, truth=truth, worn=worn
        )
    return found


def measure_motion(
    rng: np.random.Generator,
    time: FloatArray,
    rotations: FloatArray,
    positions: FloatArray,
    *,
    worse: float,
    truth: Mapping[str, Any],
    worn: np.random.Generator | None = None,
) -> SimulatedSensor:
    """Return what a sensor with its own clock, mounting and errors measures of a motion.

    Parameters
    ----------
    rng : Generator
    time : (F,) array
        s.
    rotations : (F, 3, 3) array
        From the skin under the sensor to the laboratory, z up.
    positions : (F, 3) array
        m.
    worse : float
        Factor on all errors.
    truth : mapping
        More entries for the truth.
    worn : Generator, optional
        Generator of what the sensor keeps in all trials: mounting, scale and most of its biases.
    """
    kept = worn or rng
    mount = so3.exp(kept.uniform(0, np.pi) * _direction(kept))
    offset, ppm = worse * _OFFSET * rng.standard_normal(), worse * _PPM * rng.standard_normal()
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
        scale = 1 + worse * _SCALE * kept.standard_normal(3)
        walk = np.cumsum(rng.standard_normal((len(at), 3)), axis=0) * worse * _DRIFTS[k] / np.sqrt(RATE)
        bias = worse * _BIASES[k] * kept.standard_normal(3) + walk
        if worn is not None:
            bias += worse * _SWITCHED_ON * _BIASES[k] * rng.standard_normal(3)
        density = worse * _DENSITIES[k] * rng.uniform(0.8, 1.5)
        noisy = scale * pure + bias + density * np.sqrt(RATE / 2) * rng.standard_normal(pure.shape)
        signals.append(np.round(noisy / _STEPS[k]) * _STEPS[k] if worse else noisy)
        errors |= {f"{name}_bias_start": bias[0].tolist(), f"{name}_bias_end": bias[-1].tolist()}
        errors |= {f"{name}_scale": scale.tolist(), f"{name}_nd": density}
    clock = {"offset_s": offset, "ppm": ppm, "mount_R_sensor_to_segment": mount.tolist(), "n": len(at)}
    return SimulatedSensor(stamps, signals[0], signals[1], clock | dict(truth) | errors)


def csv_bytes(sensor: SimulatedSensor) -> bytes:
    """Return the log as a CSV file."""
    return imu_csv(ImuLog(sensor.time, sensor.gyro, sensor.acc))


def _direction(rng: np.random.Generator) -> FloatArray:
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))
