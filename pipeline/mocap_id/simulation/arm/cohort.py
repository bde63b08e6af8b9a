"""Simulated reach studies on disk: several people with increasing limitation, both arms, several sessions.

A person has the same body in all trials. Markers are placed again in every session and on each arm, so that palpation
errors differ. The seed of each trial follows from the cohort's seed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np

from mocap_id.simulation.arm.arm import generate_arm
from mocap_id.simulation.arm.options import ArmOptions, Side
from mocap_id.simulation.arm.sensors import film_skeleton
from mocap_id.simulation.arm.truth import arm_document, arrays
from mocap_id.simulation.cohort import FILE
from mocap_id.simulation.options import check_options, option
from mocap_id.simulation.trial_files import create_folder, points_bytes, write_study_trial
from mocap_id.store.atomic import replace_together

_STUDY = """\
# {subjects} simulated people, each more limited than the one before; reaches of both arms in {sessions} sessions.
# Made by `mocap-id simulate reach-cohort` with seed {seed}. The exact truth of each trial is in truth/<trial>/.
# Paths are relative to this file.
study: simulated-reach-cohort
out: runs
defaults: {{space: 3d, protocol: reach}}
subjects:  # score: an estimate of Brooke's score for such a limitation; the first person has none
"""
_TRIAL = "  - {{trial: {}, subject: {}, session: {}, side: {}, recording: {}}}\n"
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
        rows += _TRIAL.format(trial.name, trial.subject, trial.session, trial.options.side, recording)
        simulated = generate_arm(trial.options)
        content = (
            film_skeleton(simulated, trial.options).csv()
            if cohort.skeletons
            else points_bytes(simulated.labels, simulated.positions, simulated.rate)
        )
        truth = arm_document(trial.options, simulated)
        write_study_trial(folder, trial.name, file, content, truth, arrays(simulated))
    text = _STUDY.format(subjects=cohort.subjects, sessions=cohort.sessions, seed=cohort.options.seed)
    for subject, score in people.items():
        text += f"  {subject}: {{}}\n" if score is None else f"  {subject}: {{score: {score}}}\n"
    replace_together(folder, {FILE: f"{text}trials:\n{rows}".encode()})
    return folder / FILE


def derive_seeds(*key: int) -> tuple[int, ...]:
    """Return three seeds that follow from the numbers ``key``, such as the cohort's seed and the person's number."""
    return tuple(int(each) for each in np.random.SeedSequence(key).generate_state(3))
