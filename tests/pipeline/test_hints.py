"""The user's hints about markers, through the stages: together, apart, ignore, joint_markers."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.errors import ConfigError
from mocap_id.runner import run
from mocap_id.stages import STAGES
from mocap_id.stages.base import Context, find_markers
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.store import Folder, LongTable, Table, Tree
from mocap_id_cli.__main__ import main
from mocap_id_simulation import Options, simulate

PLANARISE, SEGMENT, FIT_JOINTS = STAGES[:3]
KEYS = TrialKeys(trial="t", recording=Files(markers=Path("trial.c3d")), protocol="sit-to-stand")
FEET = ["LHEE", "RHEE", "LTOE", "RTOE", "PLT*"]
ANKLES = ["LANK", "RANK"]


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of two sit-to-stands."""
    folder = tmp_path_factory.mktemp("hints") / "person"
    simulate("sit-to-stand", folder, Options(seed=4, repetitions=2))
    return folder


@pytest.fixture(scope="module")
def planar(source: Path) -> LongTable:
    """The recording in the plane."""
    table = Folder(run(load(source / "trial.yaml"), [PLANARISE]).folder).read("planar.parquet")
    assert isinstance(table, LongTable)
    return table


@pytest.fixture(scope="module")
def plain(planar: LongTable) -> Table:
    return segmented(planar)


def segmented(planar: LongTable, **settings: Any) -> Table:
    """Return the segments for some settings."""
    (table,) = SEGMENT.function(Context(KEYS, SEGMENT.settings(**settings), {"planar.parquet": planar}))
    assert isinstance(table, Table)
    return table


def fitted(planar: LongTable, segments: Table, **settings: Any) -> Tree:
    inputs = {"planar.parquet": planar, "segments.parquet": segments}
    (tree,) = FIT_JOINTS.function(Context(KEYS, FIT_JOINTS.settings(frames=80, **settings), inputs))
    assert isinstance(tree, Tree)
    return tree


def where(segments: Table) -> dict[str, int | None]:
    """Return the segment of each marker by label."""
    frame = segments.frame
    numbers = frame["segment"].astype(object).where(frame["segment"].notna(), None)
    return dict(zip(frame["marker"].astype(str), numbers, strict=True))


def reason(segments: Table, marker: str) -> str:
    frame = segments.frame
    return str(frame.loc[frame["marker"].astype(str) == marker, "reason"].item())


def test_without_hints_the_segments_are_right(source: Path, plain: Table) -> None:
    assert where(plain) == json.loads((source / "truth.json").read_text())["assignment"]


def test_apart_takes_the_ankles_off_one_segment(planar: LongTable, plain: Table) -> None:
    """Both malleoli are on the shank; with this hint one of them is removed, and nothing else changes."""
    assert [where(plain)[name] for name in ANKLES] == [1, 1]
    told = where(segmented(planar, apart=[ANKLES]))
    assert sorted(str(told[name]) for name in ANKLES) in (["0", "1"], ["1", "None"])
    assert {name: k for name, k in told.items() if name not in ANKLES} == {
        name: k for name, k in where(plain).items() if name not in ANKLES
    }


def test_apart_takes_a_heel_off_the_base(planar: LongTable, plain: Table) -> None:
    base = [name for name, k in where(plain).items() if k == 0]
    told = where(segmented(planar, apart=[["LHEE", other] for other in base if other != "LHEE"]))
    assert "LHEE" in base
    assert told.pop("LHEE") != 0
    moving = {name: k for name, k in where(plain).items() if k and name not in ANKLES}  # near the heel, in doubt
    assert {name: told[name] for name in moving} == moving


def test_together_takes_a_marker_along(planar: LongTable, plain: Table) -> None:
    assert where(plain)["LASI"] == 3
    told = where(segmented(planar, together=[["LASI", "LTHI*"]]))
    assert len({told[name] for name in ("LASI", "LTHI", "LTHI2", "LTHI3")}) == 1
    malleoli = where(segmented(planar, together=[["LANK", "LHEE"]]))
    assert (malleoli["LANK"], malleoli["RANK"], malleoli["LHEE"]) == (0, where(plain)["RANK"], 0)


def test_the_whole_truth_as_a_hint_changes_nothing(planar: LongTable, plain: Table) -> None:
    """Also if the whole base is one group, so that no other still marker can be on the axis."""
    groups = [["LFHD", "RFHD", "C7", "T10", "CLAV"], ["?THI*"], ["?TIB*", "?ANK"], FEET]
    told = segmented(planar, together=groups, apart=[["C7", "LTHI", "LTIB", "LHEE"]])
    assert where(told) == where(plain)
    assert told.facts["count"] == 4


def test_ignored_markers_are_on_no_segment_and_have_a_reason(planar: LongTable, plain: Table) -> None:
    told = segmented(planar, ignore=["LWR*", "RTHI2"])
    out = {"LWRA", "LWRB", "RTHI2"}
    assert {name for name, k in where(told).items() if k is None} == out
    for name in out:
        assert reason(told, name) == "left out by `segment: ignore`"
    assert told.frame.loc[told.frame["marker"].isin(out), "residual"].isna().all()
    assert {name: k for name, k in where(told).items() if name not in out} == {
        name: k for name, k in where(plain).items() if name not in out
    }
    assert not any(out & {name for group in h["markers"] for name in group} for h in told.facts["hypotheses"])
    chain = fitted(planar, told)
    assert not out & set(chain.data["markers"]["name"])


