"""Commands that need no run: help, version, schema, stages, mistakes on the command line and in the configuration."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mocap_id import __version__
from mocap_id.stages import STAGES
from mocap_id_cli.commands import COMMANDS, Entry, load_command
from swinging_link import pendulum

ROOT = Path(__file__).resolve().parents[2]
HEAVY = {"numpy", "scipy", "pandas", "pyarrow", "h5py", "numba", "matplotlib", "pydantic", "rich"}


def loading(*arguments: str) -> tuple[str, set[str]]:
    """Return the standard output of a call, and the libraries that it loads."""
    asked = f"import sys; from mocap_id_cli.__main__ import main; sys.argv[1:] = {list(arguments)!r}"
    told = "try: main()\nexcept SystemExit: print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", f"{asked}\n{told}"], capture_output=True, text=True, check=True)
    out, _, modules = said.stdout.rstrip().rpartition("\n")
    return out, set(modules.split())


def test_help_names_every_command_and_loads_none() -> None:
    help_, modules = loading("--help")
    for entry in COMMANDS:
        assert f"\n  {entry.name} " in help_ + "\n"
    assert modules & HEAVY == set()


@pytest.mark.parametrize("command", [(), ("simulate",), ("pneumatic",)], ids=lambda names: " ".join(names) or "all")
def test_the_list_of_commands_has_whole_sentences(cli, command: tuple[str, ...]) -> None:
    """On 80 columns, longer ones would end with dots."""
    _, _, listed = cli(*command, "--help").out.partition("Commands:\n")
    assert listed and [line for line in listed.splitlines() if line.endswith("...")] == []


def test_what_has_nothing_to_do_loads_no_library_of_the_stages(cli, trial) -> None:
    path = trial.trc(pendulum())
    cli("planarise", path)
    out, modules = loading("planarise", str(path), "--json")
    assert [step["action"] for step in json.loads(out)["steps"]] == ["reused"]
    assert modules & HEAVY == {"pydantic"}


@pytest.mark.parametrize("sample", ["robot-joint", "sit-to-stand"])
def test_a_run_loads_no_library_that_it_does_not_need(sample: str, tmp_path: Path) -> None:
    """Loading each of them takes a tenth of a second or more."""
    shutil.copytree(ROOT / "sample_trials" / sample, tmp_path / sample, ignore=shutil.ignore_patterns("runs"))
    _, modules = loading("run", str(tmp_path / sample / "trial.yaml"), "--json")
    unwanted = {"matplotlib", "pandas", "filterpy", "osqp", "c3d", "ezc3d", "scipy.stats", "scipy.signal"}
    assert modules & unwanted == set()
    assert modules & {"numpy.f2py.f2py2e", "numpy.testing.overrides", "yaml.reader"} == set()  # imported, never used
    assert {"numpy", "pyarrow", "h5py", "scipy.optimize"} <= modules
    out, modules = loading("run", str(tmp_path / sample / "trial.yaml"), "--json")
    assert {step["action"] for step in json.loads(out)["steps"]} == {"reused"}
    assert modules & HEAVY == {"pydantic"}


@pytest.mark.parametrize("entry", COMMANDS, ids=lambda entry: entry.name)
def test_a_command_is_listed_with_its_own_first_sentence(entry: Entry) -> None:
    command = load_command(entry)
    assert command.name == entry.name
    assert " ".join(command.help.split()).partition(". ")[0].rstrip(".") == entry.help.rstrip(".")


@pytest.mark.parametrize("stage", [stage.name for stage in STAGES])
def test_every_stage_has_a_command_with_help(cli, stage: str) -> None:
    said = cli(stage, "--help")
    assert said.code == 0
    assert "TRIAL.yaml" in said.out


def test_version(cli) -> None:
    assert cli("--version").out == f"mocap-id {__version__}\n"


def test_schema_is_json(cli) -> None:
    found = json.loads(cli("schema").out)
    assert set(found["properties"]) >= {stage.name for stage in STAGES}


def test_stages_are_listed_in_their_order(cli) -> None:
    lines = [line.partition(":")[0] for line in cli("stages").out.splitlines() if not line.startswith(" ")]
    assert lines == [stage.name for stage in STAGES]


@pytest.mark.parametrize("arguments", [("fly",), ("run",), ("run", "a.yaml", "--fast"), ("simulate", "bird", "x")])
def test_a_wrong_command_line(cli, arguments: tuple[str, ...]) -> None:
    said = cli(*arguments)
    assert said.code == 2
    assert said.out == ""
    assert "--help" in said.err


@pytest.mark.parametrize(
    ("option", "value"),
    [("units", "furlong"), ("vertical", "up"), ("force-unit", "furlong"), ("moment-unit", "N")],
)
def test_a_wrong_option_is_a_wrong_command_line(cli, trial, option: str, value: str) -> None:
    trial.trc(pendulum())
    said = cli("inspect", trial.folder / "trial.trc", f"--{option}", value)
    assert (said.code, said.out) == (2, "")
    assert option.replace("-", "_") in said.err
    assert value in said.err
    assert cli("inspect", trial.folder / "trial.trc").code == 0


def test_a_wrong_configuration_writes_nothing(cli, trial) -> None:
    path = trial.say("trial.c3d", protcol="free")
    for command in ("run", *(stage.name for stage in STAGES)):
        said = cli(command, path)
        assert said.code == 2
        assert "did you mean `protocol`?" in said.err
    assert list(trial.folder.iterdir()) == [path]


def test_a_recording_given_for_a_configuration(cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "trial.c3d"
    path.write_bytes(bytes([2, 80, 255, 254]) * 100)
    said = cli("planarise", path)
    assert said.code == 2
    assert "expected a YAML file" in said.err
    said = cli("run", path)
    assert said.code == 3
    assert "trial.c3d" in said.err


def test_results_go_to_stdout_and_the_rest_to_stderr(cli, trial) -> None:
    said = cli("run", trial.say("nowhere.c3d"))
    assert (said.code, said.out) == (3, "")
    assert said.err.startswith("mocap-id: ")
    assert "nowhere.c3d: no such file" in said.err


def test_a_reader_that_leaves_early_is_no_failure() -> None:
    """``mocap-id schema | head -1``."""
    program = [sys.executable, "-m", "mocap_id_cli", "schema"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert "Traceback" not in process.stderr.read()


def test_rules_are_printed_for_make(cli, trial, monkeypatch: pytest.MonkeyPatch) -> None:
    trial.say("trial.c3d")
    monkeypatch.chdir(trial.folder)
    rules = cli("stages", "--make", "trial.yaml").out
    assert rules.startswith("MOCAP_ID ?= mocap-id\n")
    for stage in STAGES:
        assert f"\t$(MOCAP_ID) {stage.name} trial.yaml\n" in rules


def test_a_cohort_is_simulated(cli, tmp_path: Path) -> None:
    few = ("--subjects", "1", "--strategies", "stable, dynamic", "--repetitions", "1", "--analog-rate", "100")
    said = cli("simulate", "cohort", tmp_path / "study", *few)
    assert (said.code, said.out) == (0, f"{tmp_path / 'study' / 'study.yaml'}\n")
    assert {path.name for path in (tmp_path / "study" / "s01").iterdir()} == {"stable-1.c3d", "dynamic-1.c3d"}


def test_a_cohort_of_no_known_strategy_is_not(cli, tmp_path: Path) -> None:
    said = cli("simulate", "cohort", tmp_path / "study", "--strategies", "normal,slow")
    assert (said.code, said.out) == (2, "")
    assert "expected some of normal, dynamic, stable" in said.err
    assert not (tmp_path / "study").exists()


def test_a_run_as_json(cli, trial) -> None:
    path = trial.trc(pendulum())
    told = json.loads(cli("run", path, "--json", "--quiet").out)
    assert told["verdict"]["level"] == trial.summary()["verdict"]["level"]
    assert [step["stage"] for step in told["steps"]] == [stage.name for stage in STAGES]
    assert {step["action"] for step in told["steps"]} == {"computed"}
    again = json.loads(cli("segment", path, "--json", "--quiet").out)
    assert [step["action"] for step in again["steps"]] == ["reused"]
    assert [Path(file).name for file in again["files"]] == ["segments.parquet"]
