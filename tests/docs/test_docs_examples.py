"""Every configuration, setting and command in the documentation is valid."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from pages_of_docs import PAGES, Block, blocks, inline_code, name
from ruamel.yaml import YAML, YAMLError
from typer.main import get_command

from mocap_id.config import build_trial_model, load
from mocap_id.config.device import load_device
from mocap_id.config.study import load_robot_study, load_study
from mocap_id.errors import ConfigError
from mocap_id.stages import STAGE_HELP
from mocap_id.workflows import parallel as backends
from mocap_id.workflows.sensitivity.perturbations import read_options
from mocap_id_assist.files import load_prescription
from mocap_id_assist.workspaces import load_chain
from mocap_id_cli.commands import COMMANDS, build, load_command

KEYS = {field.alias or key for key, field in build_trial_model().model_fields.items()}
STUDY_KEYS = {"study", "subjects", "defaults", "trials", "out"}
OTHER_PROGRAMS = ("# .github/", "# .gitlab-ci.yml", "# .pre-commit-config.yaml")
"""First lines of configurations that are not ours."""
FORMS = {"window: [from, to]"}  # how it is written, with words for the numbers
by_name = pytest.mark.parametrize("page", PAGES, ids=name)


def alternatives(text: str) -> list[str]:
    """Split a block at lines ``# or``, which separate alternatives."""
    return re.split(r"^# or\n", text, flags=re.MULTILINE)


def written(shown: dict[str, Any], file: Path) -> Path:
    with file.open("w") as stream:
        YAML().dump(shown, stream)
    return file


def check_trial(shown: dict[str, Any], folder: Path) -> None:
    whole = {"trial": "shown"} | dict(shown)
    if {"imus", "calibration"} <= whole.keys():
        written({"trial": "lab", "recording": "lab.c3d", "imus": whole["imus"]}, folder / whole["calibration"])
        whole["recording"] = whole.get("recording")
    else:
        whole = {"recording": "trial.c3d"} | whole
    if isinstance(whole["recording"], dict) and "skeleton" not in whole["recording"]:
        whole["recording"] = {"markers": "trial.c3d"} | whole["recording"]
    load(written(whole, folder / "trial.yaml"))


def check_study(shown: dict[str, Any], folder: Path) -> None:
    """Check a study's file, with missing parts filled in."""
    own = {} if shown.get("defaults", {}).get("protocol") == "reach" else {"strategy": "normal"}
    trials = shown.get("trials", [{"trial": "x", "subject": "s01", "recording": "x.c3d"} | own])
    people: dict[str, Any] = {str(trial["subject"]): {} for trial in trials}
    whole = {"study": "shown", "trials": trials} | dict(shown)
    whole["subjects"] = people | dict(shown.get("subjects", {}))
    used = set(people)
    extra = [
        {"trial": f"of-{person}", "subject": person, "recording": f"{person}.c3d"} | own
        for person in whole["subjects"]
        if person not in used
    ]
    load_study(written(whole | {"trials": [*trials, *extra]}, folder / "study.yaml"))


def check_prescription(shown: dict[str, Any], folder: Path) -> None:
    load_prescription(written(shown, folder / "prescription.yaml"))


def check_device(shown: dict[str, Any], folder: Path) -> None:
    load_device(written(shown, folder / "device.yaml"))


def check_chain(shown: dict[str, Any], folder: Path) -> None:
    load_chain(written(shown, folder / "chain.yaml"))


def check_cluster(shown: dict[str, Any], folder: Path) -> None:
    """Check the keys of a cluster's file; other keys are Dask's."""
    assert shown["kind"] in backends._KINDS
    assert isinstance(shown["workers"], int)


def check_perturbations(shown: dict[str, Any], folder: Path) -> None:
    read_options(written(shown, folder / "perturbations.yaml"))


