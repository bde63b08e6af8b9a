"""What the user names becomes trials, each once."""

from __future__ import annotations

from pathlib import Path

import pytest
from batch_cases import trials

from mocap_id.errors import ConfigError
from mocap_id.workflows.batch import find_trials

STUDY = """\
study: two
subjects: {s01: {}}
trials:
  - {trial: a, subject: s01, strategy: free, recording: link.trc}
  - {trial: b, subject: s01, strategy: free, recording: link.trc}
"""


def names(*named: str | Path) -> list[str]:
    found, unreadable = find_trials([str(name) for name in named])
    assert unreadable == []
    return [trial.name for trial in found]


def test_files_folders_and_patterns(tmp_path: Path) -> None:
    one, two = trials(tmp_path / "lab", ["one", "two"])
    (three,) = trials(tmp_path / "lab" / "monday", ["three"])
    (tmp_path / "lab" / "notes.yaml").write_text("someone: else's\n")
    assert names(two, one) == ["two", "one"]
    assert names(tmp_path / "lab") == ["three", "one", "two"], "sorted, below it too, and no other YAML"
    assert names(str(tmp_path / "**" / "t*.yaml")) == ["three", "two"]
    assert names(one, tmp_path / "lab", three) == ["one", "three", "two"], "each once"


def test_a_study_is_its_trials(tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_text(STUDY)
    assert names(tmp_path / "study.yaml") == ["a", "b"]


def test_a_file_that_is_no_trials_is_kept_apart(tmp_path: Path) -> None:
    (one,) = trials(tmp_path, ["one"])
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("trial: wrong\nrecordng: link.trc\n")
    found, ((file, error),) = find_trials([str(one), str(wrong)])
    assert [trial.name for trial in found] == ["one"]
    assert file == wrong
    assert "did you mean `recording`?" in str(error)


@pytest.mark.parametrize("named", ["nowhere/*.yaml", "."])
def test_a_name_that_fits_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, named: str) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match="expected a trial's or a study's YAML file"):
        find_trials([named])


def test_two_trials_do_not_share_a_folder(tmp_path: Path) -> None:
    one, two = trials(tmp_path, ["one", "two"])
    two.write_text(two.read_text().replace("trial: two", "trial: one"))
    with pytest.raises(ConfigError, match="give one of them a different `out:`"):
        find_trials([str(one), str(two)])
