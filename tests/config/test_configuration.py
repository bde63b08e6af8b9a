"""YAML files of trials, and messages about their mistakes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import pytest
from pydantic import Field

from mocap_id.config import build_schema, load
from mocap_id.errors import ConfigError
from mocap_id.stages.base import Context, Outputs, Settings, Stage
from mocap_id.stages.trial_keys import InertialSensor, list_sensors


class FilterSettings(Settings):
    cutoff: float = Field(4.0, gt=0, description="low-pass, Hz")
    count: int | None = Field(None, ge=2, description="segments")
    mode: Literal["rts", "two-filter"] = Field("rts", description="smoother")
    span: tuple[float, float] = Field((1.0, 2.0), description="from and to, s")


def nothing(context: Context) -> Outputs:
    return ()


STAGES = (
    Stage("segment", 1, (), (), (), Settings, nothing, "Find segments."),
    Stage("ukf-smooth", 1, (), (), (), FilterSettings, nothing, "Smooth."),
)
SENSOR = "external:\n  - file: hand.csv\n    name: hand\n    segment: torso\n"
TWICE = SENSOR.removeprefix("external:\n")
LEAST = "trial: s01\nrecording: trial.c3d\n"


@pytest.fixture
def write(tmp_path: Path):
    def _write(text: str) -> Path:
        path = tmp_path / "trial.yaml"
        path.write_text(text, "utf-8")
        return path

    return _write


def complaint(path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load(path, STAGES)
    return str(caught.value)


def test_the_least_a_user_writes(write, tmp_path: Path) -> None:
    trial = load(write(LEAST), STAGES)
    assert trial.name == "s01"
    assert trial.keys.recording.markers == tmp_path / "trial.c3d"
    assert trial.keys.recording.forces is None
    assert trial.out == tmp_path / "runs" / "s01"
    assert trial.settings["ukf-smooth"] == FilterSettings()


def test_everything_a_user_may_write(write, tmp_path: Path) -> None:
    text = """\
trial: 2024-05-01           # a name, not a date
recording: {markers: ../a.trc, forces: /data/b.mot}
protocol: robot-joint
subject: {height: 1.75, mass: 70, sex: female}
encoder: encoder.csv
window: [2, 31.5]
plates: {feet: [1, 3], seat: [2]}
external:
  - {file: ../hand.csv, name: hand, segment: torso, at: RHAND, force: on-sensor, clock_offset_s: 0.5}
  - {file: /data/cable.csv, name: cable, segment: 0, at: [0.1, 2, -0.5]}
