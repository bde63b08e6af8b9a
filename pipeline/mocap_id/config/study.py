"""Configuration of a study: many trials of many people, or of a robot, in one YAML file."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, create_model

from mocap_id.config.parsing import (
    Location,
    Source,
    build_json_schema,
    parse,
    raise_mistakes,
    read_source,
    suggest_name,
)
from mocap_id.config.trial import Trial, build_trial_model, compose, load, make_absolute
from mocap_id.errors import ConfigError
from mocap_id.reporting import COHORT
from mocap_id.stages import STAGES
from mocap_id.stages.base import Settings
from mocap_id.stages.trial_keys import ConditionName, Subject, TrialKeys

TABLES_FOLDER = "study"
"""Folder of the tables and the page, beside the trials' folders; no trial may have this name."""
_ID = r"^\w[\w.+-]*$"
REACH = "reach"
"""Protocol of the trials of a reach study."""
CURL = "curl"
"""Protocol of the trials of a study of curls."""
_INSTEAD = {REACH: "`session` and `side`", CURL: "`curl: {condition: …}`"}
"""Labels that replace a strategy, by protocol."""
_OWN_KEYS = ("trial", "recording", "subject", "strategy", "session", "out")  # keys without a default for all trials


class Landmarks(Settings):
    """Segment lengths measured on the body, for example by palpation or ultrasound."""

    shank: float | None = Field(None, gt=0.1, lt=1, description="knee to ankle, m")
    thigh: float | None = Field(None, gt=0.1, lt=1, description="hip to knee, m")


class Person(Subject):
    """A person and measurements of the body; all keys are optional."""

    landmarks_m: Landmarks = Field(Landmarks(), description="segment lengths measured on the body, m")
    score: float | None = Field(None, description="clinical score, such as Brooke's; for `protocol: reach`")


class _Entry(BaseModel):
    """A trial of the study; the model of a trial checks its other keys."""

    model_config = ConfigDict(frozen=True, extra="allow")

    trial: str = Field(pattern=_ID, max_length=100, description=TrialKeys.model_fields["trial"].description)
    subject: str = Field(description="id of one of the `subjects`")
    strategy: str | None = Field(
        None,
        pattern=_ID,
        max_length=40,
        description="how the person moves: normal, dynamic …; not for reaches and curls",
    )
    session: str | None = Field(
        None, pattern=_ID, max_length=40, description="session of the recording, `protocol: reach` only"
    )


class _File(Settings):
    study: str = Field(pattern=r"^\w[\w .+-]*$", max_length=100, description="name of the study")
    out: Path = Field(Path("runs"), description="folder of the results")
    reference: ConditionName | None = Field(
        None,
        max_length=40,
        description="condition that the curls in other conditions are compared with; default: the first",
    )
    defaults: dict[str, Any] = Field({}, description="keys of a trial's file, for every trial")
    subjects: dict[str, Person] = Field(description="the people: an id and data of each person")
    trials: tuple[_Entry, ...] = Field(min_length=1, description="the recordings")


@dataclass(frozen=True)
class StudyTrial:
    """A trial and its labels in the study."""

    trial: Trial
    subject: str
    strategy: str  # empty for reaches and curls
    session: str = ""
    number: int = 0  # number among the person's trials in the same condition, counted from 1; 0 without a condition

    @property
    def name(self) -> str:
        """The trial's name."""
        return self.trial.name

    @property
    def condition(self) -> str:
        """Condition of curls; empty for other protocols."""
        return self.trial.keys.curl.condition or ""


@dataclass(frozen=True)
class Study:
    """A checked study, ready to run."""

    file: Path  # the YAML file, absolute
    name: str
    out: Path  # absolute folder of the results: a run folder for each trial, and ``study``
    subjects: Mapping[str, Person]  # by id, in the order of the file
    trials: tuple[StudyTrial, ...]
    reference: str = ""  # condition that other curls are compared with; empty for other protocols

    @property
    def folder(self) -> Path:
        """Folder of the tables and the page."""
        return self.out / TABLES_FOLDER

    @property
    def strategies(self) -> tuple[str, ...]:
        """Strategies of the trials, in the order of their first occurrence."""
        return tuple(dict.fromkeys(trial.strategy for trial in self.trials))

    @property
    def reach(self) -> bool:
        """Whether all trials are reaches."""
        return all(trial.trial.keys.protocol == REACH for trial in self.trials)

    @property
    def curl(self) -> bool:
        """Whether all trials are curls."""
        return all(trial.trial.keys.protocol == CURL for trial in self.trials)


