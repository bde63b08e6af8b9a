"""A run folder belongs to one recording: another one never replaces its results, while the same one always may."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from toy_stages import STAGES

from mocap_id.config import Trial, load
from mocap_id.errors import StoreError
from mocap_id.runner import clean, run, run_stage, status
from mocap_id.store.folder import OWNER_FILE, read_owner


def write(folder: Path, numbers: str, name: str = "sts", out: str = "../out") -> Path:
    """Write a trial with a recording of the same name in another folder; return its file."""
    folder.mkdir(exist_ok=True)
    (folder / "sts.txt").write_text(numbers)
    (folder / "trial.yaml").write_text(json.dumps({"trial": name, "recording": "sts.txt", "out": out}))
    return folder / "trial.yaml"


def read(file: Path) -> Trial:
    return load(file, STAGES)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def two(tmp_path: Path) -> tuple[Path, Path]:
    """Two people with one run folder; the first has run."""
    files = write(tmp_path / "p1", "1\n2\n3\n"), write(tmp_path / "p2", "4\n5\n6\n")
    run(read(files[0]), STAGES)
    return files


def test_another_recording_is_refused_and_both_are_named(two: tuple[Path, Path], tmp_path: Path) -> None:
    before = contents(tmp_path / "out")
    with pytest.raises(StoreError) as refused:
        run(read(two[1]), STAGES)
    assert str(two[0]) in str(refused.value)
    assert str(two[1]) in str(refused.value)
    assert "p2/sts.txt" in str(refused.value)
    with pytest.raises(StoreError, match="belongs to another recording"):
        run_stage(read(two[1]), "read", STAGES)
    with pytest.raises(StoreError, match="belongs to another recording"):
        clean(read(two[1]), stages=STAGES)
    assert "belongs to another recording" in status(read(two[1]), STAGES).stages[0].why
    assert contents(tmp_path / "out") == before, "neither results nor log of the first trial have changed"
    assert status(read(two[0]), STAGES).done


def test_a_link_to_the_folder_of_another_recording_is_refused(two: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "out", target_is_directory=True)
    file = write(tmp_path / "p2", "4\n5\n6\n", out="../link")
    with pytest.raises(StoreError, match="belongs to another recording"):
        run(read(file), STAGES)


def test_the_same_recording_may_always_run_again(two: tuple[Path, Path], tmp_path: Path) -> None:
    def run_again(file: Path) -> list[str]:
        return [step.action for step in run(read(file), STAGES).steps]

    assert run_again(two[0]) == ["reused"] * 3
    (two[0].parent / "sts.txt").write_text("7\n8\n9\n")
    assert run_again(two[0]) == ["computed"] * 3, "an edited recording of the same trial"
    other = two[0].with_name("again.yaml")
    other.write_text(two[0].read_text())
    (two[0].parent / "sts.txt").write_text("7\n8\n1\n")
    assert run_again(other) == ["computed"] * 3, "an edited recording at the same path, in another trial's file"
    for name in ("p1", "out"):
        (tmp_path / "moved").mkdir(exist_ok=True)
        shutil.move(tmp_path / name, tmp_path / "moved" / name)
    file = tmp_path / "moved" / "p1" / "again.yaml"
    assert run_again(file) == ["reused"] * 3
    (file.parent / "sts.txt").write_text("2\n2\n2\n")
    assert run_again(file) == ["computed"] * 3, "an edited recording in a moved tree"


def test_a_trial_that_moves_keeps_its_folder(two: tuple[Path, Path], tmp_path: Path) -> None:
    shutil.move(tmp_path / "p1", tmp_path / "archive")
    file = tmp_path / "archive" / "trial.yaml"
    assert [step.action for step in run(read(file), STAGES).steps] == ["reused"] * 3
    (file.parent / "sts.txt").write_text("2\n2\n2\n")
    assert [step.action for step in run(read(file), STAGES).steps] == ["computed"] * 3


def test_another_recording_in_the_same_file_under_another_name(two: tuple[Path, Path]) -> None:
    write(two[0].parent, "4\n4\n4\n", name="next-patient")
    (two[0].parent / "sts.txt").rename(two[0].parent / "next.txt")
    two[0].write_text(two[0].read_text().replace("sts.txt", "next.txt"))
    with pytest.raises(StoreError, match="`next-patient`"):
        run(read(two[0]), STAGES)


def test_a_run_that_writes_nothing_claims_no_folder(tmp_path: Path) -> None:
    file = write(tmp_path / "p1", "no number\n")
    with pytest.raises(Exception, match="unforeseen failure"):
        run(read(file), STAGES)
    assert read_owner(tmp_path / "out") is not None, "failure.log is there"
    shutil.rmtree(tmp_path / "out")
    run(read(write(tmp_path / "p2", "1\n2\n")), STAGES)
    clean(read(tmp_path / "p2" / "trial.yaml"), stages=STAGES)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("damage", ["", "[1]", '{"name": 3}', "link"])
def test_a_damaged_record_is_as_none(two: tuple[Path, Path], tmp_path: Path, damage: str) -> None:
    record = tmp_path / "out" / OWNER_FILE
    if damage == "link":
        shutil.move(record, tmp_path / "elsewhere.json")
        record.symlink_to(tmp_path / "elsewhere.json")
    else:
        record.write_text(damage)
    assert read_owner(tmp_path / "out") is None
    run(read(two[0]), STAGES)
    assert not record.is_symlink()
    owner = read_owner(tmp_path / "out")
    assert owner is not None
    assert owner.file == two[0]
    assert str(tmp_path) not in record.read_text(), "paths are relative"
