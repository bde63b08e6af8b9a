"""No file is half-written, and two runs never share a folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mocap_id.errors import StoreError
from mocap_id.store import Document, Folder, Origin
from mocap_id.store.atomic import remove_leftovers, replace_together

ORIGIN = Origin("report", 1, {}, {}, "key", 0.0)


def test_all_files_or_none(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"old")
    (tmp_path / "b").mkdir()
    with pytest.raises(StoreError, match=r"b cannot be written: a folder has the name of the file"):
        replace_together(tmp_path, {"a": b"new", "b": b"new", "c": b"new"})
    assert (tmp_path / "a").read_bytes() == b"old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


@pytest.mark.parametrize("failure", [KeyboardInterrupt, MemoryError, OSError(28, "No space left on device")])
def test_whatever_interrupts_leaves_the_old_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException
) -> None:
    replace_together(tmp_path, {"a": b"old", "figures/b": b"old"})
    written: list[int] = []

    def fail_on_the_second(descriptor: int) -> None:
        written.append(descriptor)
        if len(written) == 2:
            raise failure

    monkeypatch.setattr(os, "fsync", fail_on_the_second)
    expected = StoreError if isinstance(failure, OSError) else failure
    with pytest.raises(expected):
        replace_together(tmp_path, {"a": b"new", "figures/b": b"new"})
    files = {str(path.relative_to(tmp_path)): path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert files == {"a": b"old", str(Path("figures/b")): b"old"}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a limit on file sizes")
def test_a_full_disk_is_explained(tmp_path: Path) -> None:
    """The system refuses to write in the middle of a file."""
    program = f"""
import resource, sys
from pathlib import Path
from mocap_id.errors import StoreError
from mocap_id.store.atomic import replace_together
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    replace_together(Path({str(tmp_path)!r}), {{"a": b"x" * 100, "b": b"x" * 5000}})
except StoreError as error:
    print(error)
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "b cannot be written: the file is larger than this system allows" in result.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a limit on file sizes")
def test_a_disk_that_fills_up_under_a_table_is_explained(tmp_path: Path) -> None:
    """The table is written in blocks: the old file stays, and no half-written file remains."""
    program = f"""
import resource, sys
from pathlib import Path
import numpy as np
from mocap_id.errors import StoreError
from mocap_id.store import Folder, LongTable, Origin
from mocap_id.store.provenance import MARKERS
folder = Folder(Path({str(tmp_path)!r}))
def table(frames):
    values = {{name: np.random.default_rng(0).normal(size=(frames, 40)) for name in ("x", "y", "residual")}}
    values["used"] = values["x"] > 0
    return LongTable(MARKERS, np.arange(frames), np.arange(frames) / 100, [f"M{{m}}" for m in range(40)], values)
origin = Origin("ukf-smooth", 1, {{}}, {{}}, "key", 0.0)
folder.write([table(10)], origin)
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
try:
    folder.write([table(20_000)], origin)
except StoreError as error:
    print(error)
print(len(folder.read("markers.parquet").frame))
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "markers.parquet cannot be written: the file is larger than this system allows" in result.stdout
    assert result.stdout.split()[-1] == "400"
    files = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert files == {"markers.parquet", ".mocap-id/ukf-smooth.json"}


def test_a_file_where_the_folder_should_be(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("not a folder")
    for out in (tmp_path / "runs", tmp_path / "runs" / "trial"):
        with pytest.raises(StoreError, match="there is a file where a folder is needed"), Folder(out).locked():
            pass


def test_a_second_run_is_rejected(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with Folder(out).locked():
        with pytest.raises(StoreError, match="in use by another run") as caught, Folder(out).locked():
            pass
        assert str(out) in str(caught.value)
    with Folder(out).locked():
        pass


def test_a_folder_of_too_long_a_name(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="the name is too long"), Folder(tmp_path / ("x" * 300) / "run").locked():
        pass


def test_a_run_that_writes_nothing_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    for out in (tmp_path / "runs" / "trial", tmp_path / "mine"):
        with Folder(out).locked():
            pass
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert list((tmp_path / "mine").iterdir()) == []


def test_leftovers_of_a_killed_run_are_removed(tmp_path: Path) -> None:
    (tmp_path / "figures").mkdir()
    for name in (
        ".planar.parquet.4711.mocap-id.tmp",
        "figures/.a.svg.12.mocap-id.tmp",
        ".mine.12.tmp",
        "planar.parquet",
    ):
        (tmp_path / name).write_text("x")
    with Folder(tmp_path).locked():
        names = sorted(path.name for path in tmp_path.rglob("*") if path.is_file() and path.name != "lock")
    assert names == [".mine.12.tmp", "planar.parquet"]
    remove_leftovers(tmp_path)


def test_outputs_are_made_no_older_than_their_inputs(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write([Document("report.html", b"x")], ORIGIN)
    source = tmp_path / "trial.yaml"
    source.write_text("x")
    report = tmp_path / "report.html"
    for ahead in (-100, 100):  # an input of yesterday leaves the output alone, one of tomorrow pulls it along
        stamp = report.stat().st_mtime_ns + ahead * 10**9
        os.utime(source, ns=(stamp, stamp))
        before = report.stat().st_mtime_ns
        folder.update_times(["report.html"], [source])
        assert report.stat().st_mtime_ns == (before if ahead < 0 else stamp)


def test_forgetting_a_stage_leaves_nothing_of_it(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.write([Document("report.html", b"x"), Document("figures/a.svg", b"y")], ORIGIN)
    folder.remove_outputs("report", ["report.html"])
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
