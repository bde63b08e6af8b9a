"""`mocap-id explain` knows every reason code, error and exit code, and names only existing settings."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mocap_id import errors
from mocap_id.errors import ConfigError, MocapIdError
from mocap_id.reporting.explanations import EXIT_CODES, EXPLANATIONS
from mocap_id.stages import STAGES
from mocap_id.stages.trial_keys import TrialKeys
from mocap_id.workflows.code_lookup import explain_code, list_entries

README = Path(__file__).resolve().parents[2] / "README.md"
ERRORS = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, MocapIdError)]


@pytest.mark.parametrize("code", sorted(EXPLANATIONS))
def test_stage_and_settings_of_a_criterion_exist(code: str) -> None:
    stage, measure = EXPLANATIONS[code].stage, EXPLANATIONS[code].criterion
    settings = {stage.name: set(stage.settings.model_fields) for stage in STAGES}
    assert stage in {*settings, "transfer"}
    assert measure.endswith(".")
    for where, key in re.findall(r"`([\w-]+): \{(\w+)\}`", measure):
        known = settings[where] if where in settings else set(TrialKeys.model_fields[where].annotation.model_fields)  # type: ignore[union-attr]
        assert key in known


def test_every_error_has_an_exit_code_that_is_explained() -> None:
    assert {entry.error for entry in EXIT_CODES.values() if entry.error} == set(ERRORS)
    for number, entry in EXIT_CODES.items():
        assert entry.error is None or entry.error.exit_code == number


def test_the_readme_lists_the_same_exit_codes() -> None:
    rows = re.findall(r"^\| ([\d, ]+) \|", README.read_text("utf-8"), flags=re.MULTILINE)
    assert {int(number) for row in rows for number in row.split(",")} == set(EXIT_CODES)


@pytest.mark.parametrize("answer", list_entries().values(), ids=lambda answer: answer.code)
def test_every_answer_is_complete(answer) -> None:
    for text in (answer.title, answer.meaning, answer.action):
        assert text.strip()
    assert answer.levels or answer.kind == "exit"
    assert explain_code(answer.code) == answer


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
def test_other_spellings_are_accepted(asked: str, code: str) -> None:
    assert explain_code(asked).code == code


def test_an_unknown_code_names_the_nearest() -> None:
    with pytest.raises(ConfigError, match="segments-unsure"):
        explain_code("segment-unsure")
    with pytest.raises(ConfigError, match="lists all"):
        explain_code("xyzzy")
