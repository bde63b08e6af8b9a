"""A small part of benchmarks/kinematic_sweep.py, on other seeds."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
TRIALS = 5


@pytest.fixture(scope="module")
def sweep():
    """The benchmark as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("kinematic_sweep")


def test_a_clean_trial_is_recovered_exactly(sweep) -> None:
    result = sweep.measure(("clean", 41))
    assert result.right
    assert max(map(abs, result.error)) < 1e-3
    assert max(result.centre) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("row", "wrong"), [("ordinary", 0), ("hard", 2)])
def test_people_are_recovered_within_what_is_asked_of_most(sweep, row: str, wrong: int) -> None:
    results = [sweep.measure((row, 800_000 + seed)) for seed in range(TRIALS)]
    assert all(result.count == sweep.harness.SEGMENTS and result.wrong <= wrong for result in results)
    assert np.all(np.median([np.abs(result.error) for result in results], axis=0) < sweep.LENGTHS[row])
    assert np.all(np.median([result.centre for result in results], axis=0) < sweep.CENTRES[row])
