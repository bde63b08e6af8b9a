"""A small part of every page under docs/measured is measured again by the page's own benchmark.

Times and memory are not compared. Another machine rounds differently, so a figure may differ by 2 % or by one unit of
its last printed digit.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pages_of_docs import DOCS, ROOT

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
FIRST = {
    "accuracy": ("kinematic", "kinematic_sweep"),
    "dynamics": ("dynamic", "dynamic_sweep"),
    "intervals": ("loose-people", "loose_people"),
    "curls": ("curls", "curls"),
    "space": ("space", "space"),
    "sensors": ("sensors", "sensors"),
}
"""Pages whose tables have many trials: the section ``NAME-first`` has the first of them alone."""


@pytest.fixture(autouse=True)
def _benchmarks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The benchmarks import each other by name."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")


def read_section(page: str, name: str) -> str:
    text = (DOCS / "measured" / f"{page}.md").read_text("utf-8")
    return text.split(f"<!-- begin {name} -->")[1].split(f"<!-- end {name} -->")[0].strip()


def read_seed(text: str) -> int:
    return int(re.search(r"seeds? (?:from )?(\d+)", text)[1])


def pick_rows(table: str, *starts: str) -> list[str]:
    """Rows whose first cells are these."""
    rows = [line for line in table.splitlines() if line.startswith(tuple(f"| {start} |" for start in starts))]
    assert len(rows) >= len(starts), (starts, table)
    return rows


def list_differences(printed: str, fresh: str) -> Iterator[str]:
    """Yield the words and figures that are not the same."""
    if NUMBER.split(printed) != NUMBER.split(fresh):
        yield f"{printed!r} is now {fresh!r}"
        return
    for old, new in zip(NUMBER.findall(printed), NUMBER.findall(fresh), strict=True):
        mantissa, _, power = old.partition("e")
        digit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
        if abs(float(new) - float(old)) > max(1.01 * digit, 0.02 * abs(float(old))):
            yield f"{old} is now {new} in {printed!r}"


def assert_same(printed: list[str], fresh: list[str]) -> None:
    assert len(printed) == len(fresh), (printed, fresh)
    wrong = [each for pair in zip(printed, fresh, strict=True) for each in list_differences(*pair)]
    assert not wrong, "measure this page again:\n" + "\n".join(wrong)


def test_every_page_has_a_part_that_is_measured_again() -> None:
    others = {"cohort", "faults", "gaps-and-bursts", "reach", "real-trials", "scale"}  # one test each, below
    assert {page.stem for page in (DOCS / "measured").glob("*.md")} == FIRST.keys() | others


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("| 1.00 | `a` 2 |", "| 1.01 | `a` 2 |", True),
        ("| 1.00 |", "| 1.03 |", False),
        ("| 0.4 / 12 |", "| 0.5 / 12 |", True),
        ("| 0.4 / 12 |", "| 0.4 / 14 |", False),
        ("2e-06 %", "3e-06 %", True),
        ("2e-06 %", "5e-06 %", False),
        ("`gap` 1", "`other` 1", False),
        ("-0.01", "0.00", True),
    ],
)
def test_figures_are_compared_to_their_rounding(old: str, new: str, same: bool) -> None:
    assert (not list(list_differences(old, new))) == same


@pytest.mark.slow
@pytest.mark.parametrize("page", FIRST)
def test_the_first_trial_is_as_printed(page: str) -> None:
    name, module = FIRST[page]
    printed = read_section(page, f"{name}-first")
    fresh = importlib.import_module(module).make_first(read_seed(printed))
    assert_same(printed.splitlines(), fresh.splitlines())


@pytest.mark.slow
def test_the_first_person_of_the_cohort_is_as_printed(tmp_path: Path) -> None:
    cohort = importlib.import_module("cohort")
    options = replace(cohort.ORDINARY, seed=int(re.search(r"seed (\d+)", read_section("cohort", "cohort"))[1]))
    study = cohort.simulate_cohort(tmp_path / "study", cohort.Cohort(1, options=replace(options, repetitions=5)))
    found = cohort.measure(study, tmp_path / "trials", {}, 1)
    fresh = cohort.make_people_table(found.models)
    assert_same(*(pick_rows(table, "s01") for table in (read_section("cohort", "cohort-people"), fresh)))


@pytest.mark.slow
def test_a_fault_is_as_printed() -> None:
    faults = importlib.import_module("faults")
    printed, case = read_section("faults", "faults"), "all gains − 50 %"
    trials = int(re.search(r"on (\d+) trials", printed)[1])
    found = [faults.measure((case, read_seed(printed) + k)) for k in range(trials)]
    assert_same(pick_rows(printed, case), pick_rows(faults.make_table({case: found}), case))


@pytest.mark.slow
def test_a_gap_is_as_printed(tmp_path: Path) -> None:
    gaps = importlib.import_module("gaps")
    which, length, seed = "trunk", 0.5, read_seed(read_section("gaps-and-bursts", "gaps"))
    trials = [gaps.prepare(tmp_path / str(k), replace(gaps.harness.SHORT, seed=seed + k)) for k in range(4)]
    cells = [
        gaps._format_cell([gaps.run_case(trial, which, where, length) for trial in trials]) for where in gaps.WHERE
    ]
    row = " | ".join([f"| {which}", f"{length:g} s", *cells]) + " |"
    printed = pick_rows(read_section("gaps-and-bursts", "gaps-worst"), which)
    assert_same([each for each in printed if f"| {length:g} s |" in each], [row])


@pytest.mark.slow
def test_reaches_by_the_camera_are_as_printed() -> None:
    reach = importlib.import_module("reach")
    name = "depth camera, default"
    printed = read_section("reach", "reach").split(f"**{name}**")[1].split("\n**")[0]
    seed = read_seed(printed)
    fresh = reach.make_table(name, [reach.measure((name, seed, k)) for k in range(20)], seed)
    texts = [text.strip().splitlines() for text in (f"**{name}**{printed}", fresh)]
    assert_same(*([line for line in text if "processor time" not in line] for text in texts))


@pytest.mark.slow
@pytest.mark.recordings
@pytest.mark.usefixtures("recordings")
def test_a_real_trial_is_as_printed(recordings: Path, tmp_path: Path) -> None:
    real = importlib.import_module("real_trials")
    trial = real.run(recordings / "sit-to-stand", tmp_path, "squats1", "squats")
    inside = trial.done.facts["held_out"]["inside"]
    fresh: dict[str, Any] = {
        "real-gaps": real.make_gap_rows("squats1", trial),
        "real-inside": [["squats1", *(f"{100 * inside[key]:.0f} %" for key in real.SERIES)]],
        "real-clocks": [real.make_clock_row("squats1", trial)],
    }
    for name, rows in fresh.items():
        assert_same(pick_rows(read_section("real-trials", name), "squats1"), [f"| {' | '.join(row)} |" for row in rows])


@pytest.mark.slow
def test_the_size_of_a_run_is_as_printed(tmp_path: Path) -> None:
    parts, tables = importlib.import_module("scale_parts"), importlib.import_module("scale")
    fresh = tables.describe_storage(parts.measure_storage(tmp_path))
    assert_same(*(pick_rows(text, "all") for text in (read_section("scale", "scale-storage"), fresh)))
