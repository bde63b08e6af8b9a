"""`mocap-id doctor` on this installation and on broken ones."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path

import pytest

from mocap_id.workflows import doctor
from mocap_id.workflows.doctor import Finding, check_package, check_packages, parse_version
from mocap_id_cli.help import simulate_small_trial


def test_this_installation_works(cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    said = cli("doctor")
    assert said.code == 0, said.out
    assert said.out.endswith("mocap-id works here\n")
    for name in ("Python", "numpy", "ruamel", "HDF5", "Parquet", "compiler", "disk", "OpenSim"):
        assert name in said.out
    assert list(tmp_path.iterdir()) == []


def test_warming_up_says_where_the_compiled_code_is(cli) -> None:
    said = cli("doctor", "--warm")
    assert said.code == 0, said.out
    assert said.out.startswith("ok    modules")
    assert "\nok    compiled code" in said.out
    assert "kept in" in said.out
    assert "about a minute" in said.err
    assert "about a minute" in cli("doctor", "--help").out


def test_the_line_before_compiling_is_printed_before_it(cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed() -> Finding:
        raise KeyboardInterrupt

    monkeypatch.setattr("mocap_id.workflows.doctor.compile_filter", killed)
    assert "about a minute" in cli("doctor", "--warm").err


def test_modules_are_compiled_although_python_writes_no_bytecode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "module.py").write_text("ANSWER = 42\n")
    monkeypatch.setattr("sys.dont_write_bytecode", True)
    assert doctor.compile_modules([tmp_path]).level == "ok"
    assert len(list(tmp_path.glob("__pycache__/module.*.pyc"))) == 1
    (tmp_path / "no_folder" / "module.py").parent.mkdir()
    (tmp_path / "no_folder" / "module.py").write_text("ANSWER = 42\n")
    (tmp_path / "no_folder" / "__pycache__").touch()
    found = doctor.compile_modules([tmp_path])
    assert (found.level, str(tmp_path) in found.found) == ("warn", True)


def test_the_json_holds_every_check(cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = json.loads(cli("doctor", "--json").out)
    assert {check["level"] for check in found} <= {"ok", "warn"}
    assert all(check["advice"] for check in found if check["level"] != "ok")


def test_every_dependency_is_looked_at() -> None:
    wanted = [line for line in metadata.requires("mocap-id") or [] if "extra ==" not in line]
    names = [check.name for check in check_packages()]
    assert len(names) == len(wanted) + 2  # Python and mocap-id itself
    assert all(any(line.startswith(name) for name in names) for line in wanted)


def test_a_package_that_is_missing_old_or_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = check_package("no-such-package-anywhere", "1.0")
    assert (missing.level, missing.found) == ("fail", "not installed")
    assert "pip install 'no-such-package-anywhere>=1.0'" in missing.advice
    old = check_package("numpy", "999.0")
    assert old.level == "fail"
    assert "at least 999.0" in old.found

    def broken(name: str) -> None:
        raise OSError("libfoo.so: cannot open")

    monkeypatch.setattr("importlib.import_module", broken)
    assert "libfoo.so" in check_package("numpy", "1.0").found


@pytest.mark.parametrize(
    ("newer", "older"), [("1.10", "1.9"), ("2.0", "2.0rc1"), ("3", "2.99.9"), ("0.61.2", "0.61"), ("1.0.post1", "1.0")]
)
def test_versions_are_ordered(newer: str, older: str) -> None:
    assert parse_version(newer) >= parse_version(older)


def test_a_failure_is_told_with_exit_code_1(cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "check_space", lambda folder: Finding("disk", "fail", "full", "make room"))
    said = cli("doctor")
    assert said.code == 1
    assert "these checks failed: disk" in said.out
    assert "to do: make room" in said.out


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    found = list(doctor.check_files(tmp_path / "nowhere"))
    assert [check.level for check in found] == ["fail"]
    assert "out:" in found[0].advice


def test_a_full_disk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    usage = type("Usage", (), {"free": 5e7})
    monkeypatch.setattr("shutil.disk_usage", lambda folder: usage)
    assert doctor.check_space(tmp_path).level == "fail"


def test_threads_that_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "8")
    assert doctor.check_threads().level == "warn"
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    assert doctor.check_threads().level == "ok"


def test_an_opensim_that_is_named_but_not_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("MOCAP_ID_OPENSIM_PYTHON", str(tmp_path / "python"))
    assert doctor.find_opensim(tmp_path).level == "warn"
    monkeypatch.delenv("MOCAP_ID_OPENSIM_PYTHON")
    assert doctor.find_opensim(tmp_path).level == "ok"


def test_a_small_trial_that_breaks_is_a_finding() -> None:
    def broken(folder: Path) -> Path:
        raise RuntimeError("a library is missing\nand more")

    found = doctor.run_small_trial(broken)
    assert (found.level, found.found) == ("fail", "RuntimeError: a library is missing")


def test_a_small_trial_runs() -> None:
    found = doctor.run_small_trial(simulate_small_trial)
    assert found.level == "ok", found


def test_explain_by_the_command_line(cli) -> None:
    assert "segments are uncertain" in cli("explain", "segments-unsure").out
    assert json.loads(cli("explain", "4", "--json").out)["code"] == "exit-4"
    assert len(cli("explain").out.splitlines()) == len(json.loads(cli("explain", "--json").out))
    said = cli("explain", "segment-unsure")
    assert (said.code, said.out) == (2, "")
    assert "segments-unsure" in said.err


def test_completion_can_be_installed(cli) -> None:
    assert "--install-completion" in cli("--help").out
