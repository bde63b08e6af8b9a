"""Reaches in a folder: by their content, with side and session, and a study of them that is valid."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np
import pytest

from mocap_id.config.study import load_study
from mocap_id.recording.writer import write_c3d
from mocap_id.workflows.study.discovery import choose_sides, discover, find_session, write_draft

LANDMARKS = ("IJ", "PX", "C7", "T8", "EL", "EM", "US", "RS", "UPA1", "FOR1")
TRUNK = ("SpineShoulder", "SpineBase")


def skeleton(path: Path, *sides: str) -> None:
    """A log of a depth camera that shows the arms of some sides."""
    path.parent.mkdir(parents=True, exist_ok=True)
    joints = [*TRUNK, *(f"{joint}{side}" for side in sides for joint in ("Shoulder", "Elbow", "Wrist"))]
    names = ["time_s", *(f"{joint}_{axis}" for joint in joints for axis in "xyz")]
    rows = np.column_stack([np.arange(40) / 30, np.random.default_rng(1).random((40, 3 * len(joints)))])
    lines = [",".join(names), *(",".join(f"{value:.4f}" for value in row) for row in rows)]
    path.write_text("\n".join(lines))


def markers(path: Path, *labels: str) -> None:
    """A C3D file in which the thorax stays, elbow and wrist reach, and other markers rise and sink."""
    path.parent.mkdir(parents=True, exist_ok=True)
    time, random = np.arange(400) / 100, np.random.default_rng(1)
    places = {"IJ": (0.1, 0, 1.4), "PX": (0.12, 0, 1.2), "C7": (0, 0, 1.5), "T8": (-0.05, 0, 1.25)}
    far = {"EL": 0.3, "EM": 0.3, "UPA1": 0.15, "FOR1": 0.45, "US": 0.55, "RS": 0.55}
    angle = np.radians(60) * (1 - np.cos(2 * np.pi * 0.5 * time)) / 2
    points = random.normal(scale=5e-4, size=(len(time), len(labels), 3))
    for k, label in enumerate(labels):
        name = label.split(":")[-1].removeprefix("L")
        if name in places:
            points[:, k] += places[name]
        elif name in far:
            swing = far[name] * np.column_stack([np.sin(angle), 0 * angle, -np.cos(angle)])
            points[:, k] += swing + np.array([0.0, 0.2 + 0.02 * (k % 2), 1.4])
        else:
            points[:, k] += np.column_stack([0 * time, 0 * time, 0.3 + 0.2 * k + 0.1 * angle * k])
    write_c3d(path, labels, points, 100.0)


def test_camera_logs_become_a_study_of_reaches(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    skeleton(folder / "anna" / "session1" / "left.csv", "Left", "Right")
    skeleton(folder / "anna" / "session2" / "both.csv", "Left", "Right")
    skeleton(folder / "bob" / "session1" / "kinect.csv", "Right")
    (folder / "bob" / "session1" / "imu.csv").write_text("time_s,gyro_x\n0,1\n")
    found = discover(folder)
    assert found.reach
    assert [(one.trial, one.side, one.session) for one in found.trials] == [
        ("s01-session1-left-1", "left", "session1"),
        ("s01-session2-right-1", "right", "session2"),
        ("s01-session2-left-1", "left", "session2"),
        ("s02-session1-right-1", "right", "session1"),
    ]
    write_draft(found, tmp_path / "study.yaml")
    study = load_study(tmp_path / "study.yaml")
    assert study.reach
    assert [one.trial.keys.side for one in study.trials] == ["left", "right", "left", "right"]
    assert study.trials[0].session == "session1"
    assert study.trials[0].trial.keys.recording.skeleton == folder / "anna" / "session1" / "left.csv"


def test_markers_of_an_arm_are_reaches_and_the_fewer_are_left_out(tmp_path: Path) -> None:
    markers(tmp_path / "anna" / "right.c3d", *LANDMARKS)
    markers(tmp_path / "anna" / "reach.c3d", *(f"Anna:L{label}" for label in LANDMARKS))
    markers(tmp_path / "anna" / "squat.c3d", "RANK", "RKNE", "RASI")
    found = discover(tmp_path)
    assert {one.markers.name: one.side for one in found.trials} == {"right.c3d": "right", "reach.c3d": "left"}
    assert not any(one.skeleton for one in found.trials)
    assert list(found.left_out.values()) == ["not a reach: no markers of an arm and no skeleton"]
    markers(tmp_path / "anna" / "squat2.c3d", "RANK", "RKNE", "RASI")
    found = discover(tmp_path)
    assert not found.reach
    assert {path.name for path in found.left_out} == {"right.c3d", "reach.c3d"}


@pytest.mark.parametrize(
    ("path", "session"),
    [("anna/Visit_02/l.csv", "visit2"), ("anna_session3_left.c3d", "session3"), ("friday1/a.csv", ""), ("a/b.csv", "")],
)
def test_a_session_is_a_number_after_its_word(path: str, session: str) -> None:
    assert find_session(PurePosixPath(path)) == session


def test_the_path_names_the_side_before_the_markers() -> None:
    both = ("right", "left")
    assert choose_sides(both, PurePosixPath("anna/L_1.csv")) == ("left",)
    assert choose_sides(both, PurePosixPath("anna/left_right.csv")) == ("right", "left")
    assert choose_sides((), PurePosixPath("anna/1.c3d")) == ("right",)