def load_study(file: Path) -> Study:
    """Read and check a study's YAML file; no recording is opened.

    Raises ConfigError with one line for every mistake: file, line, key, what was found, what was expected.
    """
    source = read_source(file.absolute())
    keys = source.data.keys() if isinstance(source.data, dict) else set()
    if {"trial", "recording"} <= keys and "trials" not in keys:
        raise ConfigError(f"{source.file} is a trial, not a study: `mocap-id run {source.file}` runs it")
    parsed = parse(source, _File, "keys such as `study:`, `subjects:` and `trials:`", _fill_empty_sections)
    raise_mistakes(_find_mistakes(parsed, source))
    # The trials; the mistakes of all trials are raised together, each once.
    out = make_absolute(parsed.out, source.file.parent)
    labels: dict[str, Any] = {
        name: (str, Field("", description=_Entry.model_fields[name].description)) for name in ("strategy", "session")
    }
    model = create_model("StudyTrial", __base__=build_trial_model(STAGES), **labels)
    trials: list[StudyTrial] = []
    mistakes: list[str] = []
    # lines of all values below each default and below each key of a trial, by the location of this key
    below: defaultdict[Location, dict[Location, int]] = defaultdict(dict)
    for location, line in source.lines.items():
        size = {"defaults": 2, "trials": 3}.get(str(location[0]), 0) if location else 0
        if 0 < size <= len(location):
            below[location[:size]][location[size:]] = line
    for index, entry in enumerate(parsed.trials):
        try:
            own = _trial_source(source, below, index, parsed.subjects)
            trial = compose(own, STAGES, out=out / entry.trial, model=model)
        except ConfigError as error:
            mistakes += str(error).splitlines()
        else:
            condition = trial.keys.curl.condition
            before = sum(other.subject == entry.subject and other.condition == condition for other in trials)
            number = before + 1 if condition else 0
            trials.append(StudyTrial(trial, entry.subject, entry.strategy or "", entry.session or "", number))
    raise_mistakes(dict.fromkeys(mistakes))
    # The condition of curls that others are compared with
    reference, where = parsed.reference, source.where(("reference",))
    if trials[0].trial.keys.protocol != CURL:
        raise_mistakes([f"{where}: `reference` is only for `protocol: {CURL}`"] if reference else [])
        return Study(source.file, parsed.study, out, parsed.subjects, tuple(trials))
    raise_mistakes(
        f"{source.where(('trials', k))}: `trials[{k}].curl` has no `condition`; expected a name, such as C, AC or 5"
        for k, one in enumerate(trials)
        if not one.condition
    )
    if reference is not None and reference not in {one.condition for one in trials}:
        raise_mistakes([f"{where}: no trial has the condition `{reference}`"])
    return Study(source.file, parsed.study, out, parsed.subjects, tuple(trials), reference or trials[0].condition)


def build_study_schema() -> dict[str, Any]:
    """Return the JSON Schema of a study's YAML file, for editors."""
    schema, trial = build_json_schema(_File), build_json_schema(build_trial_model(STAGES))
    keys = {name: key for name, key in trial["properties"].items() if name not in ("subject", "out")}
    entry = schema["$defs"]["_Entry"]
    entry["properties"] = keys | entry["properties"]
    entry["required"] = sorted({*entry["required"], "recording"})
    entry["additionalProperties"] = False
    defaults = {name: key for name, key in keys.items() if name not in _OWN_KEYS}
    description = schema["properties"]["defaults"]["description"]
    schema["properties"]["defaults"] = {
        "type": "object",
        "properties": defaults,
        "additionalProperties": False,
        "description": description,
    }
    schema["$defs"] = trial["$defs"] | schema["$defs"]
    return {**schema, "title": "Study"}


def _trial_source(
    source: Source, below: Mapping[Location, Mapping[Location, int]], index: int, subjects: Mapping[str, Person]
) -> Source:
    """Return the keys of one trial, with the defaults and the person's data, each with its line in the file."""
    entry: dict[str, Any] = source.data["trials"][index]
    defaults: dict[str, Any] = source.data.get("defaults") or {}
    person = subjects[entry["subject"]].model_dump(mode="json", exclude={"landmarks_m", "score"}, exclude_none=True)
    data: dict[str, Any] = {}
    lines: dict[Location, int] = {(): source.lines["trials", index]}
    for key, value in (defaults | entry | {"subject": person}).items():
        own, other = entry.get(key), defaults.get(key)
        data[key] = {**other, **own} if isinstance(own, dict) and isinstance(other, dict) else value
        for location in (("defaults", key), ("trials", index, key)):
            lines |= {(key, *rest): line for rest, line in below.get(location, {}).items()}
    return Source(source.file, data, lines)


