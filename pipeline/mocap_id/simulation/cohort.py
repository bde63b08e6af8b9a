"""A simulated study on disk: several persons rise in several manners; recordings, truth, a study that is ready to run.

A person keeps body, markers and skin in all trials. What differs from one to the next is the motion, where the feet
stand, which way the person faces in the laboratory, how the skin wanders, drop-outs and noise. Every trial has seeds of
its own, drawn from the cohort's: more persons, strategies or trials leave those alone that were there before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mocap_id.errors import ConfigError, StoreError
from mocap_id.simulation.body import Body
from mocap_id.simulation.generate import generate
from mocap_id.simulation.options import Options
from mocap_id.simulation.schedule import MANNERS, Strategy
from mocap_id.simulation.study import study
from mocap_id.simulation.subject import Subject, draw_subject
from mocap_id.simulation.trial import packed, recording, told
from mocap_id.store.atomic import explained, replace_together

FILE = "study.yaml"
_STRATEGIES = tuple(MANNERS)


@dataclass(frozen=True)
class Cohort:
    """Who is recorded, and how often.

    Parameters
    ----------
    subjects : int
        Persons, women and men in turn.
    strategies : tuple of {"normal", "dynamic", "stable"}
    trials : int
        Of each person and strategy.
    options : Options
        Of every trial. The seed is the cohort's; strategy and subject are each trial's own.

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
        known = bool(self.strategies) and set(self.strategies) <= set(MANNERS)
        checks = (
            ("subjects", self.subjects, 1 <= self.subjects <= 999, "1 … 999"),
            ("trials", self.trials, 1 <= self.trials <= 99, "1 … 99"),
            ("strategies", ",".join(self.strategies), known, "some of " + ", ".join(MANNERS)),
        )
        for name, value, fine, expected in checks:
            if not fine:
                raise ConfigError(f"simulate cohort: {name} is {value!r}; expected {expected}")
        if len(set(self.strategies)) < len(self.strategies):
            raise ConfigError(f"simulate cohort: a strategy stands twice in {','.join(self.strategies)!r}")


@dataclass(frozen=True)
class CohortTrial:
    """One trial of a cohort."""

    subject: Subject
    strategy: Strategy
    number: int
    options: Options

    @property
    def name(self) -> str:
        """The trial's, such as ``s01-normal-1``."""
        return f"{self.subject.name}-{self.strategy}-{self.number}"

    @property
    def file(self) -> str:
        """Its recording, from the cohort's folder."""
        return f"{self.subject.name}/{self.strategy}-{self.number}.c3d"


def cohort_trials(cohort: Cohort) -> Iterator[CohortTrial]:
    """Every trial, person by person."""
    for person in range(1, cohort.subjects + 1):
        subject = draw_subject(cohort.options.seed, person)
        for strategy in cohort.strategies:
            for number in range(1, cohort.trials + 1):
                key = [cohort.options.seed, person, 1 + _STRATEGIES.index(strategy), number]
                seed = int(np.random.SeedSequence(key).generate_state(1)[0])
                options = replace(cohort.options, seed=seed, strategy=strategy, subject=subject)
                yield CohortTrial(subject, strategy, number, options)


def simulate_cohort(folder: Path, cohort: Cohort) -> Path:
    """Make a cohort with exact truth and write it.

    Parameters
    ----------
    folder : Path
        Made with its parents; gets ``<subject>/<strategy>-<number>.c3d``, ``truth/<trial>/truth.json`` and
        ``truth.npz``, and last of all ``study.yaml``.
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
    _check_empty(folder)
    bodies: dict[Subject, Body] = {}
    trials = tuple(cohort_trials(cohort))
    for trial in trials:
        made = generate("sit-to-stand", trial.options)
        bodies.setdefault(trial.subject, made.scene.body)
        truth = f"truth/{trial.name}"
        with explained(folder):
            (folder / truth).mkdir(parents=True, exist_ok=True)
        contents = {
            trial.file: recording(trial.options, made),
            f"{truth}/truth.json": told("sit-to-stand", trial.options, made),
            f"{truth}/truth.npz": packed(made),
        }
        replace_together(folder, contents)
    rows = [(trial.name, trial.subject.name, trial.strategy, trial.file) for trial in trials]
    text = study(cohort.options, bodies, rows)
    replace_together(folder, {FILE: text.encode()})
    return folder / FILE


def _check_empty(folder: Path) -> None:
    with explained(folder):
        if folder.exists() and any(folder.iterdir()):
            raise StoreError(f"{folder} is not empty: choose a new folder for the cohort")
