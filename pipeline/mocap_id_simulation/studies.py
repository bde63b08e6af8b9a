"""Simulated cohorts on disk: recordings of several persons with their truth, and a study that is ready to run.

A person has the same body, markers and skin in all trials. Motion, foot position, direction in the laboratory, drift of
the skin, occlusions and noise differ between trials. The seed of each trial follows from the cohort's seed, so that
additional persons, strategies or trials leave the other trials unchanged.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.store.atomic import replace_together, write_files
from mocap_id_simulation.arm import body_keys, carried_loads, device_yaml, generate_arm
from mocap_id_simulation.arm_files import arm_document, spatial_arrays
from mocap_id_simulation.arm_sensors import film_skeleton
from mocap_id_simulation.bodies import FREQUENCY, REFERENCE, JointName, SimulatedBody, Speed, Subject, draw_subject
from mocap_id_simulation.options import ArmOptions, CurlCondition, Options, Side, Strategy, check_options, option
from mocap_id_simulation.scene import generate
from mocap_id_simulation.sit_to_stand import STRATEGIES
from mocap_id_simulation.trial_files import (
    arrays,
    c3d_bytes,
    create_folder,
    document,
    points_bytes,
    robot_study_yaml,
    simulate,
    study_yaml,
    write_study_trial,
)

FILE = "study.yaml"
_STRATEGIES = tuple(STRATEGIES)


@dataclass(frozen=True)
class Cohort:
    """A cohort of simulated persons; a value out of range raises ConfigError."""

    subjects: int = option(6, "Number of persons, alternately female and male.", (1, 999))
    strategies: tuple[Strategy, ...] = _STRATEGIES
    trials: int = option(1, "Trials of each person and strategy.", (1, 99))
    # Common options. The seed is the cohort's; each trial has its own seed, strategy and subject.
    options: Options = field(default_factory=lambda: Options(seed=1))

    def __post_init__(self) -> None:
        check_options(self, "simulate cohort")
        names = ",".join(self.strategies)
        if not self.strategies or not set(self.strategies) <= set(STRATEGIES):
            raise ConfigError(f"simulate cohort: `strategies` is {names!r}; expected some of {', '.join(STRATEGIES)}")
        if len(set(self.strategies)) < len(self.strategies):
            raise ConfigError(f"simulate cohort: `strategies` is {names!r}; expected each strategy only once")


@dataclass(frozen=True)
class CohortTrial:
    """One trial of a cohort."""

    subject: Subject
    strategy: Strategy
    number: int
    options: Options

    @property
    def name(self) -> str:
        """Name of the trial, such as ``s01-normal-1``."""
        return f"{self.subject.name}-{self.strategy}-{self.number}"

    @property
    def file(self) -> str:
        """Path of the recording in the cohort's folder."""
        return f"{self.subject.name}/{self.strategy}-{self.number}.c3d"


def cohort_trials(cohort: Cohort) -> Iterator[CohortTrial]:
    """Yield every trial, person by person."""
    for person in range(1, cohort.subjects + 1):
        subject = draw_subject(cohort.options.seed, person)
        for strategy in cohort.strategies:
            for number in range(1, cohort.trials + 1):
                key = [cohort.options.seed, person, 1 + _STRATEGIES.index(strategy), number]
                seed = int(np.random.SeedSequence(key).generate_state(1)[0])
                options = replace(cohort.options, seed=seed, strategy=strategy, subject=subject)
                yield CohortTrial(subject, strategy, number, options)


def simulate_cohort(folder: Path, cohort: Cohort) -> Path:
    """Simulate a cohort, write it with its exact truth, and return the path of ``study.yaml``.

    The folder must be new or empty. It receives ``<subject>/<strategy>-<number>.c3d``, ``truth/<trial>/truth.json`` and
    ``truth.npz``, and finally ``study.yaml``.

    Raises
    ------
    StoreError
        The folder is not empty, or cannot be written.
    NumericalError
        No lean of the trunk balances one of the bodies.
    """
    create_folder(folder)
    bodies: dict[Subject, SimulatedBody] = {}
    trials = tuple(cohort_trials(cohort))
    for trial in trials:
        simulated = generate("sit-to-stand", trial.options)
        bodies.setdefault(trial.subject, simulated.scene.body)
        truth = document("sit-to-stand", trial.options, simulated)
        recording = c3d_bytes(trial.options, simulated)
        write_study_trial(folder, trial.name, trial.file, recording, truth, arrays(simulated))
    rows = [(trial.name, trial.subject.name, trial.strategy, trial.file) for trial in trials]
    text = study_yaml(cohort.options, bodies, rows)
    replace_together(folder, {FILE: text.encode()})
    return folder / FILE


