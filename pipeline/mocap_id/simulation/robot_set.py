"""The thesis's robot study as simulated trials: three joints, two speeds, two orientations, several repeats.

The thesis did not move the shoulder fast because the robot might have tipped over; the simulation does. Each trial has
its own seed, derived from the set's, so that changing the number of repeats leaves the other trials unchanged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.simulation.options import Options
from mocap_id.simulation.trial_files import new_folder, simulate
from mocap_id.simulation.ur5 import FREQUENCY, REFERENCE, JointName, Speed
from mocap_id.simulation.yaml_files import robot_study_yaml
from mocap_id.store.atomic import replace_together

FILE = "robot-study.yaml"
ORIENTATIONS = (0.0, 45.0)  # degrees


@dataclass(frozen=True)
class RobotSet:
    """A set of simulated robot trials.

    Parameters
    ----------
    repeats : int
        Trials of each joint, speed and orientation.
    joints, speeds : tuples
    orientations : tuple of float
        Degrees.
    options : Options
        Common options. The seed is the set's; each trial has its own joint, speed and orientation.

    Raises
    ------
    ConfigError
        The set has no trials, or too many repeats.
    """

    repeats: int = 3
    joints: tuple[JointName, ...] = tuple(REFERENCE)
    speeds: tuple[Speed, ...] = tuple(FREQUENCY)
    orientations: tuple[float, ...] = ORIENTATIONS
    options: Options = field(default_factory=lambda: Options(seed=1, rate=480.0, analog_rate=2400.0))

    def __post_init__(self) -> None:
        if not 1 <= self.repeats <= 99 or not (self.joints and self.speeds and self.orientations):
            raise ConfigError(f"simulate robot-set: repeats is {self.repeats!r}, expected 1 … 99, and some trials")


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
    """Simulate the trials of a set and write them with their exact truth, one folder each.

    Returns
    -------
    Path
        ``robot-study.yaml``, written last.

    Raises
    ------
    StoreError
        The folder is not empty, or cannot be written.
    """
    new_folder(folder)
    for name, options in robot_set_trials(robot_set):
        simulate("robot", folder / name, options)
    replace_together(folder, {FILE: robot_set_yaml(robot_set).encode()})
    return folder / FILE


def robot_set_yaml(robot_set: RobotSet) -> str:
    """Return the text of the set's ``robot-study.yaml``."""
    options = robot_set.options
    return robot_study_yaml(options.seed, options.repetitions, robot_set.joints, list(robot_set_trials(robot_set)))