out: results/here
segment:                    # nothing below
ukf-smooth: {cutoff: 1e-3, count: 4, mode: two-filter, span: [0, 1e1]}
"""
    trial = load(write(text), STAGES)
    assert trial.name == "2024-05-01"
    assert trial.keys.recording.markers == tmp_path / "../a.trc"
    assert trial.keys.recording.forces == Path("/data/b.mot")
    assert trial.keys.encoder == tmp_path / "encoder.csv"
    assert trial.keys.window == (2.0, 31.5)
    assert trial.keys.plates.feet == (1, 3)
    hand, cable = trial.keys.external
    assert (hand.file, cable.file) == (tmp_path / "../hand.csv", Path("/data/cable.csv"))
    assert (hand.segment, hand.at, hand.force, hand.clock_offset_s) == ("torso", "RHAND", "on-sensor", 0.5)
    assert (cable.segment, cable.at, cable.force, cable.clock_offset_s) == (0, (0.1, 2.0, -0.5), "on-body", 0.0)
    assert trial.out == tmp_path / "results/here"
    assert trial.settings["ukf-smooth"] == FilterSettings(cutoff=0.001, count=4, mode="two-filter", span=(0, 10))


def test_a_relative_file_finds_its_recording_from_anywhere(
    write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(LEAST)
    monkeypatch.chdir(tmp_path.parent)
    trial = load(Path(tmp_path.name) / "trial.yaml", STAGES)
    assert trial.keys.recording.markers.is_absolute()
    assert trial.out == tmp_path / "runs" / "s01"


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("protcol: free\n", 3, ["`protcol`", "did you mean `protocol`?"]),
        ("ukf_smooth: {}\n", 3, ["`ukf_smooth`", "did you mean `ukf-smooth`?"]),
        ("cutoff: 4\n", 3, ["`cutoff`", "belongs under `ukf-smooth:`"]),
        ("xyzzy: 4\n", 3, ["`xyzzy`", "expected one of trial, recording"]),
        ("ukf-smooth:\n  cutof: 3\n", 4, ["`ukf-smooth.cutof`", "did you mean `cutoff`?"]),
        ("plates:\n  feet: [1]\n  seats: [2]\n", 5, ["`plates.seats`", "did you mean `seat`?"]),
        ("subject: {height: 175}\n", 3, ["`subject.height` is 175", "less than 2.8", "stature, m"]),
        ("subject:\n  mass: 70 kg\n", 4, ["`subject.mass` is '70 kg'", "a number without a unit", "kg"]),
        ("subject: {mass: true}\n", 3, ["`subject.mass` is True", "expected a number"]),
        ("subject: {sex: femal}\n", 3, ["'femal'", "did you mean `female`?"]),
        ("protocol: sit to stand\n", 3, ["`protocol`", "did you mean `sit-to-stand`?"]),
        ("window: [3, 2]\n", 3, ["`window` is [3, 2]", "first time must come before the last"]),
        ("window: [3]\n", 3, ["`window[1]` is missing"]),
        ("window: 3\n", 3, ["`window` is 3", "expected a list"]),
        ("window: [0, .inf]\n", 3, ["`window[1]` is inf", "finite"]),
        ("ukf-smooth: {span: [1, 2, 3]}\n", 3, ["`ukf-smooth.span`", "expected 2 values"]),
        ("ukf-smooth: {cutoff: .nan}\n", 3, ["`ukf-smooth.cutoff` is nan", "finite", "Hz"]),
        ("ukf-smooth: {count: 2.5}\n", 3, ["`ukf-smooth.count` is 2.5", "whole number"]),
        ("ukf-smooth: 3\n", 3, ["`ukf-smooth` is 3", "keys and values"]),
        ("plates: {feet: [0]}\n", 3, ["`plates.feet[0]` is 0", "greater than or equal to 1"]),
        ("plates: {feet: [1], seat: [1]}\n", 3, ["`plates.seat`", "plate 1 is also named under `feet`"]),
        ("encoder: a.csv\n", 3, ["`encoder`", "robot-joint"]),
        (SENSOR + "    clock_offset: 1\n", 7, ["`external[0].clock_offset`", "did you mean `clock_offset_s`?"]),
        (SENSOR, 4, ["`external[0].at` is missing", "a marker, or a fixed point"]),
        (SENSOR + "    at: [0, 1]\n", 7, ["`external[0].at` is [0, 1]", "`external[0].at[2]` is missing"]),
        (SENSOR + "    at: RHAND\n    force: body\n", 8, ["`external[0].force` is 'body'", "did you mean `on-body`?"]),
        (SENSOR + "    at: RHAND\n    clock_offset_s: 5 ms\n", 8, ["`external[0].clock_offset_s`", "without a unit"]),
        (f"{SENSOR}    at: A\n{TWICE}    at: B\n", 3, ["`external`", "`hand` is used twice"]),
        (f"space: 3d\n{SENSOR}    at: A\n", 4, ["`external`", "need `space: plane`", "through the elbow"]),
        (SENSOR.replace("hand\n", "seat\n") + "    at: A\n", 3, ["`external`", "reserved for the chair"]),
        ("out: 7\n", 3, ["`out` is 7", 'in quotes, "7"']),
        ("protocol: free\nprotocol: free\n", 4, ["`protocol` is given twice", "first on line 3"]),
        ("subject: {mass: 70, mass: 71}\n", 3, ["`mass` is given twice"]),
        ("\tprotocol: free\n", 3, ["not valid YAML", "indent with spaces"]),
        ('out: "C:\\data"\n', 3, ["not valid YAML", "path with /"]),
        ("subject: {height: 1,75}\n", 3, ["`subject.75`", "a decimal point, not a comma"]),
        ("protocol: [free\n", 4, ["not valid YAML"]),
        ("protocol: *there\n", 3, ["not valid YAML", "there"]),
        ("segment: {ignore: [*]}\n", 3, ["begins with *", "in quotes"]),
        ("out: &x y\nencoder: *x\n", 3, ["alias"]),
        ("out: !!python/name:os.system\n", 3, ["tag"]),
        ("? [a, b]\n: c\n", 3, ["key must be a name"]),
    ],
)
def test_a_mistake_is_reported_with_its_line(write, text: str, line: int, words: list[str]) -> None:
    path = write(LEAST + text)
    told = complaint(path)
    assert f"{path}, line {line}: " in told
    for word in words:
        assert word in told, told


def test_all_mistakes_are_reported_at_once(write) -> None:
    told = complaint(write("trial: a/b\nprotocol: fre\nwindow: [2, 1]\n"))
    assert len(told.splitlines()) == 4
    assert "`recording` is missing (C3D file" in told
    assert "`trial` is 'a/b', which is not allowed" in told


@pytest.mark.parametrize("name", ["../x", "a/b", "a\\b", "..", ".hidden", "with blank", "", "x" * 101, "-q"])
def test_a_trial_is_never_a_path(write, name: str) -> None:
    assert "`trial` is" in complaint(write(f"trial: {json.dumps(name)}\nrecording: a.c3d\n"))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"# nothing\n", "is empty"),
        (b"just words", "expected keys such as"),
        (b"- a\n- b\n", "expected keys such as"),
        ("trial: café\n".encode("utf-16"), "not a text file in UTF-8"),
        (b"study: a\ntrials: []\n", "is a study, not a trial: `mocap-id study"),
        (b"\x02\x50\x00\xff\xfe" * 100, "not a text file"),
        (b"a: b\n" * 300_000, "of at most 1048576 bytes"),
        (b"[" * 200, "not valid YAML"),
        (b"a: 1\n---\nb: 2\n", "not valid YAML"),
    ],
)
def test_files_that_are_not_configurations(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "trial.yaml"
    path.write_bytes(content)
    assert words in complaint(path)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    assert "no such file" in complaint(tmp_path / "nowhere.yaml")
    assert "cannot be read" in complaint(tmp_path)


def test_models_are_frozen(write) -> None:
    trial = load(write(LEAST), STAGES)
    with pytest.raises(ValueError, match="frozen"):
        trial.settings["ukf-smooth"].cutoff = 1.0  # type: ignore[attr-defined]


def test_the_schema_knows_every_key_and_both_forms_of_a_recording() -> None:
    found = build_schema(STAGES)
    assert {"trial", "recording", "out", "segment", "ukf-smooth"} <= set(found["properties"])
    assert found["required"] == ["trial"]
    assert found["anyOf"] == [{"required": ["recording"]}, {"required": ["imus", "calibration"]}]
    assert [choice["type"] for choice in found["properties"]["recording"]["anyOf"]] == ["string", "object"]
    assert found["$defs"]["FilterSettings"]["properties"]["cutoff"]["description"] == "low-pass, Hz"


@pytest.mark.parametrize(
    ("given", "lines"),
    [
        ("{forearm: {flie: a.csv}}", ["`imus.forearm.file` is missing", "`imus.forearm.flie`: did you mean `file`?"]),
        ("{forearm: {file: a.csv, rate_hz: -1}}", ["`imus.forearm.rate_hz` is -1, expected greater than 0"]),
        ("{forearm: 3}", ["`imus.forearm` is 3, expected text"]),
    ],
)
def test_a_mistake_in_one_of_two_forms_is_told_for_that_form(write, given: str, lines: list[str]) -> None:
    """A sensor is a file, or keys with a file and a rate."""
    told = complaint(write(f"{LEAST}space: 3d\nimus: {given}\n")).splitlines()
    assert len(told) == len(lines)
    for line, words in zip(told, lines, strict=True):
        assert words in line


def test_a_sensor_may_have_a_rate(write, tmp_path: Path) -> None:
    given = "imus: {hand: b.csv, forearm: {file: a.csv, rate_hz: 60}}"
    sensors = list_sensors(load(write(f"{LEAST}space: 3d\n{given}\n"), STAGES).keys.imus)
    assert sensors["forearm"] == InertialSensor(file=tmp_path / "a.csv", rate_hz=60)
    assert sensors["hand"] == InertialSensor(file=tmp_path / "b.csv")