ROBOT_FILE = "robot-study.yaml"
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
    options = robot_set.options
    return robot_study_yaml(options.seed, options.repetitions, robot_set.joints, list(robot_set_trials(robot_set)))


_REACH_STUDY = """\
# {subjects} simulated people, each more limited than the one before; reaches of both arms in {sessions} sessions.
# Made by `mocap-id simulate reach-cohort` with seed {seed}. The exact truth of each trial is in truth/<trial>/.
# Paths are relative to this file.
study: simulated-reach-cohort
out: runs
defaults: {{space: 3d, protocol: reach}}
subjects:  # score: an estimate of Brooke's score for such a limitation; the first person has none
"""
_REACH_TRIAL = "  - {{trial: {}, subject: {}, session: {}, side: {}, recording: {}}}\n"
_MOST = 0.8  # severity of the last person
_SCORES = {1: 1, 2: 2, 3: 3, 4: 5}  # by severity / 0.2
_SPREAD = 0.02  # half of the difference in severity between the arms


@dataclass(frozen=True)
class ReachCohort:
    """A cohort of people, from healthy ones to severely limited ones; a value out of range raises ConfigError."""

    subjects: int = option(5, "Number of people, with severities evenly spaced from 0 to 0.8.", (1, 99))
    sessions: int = option(2, "Sessions of each person, with one trial of each arm.", (1, 9))
    skeletons: bool = False  # skeletons of a depth camera instead of markers
    # Common options. The seed is the cohort's; each trial has its own seed, subject, side and severity.
    options: ArmOptions = field(default_factory=lambda: ArmOptions(seed=1))

    def __post_init__(self) -> None:
        check_options(self, "simulate reach-cohort")


@dataclass(frozen=True)
class ReachCohortTrial:
    """One trial of a cohort."""

    subject: str
    session: str
    score: int | None
    options: ArmOptions

    @property
    def name(self) -> str:
        """Name of the trial, such as ``s01-session1-left``."""
        return f"{self.subject}-{self.session}-{self.options.side}"


def reach_cohort_trials(cohort: ReachCohort) -> Iterator[ReachCohortTrial]:
    """Yield every trial, person by person."""
    seed = cohort.options.seed
    for person in range(1, cohort.subjects + 1):
        severity = _MOST * (person - 1) / max(cohort.subjects - 1, 1)
        body, *others = derive_seeds(seed, person, 0, 0)
        sign = 1 if others[0] % 2 else -1
        for session in range(1, cohort.sessions + 1):
            for k, side in enumerate(get_args(Side)):
                own, markers, _ = derive_seeds(seed, person, session, 1 + k)
                limited = float(np.clip(severity + _SPREAD * (sign if k else -sign), 0, 1))
                options = replace(cohort.options, seed=own, subject=body, markers=markers, side=side, severity=limited)
                score = _SCORES.get(round(severity / 0.2))
                yield ReachCohortTrial(f"s{person:02d}", f"session{session}", score, options)


