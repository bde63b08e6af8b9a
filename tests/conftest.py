"""Where the shared recordings are, and the command line as a function, for every test."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; threads that wait for each other cost more

import pytest

from mocap_id_cli.__main__ import main

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of the shared recordings; the test is skipped where it is missing."""
    folder = Path(os.environ.get("MOCAP_ID_RECORDINGS", ROOT.parent / "shared" / "recordings"))
    if not folder.is_dir():
        pytest.skip(f"the shared recordings are not at {folder}: set MOCAP_ID_RECORDINGS")
    return folder


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
