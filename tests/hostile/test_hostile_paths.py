"""Only plain files are read, and nothing is written or deleted outside the run folder."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import hostile_seeds
import pytest

from mocap_id import plain_files, recording, runner
from mocap_id.config import load
from mocap_id.errors import ConfigError, MocapIdError, RecordingError, StoreError
from mocap_id.store import Document, Folder, Origin
from mocap_id.store.atomic import replace_together

ORIGIN = Origin("report", 1, {}, {}, "key", 0.0)
pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a system with pipes")


def spoilt(folder: Path, kind: str) -> Path:
    """Something that is not a plain file."""
    path = folder / "thing.c3d"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "ring":
        path.symlink_to(path.name)
    elif kind == "huge":
        with path.open("wb") as stream:
            stream.truncate(plain_files.LARGEST + 1)  # a hole: it takes no room on the disk
    elif kind == "device":
        return Path("/dev/zero")
    elif kind == "link to a device":
        path.symlink_to("/dev/zero")
    elif kind == "NUL":
        return folder / "a\0b.c3d"
    else:
        return folder / "x" / ".." / ("n" * 300)
    return path


KINDS = ("pipe", "folder", "ring", "huge", "device", "link to a device", "NUL", "long name")


@pytest.mark.parametrize("kind", KINDS)
def test_only_plain_files_are_read(tmp_path: Path, kind: str) -> None:
    path = spoilt(tmp_path, kind)
    with pytest.raises(RecordingError, match=r"no such file|folder|cannot be read"):
        recording.read(path)
    trial = tmp_path / "trial.yaml"
    trial.write_text(json.dumps({"trial": "t", "recording": str(path)}))
    with pytest.raises(RecordingError, match=r"named as `recording.markers`"):
        runner.run(load(trial))
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("kind", KINDS)
def test_a_configuration_is_a_plain_file_too(tmp_path: Path, kind: str) -> None:
    with pytest.raises(ConfigError, match="expected a YAML file"):
        load(spoilt(tmp_path, kind))


@pytest.mark.parametrize("kind", ["pipe", "folder", "ring", "link to a device"])
def test_an_artefact_is_a_plain_file_too(tmp_path: Path, kind: str) -> None:
    spoilt(tmp_path, kind).rename(tmp_path / "planar.parquet")
    with pytest.raises(StoreError, match=r"planar.parquet cannot be read .*: delete it and run again"):
        Folder(tmp_path).read("planar.parquet")


def test_a_recording_may_be_a_link(tmp_path: Path) -> None:
    (tmp_path / "there.c3d").write_bytes(hostile_seeds.c3d(False)[0].data)
    (tmp_path / "here.c3d").symlink_to("there.c3d")
    assert len(recording.read(tmp_path / "here.c3d").frames) == 40


def test_a_file_that_grows_while_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "grows"
    path.write_bytes(b"one")
    changed = pytest.raises(plain_files.ChangedError, match="changed while it was being read")
    with changed, plain_files.open_file(path) as stream:
        stream.read()
        with path.open("ab") as more:
            more.write(b"two")


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A folder outside a run that must not change."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "precious").write_text("mine")
    return folder


def untouched(elsewhere: Path) -> bool:
    return [path.name for path in elsewhere.iterdir()] == ["precious"] and (
        (elsewhere / "precious").read_text() == "mine"
    )


@pytest.mark.parametrize("name", ["../x", "/x", "a/../../x", "..", "", "a\0b", "a\\..\\x", "figures/../../x"])
def test_a_name_that_leads_out_is_not_written(tmp_path: Path, name: str) -> None:
    run = tmp_path / "run"
    run.mkdir()
    with pytest.raises(StoreError, match="not an allowed name"):
        replace_together(run, {"sound": b"1", name: b"2"})
    with pytest.raises(StoreError, match="not an allowed name"):
        Folder(run).remove([name])
    assert [path.name for path in tmp_path.rglob("*")] == ["run"]


def test_a_linked_subfolder_is_not_written_through(tmp_path: Path, elsewhere: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / "figures").symlink_to(elsewhere)
    folder = Folder(run)
    with pytest.raises(StoreError, match="symbolic link"):
        folder.write([Document("figures/precious", b"x")], ORIGIN)
    with pytest.raises(StoreError, match="symbolic link"):
        folder.remove(["figures/precious"])
    assert untouched(elsewhere)


def test_a_linked_file_is_replaced_and_not_written_through(tmp_path: Path, elsewhere: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    temporary = run / f".report.html.{os.getpid()}.mocap-id.tmp"
    for path in (run / "report.html", temporary):
        path.symlink_to(elsewhere / "precious")
    Folder(run).write([Document("report.html", b"x")], ORIGIN)
    assert (run / "report.html").read_bytes() == b"x"
    assert not (run / "report.html").is_symlink()
    assert not temporary.is_symlink()
    assert untouched(elsewhere)


@pytest.mark.parametrize("what", [".mocap-id", ".mocap-id/lock"])
def test_a_linked_lock_is_not_followed(tmp_path: Path, elsewhere: Path, what: str) -> None:
    run = tmp_path / "run"
    (run / what).parent.mkdir(parents=True)
    (run / what).symlink_to(elsewhere if what == ".mocap-id" else elsewhere / "precious")
    with pytest.raises(StoreError, match="delete it and run again"), Folder(run).locked():
        pass
    assert untouched(elsewhere)


def test_leftovers_are_not_sought_behind_links(tmp_path: Path, elsewhere: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (elsewhere / "precious").rename(elsewhere / ".x.1.mocap-id.tmp")
    (run / "figures").symlink_to(elsewhere)
    with Folder(run).locked():
        pass
    assert (elsewhere / ".x.1.mocap-id.tmp").exists()


@pytest.mark.parametrize(
    "documents",
    [
        {"../elsewhere/precious": ""},
        {"planar.parquet": ""},
        {".mocap-id/lock": ""},
        {"figures": ""},
        {"a\0b": ""},
        {"\ud800": ""},
        {"x" * 5000: ""},
        [],
        ["report.html"],
        None,
        1,
    ],
)
def test_a_record_deletes_nothing_but_what_was_written(tmp_path: Path, elsewhere: Path, documents: object) -> None:
    """Run folders are passed on, with records that somebody may have edited."""
    run = tmp_path / "run"
    (run / "figures").mkdir(parents=True)
    folder = Folder(run)
    folder.write([Document("report.html", b"one"), Document("figures/a.svg", b"two")], ORIGIN)
    (run / "planar.parquet").write_bytes(b"of another stage")
    record = run / ".mocap-id" / "report.json"
    strings = json.loads(record.read_text())
    record.write_text(json.dumps(strings | {"documents": json.dumps(documents)}))
    folder.remove_outputs("report", [])
    assert untouched(elsewhere)
    assert {"planar.parquet", "figures"} <= {path.name for path in run.iterdir()}
    assert folder.origin("report", ["report.html"]) is None


def test_what_somebody_has_changed_is_not_deleted_as_ours(tmp_path: Path) -> None:
    """A record may name the user's own files if the user's folder is the run folder."""
    folder = Folder(tmp_path)
    folder.write([Document("report.html", b"one"), Document("figures/a.svg", b"two")], ORIGIN)
    (tmp_path / "figures" / "a.svg").write_bytes(b"drawn over")
    folder.remove_outputs("report", ["report.html"])
    assert (tmp_path / "figures" / "a.svg").exists()
    assert not (tmp_path / "report.html").exists()


def test_an_out_that_is_a_link_is_somebodys_choice(tmp_path: Path, elsewhere: Path) -> None:
    """Users redirect results to another disk in this way."""
    (tmp_path / "run").symlink_to(elsewhere)
    folder = Folder(tmp_path / "run")
    with folder.locked():
        folder.write([Document("report.html", b"one")], ORIGIN)
    assert (elsewhere / "report.html").read_bytes() == b"one"


@pytest.mark.parametrize("file", ["run.log", "summary.json", "planar.parquet", "failure.log", ".mocap-id/report.json"])
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_finished_run_with_something_else_in_a_files_place(
    tmp_path: Path, elsewhere: Path, copied: Callable[[Path], Path], file: str, kind: str
) -> None:
    """It is replaced or refused, never followed or waited for."""
    trial = load(copied(tmp_path))
    path = trial.out / file
    content = path.read_bytes() if path.exists() else b""
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    else:
        (elsewhere / "precious").write_bytes(content)
        path.symlink_to(elsewhere / "precious")
    try:
        outcome = runner.run(trial)
    except MocapIdError as error:
        assert file in str(error)
    else:
        assert outcome.summary()["verdict"]["level"] in ("ok", "caution")
    if kind == "link":
        assert (elsewhere / "precious").read_bytes() == content
        assert [path.name for path in elsewhere.iterdir()] == ["precious"]


def test_a_recording_that_changes_while_it_is_read(
    tmp_path: Path, copied: Callable[[Path], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its hash would not match the content that was read; times are restored, so that they do not reveal the change."""
    trial = load(copied(tmp_path))
    path = trial.keys.recording.markers
    before, times = path.read_bytes(), path.stat()
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns - 10**11))
    (trial.out / "planar.parquet").unlink()
    left = sorted(file.name for file in trial.out.iterdir())
    really = recording.read

    def meddling(*arguments: object, **more: object) -> recording.Recording:
        found = really(*arguments, **more)  # type: ignore[arg-type]
        path.write_bytes(before[:-1] + bytes([before[-1] ^ 1]))
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns - 10**11))
        return found

    monkeypatch.setattr(recording, "read", meddling)
    with pytest.raises(RecordingError, match=r"link.c3d: changed while it was being read.* nothing was written"):
        runner.run(trial)
    assert sorted(file.name for file in trial.out.iterdir()) == left
    monkeypatch.undo()
    path.write_bytes(before)
    assert [step.action for step in runner.run(trial).steps][:2] == ["computed", "reused"]


def test_a_recording_that_is_only_touched_is_the_same(tmp_path: Path, copied: Callable[[Path], Path]) -> None:
    trial = load(copied(tmp_path))
    os.utime(trial.keys.recording.markers)
    assert {step.action for step in runner.run(trial).steps} == {"reused"}