def simulate_reach_cohort(folder: Path, cohort: ReachCohort) -> Path:
    """Simulate a cohort, write it with its exact truth, and return the path of ``study.yaml``.

    The folder must be new or empty. It receives ``<subject>/<session>/<side>.c3d`` (``.csv`` for skeletons),
    ``truth/<trial>/truth.json`` and ``truth.npz``, and finally ``study.yaml``.

    StoreError is raised if the folder is not empty, or cannot be written.
    """
    create_folder(folder)
    people: dict[str, int | None] = {}
    rows = ""
    for trial in reach_cohort_trials(cohort):
        people[trial.subject] = trial.score
        file = f"{trial.subject}/{trial.session}/{trial.options.side}.{'csv' if cohort.skeletons else 'c3d'}"
        recording = f"{{skeleton: {file}}}" if cohort.skeletons else file
        rows += _REACH_TRIAL.format(trial.name, trial.subject, trial.session, trial.options.side, recording)
        simulated = generate_arm(trial.options)
        content = (
            film_skeleton(simulated, trial.options).csv()
            if cohort.skeletons
            else points_bytes(simulated.labels, simulated.positions, simulated.rate)
        )
        truth = arm_document(trial.options, simulated)
        write_study_trial(folder, trial.name, file, content, truth, spatial_arrays(simulated))
    text = _REACH_STUDY.format(subjects=cohort.subjects, sessions=cohort.sessions, seed=cohort.options.seed)
    for subject, score in people.items():
        text += f"  {subject}: {{}}\n" if score is None else f"  {subject}: {{score: {score}}}\n"
    replace_together(folder, {FILE: f"{text}trials:\n{rows}".encode()})
    return folder / FILE


def derive_seeds(*key: int) -> tuple[int, ...]:
    """Return three seeds that follow from the numbers ``key``, such as the cohort's seed and the person's number."""
    return tuple(int(each) for each in np.random.SeedSequence(key).generate_state(3))


EFFECTS: Mapping[CurlCondition, float] = {"C": 0.0, "AC": 0.0, "2": -0.23, "3": 0.0, "4": 0.0, "5": 0.82}
"""Relative change of the number of repetitions in each condition, compared with AC (thesis 8.3)."""
_CAPACITY = (8.0, 14.0)  # curls of a person in AC
_RESPONSE, _VARIATION = 0.06, 0.07  # standard deviations of the logarithms of the response and of the variation
_MOVES: Mapping[CurlCondition, float] = {"C": 0.3, "AC": 0.3, "2": 0.6, "3": 0.3, "4": 0.3, "5": 0.3}
_KEPT = ("t", "isb_shoulder", "isb_elbow", "tau_total", "tau_device", "tau_human")
_CURL_STUDY = """\
# {subjects} simulated people who curl in different conditions of a pneumatic device, {trials} trials of each.
# Made by `mocap-id simulate curl-study` with seed {seed}. The exact truth of each trial is in truth/<trial>/.
# Paths are relative to this file.
study: simulated-curl-study
out: runs
reference: AC  # condition that the others are compared with
defaults:
  space: 3d
  protocol: curl
  curl: {curl}
subjects:  # kg
"""
_CALIBRATION = """\
trial: {subject}-calibration
recording: {subject}.c3d
space: 3d
protocol: reach
"""
_CURL_TRIAL = (
    "  - {{trial: {name}, subject: {subject}, recording: {subject}/{name}.c3d, "
    "calibration: calibration/{subject}.yaml, curl: {curl}}}\n"
)


@dataclass(frozen=True)
class CurlStudy:
    """A study of curls; a value out of range or an unknown condition raises ConfigError."""

    subjects: int = option(6, "Number of people.", (1, 99))
    trials: int = option(3, "Trials of each person and condition.", (1, 9))
    conditions: tuple[CurlCondition, ...] = get_args(CurlCondition)
    # Common options. The seed is the study's; each trial has its own seed, repetitions and compensation.
    options: ArmOptions = field(default_factory=lambda: ArmOptions(seed=1, movement="curl", rate=100.0, failed=1))

    def __post_init__(self) -> None:
        check_options(self, "simulate curl-study")
        if not set(self.conditions) <= set(EFFECTS) or "AC" not in self.conditions:
            expected = f"expected AC and, if needed, others of {', '.join(EFFECTS)}"
            raise ConfigError(f"simulate curl-study: `conditions` is {', '.join(self.conditions)!r}; {expected}")


@dataclass(frozen=True)
class CurlStudyTrial:
    """One trial of a study."""

    subject: str
    number: int
    options: ArmOptions

    @property
    def name(self) -> str:
        """Name of the trial, such as ``s01-AC-2``."""
        return f"{self.subject}-{self.options.condition}-{self.number}"


