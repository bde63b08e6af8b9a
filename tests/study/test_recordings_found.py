"""From a folder to the draft of a study: who, how, and what is left out."""

from __future__ import annotations

import csv
from pathlib import Path, PurePosixPath

import pytest

from mocap_id.config.study import load_study
from mocap_id.errors import ConfigError, StoreError
from mocap_id.workflows.study.discovery import Pattern, choose_pattern, discover, read_known_ids, write_draft

LAYOUTS = {
    "a folder a person": ["anna/normal1.c3d", "anna/stable_2.c3d", "bob/Normal-1.C3D"],
    "and a folder a strategy": ["anna/normal/1.c3d", "anna/stable/take2.c3d", "bob/normal/t1.c3d"],
    "a session between": ["anna/session1/normal.c3d", "anna/session1/stable.c3d", "bob/session1/normal.c3d"],
    "all in one folder": ["anna_normal_1.c3d", "anna_stable_2.c3d", "bob_normal_1.c3d"],
    "with hyphens": ["anna-normal-1.c3d", "anna-stable-2.c3d", "bob-normal-trial3.c3d"],
    "with blanks": ["anna normal 1.c3d", "anna stable 1.c3d", "bob normal 1.c3d"],
    "a folder a strategy": ["normal/anna_1.c3d", "stable/anna_2.c3d", "normal/bob-3.c3d"],
    "the name twice": ["anna/anna_normal_01.c3d", "anna/anna_stable_01.c3d", "bob/bob_normal_01.c3d"],
}


def touched(folder: Path, *names: str) -> Path:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    return folder


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_a_usual_layout_needs_no_pattern(tmp_path: Path, layout: list[str]) -> None:
    found = discover(touched(tmp_path, *layout))
    told = {(trial.subject, trial.name, trial.strategy, trial.trial) for trial in found.trials}
    assert told == {
        ("s01", "anna", "normal", "s01-normal-1"),
        ("s01", "anna", "stable", "s01-stable-1"),
        ("s02", "bob", "normal", "s02-normal-1"),
    }
    assert not found.left_out


@pytest.mark.parametrize(
    ("pattern", "path", "place"),
    [
        ("{subject}/{strategy}*.c3d", "p 7/Self-selected 03.c3d", ("p 7", "self-selected")),
        ("{subject}/{strategy}*.c3d", "p7/normal.trc", None),
        ("{subject}/{strategy}*.c3d", "p7/01.c3d", None),
        ("data/*/{subject}/sts_{strategy}_*", "data/2024/x1/sts_fast_02.c3d", ("x1", "fast")),
        ("{subject}/**/{strategy}*", "x1/a/b/c/slow.c3d", ("x1", "slow")),
        ("{subject}/*", "x1/whatever9.c3d", ("x1", "movement")),
        ("{strategy}/{subject}*", "stable/P03_trial2.c3d", ("P03", "stable")),
        ("({subject}) {strategy}*", "(x+y) slow.c3d", ("x+y", "slow")),
    ],
)
def test_a_pattern_tells_person_and_strategy(pattern: str, path: str, place: tuple[str, str] | None) -> None:
    found = Pattern(pattern).match(PurePosixPath(path))
    assert (found and (found.subject, found.strategy)) == place


@pytest.mark.parametrize(
    "pattern", ["{strategy}/{strategy}*", "{subject}/{how}*", "{subject}/{subject}", "{subject", "*"]
)
def test_a_pattern_that_means_nothing_is_refused(pattern: str) -> None:
    with pytest.raises(ConfigError, match="expected \\{subject\\}, \\{strategy\\} or both, each at most once"):
        Pattern(pattern)


