"""Simulated studies of curls on disk: several people, six conditions of a device, several trials of each.

How often a person curls before an attempt fails follows a model of fatigue: the capacity of the person, times the
effect of the condition, a response of the person to the condition, and a variation between trials. Compensation grows
while the person tires. A person keeps the body and the markers, and has a trial of reaches for the calibration.
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
from mocap_id.simulation.arm.cohort import seeds
from mocap_id.simulation.arm.curl_torque import described, loads
from mocap_id.simulation.arm.options import ArmOptions
from mocap_id.simulation.arm.pneumatic_device import CurlCondition, device_yaml
from mocap_id.simulation.arm.truth import arm_document, arrays
from mocap_id.simulation.cohort import FILE
from mocap_id.simulation.subject import draw_subject
from mocap_id.simulation.trial_files import json_bytes, new_folder, npz_bytes, points_bytes
from mocap_id.store.atomic import converting_errors, replace_together

EFFECTS: Mapping[CurlCondition, float] = {"C": 0.0, "AC": 0.0, "2": -0.23, "3": 0.0, "4": 0.0, "5": 0.82}
"""Change of the repetitions by each condition, as a share of those in AC; the sizes are the thesis's (8.3)."""
_CAPACITY = (8.0, 14.0)  # curls of a person in AC
_RESPONSE, _VARIATION = 0.06, 0.07  # standard deviations of the logarithm, of person and condition, and of a trial
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
    """A study of curls.

    Parameters
    ----------
    subjects : int
        Number of people.
    trials : int
        Trials of each person and condition.
    conditions : tuple of str
    options : ArmOptions
        Common options. The seed is the study's; each trial has its own repetitions and compensation.

    Raises
    ------
    ConfigError
        A value is out of range, or a condition is unknown.
    """

    subjects: int = 6
    trials: int = 3
    conditions: tuple[CurlCondition, ...] = get_args(CurlCondition)
    options: ArmOptions = field(default_factory=lambda: ArmOptions(seed=1, movement="curl", rate=100.0, failed=1))

    def __post_init__(self) -> None:
        for name, value, most in (("subjects", self.subjects, 99), ("trials", self.trials, 9)):
            if not 1 <= value <= most:
                raise ConfigError(f"simulate curl-study: {name} is {value!r}; expected 1 … {most}")
        unknown = [one for one in self.conditions if one not in EFFECTS]
        if unknown or "AC" not in self.conditions:
            expected = f"expected AC, and any of {', '.join(EFFECTS)}"
            raise ConfigError(f"simulate curl-study: conditions is {', '.join(self.conditions)!r}; {expected}")


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
    """Yield every trial, person by person; they do not depend on the numbers of people and trials."""
    for person in range(1, study.subjects + 1):
        body, markers, *_ = seeds(study.options.seed, person, 0, 0)
        of_person = np.random.default_rng([study.options.seed, person])
        capacity, moves = of_person.uniform(*_CAPACITY), np.exp(of_person.normal(0, 0.2))
        response = dict(zip(EFFECTS, np.exp(of_person.normal(0, _RESPONSE, len(EFFECTS))), strict=True))
        for condition in study.conditions:
            for number in range(1, study.trials + 1):
                own, *_ = seeds(study.options.seed, person, 1 + list(EFFECTS).index(condition), number)
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
    """Simulate a study of curls and write it with its exact truth.

    Parameters
    ----------
    folder : Path
        A new or empty folder; receives ``calibration/<subject>.c3d`` and ``.yaml``, ``<subject>/<trial>.c3d``,
        ``truth/<trial>/truth.json`` and ``truth.npz``, ``device.yaml`` and finally ``study.yaml``.
    study : CurlStudy

    Returns
    -------
    Path
        ``study.yaml``.

    Raises
    ------
    StoreError
        The folder is not empty, or cannot be written.
    """
    new_folder(folder)
    people, rows = "", ""
    known: set[str] = set()
    for trial in curl_study_trials(study):
        if trial.subject not in known:
            known.add(trial.subject)
            people += _person(trial)
            _calibrate(folder, trial)
        rows += _TRIAL.format(name=trial.name, subject=trial.subject, curl=_own_keys(trial.options.condition))
        _write(folder, trial)
    carried = {name: described(body) for name, body in loads("AC").items()}
    common = json.dumps({"metronome_hz": 0.5, "device": "device.yaml", "loads": carried})
    counts = {"subjects": study.subjects, "trials": study.trials, "seed": study.options.seed}
    text = _STUDY.format(curl=common, **counts) + people + "trials:\n" + rows
    replace_together(folder, {"device.yaml": device_yaml(), FILE: text.encode()})
    return folder / FILE


def _person(trial: CurlStudyTrial) -> str:
    seed = trial.options.subject or 0
    person = draw_subject(seed, 1 + seed % 2)
    return f"  {trial.subject}: {{mass: {person.mass:.2f}, sex: {person.sex}}}\n"


def _own_keys(condition: CurlCondition) -> str:
    keys: dict[str, object] = {"condition": condition}
    if condition == "C":
        keys["loads"] = {name: described(body) for name, body in loads(condition).items()}
    return json.dumps(keys)


def _calibrate(folder: Path, trial: CurlStudyTrial) -> None:
    options = replace(trial.options, movement="reach", cycles=1, severity=0.1, condition="C")
    simulated, place = generate_arm(options), folder / "calibration"
    with converting_errors(folder):
        place.mkdir(parents=True, exist_ok=True)
    text = _CALIBRATION.format(subject=trial.subject) + f"side: {options.side}\n"
    recording = points_bytes(simulated.labels, simulated.positions, simulated.rate)
    replace_together(place, {f"{trial.subject}.c3d": recording, f"{trial.subject}.yaml": text.encode()})


def _write(folder: Path, trial: CurlStudyTrial) -> None:
    simulated, truth = generate_arm(trial.options), f"truth/{trial.name}"
    file = f"{trial.subject}/{trial.name}.c3d"
    with converting_errors(folder):
        for name in (file, f"{truth}/truth.json"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
    exact = arrays(simulated)
    contents = {
        file: points_bytes(simulated.labels, simulated.positions, simulated.rate),
        f"{truth}/truth.json": json_bytes(arm_document(trial.options, simulated)),
        f"{truth}/truth.npz": npz_bytes({name: exact[name] for name in _KEPT}),
    }
    replace_together(folder, contents)
