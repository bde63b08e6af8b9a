"""Simulated studies on disk: recordings of several people with their truth, and a study that is ready to run.

A person has the same body in all trials. The seed of each trial follows from the study's seed, so that additional
people, conditions or trials leave the other trials unchanged. The three studies:

- a cohort that stands up and sits down: markers and skin of a person are the same in all trials; motion, foot position,
  direction in the laboratory, drift of the skin, occlusions and noise differ;
- a cohort that reaches, each person more limited than the one before: markers are placed again in every session and on
  each arm, so that palpation errors differ;
- people who curl with a pneumatic device: the number of curls until an attempt fails is the capacity of the person,
  times the effect of the condition, the response of the person to it, and a variation between trials; compensation
  increases with fatigue.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar, get_args

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.store.atomic import replace_together, write_files
from mocap_id_simulation.arm import body_keys, carried_loads, device_yaml, generate_arm
from mocap_id_simulation.arm_files import arm_document, film_skeleton, spatial_arrays
from mocap_id_simulation.bodies import draw_person
from mocap_id_simulation.options import (
    ArmOptions,
    CurlCondition,
    Options,
    Side,
    Strategy,
    check_options,
    draw_subject,
    option,
)
from mocap_id_simulation.scene import generate, random_streams
from mocap_id_simulation.space_robot import SimulatedSpaceTrial
from mocap_id_simulation.trial_files import (
    c3d_bytes,
    create_folder,
    derive_seeds,
    flow_mapping,
    json_bytes,
    npz_bytes,
    plane_arrays,
    plane_document,
    points_bytes,
    study_yaml,
)

FILE = "study.yaml"
_STRATEGIES: tuple[Strategy, ...] = get_args(Strategy)
_Options = TypeVar("_Options", Options, ArmOptions)
_Measured = tuple[bytes, Mapping[str, Any], Mapping[str, np.ndarray[Any, Any]]]


@dataclass(frozen=True)
class PlannedTrial(Generic[_Options]):
    """One trial of a study of people."""

    name: str  # such as s01-normal-1
    subject: str
    file: str  # path of the recording in the study's folder
    options: _Options
    keys: Mapping[str, str]  # further keys of the trial in study.yaml
    person: Mapping[str, object]  # keys of the person in study.yaml


def _write_people(
    folder: Path, head: str, trials: Iterable[PlannedTrial[_Options]], measure: Callable[[_Options], _Measured]
) -> Path:
    """Write recording and truth of every trial, and finally ``study.yaml``; ``measure`` returns both for a trial."""
    people, rows = {}, []
    for trial in trials:
        recording, truth, values = measure(trial.options)
        beside = f"truth/{trial.name}/truth"
        contents = {trial.file: recording, f"{beside}.json": json_bytes(truth), f"{beside}.npz": npz_bytes(values)}
        write_files(folder, contents)
        people[trial.subject] = trial.person
        rows.append({"trial": trial.name, "subject": trial.subject, **trial.keys})
    replace_together(folder, {FILE: study_yaml(head, people, rows).encode()})
    return folder / FILE


# --- people who stand up and sit down


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
        if not self.strategies or not set(self.strategies) <= set(_STRATEGIES):
            raise ConfigError(f"simulate cohort: `strategies` is {names!r}; expected some of {', '.join(_STRATEGIES)}")
        if len(set(self.strategies)) < len(self.strategies):
            raise ConfigError(f"simulate cohort: `strategies` is {names!r}; expected each strategy only once")


def cohort_trials(cohort: Cohort) -> Iterator[PlannedTrial[Options]]:
    """Yield every trial, person by person."""
    for number in range(1, cohort.subjects + 1):
        subject = draw_subject(cohort.options.seed, number)
        lengths = draw_person(random_streams(0, subject)["body"], subject).scored_lengths
        person = {
            "height": f"{subject.height:.3f}",
            "mass": f"{subject.mass:.2f}",
            "sex": subject.sex,
            "landmarks_m": flow_mapping({name: f"{lengths[name]:.4f}" for name in ("shank", "thigh")}),
        }
        for strategy in cohort.strategies:
            for trial in range(1, cohort.trials + 1):
                seed, *_ = derive_seeds(cohort.options.seed, number, 1 + _STRATEGIES.index(strategy), trial)
                options = replace(cohort.options, seed=seed, strategy=strategy, subject=subject)
                file = f"{subject.name}/{strategy}-{trial}.c3d"
                keys = {"strategy": strategy, "recording": file}
                yield PlannedTrial(f"{subject.name}-{strategy}-{trial}", subject.name, file, options, keys, person)


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
    options = cohort.options
    count = cohort.subjects * len(cohort.strategies) * cohort.trials
    chair = "the chair stands on no plate"
    if options.seat_plate:
        chair = "the force of the chair's own plate is included as measured"
    head = f"""\
