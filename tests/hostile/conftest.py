"""A finished run, made once, and copies of it to damage."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import hostile_seeds
import pytest


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the swinging link's recordings, trial and finished run."""
    folder = tmp_path_factory.mktemp("made")
    hostile_seeds.finished(folder)
    return folder


@pytest.fixture
def copied(made: Path) -> Callable[[Path], Path]:
    """``copied(folder)``: the finished trial in another folder; its YAML."""

    def copy(folder: Path) -> Path:
        for name in ("link.yaml", "link.c3d"):
            shutil.copy(made / name, folder / name)
        shutil.copytree(made / "done", folder / "done")
        return folder / "link.yaml"

    return copy
