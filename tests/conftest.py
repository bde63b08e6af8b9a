"""Where the shared recordings are, for every test."""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; threads that wait for each other cost more

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of the shared recordings; the test is skipped where it is missing."""
    folder = Path(os.environ.get("MOCAP_ID_RECORDINGS", ROOT.parent / "shared" / "recordings"))
    if not folder.is_dir():
        pytest.skip(f"the shared recordings are not at {folder}: set MOCAP_ID_RECORDINGS")
    return folder
