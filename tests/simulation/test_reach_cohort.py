"""Simulated cohorts of people who reach: bodies that stay, markers that are placed anew, a study that is valid."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mocap_id.config.study import load_study
from mocap_id.errors import ConfigError
from mocap_id.recording import read
from mocap_id_simulation import ArmOptions, ReachCohort, generate_arm, simulate_arm, simulate_reach_cohort
from mocap_id_simulation.studies import reach_cohort_trials

SHORT = ArmOptions(seed=4, cycles=1, rate=30)


def test_a_cohort_is_a_study_that_is_valid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocap_id_simulation.arm_files.POINTS", 2**8)
    study = load_study(simulate_reach_cohort(tmp_path / "c", ReachCohort(2, 1, options=SHORT)))
    assert study.reach
    assert [(one.name, one.trial.keys.side) for one in study.trials] == [
        *[("s01-session1-right", "right"), ("s01-session1-left", "left")],
        *[("s02-session1-right", "right"), ("s02-session1-left", "left")],
    ]
    assert [person.score for person in study.subjects.values()] == [None, 5]
    truth = json.loads((tmp_path / "c" / "truth" / "s02-session1-left" / "truth.json").read_text())
    assert truth["options"]["severity"] == pytest.approx(0.8, abs=0.03)
    file = study.trials[0].trial.keys.recording.markers
    assert file is not None
    assert "EL" in read(file).labels


def test_a_person_keeps_the_body_and_gets_new_markers() -> None:
    first, left, second, _ = (
        generate_arm(one.options) for one in reach_cohort_trials(ReachCohort(1, 2, options=SHORT))
    )
    for other in (left, second):
        assert other.document["body"].upper_arm == first.document["body"].upper_arm
        assert np.abs(other.local - first.local).max() > 1e-3
    assert len(first.time) != len(second.time), "another course of the reaches"


def test_trials_do_not_depend_on_the_number_of_sessions() -> None:
    one, two = (list(reach_cohort_trials(ReachCohort(3, n, options=SHORT))) for n in (1, 2))
    assert [trial.options for trial in one] == [trial.options for trial in two if trial.keys["session"] == "session1"]


def test_markers_of_their_own_seed_leave_the_motion() -> None:
    trial, same = (
        simulate_arm(3, subject=8, rate=30, cycles=1),
        simulate_arm(3, subject=8, markers=8, rate=30, cycles=1),
    )
    np.testing.assert_array_equal(trial.true_positions, same.true_positions)
    other = simulate_arm(3, subject=8, markers=9, rate=30, cycles=1)
    np.testing.assert_array_equal(trial.rotations, other.rotations)
    assert np.abs(trial.local - other.local).max() > 1e-3


def test_a_cohort_of_nobody_is_an_error() -> None:
    with pytest.raises(ConfigError, match="`subjects` is 0; expected 1"):
        ReachCohort(0)
