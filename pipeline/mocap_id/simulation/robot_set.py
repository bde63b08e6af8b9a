"""The thesis's robot study as simulated trials: three joints, two speeds, two orientations, several repeats.

The thesis did not move the shoulder fast, because the robot might have tipped over; the simulation does. The seed of
each trial follows from the set's seed, so that additional repeats leave the other trials unchanged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.simulation.options import Options, check_options, option
from mocap_id.simulation.trial_files import create_folder, simulate
from mocap_id.simulation.ur5 import FREQUENCY, REFERENCE, JointName, Speed
from mocap_id.simulation.yaml_files import robot_study_yaml
from mocap_id.store.atomic import replace_together

FILE = "robot-study.yaml"
ORIENTATIONS = (0.0, 45.0)  # degrees


@dataclass(frozen=True)
class RobotSet:
    """A set of simulated robot trials; a value out of range raises ConfigError."""

    repeats: int = option(3, "Trials of each joint, speed and orientation.", (1, 99))
    joints: tuple[JointName, ...] = tuple(REFERENCE)
    speeds: tuple[Speed, ...] = tuple(FREQUENCY)
    orientations: tuple[float, ...] = ORIENTATIONS  # degrees
    # Common options. The seed is the set's; each trial has its own seed, joint, speed and orientation.
    options: Options = field(default_factory=lambda: Options(seed=1, rate=480.0, analog_rate=2400.0))

    def __post_init__(self) -> None:
        check_options(self, "simulate robot-set")
        if not (self.joints and self.speeds and self.orientations):
            raise ConfigError("simulate robot-set: `joints`, `speeds` or `orientations` is empty; expected one or more")


def robot_set_trials(robot_set: RobotSet) -> Iterator[tuple[str, Options]]:
    """Yield the name and options of every trial."""
    for joint in robot_set.joints:
        for speed in robot_set.speeds:
            for orientation in robot_set.orientations:
                for repeat in range(1, robot_set.repeats + 1):
                    indices = (tuple(REFERENCE).index(joint), tuple(FREQUENCY).index(speed), round(orientation) % 360)
                    key = [robot_set.options.seed, *indices, repeat]
                    seed = int(np.random.SeedSequence(key).generate_state(1)[0])
                    options = replace(robot_set.options, seed=seed, joint=joint, speed=speed, orientation=orientation)
                    yield f"{joint}-{speed}-{orientation:g}-{repeat}", options


def simulate_robot_set(folder: Path, robot_set: RobotSet) -> Path:
    """Simulate the trials of a set, and return the path of ``robot-study.yaml``, which is written last.

    Every trial has a folder with its exact truth. StoreError is raised if the folder is not empty or cannot be written.
    """
    create_folder(folder)
    for name, options in robot_set_trials(robot_set):
        simulate("robot", folder / name, options)
    replace_together(folder, {FILE: robot_set_yaml(robot_set).encode()})
    return folder / FILE


def robot_set_yaml(robot_set: RobotSet) -> str:
    """Return the text of the set's ``robot-study.yaml``."""
    options = robot_set.options
    return robot_study_yaml(options.seed, options.repetitions, robot_set.joints, list(robot_set_trials(robot_set)))
