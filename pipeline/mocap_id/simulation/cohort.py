"""Simulated cohorts on disk: recordings of several persons with their truth, and a study that is ready to run.

A person keeps body, markers and skin in all trials. Motion, foot position, direction in the laboratory, drift of the
skin, drop-outs and noise differ between trials. Each trial has its own seed, derived from the cohort's, so that adding
persons, strategies or trials leaves the other trials unchanged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mocap_id.errors import ConfigError
from mocap_id.simulation.body import SimulatedBody
from mocap_id.simulation.options import Options
from mocap_id.simulation.schedule import STRATEGIES, Strategy
from mocap_id.simulation.simulated_trial import generate
from mocap_id.simulation.subject import Subject, draw_subject
from mocap_id.simulation.trial_files import c3d_bytes, new_folder, truth_json, truth_npz
from mocap_id.simulation.yaml_files import study_yaml
from mocap_id.store.atomic import replace_together, write_files

FILE = "study.yaml"
_STRATEGIES = tuple(STRATEGIES)


@dataclass(frozen=True)
class Cohort:
    """A cohort of simulated persons.

    Parameters
    ----------
    subjects : int
        Number of persons, alternately female and male.
    strategies : tuple of {"normal", "dynamic", "stable"}
    trials : int
        Trials of each person and strategy.
    options : Options
        Common options. The seed is the cohort's; each trial has its own strategy and subject.

    Raises
    ------
    ConfigError
        A value is out of range.
    """

    subjects: int = 6
    strategies: tuple[Strategy, ...] = _STRATEGIES
    trials: int = 1
    options: Options = field(default_factory=lambda: Options(seed=1))

    def __post_init__(self) -> None:
        known = bool(self.strategies) and set(self.strategies) <= set(STRATEGIES)
        checks = (
            ("subjects", self.subjects, 1 <= self.subjects <= 999, "1 … 999"),
            ("trials", self.trials, 1 <= self.trials <= 99, "1 … 99"),
            ("strategies", ",".join(self.strategies), known, "some of " + ", ".join(STRATEGIES)),
        )
        for name, value, fine, expected in checks:
            if not fine:
                raise ConfigError(f"simulate cohort: {name} is {value!r}; expected {expected}")
        if len(set(self.strategies)) < len(self.strategies):
            raise ConfigError(f"simulate cohort: a strategy is repeated in {','.join(self.strategies)!r}")


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
        """Path of its recording in the cohort's folder."""
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
    """Simulate a cohort and write it with its exact truth.

    Parameters
    ----------
    folder : Path
        A new or empty folder; receives ``<subject>/<strategy>-<number>.c3d``, ``truth/<trial>/truth.json`` and
        ``truth.npz``, and finally ``study.yaml``.
    cohort : Cohort

    Returns
    -------
    Path
        ``study.yaml``.

    Raises
    ------
    StoreError
        The folder is not empty, or cannot be written.
    NumericalError
        No lean of the trunk balances one of the bodies.
    """
    new_folder(folder)
    bodies: dict[Subject, SimulatedBody] = {}
    trials = tuple(cohort_trials(cohort))
    for trial in trials:
        simulated = generate("sit-to-stand", trial.options)
        bodies.setdefault(trial.subject, simulated.scene.body)
        truth = f"truth/{trial.name}"
        contents = {
            trial.file: c3d_bytes(trial.options, simulated),
            f"{truth}/truth.json": truth_json("sit-to-stand", trial.options, simulated),
            f"{truth}/truth.npz": truth_npz(simulated),
        }
        write_files(folder, contents)
    rows = [(trial.name, trial.subject.name, trial.strategy, trial.file) for trial in trials]
    text = study_yaml(cohort.options, bodies, rows)
    replace_together(folder, {FILE: text.encode()})
    return folder / FILE
