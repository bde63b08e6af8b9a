"""The tuple of stages is consistent, and everything generated from it is up to date."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from mocap_id import errors
from mocap_id.config import load
from mocap_id.stages import STAGES
from mocap_id.stages.base import Stage
from mocap_id.stages.trial_keys import TrialKeys
from mocap_id.store.provenance import SCHEMAS
from mocap_id_cli.pages import SETTINGS_MARK, make_pages
from mocap_id_cli.stages import list_settings

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))
by_name = pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)


@by_name
def test_a_stage_reads_what_earlier_ones_wrote(stage: Stage) -> None:
    earlier = STAGES[: STAGES.index(stage)]
    written = {file for other in earlier for file in other.outputs}
    assert set(stage.inputs) <= written
    assert not set(stage.outputs) & written


@by_name
def test_a_stage_says_what_it_is(stage: Stage) -> None:
    assert re.fullmatch(r"[a-z]+(-[a-z]+)*", stage.name)
    assert stage.help.endswith(".")
    assert {*stage.uses, *stage.uses_alone} <= set(TrialKeys.model_fields)
    for name, field in stage.settings.model_fields.items():
        assert field.description, name
        assert not field.is_required(), name


def test_every_artefact_is_written_by_one_stage() -> None:
    written = [file for stage in STAGES for file in stage.outputs if file in SCHEMAS]
    assert sorted(written) == sorted(SCHEMAS)


def test_the_last_stage_is_the_report() -> None:
    assert STAGES[-1].name == "report"
    assert set(STAGES[-1].inputs) == set(SCHEMAS)
    assert {"summary.json", "report.html"} <= set(STAGES[-1].outputs)


def test_there_is_an_example_for_every_protocol() -> None:
    assert {load(path).keys.protocol for path in CONFIGS} == {"free", "sit-to-stand", "robot-joint", "reach", "curl"}


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.name)
def test_an_example_holds_every_setting_with_its_default(path: Path, tmp_path: Path) -> None:
    head, mark, tail = path.read_text("utf-8").partition(SETTINGS_MARK)
    assert mark
    whole = tmp_path / "all.yaml"
    whole.write_text(head + uncommented(tail), "utf-8")
    trial = load(whole)
    for stage in STAGES:
        assert trial.settings[stage.name] == stage.settings()
        assert trial.settings[stage.name].model_fields_set == set(list_settings(stage.settings, trial.keys.space))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.name)
def test_what_is_commented_out_in_an_example_is_valid(path: Path, tmp_path: Path) -> None:
    whole = tmp_path / "all.yaml"
    whole.write_text(uncommented(path.read_text("utf-8")), "utf-8")
    shutil.copytree(ROOT / "configs" / "devices", tmp_path / "devices")
    trial = load(whole)
    assert trial.keys.window is not None
    assert trial.keys.plates.feet or trial.keys.space == "3d"
    assert trial.out == tmp_path / "runs" / trial.name


def uncommented(text: str) -> str:
    """Remove the ``#`` at the start of all lines except remarks, which start with ``#`` and a blank."""
    return re.sub(r"^#(?! [^ ])", "", text, flags=re.MULTILINE)


def test_the_samples_are_valid() -> None:
    trials = [load(path) for path in sorted((ROOT / "sample_trials").glob("*/trial.yaml"))]
    assert len(trials) >= 2
    for trial in trials:
        assert trial.keys.recording.markers.is_file()


def test_generated_pages_are_up_to_date() -> None:
    """`make docs` writes them."""
    for path, text in make_pages(ROOT).items():
        assert path.read_text("utf-8") == text, f"{path.name} is out of date: run `make docs`"


def test_the_readme_knows_every_exit_code() -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    codes = {kind.exit_code for kind in vars(errors).values() if isinstance(kind, type)} - {1}
    assert codes == {2, 3, 4, 5, 6}
    for code in codes:
        assert re.search(rf"^\| {code} \|", readme, flags=re.MULTILINE)


def test_the_docs_name_every_stage_and_artefact() -> None:
    formats = (ROOT / "docs" / "formats.md").read_text("utf-8")
    architecture = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    for stage in STAGES:
        assert stage.name in architecture
        for file in stage.outputs:
            assert f"`{file}`" in formats or file.startswith("figures/")