@pytest.mark.parametrize(
    "names",
    [
        ["slow_1.c3d", "slow_2.c3d", "normal_1.c3d"],
        ["slow1.c3d", "slow2.c3d", "normal.c3d"],
        ["slow_trial1.c3d", "slow_trial2.c3d", "normal-take-1.c3d"],
        ["slow trial 1.c3d", "slow 2.c3d", "normal.c3d"],
    ],
)
def test_a_flat_folder_is_of_one_person(tmp_path: Path, names: list[str]) -> None:
    found = discover(touched(tmp_path / "anna", *names))
    assert found.pattern == "{strategy}*"
    assert found.names == {"s01": "anna"}
    assert sorted(trial.trial for trial in found.trials) == ["s01-normal-1", "s01-slow-1", "s01-slow-2"]
    assert not found.left_out
    assert "{subject}_{strategy}*" in found.tried


def test_trials_of_one_person_with_numbers_alone(tmp_path: Path) -> None:
    found = discover(touched(tmp_path / "anna", "trial1.c3d", "trial2.c3d"))
    assert [trial.trial for trial in found.trials] == ["s01-movement-1", "s01-movement-2"]
    with pytest.raises(
        ConfigError, match=r"none of the 1 recordings fits one of the patterns .*\{strategy\}\*; an example is 1.c3d"
    ):
        discover(touched(tmp_path / "bob", "1.c3d"))


def test_a_flat_folder_of_several_people_is_not_of_one(tmp_path: Path) -> None:
    found = discover(touched(tmp_path, "anna_normal_1.c3d", "bob_normal_1.c3d", "carl_normal.c3d", "again.c3d"))
    assert set(found.names.values()) == {"anna", "bob", "carl"}
    assert [path.name for path in found.left_out] == ["again.c3d"]


def test_exports_are_recordings_and_other_tables_are_not(tmp_path: Path) -> None:
    folder = touched(tmp_path / "anna", "encoder.csv", "slow.mot")
    (folder / "slow.tsv").write_text("NO_OF_FRAMES\t10\n")
    (folder / "fast.csv").write_text("Trajectories\n100\n")
    found = discover(folder)
    files = {(trial.markers.name, trial.forces and trial.forces.name) for trial in found.trials}
    assert files == {("slow.tsv", "slow.mot"), ("fast.csv", None)}


def test_two_people_whose_names_differ_by_a_number_stay_two() -> None:
    paths = [PurePosixPath("P 01/normal.c3d"), PurePosixPath("P 02/normal.c3d")]
    assert {labels.subject for path in paths if (labels := choose_pattern(paths).match(path))} == {"P 01", "P 02"}


def test_people_and_trials_are_counted_as_people_count(tmp_path: Path) -> None:
    names = [f"p{k}/normal{n}.c3d" for k in (10, 9, 2) for n in (1, 2, 10)]
    found = discover(touched(tmp_path, *names))
    assert list(found.names.items()) == [("s01", "p2"), ("s02", "p9"), ("s03", "p10")]
    own = [trial.markers.name for trial in found.trials if trial.subject == "s01"]
    assert own == ["normal1.c3d", "normal2.c3d", "normal10.c3d"]


def test_a_trc_file_takes_its_mot_and_gives_way_to_a_c3d(tmp_path: Path) -> None:
    folder = touched(
        tmp_path, "a/sts1.trc", "a/sts1_grf.mot", "a/sts1_ik.mot", "a/sts2.trc", "a/sts3.trc", "a/sts3.c3d",
        "a/static1.trc", "a/.hidden.c3d", "a/notes.txt",
    )  # fmt: skip
    found = discover(folder)
    files = [(trial.markers.name, trial.forces and trial.forces.name) for trial in found.trials]
    assert files == [("sts1.trc", "sts1_grf.mot"), ("sts2.trc", None), ("sts3.c3d", None)]
    assert {path.name: why for path, why in found.left_out.items()} == {
        "static1.trc": "the name is that of a static or calibration trial",
        "sts3.trc": "the C3D file with the same name is used",
    }


def test_what_does_not_fit_is_told_and_nothing_found_is_an_error(tmp_path: Path) -> None:
    folder = touched(tmp_path, "a/normal.c3d", "stray.c3d")
    found = discover(folder, "{subject}/{strategy}*")
    assert list(found.left_out.values()) == ["does not fit the pattern {subject}/{strategy}*"]
    with pytest.raises(ConfigError, match="none of the 2 recordings fits the pattern x/"):
        discover(folder, "x/{subject}/{strategy}*")
    with pytest.raises(ConfigError, match="the folder contains no recording"):
        discover(touched(tmp_path / "empty", "readme.txt"))
    with pytest.raises(ConfigError, match="no such folder"):
        discover(tmp_path / "nowhere")


