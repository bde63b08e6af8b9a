"""benchmarks/claims.py: claims that are laws, on a small trial; every claim is on its page."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from mocap_id.workflows.sensitivity.perturbations import RerunInputs

ROOT = Path(__file__).resolve().parents[2]
EXACT = ("turn the other way", "nothing else moves", "mean up to 10 N rejected", "total mass alone", "mx1 + … alone")


@pytest.fixture
def claims(monkeypatch: pytest.MonkeyPatch):
    """The benchmark, which imports others by name."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("claims")


@pytest.mark.parametrize("words", EXACT)
def test_claims_that_are_laws_are_confirmed(claims, robot: RerunInputs, words: str) -> None:
    (claim,) = [claim for claim in claims.CLAIMS if words in claim.text]
    holds, said = claims.judge(claim, [claims.Case(robot)])
    assert holds
    assert said.value < 0.01


def test_a_filter_that_is_tuned_to_the_noise_of_the_angles_is_tried(claims, robot: RerunInputs) -> None:
    assert 0 < claims.measure_tuned_angles(claims.Case(robot)).value < 5


def test_one_trial_that_speaks_against_it_refutes_a_claim(claims) -> None:
    said = {"one": claims.Outcome(0.1), "two": claims.Outcome(0.7, "I2"), "three": claims.Outcome(0.6)}
    claim = claims.Claim("x", "", said.__getitem__, *claims._below(0.5))
    assert claims.judge(claim, list(said)) == (False, said["two"])
    assert claims.judge(claim, ["one"]) == (True, said["one"])


def test_the_page_has_every_claim(claims) -> None:
    page = (ROOT / "docs" / "sensitivity.md").read_text("utf-8")
    for claim in claims.CLAIMS:
        start = f"| {claim.letter} | {claim.text} | {claim.limit} |"
        (row,) = [line for line in page.splitlines() if line.startswith(start)]
        assert row.count("confirmed:") + row.count("refuted**:") == 4
