"""A part of the benchmark behind docs/gaps.md, on a seed of its own: no gap ends in a silent wrong number."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "gaps.py"
SEED = 970_000
LENGTHS = (0.3, 3.0)


@pytest.fixture(scope="module")
def gaps() -> ModuleType:
    """The benchmark as a module."""
    spec = importlib.util.spec_from_file_location("gaps", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["gaps"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def found(gaps: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str, float], Any]:
    """Every run on one trial."""
    options = gaps.replace(gaps.OPTIONS, seed=SEED)
    material = gaps.prepare(tmp_path_factory.mktemp("gaps"), options)
    assert material is not None
    return {key: gaps.run_case(material, *key) for key in gaps.cases(LENGTHS)}


def test_what_is_given_is_within_five_standard_deviations(gaps: ModuleType, found: dict[Any, Any]) -> None:
    far = {key: case.worst() for key, case in found.items() if np.any(case.worst() > gaps.LIMIT)}
    assert not far


def test_what_is_not_given_is_flagged_and_said(found: dict[Any, Any]) -> None:
    for key, case in found.items():
        none = np.isnan(case.off).any(axis=2)
        assert np.array_equal(none, np.isnan(case.off).all(axis=2)), key
        assert not np.any(none & ~case.bridged), key
        assert case.cautioned == none.any(), key


def test_long_gaps_of_all_markers_are_not_filled_in(found: dict[Any, Any]) -> None:
    for where in ("start", "standing", "rising", "end"):
        case = found["all", where, 3.0]
        assert np.isnan(case.off[case.gap]).mean() > 0.5
        assert np.isfinite(found["all", where, 0.3].off).all()


def test_intervals_hold_the_truth_of_bridged_samples(gaps: ModuleType, found: dict[Any, Any]) -> None:
    """One trial tells the filter's part; the angle's own error, one draw, is in docs/state-coverage.md.

    That draw is the skin's: in a tenth of all trials, gaps or none, the angle's intervals hold 72 % of the samples.
    """
    share, total = gaps.coverage(list(found.values()), "bridged")
    assert total > 500
    assert np.all(share >= (0.72, 0.88, 0.88))
