"""The small study, run once."""

from __future__ import annotations

import pytest
from small_study import NAME, STUDY, Ran, record

from mocap_id.workflows.performing import Performed
from mocap_id.workflows.study import run


@pytest.fixture(scope="session")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    folder = tmp_path_factory.mktemp("study")
    record(folder / NAME)
    file = folder / "study.yaml"
    file.write_text(STUDY)
    told: list[Performed] = []
    return Ran(file, run(file, tell=told.append), tuple(told))