# {cohort.subjects} simulated persons, {count} trials of {options.repetitions} sit-to-stands each.
# Made by `mocap-id simulate cohort` with seed {options.seed}. The exact truth of each trial is in truth/<trial>/.
# Paths are relative to this file.
study: simulated-cohort
out: runs
defaults: {{protocol: sit-to-stand}}  # {chair}
subjects:  # m, kg; the lengths between landmarks are the true ones
"""

    def measure(options: Options) -> _Measured:
        simulated = generate("sit-to-stand", options)
        return (
            c3d_bytes(options, simulated),
            plane_document("sit-to-stand", options, simulated),
            plane_arrays(simulated),
        )

    return _write_people(folder, head, cohort_trials(cohort), measure)


# --- people who reach

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


def reach_cohort_trials(cohort: ReachCohort) -> Iterator[PlannedTrial[ArmOptions]]:
    """Yield every trial, person by person, named such as ``s01-session1-left``."""
    seed = cohort.options.seed
    for number in range(1, cohort.subjects + 1):
        severity = _MOST * (number - 1) / max(cohort.subjects - 1, 1)
        score = _SCORES.get(round(severity / 0.2))
        person = {} if score is None else {"score": score}
        body, odd, _ = derive_seeds(seed, number, 0, 0)
        sign = 1 if odd % 2 else -1
        for session in range(1, cohort.sessions + 1):
            for k, side in enumerate(get_args(Side)):
                own, markers, _ = derive_seeds(seed, number, session, 1 + k)
                limited = float(np.clip(severity + _SPREAD * (sign if k else -sign), 0, 1))
                options = replace(cohort.options, seed=own, subject=body, markers=markers, side=side, severity=limited)
                subject, name = f"s{number:02d}", f"session{session}"
                file = f"{subject}/{name}/{side}.{'csv' if cohort.skeletons else 'c3d'}"
                recording = flow_mapping({"skeleton": file}) if cohort.skeletons else file
                keys = {"session": name, "side": side, "recording": recording}
                yield PlannedTrial(f"{subject}-{name}-{side}", subject, file, options, keys, person)


def simulate_reach_cohort(folder: Path, cohort: ReachCohort) -> Path:
    """Simulate a cohort, write it with its exact truth, and return the path of ``study.yaml``.

    The folder must be new or empty. It receives ``<subject>/<session>/<side>.c3d`` (``.csv`` for skeletons),
    ``truth/<trial>/truth.json`` and ``truth.npz``, and finally ``study.yaml``.

    StoreError is raised if the folder is not empty, or cannot be written.
    """
    create_folder(folder)
    people, seed = cohort.subjects, cohort.options.seed
    head = f"""\
