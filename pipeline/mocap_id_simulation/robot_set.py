"""The thesis's robot study as simulated trials: three joints, two speeds, two orientations, several repeats.

The thesis did not move the shoulder fast, because the robot might have tipped over; the simulation does. The seed of
each trial follows from the set's seed, so that additional repeats leave the other trials unchanged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

from mocap_id.errors import ConfigError
from mocap_id.store.atomic import replace_together
from mocap_id_simulation.bodies import REFERENCE, TOTAL
from mocap_id_simulation.options import JointName, Options, Speed, check_options, option
from mocap_id_simulation.trial_files import create_folder, derive_seeds, simulate, study_yaml

ROBOT_FILE = "robot-study.yaml"
ORIENTATIONS = (0.0, 45.0)  # degrees


@dataclass(frozen=True)
class RobotSet:
    """A set of simulated robot trials; a value out of range raises ConfigError."""

    repeats: int = option(3, "Trials of each joint, speed and orientation.", (1, 99))
    joints: tuple[JointName, ...] = get_args(JointName)
    speeds: tuple[Speed, ...] = get_args(Speed)
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
                    indices = (get_args(JointName).index(joint), get_args(Speed).index(speed), round(orientation) % 360)
                    seed, *_ = derive_seeds(robot_set.options.seed, *indices, repeat)
                    options = replace(robot_set.options, seed=seed, joint=joint, speed=speed, orientation=orientation)
                    yield f"{joint}-{speed}-{orientation:g}-{repeat}", options


def simulate_robot_set(folder: Path, robot_set: RobotSet) -> Path:
    """Simulate the trials of a set, and return the path of ``robot-study.yaml``, which is written last.

    Every trial has a folder with its exact truth. StoreError is raised if the folder is not empty or cannot be written.
    """
    create_folder(folder)
    for name, options in robot_set_trials(robot_set):
        simulate("robot", folder / name, options)
    replace_together(folder, {ROBOT_FILE: robot_set_yaml(robot_set).encode()})
    return folder / ROBOT_FILE


def reuse_robot_set(folder: Path, robot_set: RobotSet) -> Path:
    """Return the file of the simulated set in a folder; simulate the set if it is missing.

    ConfigError is raised if the folder contains a set with different options.
    """
    if not (folder / ROBOT_FILE).exists():
        return simulate_robot_set(folder, robot_set)
    if (folder / ROBOT_FILE).read_text("utf-8") != robot_set_yaml(robot_set):
        raise ConfigError(
            f"{folder} contains a set with a different seed or number of trials: give the same options as for that "
            "set, or choose a different `--out`"
        )
    return folder / ROBOT_FILE


def robot_set_yaml(robot_set: RobotSet) -> str:
    """Return the text of the set's ``robot-study.yaml``."""
    trials = list(robot_set_trials(robot_set))
    count, swings = len(trials), robot_set.options.repetitions
    head = f"""\
# {count} simulated trials of the thesis's robot, {swings} swings of one joint each (`mocap-id validate robot`).
# Made by `mocap-id simulate robot-set` with seed {robot_set.options.seed}. The exact truth stands beside each trial.
# Paths are relative to this file.
study: simulated-ur5
reference:  # table 5.2's: m, kg, kg·m, kg·m²; `base` is the joint's distance from the plate's centre
"""
    reference: dict[str, Mapping[str, float]] = {}
    for joint in robot_set.joints:
        known = REFERENCE[joint]
        moving = {"mx1": 0.0, "mx2": 0.0, "my2": known.my, "Izz2": known.inertia}
        reference[joint] = {"base": known.distance, "mass": TOTAL, **moving}
    rows = [
        {"file": f"{name}/trial.yaml", "joint": one.joint, "speed": one.speed, "orientation": f"{one.orientation:g}"}
        for name, one in trials
    ]
    return study_yaml(head, reference, rows)
