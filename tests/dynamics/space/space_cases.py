"""Random chains in space, and small trials of a robot on a plate."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from mocap_id.dynamics.preparation import FitSettings
from mocap_id.dynamics.space.consistency import point_mass
from mocap_id.dynamics.space.identification import SpatialIdentification, identify_parameters_in_space
from mocap_id.dynamics.space.preparation import SpatialRecord, SpatialTrial, prepare_in_space
from mocap_id.geometry import se3, so3
from mocap_id.geometry.spatial_chain import JointKind, SpatialChain, SpatialJoint
from mocap_id_simulation import SpaceRobotOptions, SpaceRobotTrial, generate_space_robot
from mocap_id_simulation.instruments import SIZE
from mocap_id_simulation.space_robot import FRAME

SIX = FitSettings(components=tuple(range(6)))


def unit(rng: np.random.Generator) -> np.ndarray:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def random_chain(rng: np.random.Generator, kinds: Sequence[JointKind], parents: Sequence[int] = ()) -> SpatialChain:
    joints = tuple(
        SpatialJoint(
            kind,
            parents[k] if parents else k,
            rng.normal(size=3) * 0.4,
            first_axis=unit(rng),
            second_axis=unit(rng),
            offset=so3.exp(rng.normal(size=3)),
        )
        for k, kind in enumerate(kinds)
    )
    return SpatialChain(joints, np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0, dtype=np.bool_))


def random_base(rng: np.random.Generator) -> np.ndarray:
    return se3.exp_twist(rng.normal(size=6))


def random_bodies(rng: np.random.Generator, count: int) -> np.ndarray:
    """Parameters (count, 10) of bodies of twelve point masses."""
    masses, places = rng.uniform(0.05, 0.5, (count, 12)), rng.normal(0, 0.2, (count, 12, 3))
    return np.array(
        [sum(m * point_mass(x) for m, x in zip(own, at, strict=True)) for own, at in zip(masses, places, strict=True)]
    )


@cache
def robot(seed: int, preset: str = "default", joints: int = 2, payload: float = 0.0) -> SpaceRobotTrial:
    return generate_space_robot(
        SpaceRobotOptions(
            seed=seed, preset=preset, joints=joints, payload=payload, duration=20, rate=60, analog_rate=600
        )
    )


def plate_wrench(trial: SpaceRobotTrial) -> np.ndarray:
    """The plate's wrench (T, 6) at the frames as the file gives it, about the origin of the trial's frame."""
    signals = trial.signals
    x = (signals.corners[0] - signals.corners[1]) / SIZE[0]
    y = (signals.corners[0] - signals.corners[3]) / SIZE[1]
    axes = np.column_stack([x, y, np.cross(x, y)])
    sign = 1.0 if np.median(signals.channels[:, 2]) < 0 else -1.0  # z of the plate points down
    force = sign * signals.channels[:, :3]
    moment = sign * signals.channels[:, 3:] - np.cross(signals.origin, force)
    force, moment = force @ axes.T, moment @ axes.T
    moment = moment + np.cross(signals.corners.mean(axis=0), force)
    each = round(trial.options.analog_rate / trial.options.rate)
    return np.hstack([force @ FRAME.axes.T, moment @ FRAME.axes.T])[::each]


def record(trial: SpaceRobotTrial) -> SpatialRecord:
    """The true kinematics and the measured wrench."""
    motion = trial.motion
    return SpatialRecord(
        time=trial.time,
        chain=trial.robot.chain,
        base=trial.robot.base,
        rotation=motion.rotation[:, 1:],
        omega=motion.omega[:, 1:],
        alpha=motion.alpha[:, 1:],
        alpha_sd=np.full(motion.alpha[:, 1:, 0].shape, 0.1),
        observed=np.ones(len(trial.time), dtype=np.bool_),
        wrench=plate_wrench(trial),
        plate=FRAME.to_plane(trial.signals.corners.mean(axis=0)),
    )


@cache
def identified(
    seed: int, preset: str = "default", joints: int = 2, payload: float = 0.0
) -> tuple[SpatialTrial, SpatialIdentification]:
    trial = robot(seed, preset, joints, payload)
    prepared = prepare_in_space(record(trial), SIX)
    return prepared, identify_parameters_in_space(
        prepared, np.ones(len(trial.time), dtype=np.bool_), trial.options.errors
    )


def true_base(trial: SpaceRobotTrial, prepared: SpatialTrial) -> np.ndarray:
    return prepared.structure.mapping @ trial.robot.parameters.ravel()
