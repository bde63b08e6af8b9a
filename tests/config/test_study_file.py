"""YAML files of studies: every mistake with its line, and trials that equal those of separate files."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from mocap_id.config import build_trial_model, load
from mocap_id.config import study as study_module
from mocap_id.config.parsing import Source, read_source
from mocap_id.config.study import build_study_schema, load_study
from mocap_id.errors import ConfigError

GOOD = """\
study: five times
out: results
defaults:
  protocol: sit-to-stand
  segment: {count: 4}
subjects:
  s01: {height: 1.75, mass: 70.1, sex: female, landmarks_m: {shank: 0.41}}
  s02:
trials:
  - {trial: s01-normal-1, subject: s01, strategy: normal, recording: rec/a.c3d}
  - trial: s02-stable-1
    subject: s02
    strategy: stable
    recording: {markers: rec/b.trc, forces: rec/b.mot}
    window: [1.0, 9.0]
    segment: {ignore: [HEAD]}
"""


def study(folder: Path, text: str) -> Path:
    file = folder / "study.yaml"
    file.write_text(text)
    return file


def told(folder: Path, text: str) -> list[str]:
    """Return the messages about a file with mistakes, without its folder."""
    with pytest.raises(ConfigError) as error:
        load_study(study(folder, text))
    return str(error.value).replace(f"{folder}/", "").splitlines()


def test_a_study_is_its_people_and_trials(tmp_path: Path) -> None:
    found = load_study(study(tmp_path, GOOD))
    assert (found.name, found.out, found.folder) == ("five times", tmp_path / "results", tmp_path / "results" / "study")
    assert found.strategies == ("normal", "stable")
    assert found.subjects["s01"].landmarks_m.shank == 0.41
    assert found.subjects["s02"].height is None
    first, second = found.trials
    assert (first.name, first.subject, first.strategy) == ("s01-normal-1", "s01", "normal")
    assert first.trial.keys.recording.markers == tmp_path / "rec" / "a.c3d"
    assert first.trial.keys.subject.mass == 70.1
    assert second.trial.out == tmp_path / "results" / "s02-stable-1"
    assert second.trial.keys.window == (1.0, 9.0)


def test_a_trial_of_a_study_is_the_one_of_a_file(tmp_path: Path) -> None:
    alone = tmp_path / "trial.yaml"
    alone.write_text(
        "trial: s01-normal-1\nrecording: rec/a.c3d\nprotocol: sit-to-stand\nsegment: {count: 4}\n"
        "subject: {height: 1.75, mass: 70.1, sex: female}\nout: results/s01-normal-1\n"
    )
    one, same = load(alone), load_study(study(tmp_path, GOOD)).trials[0].trial
    assert (one.keys, one.settings, one.out) == (same.keys, same.settings, same.out)


def test_a_trials_own_keys_add_to_the_defaults(tmp_path: Path) -> None:
    settings = load_study(study(tmp_path, GOOD)).trials[1].trial.settings["segment"]
    assert settings.model_dump(exclude_unset=True) == {"count": 4, "ignore": ("HEAD",)}
    other = GOOD.replace("{ignore: [HEAD]}", "{count: 3}")
    assert load_study(study(tmp_path, other)).trials[1].trial.settings["segment"].model_dump()["count"] == 3


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("study: five times", "studi: five times", "study.yaml, line 1: unknown key `studi`: did you mean `study`?"),
        ("s01-normal-1", "s02-stable-1", "line 11: the trial `s02-stable-1` is given twice, first on line 10"),
        ("s01-normal-1", "S02-Stable-1", "line 11: the trial `s02-stable-1` is given twice, first on line 10"),
        ("subject: s02", "subject: so2", "line 12: there is no subject `so2`: did you mean `s02`?"),
        ("    strategy: stable\n", "", "line 11: `trials[1].strategy` is missing"),
        ("window: [1.0, 9.0]", "window: [9.0, 1.0]", "line 15: `window` is [9.0, 1.0], but the first time must come"),
        ("window:", "windov:", "line 15: unknown key `windov`: did you mean `window`?"),
        ("window: [1.0, 9.0]", "strategi: x", "line 15: unknown key `strategi`: did you mean `strategy`?"),
        ("{count: 4}", "{count: four}", "line 5: `segment.count` is 'four', expected a whole number"),
        ("protocol: sit-to-stand", "protocol: sit", "line 4: `protocol` is 'sit', expected 'free', 'sit-to-stand'"),
        ("height: 1.75", "height: 175", "line 7: `subjects.s01.height` is 175, expected less than 2.8"),
        (
            "shank: 0.41",
            "shin: 0.41",
            "line 7: unknown key `subjects.s01.landmarks_m.shin`: did you mean",
        ),
        (
            "    window: [1.0, 9.0]",
            "    out: x",
            "line 15: `out` is not allowed in a trial: write it at the top",
        ),
        (
            "  protocol: sit-to-stand",
            "  recording: x.c3d",
            "line 4: `defaults.recording` is not allowed",
        ),
        ("  protocol: sit-to-stand", "  out: x", "line 4: `defaults.out` is not allowed: write `out` at the top"),
        ("trial: s01-normal-1", "trial: study", "line 10: no trial can be called `study`"),
        ("  s02:", "  s02:\n  cohort: {}", "line 9: no subject can be called `cohort`"),
        ("recording: {markers: rec/b.trc, forces: rec/b.mot}", "protocol: free", "line 11: `recording` is missing"),
        ("subject: s02", "subject: 2", 'line 12: `trials[1].subject` is 2, expected text: write it in quotes, "2"'),
        ("subject: s02", "subject: {height: 1.8}", "line 12: `trials[1].subject` is {'height': 1.8}, expected"),
    ],
)
def test_a_mistake_is_reported_with_its_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in GOOD
    lines = told(tmp_path, GOOD.replace(old, new, 1))
    assert any(said in line for line in lines), lines


def test_mistakes_of_all_trials_are_reported_together_and_once(tmp_path: Path) -> None:
    wrong = GOOD.replace("{count: 4}", "{count: four}").replace("window: [1.0, 9.0]", "window: 1")
    lines = told(tmp_path, wrong)
    assert [line.partition(":")[0] for line in lines] == ["study.yaml, line 5", "study.yaml, line 15"]


def test_the_schema_knows_the_keys_of_study_and_trial() -> None:
    schema = build_study_schema()
    entry, defaults = schema["$defs"]["_Entry"], schema["properties"]["defaults"]
    assert entry["required"] == ["recording", "subject", "trial"]
    of_trial = set(build_trial_model().model_json_schema()["properties"])
    assert set(entry["properties"]) - {"strategy", "session", "subject"} == of_trial - {"subject", "out"}
    assert entry["properties"]["subject"]["type"] == "string", "an id, and not the person"
    assert {"trial", "recording", "strategy", "out"}.isdisjoint(defaults["properties"])
    assert "segment" in defaults["properties"]
    references = set(re.findall(r'"#/\$defs/(\w+)"', json.dumps(schema)))
    assert references <= set(schema["$defs"])


def test_a_study_without_trials_is_refused(tmp_path: Path) -> None:
    assert "`trials` is missing" in told(tmp_path, "study: x\nsubjects: {}\n")[0]
    assert "`trials` is []" in told(tmp_path, "study: x\nsubjects: {}\ntrials: []\n")[0]
    assert "expected keys such as `study:`" in told(tmp_path, "- a\n")[0]


def test_a_trial_is_sent_to_its_own_command(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"is a trial, not a study: `mocap-id run .*study\.yaml`"):
        load_study(study(tmp_path, "trial: a\nrecording: a.c3d\n"))


class _Counted(dict):  # type: ignore[type-arg]
    """Lines of a file that count the iterations over all of them."""

    walks = 0

    def items(self):  # type: ignore[no-untyped-def]
        _Counted.walks += 1
        return super().items()


@pytest.mark.parametrize("count", [5, 50])
def test_all_lines_are_read_once_for_any_number_of_trials(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """Reading all lines for each of thousands of trials would take minutes."""
    entry = GOOD.splitlines()[9]
    text = GOOD + "".join(f"{entry.replace('normal-1', f'normal-{k + 2}')}\n" for k in range(count))

    def counted(file: Path) -> Source:
        source = read_source(file)
        return replace(source, lines=_Counted(source.lines))

    monkeypatch.setattr(study_module, "read_source", counted)
    _Counted.walks = 0
    assert len(load_study(study(tmp_path, text)).trials) == count + 2
    assert _Counted.walks <= 2


REACHES = """\
study: reaches
defaults: {space: 3d, protocol: reach}
subjects:
  s01: {score: 2}
