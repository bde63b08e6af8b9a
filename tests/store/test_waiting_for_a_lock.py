"""A run can wait until another run of the same folder has ended."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from mocap_id.errors import StoreError
from mocap_id.store import Folder


def test_a_run_waits_for_another(tmp_path: Path) -> None:
    held, ended = threading.Event(), []

    def hold() -> None:
        with Folder(tmp_path / "run").locked():
            held.set()
            time.sleep(0.4)
            ended.append(1)

    other = threading.Thread(target=hold)
    other.start()
    held.wait()
    with pytest.raises(StoreError, match="in use by another run"), Folder(tmp_path / "run").locked():
        pass
    with Folder(tmp_path / "run").locked(wait=20.0):
        assert ended
    other.join()