def curl_study_trials(study: CurlStudy) -> Iterator[CurlStudyTrial]:
    """Yield every trial, person by person; a trial does not depend on the numbers of people and trials."""
    for person in range(1, study.subjects + 1):
        body, markers, *_ = derive_seeds(study.options.seed, person, 0, 0)
        of_person = np.random.default_rng([study.options.seed, person])
        capacity, moves = of_person.uniform(*_CAPACITY), np.exp(of_person.normal(0, 0.2))
        response = dict(zip(EFFECTS, np.exp(of_person.normal(0, _RESPONSE, len(EFFECTS))), strict=True))
        for condition in study.conditions:
            for number in range(1, study.trials + 1):
                own, *_ = derive_seeds(study.options.seed, person, 1 + list(EFFECTS).index(condition), number)
                varied = np.exp(np.random.default_rng(own).normal(0, _VARIATION))
                expected = capacity * (1 + EFFECTS[condition]) * response[condition] * varied
                options = replace(
                    study.options,
                    seed=own,
                    subject=body,
                    markers=markers,
                    condition=condition,
                    repetitions=max(1, round(expected)),
                    compensation=min(_MOVES[condition] * moves, 2.0),
                )
                yield CurlStudyTrial(f"s{person:02d}", number, options)


def simulate_curl_study(folder: Path, study: CurlStudy) -> Path:
    """Simulate a study of curls, write it with its exact truth, and return the path of ``study.yaml``.

    The folder must be new or empty. It receives ``calibration/<subject>.c3d`` and ``.yaml``,
    ``<subject>/<trial>.c3d``, ``truth/<trial>/truth.json`` and ``truth.npz``, ``device.yaml`` and finally
    ``study.yaml``.

    StoreError is raised if the folder is not empty, or cannot be written.
    """
    create_folder(folder)
    people, rows = "", ""
    known: set[str] = set()
    for trial in curl_study_trials(study):
        if trial.subject not in known:
            known.add(trial.subject)
            people += _person_yaml(trial)
            _write_calibration(folder, trial)
        rows += _CURL_TRIAL.format(
            name=trial.name, subject=trial.subject, curl=_condition_yaml(trial.options.condition)
        )
        _write_trial(folder, trial)
    loads = {name: body_keys(body) for name, body in carried_loads("AC").items()}
    common = json.dumps({"metronome_hz": 0.5, "device": "device.yaml", "loads": loads})
    counts = {"subjects": study.subjects, "trials": study.trials, "seed": study.options.seed}
    text = _CURL_STUDY.format(curl=common, **counts) + people + "trials:\n" + rows
    replace_together(folder, {"device.yaml": device_yaml(), FILE: text.encode()})
    return folder / FILE


def _person_yaml(trial: CurlStudyTrial) -> str:
    seed = trial.options.subject or 0
    person = draw_subject(seed, 1 + seed % 2)
    return f"  {trial.subject}: {{mass: {person.mass:.2f}, sex: {person.sex}}}\n"


def _condition_yaml(condition: CurlCondition) -> str:
    keys: dict[str, object] = {"condition": condition}
    if condition == "C":
        keys["loads"] = {name: body_keys(body) for name, body in carried_loads(condition).items()}
    return json.dumps(keys)


def _write_calibration(folder: Path, trial: CurlStudyTrial) -> None:
    options = replace(trial.options, movement="reach", cycles=1, severity=0.1, condition="C")
    simulated = generate_arm(options)
    text = _CALIBRATION.format(subject=trial.subject) + f"side: {options.side}\n"
    recording = points_bytes(simulated.labels, simulated.positions, simulated.rate)
    contents = {f"{trial.subject}.c3d": recording, f"{trial.subject}.yaml": text.encode()}
    write_files(folder / "calibration", contents)


def _write_trial(folder: Path, trial: CurlStudyTrial) -> None:
    simulated = generate_arm(trial.options)
    recording = points_bytes(simulated.labels, simulated.positions, simulated.rate)
    values = spatial_arrays(simulated)
    truth = arm_document(trial.options, simulated)
    file = f"{trial.subject}/{trial.name}.c3d"
    write_study_trial(folder, trial.name, file, recording, truth, {name: values[name] for name in _KEPT})
