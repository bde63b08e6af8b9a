"""The settings file and the plan: what is tried, and what is said of mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_id.errors import ConfigError
from mocap_id.workflows.sensitivity.perturbations import (
    ALL_KINDS,
    KINDS,
    KindSelection,
    SensitivityOptions,
    plan,
    read_options,
)

LEG = ("ankle", "knee", "hip")
MISTAKES = [
    ("- kind: clock-ofset", "line 1", "did you mean `clock-offset`?"),
    ("- kind: drop-outs\n  levels: [0.1, 1.5]", "line 2", "the level 1.5 is not a fraction of at least 0 and below 1"),
    ("- kind: marker-count\n  levels: [2.5]", "line 2", "a whole number of markers"),
    ("- kind: soft-tissue\n  on: [knee]", "line 2", "acts on everything"),
    ("- kind: wrench-bias\n  on: [Fz]", "line 2", "expected one of Fx, Fy, tauz"),
    ("- kind: filter-noise\n  on: [soft]", "line 2", "a marker's standard deviation above 0"),
    ("- kind: angle-bias\n  level: [0.1]", "line 2", "did you mean `levels`?"),
    ("perturbations: []\ntolerence: 3", "line 2", "did you mean `tolerance`?"),
    ("tolerance: 0", "line 1", "greater than 0"),
    ("- levels: [0.1]", "line 1", "`perturbations[0].kind` is missing"),
    ("just words", "line 1", "expected a list of perturbations"),
]


def asked(folder: Path, text: str) -> SensitivityOptions:
    file = folder / "asked.yaml"
    file.write_text(text)
    return read_options(file)


@pytest.mark.parametrize(("text", "line", "said"), MISTAKES)
def test_a_mistake_is_told_with_its_line(tmp_path: Path, text: str, line: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        asked(tmp_path, text)
    assert f"asked.yaml, {line}: " in str(error.value)
    assert said in str(error.value)


def test_every_mistake_is_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        asked(tmp_path, "- kind: nonsense\n- kind: drop-outs\n  levels: [2]\n")
    assert len(str(error.value).splitlines()) == 2


def test_a_list_alone_and_the_whole_form_say_the_same(tmp_path: Path) -> None:
    entries = "- kind: filter-noise\n  on: [0.001]\n  levels: [100]\n- kind: frame-rate\n"
    whole = "seed: 1\nperturbations:\n" + "".join(f"  {line}\n" for line in entries.splitlines())
    assert asked(tmp_path, entries) == asked(tmp_path, whole)
    assert asked(tmp_path, entries).selections == (
        KindSelection("filter-noise", (100.0,), ("0.001",)),
        KindSelection("frame-rate"),
    )


def test_without_perturbations_everything_is_tried(tmp_path: Path) -> None:
    found = asked(tmp_path, "seed: 7\ntolerance: 10\n")
    assert found == SensitivityOptions(ALL_KINDS, 7, 0.10)


def test_only_some_kinds() -> None:
    assert SensitivityOptions().only(["frame-rate"]).selections == (KindSelection("frame-rate"),)
    assert SensitivityOptions().only([]) == SensitivityOptions()
    with pytest.raises(ConfigError, match="did you mean `wrench-bias`"):
        SensitivityOptions().only(["wrench_bas"])
    with pytest.raises(ConfigError, match="does not contain these kinds"):
        SensitivityOptions((KindSelection("frame-rate"),)).only(["drop-outs"])


def test_by_default_there_are_sixty_or_more_of_all_kinds() -> None:
    for joints in (LEG, ("elbow",)):
        changes = plan(ALL_KINDS, joints)
        assert len(changes) >= 60
        assert {change.kind for change in changes} == set(KINDS)
        assert len({change.name for change in changes}) == len(changes)


def test_a_joint_that_is_not_there_is_told_with_those_that_are() -> None:
    with pytest.raises(ConfigError, match="no 'elbow' to perturb in this trial; expected one of ankle, knee, hip, all"):
        plan((KindSelection("angle-bias", (), ("elbow",)),), LEG)


def test_nothing_is_tried_twice() -> None:
    assert len(plan((KindSelection("frame-rate", (2, 2)), KindSelection("frame-rate", (2,))), LEG)) == 1
