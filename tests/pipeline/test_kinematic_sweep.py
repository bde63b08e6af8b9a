"""A small part of the sweep behind docs/kinematic-sweep.md, on seeds of its own."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "kinematic_sweep.py"
TRIALS = 8


@pytest.fixture(scope="module")
def sweep():
    """The benchmark as a module."""
    spec = importlib.util.spec_from_file_location("kinematic_sweep", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["kinematic_sweep"] = module
    spec.loader.exec_module(module)
    return module


def test_a_clean_trial_is_recovered_exactly(sweep) -> None:
    result = sweep.measure(("clean", 41))
    assert result.right
    assert max(map(abs, result.error)) < 1e-3
    assert max(result.centre) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("row", "wrong"), [("ordinary", 0), ("hard", 2)])
def test_people_are_recovered_within_what_is_asked_of_most(sweep, row: str, wrong: int) -> None:
    results = [sweep.measure((row, 800_000 + seed)) for seed in range(TRIALS)]
    assert all(result.count == sweep.COUNT and result.wrong <= wrong for result in results)
    assert np.all(np.median([np.abs(result.error) for result in results], axis=0) < sweep._LENGTHS[row])
    assert np.all(np.median([result.centre for result in results], axis=0) < sweep._CENTRES[row])