trials:
  - {trial: a, subject: s01, side: left, session: first, recording: a.c3d}
  - {trial: b, subject: s01, recording: b.c3d}
"""


def test_a_study_of_reaches_has_scores_sides_and_sessions(tmp_path: Path) -> None:
    found = load_study(study(tmp_path, REACHES))
    assert found.reach
    assert found.subjects["s01"].score == 2
    assert [(one.session, one.strategy, one.trial.keys.side) for one in found.trials] == [
        ("first", "", "left"),
        ("", "", None),
    ]
    assert not load_study(study(tmp_path, GOOD)).reach


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("recording: b.c3d", "recording: b.c3d, strategy: fast", "`trials[1].strategy` is not for `protocol: reach`"),
        (
            "recording: b.c3d",
            "recording: b.c3d, protocol: free",
            "`protocol: reach` and other protocols cannot be in one study",
        ),
        (
            "{space: 3d, protocol: reach}",
            "{space: 3d, protocol: free}",
            "`trials[0].session` is only for `protocol: reach`",
        ),
        ("score: 2", "score: severe", "`subjects.s01.score` is 'severe'"),
    ],
)
def test_mistakes_in_a_study_of_reaches_have_lines(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in REACHES
    lines = told(tmp_path, REACHES.replace(old, new, 1))
    assert any(said in line and line.startswith("study.yaml, line ") for line in lines), lines
