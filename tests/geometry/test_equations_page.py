"""docs/equations.md names every equation once and only functions that exist."""

from __future__ import annotations

import importlib
import re
from collections import Counter
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "equations.md"
EQUATIONS = {2: 57, 3: 18, 4: 26, 5: 1, 6: 1, 7: 20}
ROW = re.compile(r"^\| (\d\.\d+[^|]*)\|", re.MULTILINE)
NAME = re.compile(r"`((?:geometry|kinematics|estimation|dynamics|mocap_id_assist)\.[\w.]+)`")


def numbers(cell: str):
    for part in cell.split(","):
        first, _, last = part.strip().partition("–")
        chapter, start = (int(x) for x in first.split("."))
        end = int(last.split(".")[1]) if last else start
        yield from ((chapter, number) for number in range(start, end + 1))


def find(name: str):
    """Return the object named ``package.module.attribute…``."""
    parts = name.split(".")
    package = "" if parts[0] == "mocap_id_assist" else "mocap_id."
    module = importlib.import_module(package + ".".join(parts[:2]))
    found = module
    for part in parts[2:]:
        found = getattr(found, part)
    return found


def test_every_equation_has_one_row():
    listed = Counter(number for cell in ROW.findall(PAGE.read_text(encoding="utf-8")) for number in numbers(cell))
    expected = {(chapter, i) for chapter, count in EQUATIONS.items() for i in range(1, count + 1)}
    assert set(listed) == expected
    assert max(listed.values()) == 1


@pytest.mark.parametrize("name", sorted(set(NAME.findall(PAGE.read_text(encoding="utf-8")))))
def test_every_function_named_exists(name):
    assert find(name) is not None
