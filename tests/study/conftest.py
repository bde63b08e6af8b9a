"""The small study, run once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from small_study import NAME, STUDY, Ran, record

from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study import run_study


@pytest.fixture(scope="session")
def ran(once: Callable[..., Any]) -> Ran:
    found: Ran = once("study", _run)
    return found


def _run(folder: Path) -> Ran:
    record(folder / NAME)
    file = folder / "study.yaml"
    file.write_text(STUDY)
    told: list[TrialRun] = []
    return Ran(file, run_study(file, tell=told.append), tuple(told))
