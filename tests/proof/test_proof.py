"""The proof that a change of the code changes no result: its corpus is complete, its snapshots repeat and differ."""

from __future__ import annotations

import re
import subprocess
import sys

from corpus import Case, list_cases

from mocap_id_simulation import Options
from proof import ROOT, compare, make_environment, read_commands, run_case, tidy


def test_every_case_has_its_own_name() -> None:
    names = [case.name for case in list_cases(read_commands(ROOT))]
    assert len(set(names)) == len(names)
    assert {"sample/sit-to-stand", "help/run", "study/cohort", "error/0-run"} <= set(names)


def test_every_option_and_fault_of_simulated_people_is_in_the_corpus() -> None:
    words = " ".join(command for case in list_cases(()) for command in case.commands)
    shown = subprocess.run(
        [sys.executable, "-m", "mocap_id_cli", "simulate", "sit-to-stand", "--help"],
        env=make_environment(ROOT), capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    options = set(re.findall(r"^  (--[a-z-]+)", shown, flags=re.MULTILINE)) - {"--help"}
    faults = set(
        re.findall(
            r"\b[a-z]+(?:_[a-zA-Z]+)+\b", " ".join(re.findall(r"(?:segments with|recording:)(.*?)\.\s", shown, re.S))
        )
    )
    assert options and faults
    assert {option for option in options if option not in words} == set()
    assert {fault for fault in faults if fault not in words} == set()
    assert Options().repetitions  # the options have defaults, so that each case changes one of them


def test_a_snapshot_repeats_and_a_difference_is_named() -> None:
    case = Case("one", ("explain no-chain", "run missing.yaml"))
    first, second = run_case(case, ROOT), run_case(case, ROOT)
    assert list(compare({"one": first}, {"one": second})) == []
    assert first["command 1"][0] == 2 and "missing.yaml" in first["command 1"][2]
    changed = first | {"command 0": [first["command 0"][0], "other text", ""]}
    (line,) = compare({"one": first}, {"one": changed})
    assert line.startswith("one | command 0 | 1") and "other text" in line
    assert tidy("took  0.31 s in FOLDER", "x") == "took TIME in FOLDER"