# {people} simulated people, each more limited than the one before; reaches of both arms in {cohort.sessions} sessions.
# Made by `mocap-id simulate reach-cohort` with seed {seed}. The exact truth of each trial is in truth/<trial>/.
# Paths are relative to this file.
study: simulated-reach-cohort
out: runs
defaults: {{space: 3d, protocol: reach}}
subjects:  # score: an estimate of Brooke's score for such a limitation; the first person has none
"""

    def measure(options: ArmOptions) -> _Measured:
        simulated = generate_arm(options)
        recording = film_skeleton(simulated, options)[0] if cohort.skeletons else _markers(simulated)
        return recording, arm_document(options, simulated), spatial_arrays(simulated)

    return _write_people(folder, head, reach_cohort_trials(cohort), measure)


def _markers(trial: SimulatedSpaceTrial) -> bytes:
    return points_bytes(trial.labels, trial.positions, trial.rate)


# --- people who curl

EFFECTS: Mapping[CurlCondition, float] = {"C": 0.0, "AC": 0.0, "2": -0.23, "3": 0.0, "4": 0.0, "5": 0.82}
"""Relative change of the number of repetitions in each condition, compared with AC (thesis 8.3)."""
_CAPACITY = (8.0, 14.0)  # curls of a person in AC
_RESPONSE, _VARIATION = 0.06, 0.07  # standard deviations of the logarithms of the response and of the variation
_COMPENSATION: Mapping[CurlCondition, float] = {"C": 0.3, "AC": 0.3, "2": 0.6, "3": 0.3, "4": 0.3, "5": 0.3}
_KEPT = ("t", "isb_shoulder", "isb_elbow", "tau_total", "tau_device", "tau_human")


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


def curl_study_trials(study: CurlStudy) -> Iterator[PlannedTrial[ArmOptions]]:
    """Yield every trial, person by person; a trial does not depend on the numbers of people and trials."""
    for number in range(1, study.subjects + 1):
        subject = f"s{number:02d}"
        body, markers, _ = derive_seeds(study.options.seed, number, 0, 0)
        drawn = draw_subject(body, 1 + body % 2)
        person = {"mass": f"{drawn.mass:.2f}", "sex": drawn.sex}
        of_person = np.random.default_rng([study.options.seed, number])
        capacity, moves = of_person.uniform(*_CAPACITY), np.exp(of_person.normal(0, 0.2))
        response = dict(zip(EFFECTS, np.exp(of_person.normal(0, _RESPONSE, len(EFFECTS))), strict=True))
        for condition in study.conditions:
            curl: dict[str, object] = {"condition": condition}
            if condition == "C":
                curl["loads"] = _loads(condition)
            for trial in range(1, study.trials + 1):
                own, *_ = derive_seeds(study.options.seed, number, 1 + list(EFFECTS).index(condition), trial)
                varied = np.exp(np.random.default_rng(own).normal(0, _VARIATION))
                expected = capacity * (1 + EFFECTS[condition]) * response[condition] * varied
                options = replace(
                    study.options,
                    seed=own,
                    subject=body,
                    markers=markers,
                    condition=condition,
                    repetitions=max(1, round(expected)),
                    compensation=min(_COMPENSATION[condition] * moves, 2.0),
                )
                name = f"{subject}-{condition}-{trial}"
                file = f"{subject}/{name}.c3d"
                calibration = f"calibration/{subject}.yaml"
                keys = {"recording": file, "calibration": calibration, "curl": json.dumps(curl)}
                yield PlannedTrial(name, subject, file, options, keys, person)


def _loads(condition: CurlCondition) -> dict[str, Any]:
    """Return the keys of the carried loads in a configuration."""
    return {name: body_keys(body) for name, body in carried_loads(condition).items()}


def simulate_curl_study(folder: Path, study: CurlStudy) -> Path:
    """Simulate a study of curls, write it with its exact truth, and return the path of ``study.yaml``.

    The folder must be new or empty. It receives ``calibration/<subject>.c3d`` and ``.yaml``,
    ``<subject>/<trial>.c3d``, ``truth/<trial>/truth.json`` and ``truth.npz``, ``device.yaml`` and finally
    ``study.yaml``.

    StoreError is raised if the folder is not empty, or cannot be written.
    """
    create_folder(folder)
    common = json.dumps({"metronome_hz": 0.5, "device": "device.yaml", "loads": _loads("AC")})
    people, seed = study.subjects, study.options.seed
    head = f"""\
# {people} simulated people who curl in different conditions of a pneumatic device, {study.trials} trials of each.
# Made by `mocap-id simulate curl-study` with seed {seed}. The exact truth of each trial is in truth/<trial>/.
# Paths are relative to this file.
study: simulated-curl-study
out: runs
reference: AC  # condition that the others are compared with
defaults:
  space: 3d
  protocol: curl
  curl: {common}
subjects:  # kg
"""
    trials = tuple(curl_study_trials(study))
    # a trial of reaches for the calibration of each person, with the options of the person's first trial
    for first in {trial.subject: trial for trial in reversed(trials)}.values():
        options = replace(first.options, movement="reach", cycles=1, severity=0.1, condition="C")
        text = (
            f"trial: {first.subject}-calibration\nrecording: {first.subject}.c3d\nspace: 3d\nprotocol: reach\n"
            f"side: {options.side}\n"
        )
        recording = _markers(generate_arm(options))
        contents = {f"{first.subject}.c3d": recording, f"{first.subject}.yaml": text.encode()}
        write_files(folder / "calibration", contents)
    write_files(folder, {"device.yaml": device_yaml()})

    def measure(options: ArmOptions) -> _Measured:
        simulated = generate_arm(options)
        values = spatial_arrays(simulated)
        return _markers(simulated), arm_document(options, simulated), {name: values[name] for name in _KEPT}

    return _write_people(folder, head, trials, measure)
