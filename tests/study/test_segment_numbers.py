"""One number of segments for all trials of a person."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mocap_id.workflows.study import run_study
from mocap_id.workflows.study.study import Evidence, choose_counts, describe_counts


def people(**subjects: str) -> list[Any]:
    return [SimpleNamespace(name=name, subject=subject) for name, subject in subjects.items()]


def evidence(base: str = "foot", **costs: float) -> Evidence:
    by_number = {int(number.removeprefix("n")): cost for number, cost in costs.items()}
    return Evidence(min(by_number, key=lambda number: by_number[number]), base, by_number, "")


def test_the_number_with_the_smallest_sum_is_used() -> None:
    trials = people(a="s1", b="s1", c="s2")
    found = {
        "a": evidence(n4=-10.0, n5=-12.0),
        "b": evidence(n4=-20.0, n5=-15.0),
        "c": evidence(n5=-9.0, n4=-2.0),
    }
    assert choose_counts(trials, found) == {"a": 4}
    assert describe_counts(trials, found, {"a": 4}) == [
        "the number of segments of s1, 4, was chosen from all trials together; it changes a (alone 5)"
    ]


def test_trials_that_agree_or_have_no_common_number_stay_as_they_are() -> None:
    trials = people(a="s1", b="s1")
    same = {"a": evidence(n4=-10.0, n5=-9.0), "b": evidence(n4=-2.0, n3=-1.0)}
    assert choose_counts(trials, same) == {}
    assert describe_counts(trials, same, {}) == []
    apart = {"a": evidence(n4=0.0), "b": evidence(n5=0.0)}
    assert choose_counts(trials, apart) == {}
    assert "a 4, b 5" in describe_counts(trials, apart, {})[0]
    turning = {"a": evidence(n4=-2.0, n5=-1.0), "b": evidence("floor", n5=-2.0, n4=-1.0)}
    assert choose_counts(trials, turning) == {}, "with a foot that turns, 5 segments are another chain"


@pytest.mark.slow
@pytest.mark.recordings
def test_a_study_runs_a_deviating_trial_again_and_says_so(recordings: Path, tmp_path: Path) -> None:
    folder = recordings / "sit-to-stand"
    trials = [
        {
            **{"trial": name, "subject": "s01", "strategy": strategy},
            "recording": {"markers": str(folder / f"{file}.trc"), "forces": str(folder / f"{file}_grf.mot")},
        }
        for name, strategy, file in (("sts", "normal", "STS1"), ("squats", "squats", "squats1"))
    ]
    study = tmp_path / "study.yaml"
    keys = {"study": "two", "defaults": {"protocol": "sit-to-stand"}, "subjects": {"s01": {}}, "trials": trials}
    study.write_text(json.dumps(keys))
    first = run_study(study)
    summaries = [json.loads((tmp_path / "runs" / name / "summary.json").read_text()) for name in ("sts", "squats")]
    assert len({summary["segments"]["count"] for summary in summaries}) == 1
    notes = [note["code"] for summary in summaries for note in summary["verdict"]["notes"]]
    assert notes.count("segments-together") == len(first.document["segments"]) == 1
    assert "chosen from all trials together" in first.document["remarks"][0]
    again = run_study(study)
    assert again.reused
    assert not any(done.computed for done in again.runs)
