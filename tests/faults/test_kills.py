"""A few of the kills of ``killing.py``."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from killing import Killing

SAMPLE = Path(__file__).resolve().parents[2] / "sample_trials" / "robot-joint" / "trial.yaml"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
@pytest.mark.filterwarnings("ignore:This process.*is multi-threaded:DeprecationWarning")
def test_killed_runs_resume_to_the_same(tmp_path: Path) -> None:
    killing = Killing(SAMPLE, tmp_path)
    done = list(killing.at_random(2, seed=7))
    assert sum(one.killed for one in done) == 2
    assert any(one.computed for one in done), "some were killed before they were done"
    between = list(killing.at_renamings(step=6))
    assert sum(one.killed for one in between) >= 3
