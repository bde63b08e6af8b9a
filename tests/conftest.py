"""Where the shared recordings are, and the command line as a function, for every test."""

from __future__ import annotations

import logging
import os
import pickle
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; threads that wait for each other cost more

import pytest
from filelock import FileLock
from hypothesis import HealthCheck, settings

from mocap_id_cli.__main__ import main

ROOT = Path(__file__).resolve().parent.parent

# The duration of an example depends on the load of the machine; it says nothing about a law.
settings.register_profile("laws", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("laws")


@pytest.fixture(autouse=True)
def no_log_of_an_earlier_command() -> Iterator[None]:
    """The command line logs to the standard error of one test; a thread of Dask may still log when it is closed."""
    before = logging.root.handlers[:]
    yield
    for handler in logging.root.handlers[:]:
        if handler not in before:
            logging.root.removeHandler(handler)


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of the shared recordings; the test is skipped where it is missing."""
    folder = Path(os.environ.get("MOCAP_ID_RECORDINGS", ROOT.parent / "shared" / "recordings"))
    if not folder.is_dir():
        pytest.skip(f"the shared recordings are not at {folder}: set MOCAP_ID_RECORDINGS")
    return folder


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], Any]], Any]:
    """``once(name, make)``: what ``make(folder)`` gives, computed by one of the processes that share the tests.

    It reaches the others pickled; the folder stays, and nobody may change what is in it.
    """
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent  # each worker has its own below it

    def made(name: str, make: Callable[[Path], Any]) -> Any:
        kept = base / f"{name}.pickle"
        with FileLock(base / f"{name}.lock"):
            if not kept.exists():
                kept.write_bytes(pickle.dumps(make(Path(tempfile.mkdtemp(prefix=f"{name}-", dir=base)))))
        return pickle.loads(kept.read_bytes())

    return made


@dataclass(frozen=True)
class Said:
    """What a command did."""

    code: int
    out: str
    err: str


@pytest.fixture
def cli(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """``cli("run", path)``: exit code and output; there is never a traceback."""

    def call(*arguments: object) -> Said:
        monkeypatch.setattr(sys, "argv", ["mocap-id", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main()
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        code = left.value.code
        assert code is None or isinstance(code, int)
        return Said(code or 0, out, err)

    return call