def test_the_draft_is_a_valid_study_without_a_name_in_it(tmp_path: Path) -> None:
    folder = touched(tmp_path / "recordings", "Anna Müller/normal.c3d", "Bob #2/stable.trc", "Bob #2/stable.mot")
    file = tmp_path / "here" / "study.yaml"
    assert write_draft(discover(folder), file) == [file, tmp_path / "here" / "subjects.csv"]
    study = load_study(file)
    first, second = study.trials
    assert first.trial.keys.recording.markers.resolve() == folder / "Anna Müller" / "normal.c3d"
    assert second.trial.keys.recording.forces == file.parent / "../recordings/Bob #2/stable.mot"
    assert first.trial.keys.protocol == "sit-to-stand"
    assert list(study.subjects) == ["s01", "s02"]
    with (file.parent / "subjects.csv").open(encoding="utf-8") as stream:
        assert list(csv.reader(stream)) == [["id", "name"], ["s01", "Anna Müller"], ["s02", "Bob #2"]]


def test_nothing_is_overwritten_unasked_and_people_keep_their_ids(tmp_path: Path) -> None:
    folder, file = touched(tmp_path / "rec", "bob/normal.c3d", "zoe/normal.c3d"), tmp_path / "study.yaml"
    write_draft(discover(folder), file)
    before = file.read_bytes()
    touched(folder, "anna/normal.c3d")
    with pytest.raises(StoreError, match=r"study\.yaml exists already: .* --force"):
        write_draft(discover(folder), file)
    assert file.read_bytes() == before
    write_draft(discover(folder, known=read_known_ids(file)), file, force=True)
    assert read_known_ids(file) == {"bob": "s01", "zoe": "s02", "anna": "s03"}


def test_names_may_be_kept(tmp_path: Path) -> None:
    folder, file = touched(tmp_path / "rec", "Bob B/normal.c3d"), tmp_path / "study.yaml"
    assert write_draft(discover(folder, keep_names=True), file, keep_names=True) == [file]
    assert load_study(file).trials[0].name == "Bob-B-normal-1"
    with pytest.raises(ConfigError, match="several folders give the id `Bob-B`"):
        discover(touched(folder, "Bob-B/normal.c3d"), keep_names=True)


@pytest.mark.parametrize(
    ("layout", "people"),
    [
        (["normal/subject_01.c3d", "fast/subject_01.c3d", "normal/subject_02.c3d"], {"subject_01", "subject_02"}),
        (["P_01_normal.c3d", "P_01_fast.c3d", "P_02_normal.c3d"], {"P_01", "P_02"}),
        (["sub-01_normal.c3d", "sub-02_normal.c3d"], {"sub-01", "sub-02"}),
        (["clinic/p1/normal1.c3d", "clinic/p2/normal1.c3d"], {"p1", "p2"}),
        (["clinic/2024/p1/sts.c3d", "clinic/2024/p2/sts.c3d"], {"p1", "p2"}),
    ],
)
def test_numbered_people_are_not_one_person(tmp_path: Path, layout: list[str], people: set[str]) -> None:
    found = discover(touched(tmp_path, *layout))
    assert set(found.names.values()) == people
    assert len({trial.subject for trial in found.trials}) == len(people)
    assert not found.doubts


def test_an_id_that_may_be_two_people_is_reported(tmp_path: Path) -> None:
    folder = touched(tmp_path, *(f"{site}/{person}/normal1.c3d" for site in ("A", "B") for person in ("p1", "p2")))
    assert "p1 is a name in the folders A, B" in discover(folder).doubts[0]
    assert "the paths of its recordings contain p1, p2" in discover(folder, "{subject}/*/{strategy}*").doubts[0]
