"""Configuration of a robot study: trials, their labels in the tables, and reference values of the robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import Field

from mocap_id.config.parsing import parse, read_source
from mocap_id.config.trial import Trial, load, make_absolute
from mocap_id.errors import ConfigError
from mocap_id.stages.base import Settings


class RobotReference(Settings):
    """Reference values of a robot for one joint, in the robot's frame; all keys are optional."""

    base: float | None = Field(None, gt=0, description="distance of the joint from the plate's centre, m")
    mass: float | None = Field(None, gt=0, description="mass of everything on the plate, kg")
    mx1: float | None = Field(None, description="first moment of everything along x with the arm upright, kg*m")
    mx2: float | None = Field(None, description="first moment of the arm across it, kg*m")
    my2: float | None = Field(None, description="first moment of the arm along it, kg*m")
    Izz2: float | None = Field(None, gt=0, description="moment of inertia of the arm about the joint, kg*m^2")


class _Entry(Settings):
    file: Path = Field(description="the trial's YAML file")
    joint: str = Field("", max_length=40, description="the joint that moves; its `reference` has the same name")
    speed: str = Field("", max_length=40, description="how it moves: slow, fast")
    orientation: float | None = Field(None, description="angle of the robot about the vertical, degrees")


class _File(Settings):
    study: str = Field(pattern=r"^\w[\w .+-]*$", max_length=100, description="name of the study")
    reference: dict[str, RobotReference] = Field({}, description="reference values of the robot, by joint")
    trials: tuple[_Entry, ...] = Field(min_length=1, description="the trials and their labels in the tables")


@dataclass(frozen=True)
class RobotTrial:
    """A trial of a robot study; a label is empty or None if it is not known."""

    trial: Trial
    joint: str = ""
    speed: str = ""
    orientation: float | None = None  # angle of the robot about the vertical, degrees


@dataclass(frozen=True)
class RobotStudy:
    """A checked robot study, ready to run."""

    name: str
    trials: tuple[RobotTrial, ...]
    reference: Mapping[str, RobotReference]  # by joint


def load_robot_study(files: tuple[Path, ...]) -> RobotStudy:
    """Read the file of a study, or the files of trials.

    Raises ConfigError if a file has mistakes or two trials have the same name.
    """
    source = read_source(files[0].absolute()) if len(files) == 1 else None
    if source is not None and isinstance(source.data, dict) and "trials" in source.data:
        parsed, folder = parse(source, _File, "keys such as `study:` and `trials:`"), source.file.parent
        trials = [
            RobotTrial(load(make_absolute(one.file, folder)), one.joint, one.speed, one.orientation)
            for one in parsed.trials
        ]
        study = RobotStudy(parsed.study, tuple(trials), parsed.reference)
    else:
        study = RobotStudy("robot", tuple(RobotTrial(load(file)) for file in files), {})
    names = [one.trial.name for one in study.trials]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"two trials are called {twice[0]}: each needs a unique name for its run folder")
    for one in study.trials:
        if one.trial.keys.protocol != "robot-joint":
            raise ConfigError(f"{one.trial.file}: has `protocol: {one.trial.keys.protocol}`, expected robot-joint")
    return study
