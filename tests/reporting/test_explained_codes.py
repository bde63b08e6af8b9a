"""`mocap-id explain` knows every code, every error and every exit code, and names no setting that does not exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mocap_id import errors
from mocap_id.errors import ConfigError, MocapIdError
from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.reporting.explanations.exits import EXITS
from mocap_id.reporting.explanations.judged import JUDGED
from mocap_id.stages import STAGES
from mocap_id.stages.base import TrialKeys
from mocap_id.workflows.explaining import answers, explain

README = Path(__file__).resolve().parents[2] / "README.md"
ERRORS = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, MocapIdError)]


def test_how_it_is_judged_is_told_of_every_code_and_no_other() -> None:
    assert set(JUDGED) == set(EXPLANATIONS)


@pytest.mark.parametrize("code", sorted(JUDGED))
def test_a_judge_and_its_settings_exist(code: str) -> None:
    stage, measure = JUDGED[code]
    settings = {stage.name: set(stage.settings.model_fields) for stage in STAGES}
    assert stage in {*settings, "transfer"}
    assert measure.endswith(".")
    for where, key in re.findall(r"`([\w-]+): \{(\w+)\}`", measure):
        known = settings[where] if where in settings else set(TrialKeys.model_fields[where].annotation.model_fields)  # type: ignore[union-attr]
        assert key in known


def test_every_error_has_an_exit_code_that_is_explained() -> None:
    assert {entry.error for entry in EXITS.values() if entry.error} == set(ERRORS)
    for number, entry in EXITS.items():
        assert entry.error is None or entry.error.exit_code == number


def test_the_readme_lists_the_same_exit_codes() -> None:
    rows = re.findall(r"^\| ([\d, ]+) \|", README.read_text("utf-8"), flags=re.MULTILINE)
    assert {int(number) for row in rows for number in row.split(",")} == set(EXITS)


@pytest.mark.parametrize("answer", answers().values(), ids=lambda answer: answer.code)
def test_every_answer_is_whole(answer) -> None:
    for text in (answer.title, answer.meaning, answer.action):
        assert text.strip()
    assert answer.levels or answer.kind == "exit"
    assert explain(answer.code) == answer


@pytest.mark.parametrize(
    ("asked", "code"),
    [
        ("Segments_Unsure", "segments-unsure"),
        ("4", "exit-4"),
        ("StoreError", "exit-6"),
        ("store-error", "exit-6"),
        ("130", "exit-130"),
        ("refused", "exit-4"),
    ],
)
def test_other_ways_to_ask(asked: str, code: str) -> None:
    assert explain(asked).code == code


def test_an_unknown_code_names_the_nearest() -> None:
    with pytest.raises(ConfigError, match="segments-unsure"):
        explain("segment-unsure")
    with pytest.raises(ConfigError, match="lists all"):
        explain("xyzzy")
