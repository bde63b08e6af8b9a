"""The thesis's robot study as simulated trials: three joints, two speeds, two orientations, each several times over.

The thesis did not move the shoulder fast, for fear of tipping the robot over; here it may. Trials have seeds of their
own, drawn from the set's: another number of repeats leaves those alone that were there before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mocap_id.errors import ConfigError, StoreError
from mocap_id.simulation.options import Options
from mocap_id.simulation.trial import simulate
from mocap_id.simulation.ur5 import FREQUENCY, REFERENCE, TOTAL, JointName, Speed
from mocap_id.store.atomic import explained, replace_together

FILE = "robot-study.yaml"
ORIENTATIONS = (0.0, 45.0)  # degrees

_TOP = """\
# {count} simulated trials of the thesis's robot, {periods} swings of one joint each (`mocap-id validate robot`).
# Made by `mocap-id simulate robot-set` with seed {seed}. The exact truth stands beside each trial.
# Paths are relative to this file.
study: {name}
reference:  # table 5.2's: m, kg, kg·m, kg·m²; `base` is the joint's distance from the plate's centre
"""
_REFERENCE = "  {name}: {{base: {l1}, mass: {mass}, mx1: 0.0, mx2: 0.0, my2: {my}, Izz2: {inertia}}}\n"
_TRIAL = "  - {{file: {}/trial.yaml, joint: {}, speed: {}, orientation: {:g}}}\n"


@dataclass(frozen=True)
class RobotSet:
    """Which trials are made.

    Parameters
    ----------
    repeats : int
        Of each joint, speed and orientation.
    joints, speeds : tuples
    orientations : tuple of float
        Degrees.
    options : Options
        Of every trial. The seed is the set's; joint, speed and orientation are each trial's own.

    Raises
    ------
    ConfigError
        There are no trials.
    """

    repeats: int = 3
    joints: tuple[JointName, ...] = tuple(REFERENCE)
    speeds: tuple[Speed, ...] = tuple(FREQUENCY)
    orientations: tuple[float, ...] = ORIENTATIONS
    options: Options = field(default_factory=lambda: Options(seed=1, rate=480.0, analog_rate=2400.0))

    def __post_init__(self) -> None:
        if not 1 <= self.repeats <= 99 or not (self.joints and self.speeds and self.orientations):
            raise ConfigError(f"simulate robot-set: repeats is {self.repeats!r}, expected 1 … 99, and some trials")


def set_trials(wanted: RobotSet) -> Iterator[tuple[str, Options]]:
    """Name and options of every trial."""
    for joint in wanted.joints:
        for speed in wanted.speeds:
            for orientation in wanted.orientations:
                for repeat in range(1, wanted.repeats + 1):
                    places = (tuple(REFERENCE).index(joint), tuple(FREQUENCY).index(speed), round(orientation) % 360)
                    key = [wanted.options.seed, *places, repeat]
                    seed = int(np.random.SeedSequence(key).generate_state(1)[0])
                    options = replace(wanted.options, seed=seed, joint=joint, speed=speed, orientation=orientation)
                    yield f"{joint}-{speed}-{orientation:g}-{repeat}", options


def simulate_set(folder: Path, wanted: RobotSet) -> Path:
    """Make the trials with exact truth and write them, a folder each.

    Returns
    -------
    Path
        ``robot-study.yaml``, written last.

    Raises
    ------
    StoreError
        The folder is not empty, or cannot be written.
    """
    with explained(folder):
        if folder.exists() and any(folder.iterdir()):
            raise StoreError(f"{folder} is not empty: choose a new folder for the set")
        folder.mkdir(parents=True, exist_ok=True)
    for name, options in set_trials(wanted):
        simulate("robot", folder / name, options)
    replace_together(folder, {FILE: set_file(wanted).encode()})
    return folder / FILE


def set_file(wanted: RobotSet) -> str:
    """The text of ``robot-study.yaml``."""
    trials = list(set_trials(wanted))
    text = _TOP.format(
        count=len(trials), periods=wanted.options.repetitions, seed=wanted.options.seed, name="simulated-ur5"
    )
    for joint in wanted.joints:
        known = REFERENCE[joint]
        text += _REFERENCE.format(name=joint, l1=known.distance, mass=TOTAL, my=known.my, inertia=known.inertia)
    text += "trials:\n"
    return text + "".join(_TRIAL.format(name, each.joint, each.speed, each.orientation) for name, each in trials)
