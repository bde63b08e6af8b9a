"""A few of the kills of ``make kills``."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from killing import kills

SAMPLE = Path(__file__).resolve().parents[2] / "sample_trials" / "robot-joint" / "trial.yaml"


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
@pytest.mark.filterwarnings("ignore:This process.*is multi-threaded:DeprecationWarning")
def test_killed_runs_resume_to_the_same() -> None:
    done = list(kills(SAMPLE, 5, seed=7))
    assert any(one.computed for one in done), "some were killed before they were done"