def check_robot_study(shown: dict[str, Any], folder: Path) -> None:
    """Check a robot study's file; its trials are separate files."""
    for number, one in enumerate(shown["trials"]):
        file = folder / one["file"]
        file.parent.mkdir(parents=True, exist_ok=True)
        written({"trial": f"t{number}", "protocol": "robot-joint", "recording": "trial.c3d"}, file)
    load_robot_study((written(shown, folder / "robot-study.yaml"),))


def checker(shown: dict[str, Any]) -> Callable[[dict[str, Any], Path], None]:
    """Return the check for a block by its top-level keys."""
    keys = set(shown)
    for key, check in OTHER_FILES.items():
        if key in keys:
            return check
    assert keys <= KEYS or keys <= STUDY_KEYS, (
        f"{sorted(keys - KEYS - STUDY_KEYS)} are keys of neither a trial nor a study; a new kind of file needs a line "
        "in OTHER_FILES of this test"
    )
    return check_trial if keys <= KEYS else check_study


OTHER_FILES: dict[str, Callable[[dict[str, Any], Path], None]] = {
    "prescription": check_prescription,
    "pulley_radius_m": check_device,
    "chain": check_chain,
    "kind": check_cluster,
    "perturbations": check_perturbations,
    "reference": check_robot_study,
}
"""Configurations of other commands, by a key that only they have."""


@by_name
def test_configurations_are_valid(page: Path, tmp_path: Path) -> None:
    for block in blocks(page):
        if block.kind not in ("yaml", "yml"):
            continue
        for text in alternatives(block.text):
            shown = YAML(typ="safe").load(text)
            if text.startswith(OTHER_PROGRAMS):
                continue
            try:
                checker(shown)(shown, tmp_path)
            except Exception as error:
                raise AssertionError(f"{block.where}: {error}") from error


