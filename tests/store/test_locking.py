"""A run folder is used by one run at a time, also on disks without locks."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mocap_id.errors import StoreError
from mocap_id.store import Folder, atomic

fcntl = pytest.importorskip("fcntl")
WITHOUT = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)
SCRIPT = """
import fcntl, os, pathlib, signal, sys
def flock(descriptor, operation):
    raise OSError(int(sys.argv[1]), "none here")
fcntl.flock = flock
from mocap_id.store import Folder
with Folder(pathlib.Path(sys.argv[2])).locked():
    (pathlib.Path(sys.argv[2]) / "kept").touch()
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture(params=WITHOUT, ids=[errno.errorcode[number] for number in WITHOUT])
def disk(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run folder on a disk that knows no locks, which was held elsewhere before: its lock's file is there."""
    with Folder(tmp_path / "run").locked():
        (tmp_path / "run" / "kept").touch()
    monkeypatch.setattr(fcntl, "flock", lambda *_: (_ for _ in ()).throw(OSError(request.param, "none here")))
    return tmp_path / "run"


def test_one_run_at_a_time(disk: Path) -> None:
    turned_away = pytest.raises(StoreError, match=r"in use by another run.*delete .*lock\.held")
    with Folder(disk).locked(), turned_away, Folder(disk).locked():
        pass
    with Folder(disk).locked():
        pass
    assert {path.name for path in (disk / ".mocap-id").iterdir()} <= {atomic.LOCK}


@pytest.mark.parametrize("number", WITHOUT)
def test_a_killed_run_keeps_no_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    ended = subprocess.run([sys.executable, "-c", SCRIPT, str(number), tmp_path], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert (tmp_path / ".mocap-id" / atomic.MARKER).exists()
    monkeypatch.setattr(fcntl, "flock", lambda *_: (_ for _ in ()).throw(OSError(number, "none here")))
    with Folder(tmp_path).locked():
        pass
    assert not (tmp_path / ".mocap-id" / atomic.MARKER).exists()


def test_a_run_that_writes_nothing_leaves_nothing_there_either(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fcntl, "flock", lambda *_: (_ for _ in ()).throw(OSError(errno.ENOLCK, "none here")))
    with Folder(tmp_path / "runs" / "trial").locked():
        pass
    assert list(tmp_path.iterdir()) == []


def test_any_other_failure_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fcntl, "flock", lambda *_: (_ for _ in ()).throw(OSError(errno.EIO, "Input/output error")))
    with pytest.raises(StoreError, match="Input/output error"), Folder(tmp_path).locked():
        pass


@pytest.mark.slow
def test_several_runs_at_the_same_time(tmp_path: Path) -> None:
    """Testing for locks does not break any: of several runs that start together, one gets the folder."""
    script = (
        "import pathlib, sys, time; from mocap_id.store import Folder; from mocap_id.errors import StoreError\n"
        "begin = float(sys.argv[2])\n"
        "while time.time() < begin: pass\n"
        "try:\n"
        "    with Folder(pathlib.Path(sys.argv[1])).locked():\n"
        "        (pathlib.Path(sys.argv[1]) / 'kept').touch(); time.sleep(1.5)\n"
        "    print('held')\n"
        "except StoreError as error: print(error)\n"
    )
    import time

    begin = str(time.time() + 4.0)
    command = [sys.executable, "-c", script, str(tmp_path), begin]
    several = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=dict(os.environ)) for _ in range(4)]
    said = [process.communicate(timeout=60)[0] for process in several]
    assert sum(text == "held\n" for text in said) == 1, said
    assert sum("in use by another run" in text for text in said) == 3, said
