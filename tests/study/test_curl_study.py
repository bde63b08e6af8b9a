"""Tables, figures and page of a study of curls from given results."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from curl_cases import cohort

from mocap_id.config.study import load_study
from mocap_id.errors import ConfigError
from mocap_id.reporting.study import CohortData
from mocap_id.reporting.study.curls import render_curl_page
from mocap_id.workflows.study.arms import CURLS, ArmTrial
from mocap_id.workflows.study.study import average_people, sign_flip_p

COUNTS = {
    "C": [[10, 12], [8, 8], [6, 6]],
    "AC": [[10, 10], [8, 10], [5, 6]],
    "5": [[20, 15], [16, 15], [10, None]],
    "2": [[8, 8], [6, 7], [4, 4]],
}
STUDY = """\
study: curls
reference: {reference}
defaults: {{space: 3d, protocol: curl}}
subjects: {{p1: {{}}}}
trials:
  - {{trial: a, subject: p1, recording: a.c3d, curl: {{condition: C}}}}
  - {{trial: b, subject: p1, recording: b.c3d, curl: {{condition: AC}}}}
  - {{trial: c, subject: p1, recording: c.c3d{more}}}
"""


def frames(trials: Sequence[ArmTrial]) -> dict[str, pd.DataFrame]:
    return {name: table.frame for name, table in CURLS.make_tables(trials).items()}


def row(frame: pd.DataFrame, **chosen: str) -> pd.Series:
    for name, value in chosen.items():
        frame = frame[frame[name] == value]
    assert len(frame) == 1
    return frame.iloc[0]


def test_repetitions_are_normalised_by_person_and_number() -> None:
    trials = frames(cohort(COUNTS))["trials"].set_index("trial")
    assert trials.loc["p1-5-1", "normalised"] == 2.0
    assert trials.loc["p2-5-2", "normalised"] == 1.5
    assert (trials.loc[trials["condition"] == "AC", "normalised"] == 1.0).all()
    assert np.isnan(trials.loc["p3-5-2", "normalised"]), "the trial failed"
    assert trials.loc["p3-5-2", "verdict"] == "failed"


def test_differences_are_paired_and_of_people() -> None:
    found = frames(cohort(COUNTS))["comparisons"]
    five = row(found, comparison="5 - AC", measure="repetitions", subject="cohort")
    assert five[["people", "pairs"]].tolist() == [3, 5]
    expected = average_people([7.5, 6.5, 5.0])
    assert five["difference"] == pytest.approx(19 / 3)
    assert five["difference_low"] == pytest.approx(expected.low)
    assert five["p"] == pytest.approx(2 / 8)
    assert five["sd_within"] == pytest.approx(np.sqrt((12.5 + 4.5) / 2))
    assert five["sd_between"] == pytest.approx(np.std([7.5, 6.5, 5.0], ddof=1))
    assert row(found, comparison="5 - AC", measure="normalised", subject="p3")["difference"] == 1.0
    assert row(found, comparison="2 - AC", measure="shoulder_axial", subject="cohort")["difference"] == pytest.approx(1)
    assert "AC - C" not in set(found["comparison"]), "the reference is subtracted"
    assert {"5 - C", "2 - C", "2 - 5"} < set(found["comparison"])


def test_a_p_value_counts_signs() -> None:
    rng = np.random.default_rng(5)
    differences = rng.normal(0.5, 1, 8)
    signs = np.array(list(product((-1, 1), repeat=8)))
    assert sign_flip_p(differences.tolist()) == np.mean(np.abs(signs @ differences) >= abs(differences.sum()) - 1e-12)
    assert np.isnan(sign_flip_p([1.0]))
    many = rng.normal(0, 1, 30)
    assert 0 < sign_flip_p((many - many.mean()).tolist()) <= 1


def test_the_interval_and_p_value_are_honest_without_an_effect() -> None:
    rng = np.random.default_rng(6)
    drawn = [rng.normal(0, 1, 6).tolist() for _ in range(400)]
    assert np.mean([average_people(each).low < 0 < average_people(each).high for each in drawn]) == pytest.approx(
        0.95, abs=0.03
    )
    assert np.mean([sign_flip_p(each) <= 0.05 for each in drawn]) < 0.08


def test_the_page_shows_boxes_and_effects() -> None:
    trials = cohort(COUNTS)
    entries = tuple(one.entry(one.name, one.subject, f"../{one.name}/report.html") for one in trials)
    text = render_curl_page(CohortData("curls", entries, CURLS.make_tables(trials)), "AC").decode()
    for words in ("thesis figure 8.5", "Differences from AC", "5 - AC", "Compensation by condition", "23 of 24 trials"):
        assert words in text


def test_a_study_of_failed_trials_still_has_a_page() -> None:
    trials = cohort({"AC": [[None]], "5": [[None]]})
    entries = tuple(one.entry(one.name, one.subject, f"../{one.name}/report.html") for one in trials)
    data = CohortData("curls", entries, CURLS.make_tables(trials))
    assert b"No repetitions" in render_curl_page(data, "AC")


@pytest.mark.parametrize(
    ("reference", "more", "said"),
    [
        ("AD", ", curl: {condition: C}", "no trial has the condition `AD`"),
        ("C", "", r"`trials\[2\].curl` has no `condition`"),
        ("C", ", strategy: normal", "`trials[2].strategy` is not for `protocol: curl`"),
        ("C", ", protocol: reach", "`protocol: reach` and other protocols cannot be in one study"),
    ],
)
def test_mistakes_of_a_file_are_named(tmp_path: Path, reference: str, more: str, said: str) -> None:
    (tmp_path / "study.yaml").write_text(STUDY.format(reference=reference, more=more))
    with pytest.raises(ConfigError, match=said if "\\" in said else said.replace("[", r"\[").replace("]", r"\]")):
        load_study(tmp_path / "study.yaml")


def test_trials_are_numbered_within_person_and_condition(tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_text(STUDY.format(reference="AC", more=", curl: {condition: C}"))
    study = load_study(tmp_path / "study.yaml")
    assert study.reference == "AC"
    assert [(one.condition, one.number) for one in study.trials] == [("C", 1), ("AC", 1), ("C", 2)]