def settings_in_text(page: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield settings in inline code such as ``segment: {count: 4}``; ``…`` or a key alone means any value."""
    for code in inline_code(page):
        if not re.match(rf"({'|'.join(sorted(KEYS, key=len, reverse=True))}): ?\S", code) or code in FORMS:
            continue
        try:
            shown = YAML(typ="safe").load(code)
        except YAMLError:
            shown = None
        if isinstance(shown, dict):
            yield code, shown


def without_gaps(shown: dict[str, Any]) -> dict[str, Any]:
    """Return a stage's section without the keys that have no value in the text."""
    section = {key: value for key, value in shown.items() if value not in (None, "…")}
    return {key: without_gaps(value) if isinstance(value, dict) else value for key, value in section.items()}


def named(shown: dict[str, Any]) -> set[tuple[str, str]]:
    """Yield every (stage, setting) named, with or without a value."""
    pairs = set()
    for stage, section in shown.items():
        if stage in STAGE_HELP:
            pairs |= {(stage, key) for key in ([section] if isinstance(section, str) else section)}
    return pairs


@by_name
def test_settings_in_the_text_exist(page: Path, tmp_path: Path) -> None:
    fields = {key: field.annotation for key, field in build_trial_model().model_fields.items()}
    (tmp_path / "static.yaml").write_text("trial: static\nrecording: static.c3d\n")
    for code, shown in settings_in_text(page):
        for stage, key in named(shown):
            model: Any = fields[stage.replace("-", "_")]
            assert str(key) in model.model_fields, f"{name(page)}: `{code}`: {stage} has no setting {key}"
        section = {key: value for key, value in without_gaps(shown).items() if not isinstance(value, str)}
        protocol = {"protocol": shown["protocol"]} if shown.get("protocol") not in (None, "…") else {}
        try:
            check_in_its_space(section | protocol, tmp_path)
        except Exception as error:
            raise AssertionError(f"{name(page)}: `{code}`: {error}") from error


def check_in_its_space(shown: dict[str, Any], folder: Path) -> None:
    """Check keys of a trial, in space if they need it."""
    try:
        check_trial(shown, folder)
    except ConfigError as error:
        if "`space: 3d`" not in str(error):
            raise
        check_trial(shown | {"space": "3d"}, folder)


def commands(page: Path) -> Iterator[tuple[str, str, bool]]:
    """Yield (place, command line, whether it is complete) of every call in the documentation."""
    for block in blocks(page):
        if not block.note.startswith("run by tests/"):
            yield from ((block.where, line, True) for line in _typed(block))
    for code in inline_code(page):
        yield name(page), code, False


def _typed(block: Block) -> Iterator[str]:
    text = block.text.replace("\\\n", " ")
    if block.kind == "console":
        yield from (line[2:] for line in text.splitlines() if line.startswith("$ "))
    elif block.kind in ("sh", "bash"):
        yield from text.splitlines()
    elif block.kind == "yaml":
        yield from re.findall(r"^ *- (?:run: )?(mocap-id .*)$", text, flags=re.MULTILINE)


def check_command(line: str, *, whole: bool = True) -> None:
    """Check that commands and options exist, and if ``whole`` that none is missing; nothing is run."""
    words = [word for word in shlex.split(line, comments=True)[1:] if word not in ("…", "...")]
    command: Any = get_command(build())
    while words and hasattr(command, "commands") and not words[0].startswith("-"):
        assert words[0] in command.commands, f"there is no command {words[0]}"
        entry = next((entry for entry in COMMANDS if entry.name == words[0]), None)
        command = (
            load_command(entry)
            if entry and entry.name == command.commands[words[0]].name
            else command.commands[words[0]]
        )
        words = words[1:]
    if whole:
        command.make_parser(typer.Context(command)).parse_args(words)
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    known |= {"--help"}
    for word in words:
        assert not word.startswith("-") or word.partition("=")[0] in known, f"No such option: {word}"


@by_name
def test_commands_exist(page: Path) -> None:
    for where, line, whole in commands(page):
        if not re.match(r"mocap-id( |$)", line):
            continue
        try:
            check_command(line, whole=whole)
        except Exception as error:
            raise AssertionError(f"{where}: {line}: {error}") from error


def test_the_checks_can_fail(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="No such option"):
        check_command("mocap-id run trial.yaml --no-such-option")
    with pytest.raises(AssertionError):
        check_command("mocap-id no-such-command")
    with pytest.raises(AssertionError):
        check_command("mocap-id simulate sit-to-stand --no-such-option", whole=False)
    with pytest.raises(Exception, match="did you mean"):
        check_trial({"segment": {"cuont": 4}}, tmp_path)


def test_types_of_settings_are_words() -> None:
    """The generated page shows no Python type."""
    (page,) = (page for page in PAGES if page.name == "settings.md")
    types = re.findall(r"^\| `[^|]*` \| ([^|]*) \|", page.read_text("utf-8"), flags=re.MULTILINE)
    assert len(types) > 40
    words = r"((list of |[a-z ]+ or )?(`[^`]+`(, )?)+|[a-z0-9 ]+)"
    assert [kind for kind in types if not re.fullmatch(rf"{words}(: {words})?", kind)] == []


def test_the_page_of_settings_lists_keys_inside_every_mapping() -> None:
    """Also those of the second type of a key, of list items and of a mapping's values."""
    (page,) = (page for page in PAGES if page.name == "settings.md")
    keys = set(re.findall(r"^\| `([^`]*)` \|", page.read_text("utf-8"), flags=re.MULTILINE))
    assert keys >= {
        "recording", "recording.markers", "recording.forces", "recording.forces.balance_board", "recording.forces.top",
        "curl.loads", "curl.loads.<name>.mass", "curl.forearm.centre", "curl.hand.inertia", "external[].file",
    }  # fmt: skip


def test_make_knows_every_target_that_is_shown() -> None:
    rules = (PAGES[0].parents[0] / "Makefile").read_text("utf-8")
    (phony,) = re.findall(r"^\.PHONY: (help .*)$", rules, flags=re.MULTILINE)
    for page in PAGES:
        for where, line, _ in commands(page):
            if line.startswith("make "):
                target = shlex.split(line, comments=True)[1]
                assert target.startswith("-") or target in phony.split(), f"{where}: {line}"
