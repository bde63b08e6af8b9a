"""Runs of recordings and arrays, and what a run says of itself."""

from __future__ import annotations

import shutil
import webbrowser
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocap_id
from mocap_id.config import load
from mocap_id.recording import write_recording
from mocap_id.workflows.recording_trial import make_trial
from mocap_id_simulation import ArmOptions, write_arm

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "sample_trials" / "robot-joint"
ROBOT = {"protocol": "robot-joint"}


@pytest.fixture
def finished(once: Callable[[str, Callable[[Path], Any]], Any], tmp_path: Path) -> Path:
    """A copy of a folder with the sample's recording and its run."""

    def make(folder: Path) -> Path:
        for name in ("trial.c3d", "encoder.csv"):
            shutil.copy(SAMPLE / name, folder)
        options = {"protocol": "robot-joint", "encoder": folder / "encoder.csv", "out": folder / "runs" / "trial"}
        mocap_id.run(folder / "trial.c3d", **options)
        return folder

    return Path(shutil.copytree(once("interface-run", make), tmp_path / "copy"))


@pytest.fixture
def sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with the sample's recording."""
    shutil.copy(SAMPLE / "trial.c3d", tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_run_equals_that_of_the_yaml_file(finished: Path) -> None:
    yaml, own = load(SAMPLE / "trial.yaml"), load(finished / "runs" / "trial" / "trial.yaml")
    assert own.settings == yaml.settings
    assert own.keys.model_copy(update={"recording": None, "encoder": None, "trial": ""}) == yaml.keys.model_copy(
        update={"recording": None, "encoder": None, "trial": ""}
    )
    assert own.keys.encoder is not None
    assert own.keys.encoder.resolve() == finished / "encoder.csv"
    assert own.out == finished / "runs" / "trial"
    again = mocap_id.run(finished / "runs" / "trial" / "trial.yaml")
    assert {step.action for step in again.steps} == {"reused"}


def test_tables_are_read_when_they_are_used(finished: Path) -> None:
    folder = finished / "runs" / "trial"
    (folder / "dynamics.parquet").write_bytes(b"damaged")
    run = mocap_id.open(folder)
    assert run.verdict.level == run.summary["verdict"]["level"]
    assert run.segments.attrs["units"]["residual"] == "m"
    with pytest.raises(mocap_id.StoreError, match="damaged"):
        _ = run.dynamics


def test_tables_of_two_runs_are_not_mixed(finished: Path) -> None:
    first, second = finished / "runs" / "trial", finished / "runs" / "other"
    mocap_id.run(finished / "trial.c3d", protocol="robot-joint", window=(1, 6), out=second)
    for name in ("chain.h5", "skin.h5", ".mocap-id/fit-joints.json"):
        shutil.copy(second / name, first / name)
    with pytest.raises(mocap_id.StoreError, match=r"states.parquet was not made from the chain.h5 in"):
        _ = mocap_id.open(first).states


def test_a_notebook_shows_verdict_and_intervals(finished: Path) -> None:
    run = mocap_id.open(finished / "runs" / "trial")
    html = run._repr_html_()
    assert "95 % interval" in html
    assert all(
        name.replace("*", "") in html.replace("·", "").replace("*", "") for name in run.parameters["base parameter"]
    )
    assert "<script" not in html


@pytest.mark.parametrize("kind", [mocap_id.StoreError, mocap_id.NumericalError, mocap_id.RecordingError])
def test_a_notebook_shows_the_numbers_without_the_player(
    kind: type[Exception], finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(data: object) -> None:
        raise kind("no pose in <frame> 3")

    monkeypatch.setattr("mocap_id.reporting.player.make_player", fail)
    html = mocap_id.open(finished / "runs" / "trial")._repr_html_()
    assert "95 % interval" in html
    assert html.endswith("<p>There is no player: no pose in &lt;frame&gt; 3</p>")


def test_messages_of_an_export_are_in_words_of_python(finished: Path) -> None:
    run = mocap_id.open(finished / "runs" / "trial")
    for formats, expected in ((("fbx",), "unknown format 'fbx'; expected some of trc"), ((), "no format; expected")):
        with pytest.raises(mocap_id.ConfigError, match=expected):
            run.export(*formats)
    run.export("mot")
    with pytest.raises(mocap_id.StoreError, match=r"`out=` .* `force=True`"):
        run.export("mot")


def test_what_is_no_trial() -> None:
    for wrong in (None, 3, np.zeros((4, 2, 3))):
        with pytest.raises(mocap_id.ConfigError, match=f"{type(wrong).__name__} is not a trial; expected the path"):
            mocap_id.run(wrong)


def test_a_refusal_is_a_result(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    still = rng.normal(size=(4, 3)) + 0.001 * rng.normal(size=(300, 4, 3))
    recording = mocap_id.Recording.from_arrays(["A", "B", "C", "D"], still, 100)
    run = mocap_id.run(recording, protocol="free", out=tmp_path / "out")
    assert run.refused
    assert run.verdict.reasons[0].code == "no-motion"
    assert "space: 3d" not in run.verdict.reasons[0].message, "no other space gives a still recording joints"
    assert "No joint moves" in run._repr_html_()
    with pytest.raises(mocap_id.StoreError, match=r"refused \(no-motion\) before states.parquet was made"):
        _ = run.states
    (tmp_path / "at-once").mkdir()
    shutil.copy(run.folder / "summary.json", tmp_path / "at-once")
    assert mocap_id.open(tmp_path / "at-once").refused


def test_what_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(mocap_id.StoreError, match="contains no artefacts"):
        mocap_id.open(tmp_path)


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_recording_in_memory_keeps_its_wrench(turn: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    c, s = np.cos(turn), np.sin(turn)
    corners = np.array([[0.3, 0.2, 0], [-0.3, 0.2, 0], [-0.3, -0.2, 0], [0.3, -0.2, 0]]) * [1, -1, 1]
    corners = corners @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [0.5, -0.4, 0.1]
    force = np.array([5.0, -3.0, 600.0]) + rng.normal(size=(400, 3))
    moment = np.cross([0.5, -0.4, 0.1], force) + rng.normal(size=(400, 3))
    ok = np.arange(400) != 17
    plate = mocap_id.Plate(1, "own", corners, force, moment, ok, 400.0)
    positions = rng.normal(size=(100, 2, 3))
    positions[5, 1] = np.nan
    made = mocap_id.Recording.from_arrays(["A", "B"], positions, 100.0, [plate])
    write_recording(tmp_path / "own.c3d", made)
    read = mocap_id.read(tmp_path / "own.c3d")
    np.testing.assert_allclose(read.positions, positions, atol=1e-6)
    np.testing.assert_allclose(read.plates[0].force[ok], force[ok], atol=1e-3)
    np.testing.assert_allclose(read.plates[0].moment[ok], moment[ok], atol=1e-3)
    assert read.plates[0].ok.tolist() == ok.tolist()
    np.testing.assert_allclose(read.time, made.time, atol=1e-9)
    assert read.to_frame()["B"]["y"].isna().sum() == 1


def test_arrays_that_do_not_fit(tmp_path: Path) -> None:
    with pytest.raises(mocap_id.RecordingError, match=r"shape is \(4, 3\); expected \(frames, 2, 3\)"):
        mocap_id.Recording.from_arrays(["A", "B"], np.zeros((4, 3)), 100)
    with pytest.raises(mocap_id.RecordingError, match="occurs twice"):
        mocap_id.Recording.from_arrays(["A", "A"], np.zeros((4, 2, 3)), 100)
    made = mocap_id.Recording.from_arrays(["A", "B"], np.zeros((4, 2, 3)), 100)
    with pytest.raises(mocap_id.RecordingError, match="not evenly spaced"):
        write_recording(tmp_path / "own.c3d", replace(made, time=made.time**2))
    plate = mocap_id.Plate(1, "own", None, np.zeros((4, 3)), np.zeros((4, 3)), np.ones(4, bool), 100)
    with pytest.raises(mocap_id.RecordingError, match="plate 1 has no corners"):
        write_recording(tmp_path / "own.c3d", replace(made, plates=(plate,)))


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, ("3d", "reach", "right")),
        ({"protocol": "curl"}, ("3d", "curl", "right")),
        ({"protocol": "free"}, ("3d", "free", "right")),
        ({"space": "plane"}, ("plane", "free", None)),
        ({"protocol": "sit-to-stand"}, ("plane", "sit-to-stand", None)),
    ],
)
def test_markers_of_an_arm_are_a_reach(
    given: dict[str, str], expected: tuple[str, ...], once: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("WARNING", "mocap_id")
    arm = once("interface-arm", lambda folder: write_arm(folder / "S1_l" / "arm", ArmOptions(seed=1, cycles=1)))
    trial = make_trial(arm.parent / "trial.c3d", {**given, "out": tmp_path / "run"})
    assert (trial.keys.space, trial.keys.protocol, trial.keys.side) == expected
    assert ("`protocol: reach`" in caplog.text) == (not given)


def test_settings_are_checked_and_files_of_others_kept(sample: Path) -> None:
    with pytest.raises(mocap_id.ConfigError, match=r"trial\.c3d: unknown key `windw`: did you mean `window`"):
        make_trial(Path("trial.c3d"), {**ROBOT, "windw": (1, 2)})
    with pytest.raises(mocap_id.RecordingError, match="no such file"):
        mocap_id.run("nothing.c3d")
    (sample / "mine.yaml").write_text("trial: mine\n")
    with pytest.raises(mocap_id.StoreError, match="was not made by"):
        make_trial(Path("trial.c3d"), ROBOT, Path("mine.yaml"))
    with pytest.raises(mocap_id.ConfigError, match="contains the settings of its trial"):
        mocap_id.run("mine.yaml", protocol="free")
    (sample / "runs" / "trial" / ".mocap-id").mkdir(parents=True)
    with pytest.raises(mocap_id.StoreError, match="belongs to another trial"):
        make_trial(Path("trial.c3d"), ROBOT)


def test_edited_settings_are_not_replaced(sample: Path) -> None:
    saved = sample / "saved.yaml"
    make_trial(Path("trial.c3d"), ROBOT, Path("saved.yaml"))
    make_trial(Path("trial.c3d"), {**ROBOT, "window": (1, 6)}, Path("saved.yaml"))
    assert "window" in saved.read_text()
    for edit in ("subject: {mass: 70}\n", "# a remark\n"):
        edited = saved.read_text() + edit
        saved.write_text(edited)
        with pytest.raises(mocap_id.StoreError, match="was edited"):
            make_trial(Path("trial.c3d"), ROBOT, Path("saved.yaml"))
        assert saved.read_text() == edited


def test_settings_of_stages_and_numbers_of_numpy(sample: Path) -> None:
    given = {
        "window": np.array([1, 6]).tolist(),
        "subject": {"mass": np.float64(70)},
        "segment": {"count": np.int64(2)},
    }
    trial = make_trial(Path("trial.c3d"), {**ROBOT, **given, "identify_dim": {}}, Path("kept") / "own.yaml")
    assert trial.out == sample / "kept" / "runs" / "trial"
    assert trial.keys.recording.motion.resolve() == sample / "trial.c3d"
    assert (trial.keys.window, trial.keys.subject.mass) == ((1, 6), 70)
    assert trial.settings["segment"].model_fields_set == {"count"}


def test_the_command_without_a_yaml_file(sample: Path, cli: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    first = cli("run", "trial.c3d", "--protocol", "free", "--window", 1, 6, "--mass", 33)
    assert first.code == 0
    assert "guessed" not in first.err.replace("`space: plane` was guessed", "")
    assert (sample / "runs" / "trial" / "trial.yaml").exists()
    saved = cli("run", "trial.c3d", "--protocol", "free", "--window", 1, 6, "--mass", 33, "--save", "t.yaml", "--open")
    assert opened == [(sample / "runs" / "trial" / "report.html").resolve().as_uri()]
    assert not (sample / "runs" / "trial" / "trial.yaml").exists()
    again = cli("run", "t.yaml")
    assert again.out == saved.out == first.out
    assert saved.err.count("reused") == again.err.count("reused") == 6