@pytest.mark.parametrize(
    ("settings", "key", "near"),
    [
        ({"together": [["LTHI", "LTHY2"]]}, "segment: together", "did you mean LTHI2?"),
        ({"apart": [["LANC", "RTOE"]]}, "segment: apart", "did you mean LANK?"),
        ({"ignore": ["PLT8"]}, "segment: ignore", "did you mean PLT"),
        ({"ignore": ["lank"]}, "segment: ignore", "no marker is called lank"),
        ({"ignore": ["QQQ*"]}, "segment: ignore", "the markers are LFHD, RFHD"),
        ({"joint_markers": {"ankle": ["LANKLE"]}}, "segment: joint_markers: ankle", "did you mean LANK?"),
    ],
)
def test_an_unknown_marker_is_reported_with_its_key(planar: LongTable, settings: Any, key: str, near: str) -> None:
    with pytest.raises(ConfigError) as caught:
        segmented(planar, **settings)
    assert str(caught.value).startswith(key)
    assert near in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_contradiction_is_a_mistake_of_the_configuration(planar: LongTable) -> None:
    with pytest.raises(
        ConfigError, match=r"`together` and `apart` contradict each other: one joins L(ANK|TIB2?) to"
    ) as one:
        segmented(planar, together=[["LANK", "LTIB"], ["LTIB", "LTIB2"]], apart=[["LANK", "LTIB2"]])
    assert one.value.exit_code == 2


def test_an_unknown_joint_is_a_mistake_of_the_configuration(planar: LongTable) -> None:
    with pytest.raises(ConfigError, match="there is no joint ancle; expected one of ankle, knee, hip"):
        segmented(planar, joint_markers={"ancle": ANKLES})


def test_markers_around_a_joint_attract_it(planar: LongTable, plain: Table) -> None:
    """Their mean attracts it, more with a larger lambda_a; the segments stay the same, and a note says so."""
    about = segmented(planar, joint_markers={"ankle": ["?ANK"]})
    assert about.facts["joint_markers"] == {"ankle": ANKLES}
    assert where(about) == where(plain)
    free = fitted(planar, plain)
    assert "joint-markers" not in {reason.code for reason in free.reasons}
    frame = planar.frame[planar.frame["marker"].isin(ANKLES)]
    middle = frame.groupby("frame", observed=True)[["x", "y"]].mean().mean().to_numpy()
    pulled = [fitted(planar, about, lambda_a=pull) for pull in (0.01, 1e5)]
    distance = [np.hypot(*(tree.data["joints"]["centre"][0] - middle)) for tree in (free, *pulled)]
    assert distance[0] > distance[1] > distance[2]
    assert distance[2] < 5e-4
    for tree in pulled:
        (note,) = (reason for reason in tree.reasons if reason.code == "joint-markers")
        assert note.level == "ok"
        assert "the ankle is attracted to the mean of LANK, RANK" in note.message


def test_only_the_fit_of_the_whole_chain_uses_joint_markers(planar: LongTable) -> None:
    about = segmented(planar, joint_markers={"ankle": ANKLES})
    with pytest.raises(ConfigError, match=r"joint_markers: `fit-joints: \{estimator: circle\}` cannot use them"):
        fitted(planar, about, estimator="circle")


def test_ignored_markers_may_be_joint_markers(planar: LongTable) -> None:
    about = segmented(planar, ignore=ANKLES, joint_markers={"ankle": ANKLES})
    tree = fitted(planar, about, lambda_a=1e5)
    assert not set(ANKLES) & set(tree.data["markers"]["name"])
    frame = planar.frame[planar.frame["marker"].isin(ANKLES)]
    middle = frame.groupby("frame", observed=True)[["x", "y"]].mean().mean().to_numpy()
    assert np.hypot(*(tree.data["joints"]["centre"][0] - middle)) < 5e-4


def test_a_mistake_within_a_stage_names_trial_and_stage(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    yaml = tmp_path / "typo.yaml"
    keys = {"trial": "typo", "recording": str(source / "trial.c3d"), "protocol": "sit-to-stand"}
    yaml.write_text(json.dumps({**keys, "segment": {"ignore": ["LANKK"]}}))
    with pytest.raises(ConfigError) as caught:
        run(load(yaml))
    assert caught.value.__notes__ == ["trial typo, stage segment"]
    monkeypatch.setattr(sys, "argv", ["mocap-id", "run", str(yaml)])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    said = capsys.readouterr().err
    assert "trial typo, stage segment: segment: ignore: no marker is called LANKK; did you mean LANK?" in said.replace(
        "\n", " "
    )


def test_names_and_patterns() -> None:
    labels = ("LTHI", "LTHI2", "RTHI", "C7", "Bob:LWRA")
    assert find_markers(labels, (), "key") == ()
    assert find_markers(labels, ("LTHI",), "key") == (0,)  # a name is no beginning of one
    assert find_markers(labels, ("RTHI", "LTHI"), "key") == (0, 2)
    assert find_markers(labels, ("LTHI*",), "key") == (0, 1)
    assert find_markers(labels, ("?THI", "LTHI*"), "key") == (0, 1, 2)
    assert find_markers(labels, ("*:LWR?",), "key") == (4,)
    with pytest.raises(ConfigError, match="key: no marker is called c7"):
        find_markers(labels, ("C7", "c7"), "key")


@pytest.mark.parametrize("label", ["*12", "M[1]", "what?"])
def test_a_label_that_looks_like_a_pattern_selects_itself(label: str) -> None:
    """Cameras call unlabelled markers ``*12``."""
    labels = ("M1", "A*12", label, "whatX")
    assert find_markers(labels, (label,), "key") == (2,)


def test_a_marker_ignored_and_in_a_group_stays_ignored(planar: LongTable, plain: Table) -> None:
    told = segmented(planar, together=[["LTHI*"]], ignore=["LTHI2"])
    expected = {**where(plain), "LTHI2": None}
    assert where(told) == expected
    assert fitted(planar, told).data["markers"]["name"].tolist() == [
        name for name, k in expected.items() if k is not None
    ]
