"""Part of the gap benchmark (docs/measured/gaps-and-bursts.md) with its own seed: no silent wrong number."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
SEED = 970_000
LENGTHS = (0.3, 3.0)


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def gaps() -> Iterator[ModuleType]:
    """The benchmark as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("gaps")


@pytest.fixture(scope="module")
def found(gaps: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str, float], Any]:
    """Return every run on one trial."""
    options = replace(gaps.harness.SHORT, seed=SEED)
    material = gaps.prepare(tmp_path_factory.mktemp("gaps"), options)
    assert material is not None
    return {key: gaps.run_case(material, *key) for key in gaps.list_cases(LENGTHS)}


def test_errors_are_within_five_standard_deviations(gaps: ModuleType, found: dict[Any, Any]) -> None:
    far = {key: case.worst() for key, case in found.items() if np.any(case.worst() > gaps.LIMIT)}
    assert not far


def test_missing_states_are_flagged_and_reported(found: dict[Any, Any]) -> None:
    for key, case in found.items():
        none = np.isnan(case.error).any(axis=2)
        assert np.array_equal(none, np.isnan(case.error).all(axis=2)), key
        assert not np.any(none & ~case.bridged), key
        assert case.cautioned == none.any(), key


def test_long_gaps_of_all_markers_are_not_filled_in(found: dict[Any, Any]) -> None:
    for where in ("start", "standing", "rising", "end"):
        case = found["all", where, 3.0]
        assert np.isnan(case.error[case.gap]).mean() > 0.5
        assert np.isfinite(found["all", where, 0.3].error).all()


def test_intervals_hold_the_truth_of_bridged_samples(gaps: ModuleType, found: dict[Any, Any]) -> None:
    """One trial tests the filter's part; the coverage of the angle over many trials is in docs/measured/intervals.md.

    Skin movement is one draw per trial: in a tenth of all trials, with or without gaps, 72 % of an angle's samples are
    inside.
    """
    share, total = gaps.measure_coverage(list(found.values()), "bridged")
    assert total > 500
    assert np.all(share >= (0.72, 0.88, 0.88))
