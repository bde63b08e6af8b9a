"""Full disks, folders without permissions and jumping clocks give a clear error and no half-written file."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mocap_id.recording.writer import write_trc
from swinging_link import LABELS, RATE, pendulum


@pytest.fixture
def trial(tmp_path: Path) -> Path:
    """A trial's file."""
    write_trc(tmp_path / "link.trc", LABELS, pendulum(), RATE)
    file = tmp_path / "trial.yaml"
    file.write_text("trial: link\nrecording: link.trc\nout: out\n")
    return file


@pytest.fixture
def small_files() -> Iterator[Callable[[int], None]]:
    """Limit the size of all files of this process, like a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def half_written(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.name.endswith(".mocap-id.tmp")]


@pytest.mark.parametrize("size", [2_000, 60_000])
def test_a_file_that_cannot_grow(cli: Callable[..., Any], trial: Path, small_files: Any, size: int) -> None:
    small_files(size)
    said = cli("run", trial)
    assert said.code == 6
    assert "cannot be written" in said.err
    assert half_written(trial.parent) == []
    small_files(resource.RLIM_INFINITY)
    assert cli("run", trial).code == 0


@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk takes root")
def test_a_full_disk(cli: Callable[..., Any], trial: Path, tmp_path: Path) -> None:
    disk = tmp_path / "out"
    disk.mkdir()
    if os.system(f"mount -t tmpfs -o size=100k none {disk} 2>/dev/null") != 0:
        pytest.skip("a small disk cannot be mounted here")
    try:
        said = cli("run", trial)
        assert said.code == 6
        assert "the disk is full: make room and run again" in said.err
        assert half_written(disk) == []
        os.system(f"mount -o remount,size=50m {disk}")
        assert cli("run", trial).code == 0
    finally:
        os.system(f"umount {disk}")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written(cli: Callable[..., Any], trial: Path) -> None:
    trial.parent.chmod(0o555)
    try:
        said = cli("run", trial)
    finally:
        trial.parent.chmod(0o755)
    assert said.code == 6
    assert "you may not write there" in said.err


def test_a_clock_that_jumps(cli: Callable[..., Any], trial: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cli("run", trial).code == 0
    for path in [*trial.parent.glob("*.*"), *(trial.parent / "out").glob("*.*")]:
        os.utime(path, (time.time() + 1e6, time.time() + 1e6))
    for now in (1.0, time.time() + 1e8):
        monkeypatch.setattr(time, "time", lambda now=now: now)
        said = cli("run", trial)
        assert said.code == 0
        assert said.err.count("reused") == 6


@pytest.mark.parametrize("command", ["run", "status", "clean"])
def test_a_folder_that_may_not_be_read(
    cli: Callable[..., Any], trial: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """`status` and `clean` must not report this as a failure of the program."""
    assert cli("run", trial).code == 0
    stat, out = Path.stat, trial.parent / "out"

    def closed(path: Path, **options: Any) -> os.stat_result:
        if out in path.parents:
            raise PermissionError(13, "Permission denied", str(path))
        return stat(path, **options)

    monkeypatch.setattr(Path, "stat", closed)
    said = cli(command, trial)
    assert said.code == (0 if command == "status" else 6)
    assert "permissions" in said.out + said.err
    assert "unforeseen" not in said.out + said.err
