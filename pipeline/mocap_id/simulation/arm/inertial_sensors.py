"""Inertial sensors on the skin of a simulated arm: gyroscope and accelerometer, each sensor on its own clock."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.simulation.arm.options import ArmOptions
from mocap_id.simulation.arm.trial import SpatialTrial
from mocap_id.simulation.arm.turns import Y
from mocap_id.simulation.inertial_sensors import SEED, SimulatedSensor, measure_motion

_WORSE = {"clean": 0.0, "default": 1.0, "hard": 2.0}
_DISTANCE = {"thorax": (0.04, -0.06, 0.0), "upper_arm": (0.0, -0.19, 0.05), "forearm": (-0.01, -0.21, 0.03)}
_ON_HAND = (-0.03, -0.06, 0.0)
_LOSS = {"upper_arm": 0.25, "forearm": 0.12}  # share of the twist that the skin misses


def simulate_sensors(trial: SpatialTrial, options: ArmOptions) -> dict[str, SimulatedSensor]:
    """Return a sensor on every segment of a simulated arm.

    Parameters
    ----------
    trial : SpatialTrial
        Made with these options.
    options : ArmOptions
        The preset scales the errors; its factor of soft tissue also scales how far the skin turns the sensors.

    Examples
    --------
    >>> from mocap_id.simulation.arm.arm import generate_arm
    >>> options = ArmOptions(seed=1, preset="clean", cycles=1)
    >>> sorted(simulate_sensors(generate_arm(options), options))
    ['forearm', 'hand', 'thorax', 'upper_arm']
    """
    twists = {"upper_arm": _upper_arm_twist(trial), "forearm": trial.arrays["q_pron"][:, 0]}
    worse = _WORSE[options.preset]
    loss = min(options.soft_tissue, 1.0) * {"clean": 0.0, "default": 1.0, "hard": 1.5}[options.preset]
    found = {}
    for s, name in enumerate(trial.segments):
        rng = np.random.default_rng([options.seed, SEED, s])
        lost = loss * _LOSS.get(name, 0.0)
        twist = twists.get(name, np.zeros(len(trial.time)))
        place = np.array(_DISTANCE.get(name, _ON_HAND)) * np.where(np.arange(3) == 1, rng.uniform(0.9, 1.1), 1.0)
        turn = so3.exp(-lost * (twist - twist[0])[:, None] * Y)
        rotations = trial.rotations[:, s] @ turn
        positions = trial.origins[:, s] + np.einsum("fij,j->fi", rotations, place)
        truth = {"position_in_segment_m": place.tolist(), "twist_loss": lost}
        found[name] = measure_motion(rng, trial.time, rotations, positions, worse=worse, truth=truth)
    if options.side == "left":
        return {name: _mirrored(sensor) for name, sensor in found.items()}
    return found


def _upper_arm_twist(trial: SpatialTrial) -> FloatArray:
    """Return the axial rotation (F,) of the upper arm that its skin follows in part."""
    return np.unwrap(np.asarray(trial.angles["shoulder_axial"] + trial.angles["shoulder_plane"]))


def _mirrored(sensor: SimulatedSensor) -> SimulatedSensor:
    """Return what the mirrored sensor on a left arm measures."""
    return SimulatedSensor(sensor.time, sensor.gyro * [-1.0, -1.0, 1.0], sensor.acc * [1.0, 1.0, -1.0], sensor.truth)
