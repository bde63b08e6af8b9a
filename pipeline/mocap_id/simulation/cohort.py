"""Simulated cohorts on disk: recordings of several persons with their truth, and a study that is ready to run.

A person has the same body, markers and skin in all trials. Motion, foot position, direction in the laboratory, drift of
the skin, occlusions and noise differ between trials. The seed of each trial follows from the cohort's seed, so that
additional persons, strategies or trials leave the other trials unchanged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.simulation.body import SimulatedBody, Subject, draw_subject
from mocap_id.simulation.options import Options, check_options, option
from mocap_id.simulation.schedule import STRATEGIES, Strategy
from mocap_id.simulation.simulated_trial import generate
from mocap_id.simulation.trial_files import c3d_bytes, create_folder, write_study_trial
from mocap_id.simulation.truth import arrays, document
from mocap_id.simulation.yaml_files import study_yaml
from mocap_id.store.atomic import replace_together

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
