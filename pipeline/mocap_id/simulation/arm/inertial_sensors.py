"""Inertial sensors on the skin of a simulated arm: gyroscope and accelerometer, each sensor on its own clock."""

from __future__ import annotations

import numpy as np

from mocap_id.geometry import so3
from mocap_id.simulation.arm.options import PRESETS, ArmOptions
from mocap_id.simulation.arm.rotations import Y
from mocap_id.simulation.arm.trial import SpatialTrial
from mocap_id.simulation.inertial_sensors import SEED, SimulatedSensor, measure_motion

_ERROR_FACTOR = {"clean": 0.0, "default": 1.0, "hard": 2.0}
_POSITION = {"thorax": (0.04, -0.06, 0.0), "upper_arm": (0.0, -0.19, 0.05), "forearm": (-0.01, -0.21, 0.03)}
_ON_HAND = (-0.03, -0.06, 0.0)
_LOSS = {"upper_arm": 0.25, "forearm": 0.12}  # share of the axial rotation that the skin does not follow


def simulate_sensors(trial: SpatialTrial, options: ArmOptions) -> dict[str, SimulatedSensor]:
    """Return a sensor on every segment of a simulated arm that was generated with these options.

    The preset scales the errors of the sensors. The preset and the factor of soft tissue scale the rotation of the skin
    under the sensors.

    Examples
    --------
    >>> from mocap_id.simulation.arm.arm import generate_arm
    >>> options = ArmOptions(seed=1, preset="clean", cycles=1)
    >>> sorted(simulate_sensors(generate_arm(options), options))
    ['forearm', 'hand', 'thorax', 'upper_arm']
    """
    upper_arm = np.unwrap(np.asarray(trial.angles["shoulder_axial"] + trial.angles["shoulder_plane"]))
    axial = {"upper_arm": upper_arm, "forearm": trial.arrays["q_pron"][:, 0]}
    factor = _ERROR_FACTOR[options.preset]
    loss = min(options.soft_tissue, 1.0) * PRESETS[options.preset].twist_loss
    sensors = {}
    for s, name in enumerate(trial.segments):
        rng = np.random.default_rng([options.seed, SEED, s])
        share = loss * _LOSS.get(name, 0.0)
        angle = axial.get(name, np.zeros(len(trial.time)))
        position = np.array(_POSITION.get(name, _ON_HAND)) * np.where(np.arange(3) == 1, rng.uniform(0.9, 1.1), 1.0)
        rotations = trial.rotations[:, s] @ so3.exp(-share * (angle - angle[0])[:, None] * Y)
        points = trial.origins[:, s] + np.einsum("fij,j->fi", rotations, position)
        truth = {"position_in_segment_m": position.tolist(), "twist_loss": share}
        sensors[name] = measure_motion(rng, trial.time, rotations, points, error_factor=factor, truth=truth)
    if options.side == "left":
        return {name: _mirror(sensor) for name, sensor in sensors.items()}
    return sensors


def _mirror(sensor: SimulatedSensor) -> SimulatedSensor:
    """Return the measurement of the mirrored sensor on a left arm."""
    return SimulatedSensor(sensor.time, sensor.gyro * [-1.0, -1.0, 1.0], sensor.acc * [1.0, 1.0, -1.0], sensor.truth)
