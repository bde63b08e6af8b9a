"""Simulated studies of curls on disk: several people, six conditions of a device, several trials of each.

A model of fatigue gives the number of curls until an attempt fails: the capacity of the person, times the effect of the
condition, the response of the person to the condition, and a variation between trials. Compensation increases with
fatigue. A person has the same body and markers in all trials, and a trial of reaches for the calibration.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.simulation.arm.arm import generate_arm
from mocap_id.simulation.arm.cohort import derive_seeds
from mocap_id.simulation.arm.curl_torque import body_keys, carried_loads, device_yaml
from mocap_id.simulation.arm.options import ArmOptions, CurlCondition
from mocap_id.simulation.arm.truth import arm_document, arrays
from mocap_id.simulation.body import draw_subject
from mocap_id.simulation.cohort import FILE
from mocap_id.simulation.options import check_options, option
from mocap_id.simulation.trial_files import create_folder, points_bytes, write_study_trial
from mocap_id.store.atomic import replace_together, write_files

EFFECTS: Mapping[CurlCondition, float] = {"C": 0.0, "AC": 0.0, "2": -0.23, "3": 0.0, "4": 0.0, "5": 0.82}
"""Relative change of the number of repetitions in each condition, compared with AC (thesis 8.3)."""
_CAPACITY = (8.0, 14.0)  # curls of a person in AC
_RESPONSE, _VARIATION = 0.06, 0.07  # standard deviations of the logarithms of the response and of the variation
_COMPENSATION: Mapping[CurlCondition, float] = {"C": 0.3, "AC": 0.3, "2": 0.6, "3": 0.3, "4": 0.3, "5": 0.3}
_KEPT = ("t", "isb_shoulder", "isb_elbow", "tau_total", "tau_device", "tau_human")
_STUDY = """\
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
_TRIAL = (
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
                    compensation=min(_COMPENSATION[condition] * moves, 2.0),
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
        rows += _TRIAL.format(name=trial.name, subject=trial.subject, curl=_condition_yaml(trial.options.condition))
        _write_trial(folder, trial)
    loads = {name: body_keys(body) for name, body in carried_loads("AC").items()}
    common = json.dumps({"metronome_hz": 0.5, "device": "device.yaml", "loads": loads})
    counts = {"subjects": study.subjects, "trials": study.trials, "seed": study.options.seed}
    text = _STUDY.format(curl=common, **counts) + people + "trials:\n" + rows
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
    values = arrays(simulated)
    truth = arm_document(trial.options, simulated)
    file = f"{trial.subject}/{trial.name}.c3d"
    write_study_trial(folder, trial.name, file, recording, truth, {name: values[name] for name in _KEPT})