def _find_mistakes(parsed: _File, source: Source) -> Iterator[str]:
    """Yield a line for every contradiction between keys, between trials, and of a label with its protocol."""
    for key in _OWN_KEYS:
        if key in parsed.defaults:
            where = source.where(("defaults", key))
            place = "the top of the file" if key == "out" else "each trial"
            yield f"{where}: `defaults.{key}` is not allowed: write `{key}` at {place}"
    for name in parsed.subjects:
        if name == COHORT:
            yield f"{source.where(('subjects', name))}: no subject can be called `{COHORT}`, which means all people"
    places: dict[str, int] = {}
    for index, entry in enumerate(parsed.trials):
        where = source.where(("trials", index, "trial"))
        first = places.setdefault(entry.trial.casefold(), index)  # file names of some systems ignore case
        if first != index:
            line = source.where(("trials", first, "trial")).rpartition(" ")[2]
            yield f"{where}: the trial `{entry.trial}` is given twice, first on line {line}: give it another name"
        if entry.trial.casefold() == TABLES_FOLDER:
            yield f"{where}: no trial can be called `{TABLES_FOLDER}`: the tables' folder has that name"
        if "out" in (entry.model_extra or {}):
            yield f"{source.where(('trials', index, 'out'))}: `out` is not allowed in a trial: write it at the top"
        if entry.subject not in parsed.subjects:
            where, hint = source.where(("trials", index, "subject")), suggest_name(entry.subject, list(parsed.subjects))
            yield f"{where}: there is no subject `{entry.subject}`: {hint}"
    default = parsed.defaults.get("protocol")
    protocols = [(entry.model_extra or {}).get("protocol", default) for entry in parsed.trials]
    kinds = [protocol if protocol in _INSTEAD else None for protocol in protocols]
    for index, (entry, kind) in enumerate(zip(parsed.trials, kinds, strict=True)):
        where = source.where(("trials", index))
        if kind != kinds[0]:
            yield f"{where}: `protocol: {kind or kinds[0]}` and other protocols cannot be in one study"
        elif kind and entry.strategy:
            yield f"{where}: `trials[{index}].strategy` is not for `protocol: {kind}`: use {_INSTEAD[kind]}"
        elif kind != REACH and entry.session:
            yield f"{where}: `trials[{index}].session` is only for `protocol: {REACH}`"
        elif not kind and entry.strategy is None:
            yield f"{where}: `trials[{index}].strategy` is missing: it says how the person moves, such as normal"


def _fill_empty_sections(data: dict[str, Any]) -> dict[str, Any]:
    """Replace empty subjects and empty defaults by empty mappings."""
    filled: dict[str, Any] = {}
    if "defaults" in data and data["defaults"] is None:
        filled["defaults"] = {}
    if isinstance(data.get("subjects"), dict):
        filled["subjects"] = {name: {} if person is None else person for name, person in data["subjects"].items()}
    return data | filled


class RobotReference(Settings):
    """Reference values of a robot for one joint, in the robot's frame; all keys are optional."""

    base: float | None = Field(None, gt=0, description="distance of the joint from the plate's centre, m")
    mass: float | None = Field(None, gt=0, description="mass of everything on the plate, kg")
    mx1: float | None = Field(None, description="first moment of everything along x with the arm upright, kg*m")
    mx2: float | None = Field(None, description="first moment of the arm across it, kg*m")
    my2: float | None = Field(None, description="first moment of the arm along it, kg*m")
    Izz2: float | None = Field(None, gt=0, description="moment of inertia of the arm about the joint, kg*m^2")


class _RobotEntry(Settings):
    file: Path = Field(description="the trial's YAML file")
    joint: str = Field("", max_length=40, description="the joint that moves; its `reference` has the same name")
    speed: str = Field("", max_length=40, description="how it moves: slow, fast")
    orientation: float | None = Field(None, description="angle of the robot about the vertical, degrees")


class _RobotFile(Settings):
    study: str = Field(pattern=r"^\w[\w .+-]*$", max_length=100, description="name of the study")
    reference: dict[str, RobotReference] = Field({}, description="reference values of the robot, by joint")
    trials: tuple[_RobotEntry, ...] = Field(min_length=1, description="the trials and their labels in the tables")


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
        parsed, folder = parse(source, _RobotFile, "keys such as `study:` and `trials:`"), source.file.parent
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
