"""`mocap-id export`: complete output or none, overwriting only on request, and messages for mistakes."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest


def files(folder: Path) -> dict[str, bytes]:
    visible = folder.glob("[!.]*") if folder.exists() else ()
    return {path.name: path.read_bytes() for path in visible}


def test_files_are_named_on_stdout_and_notes_on_stderr(cli, links, tmp_path: Path) -> None:
    said = cli("export", links(), "--to", "trc", "--to", "mot,osim", "--out", tmp_path / "out")
    assert said.code == 0
    assert {Path(line).name for line in said.out.splitlines()} == set(files(tmp_path / "out"))
    assert "note: osim: inertial parameters" in said.err
    assert cli("export", links(), "--to", "trc", "--out", tmp_path / "again", "-q").err == ""


@pytest.mark.parametrize("content", ["[]", "{}", "3", '{"schema": "other"}', "[" * 100_000])
def test_another_file_in_place_of_the_summary_is_named(cli, links, tmp_path: Path, content: str) -> None:
    run = tmp_path / "run"
    shutil.copytree(links(), run)
    (run / "summary.json").write_text(content)
    for command in (("export", run, "--to", "trc", "--force"), ("compare", run, links())):
        said = cli(*command)
        assert said.code == 6
        assert "summary.json cannot be read" in said.err


def test_nothing_is_overwritten_unless_forced(cli, links, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "two-links_angles.mot").write_text("mine")
    said = cli("export", links(), "--to", "mot", "--out", out)
    assert said.code == 6
    assert "--force" in said.err
    assert files(out) == {"two-links_angles.mot": b"mine"}
    assert cli("export", links(), "--to", "mot", "--out", out, "--force").code == 0
    assert files(out)["two-links_angles.mot"].startswith(b"joint angles")


def test_whole_or_not_at_all(cli, links, tmp_path: Path) -> None:
    """A folder has the name of one of the files."""
    out = tmp_path / "out"
    (out / "two-links_grf.mot").mkdir(parents=True)
    said = cli("export", links(), "--to", "mot", "--out", out, "--force")
    assert said.code == 6
    assert [path.name for path in out.iterdir()] == ["two-links_grf.mot"]


def test_by_default_it_goes_into_the_run_folder(cli, links, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(links(), run)
    before = files_of(run)
    assert cli("export", run, "--to", "csv").code == 0
    assert {path.name for path in (run / "export").iterdir()} >= {"two-links_states.csv", "two-links_markers.csv"}
    assert {name: content for name, content in files_of(run).items() if not name.startswith("export")} == before


def files_of(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_trial_by_its_yaml_is_run_first(cli, links, tmp_path: Path) -> None:
    source = links().parents[1]
    shutil.copytree(source, tmp_path, dirs_exist_ok=True)
    (tmp_path / "runs" / "two-links" / "dynamics.h5").unlink()
    said = cli("export", tmp_path / "t.yaml", "--to", "osim")
    assert said.code == 0
    assert (tmp_path / "runs" / "two-links" / "export" / "two-links.osim").is_file()
    assert "segment           reused" in said.err
    assert "identify-dim      reused" not in said.err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--to", "fbx"), "expected some of trc, mot, sto, csv, osim"),
        (("--to", ""), "expected some of"),
        ((), "--to"),
    ],
)
def test_a_wrong_format(cli, links, tmp_path: Path, arguments: tuple[str, ...], says: str) -> None:
    said = cli("export", links(), *arguments, "--out", tmp_path / "out")
    assert (said.code, said.out) == (2, "")
    assert says in said.err
    assert not (tmp_path / "out").exists()


def test_a_folder_without_a_run_and_a_damaged_one(cli, links, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    said = cli("export", tmp_path / "empty", "--to", "trc")
    assert said.code == 6
    assert "no artefacts of a run" in said.err
    run = tmp_path / "run"
    shutil.copytree(links(), run)
    (run / "chain.h5").write_bytes(b"no HDF5")
    said = cli("export", run, "--to", "osim")
    assert said.code == 6
    assert "chain.h5" in said.err
    assert not (run / "export").exists()


def test_a_run_that_stopped_early_gives_what_it_has(cli, links, tmp_path: Path) -> None:
    run = tmp_path / "two-links"
    run.mkdir()
    for name in ("planar.parquet", "wrench.parquet"):
        shutil.copy(links() / name, run / name)
    said = cli("export", run, "--to", "trc,mot,osim,csv")
    assert said.code == 0
    written = {path.name for path in (run / "export").iterdir()}
    assert written == {"two-links.trc", "two-links_grf.mot", "two-links_markers.csv", "two-links_dynamics.csv"}
    assert "osim: no model: chain.h5 is not in" in said.err
    said = cli("export", run, "--to", "osim", "--force")
    assert said.code == 6
    assert "has no data for the formats osim" in said.err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_may_not_be_written(cli, links, tmp_path: Path) -> None:
    out = tmp_path / "shut"
    out.mkdir(mode=0o500)
    said = cli("export", links(), "--to", "trc", "--out", out)
    assert said.code == 6
    assert "may not write" in said.err
