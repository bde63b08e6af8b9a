"""Skeletons of depth cameras and markerless software: formats, times, states, names of joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_id.anatomy.landmarks import find_roles
from mocap_id.errors import RecordingError
from mocap_id.recording import write_trc
from mocap_id.recording.skeleton_log import KINECT_V2, read_skeleton

ARM = ("near_shoulder", "far_shoulder", "elbow", "wrist")


def write_log(path: Path, time: np.ndarray, x: np.ndarray, state: np.ndarray | None = None) -> Path:
    """Write a joint that moves along x, and one at rest; the state belongs to the first."""
    head = "frame,time_s,Hand_x,Hand_y,Hand_z,Hand_state,Neck_x,Neck_y,Neck_z\n"
    state = np.full(len(time), 2) if state is None else state
    rows = [f"{k},{t:.6f},{a:.6f},0.5,2.0,{s},0.1,1.2,2.0\n" for k, (t, a, s) in enumerate(zip(time, x, state))]  # noqa: B905
    path.write_text(head + "".join(rows))
    return path


def test_uneven_times_become_even_and_motion_stays_where_it_was(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    time = np.arange(120) / 30 + rng.uniform(-2e-3, 2e-3, 120)
    time = np.delete(time, [40, 80, 81])
    found = read_skeleton(write_log(tmp_path / "a.csv", time, np.sin(time)))
    source = found.recording
    assert np.ptp(np.diff(source.time)) < 1e-9
    assert source.rate == pytest.approx(30, rel=0.01)
    hand = source.positions[:, source.labels.index("Hand")]
    seen = np.isfinite(hand[:, 0])
    assert np.allclose(hand[seen, 0], np.sin(source.time[seen]), atol=2e-3)
    assert np.allclose(hand[seen, 2], 0.5)  # y of the file points up
    lost = source.time[~seen]
    assert all(min(abs(t - gap) for gap in (40 / 30, 80 / 30, 81 / 30)) < 0.04 for t in lost)
    assert 2 <= len(lost) <= 6
    assert any("uneven" in note for note in source.oddities)


def test_lost_joints_are_missing_and_guessed_ones_are_marked(tmp_path: Path) -> None:
    time, state = np.arange(60) / 30, np.full(60, 2)
    state[10:15], state[30:33] = 1, 0
    found = read_skeleton(write_log(tmp_path / "a.csv", time, time, state))
    hand = found.recording.labels.index("Hand")
    assert np.flatnonzero(found.inferred[:, hand]).tolist() == [10, 11, 12, 13, 14]
    assert np.isnan(found.recording.positions[30:33, hand]).all()
    assert np.isfinite(found.recording.positions[33:, hand]).all()
    assert not found.inferred[:, found.recording.labels.index("Neck")].any()


def test_capital_letters_in_the_header_change_nothing(tmp_path: Path) -> None:
    time = np.arange(60) / 30
    state = np.where(time > 1, 1, 2)
    small = read_skeleton(write_log(tmp_path / "a.csv", time, time, state))
    head, rows = (tmp_path / "a.csv").read_text().split("\n", 1)
    for small_name, capital in (("_x", "_X"), ("_y", "_Y"), ("_z", "_Z"), ("_state", "_State"), ("time_s", "Time_s")):
        head = head.replace(small_name, capital)
    (tmp_path / "b.csv").write_text(f"{head}\n{rows}")
    capitals = read_skeleton(tmp_path / "b.csv")
    assert capitals.recording.labels == small.recording.labels == ("Hand", "Neck")
    assert np.array_equal(capitals.recording.positions, small.recording.positions, equal_nan=True)
    assert np.array_equal(capitals.inferred, small.inferred)
    assert capitals.inferred.any()


@pytest.mark.parametrize("width", [3, 7])
def test_rows_of_a_kinect_without_header_have_its_joints_at_30_hz(tmp_path: Path, width: int) -> None:
    values = np.random.default_rng(0).normal(0, 1, (40, 25, width))
    path = tmp_path / "kinect.txt"
    np.savetxt(path, values.reshape(40, -1), fmt="%.6f")
    source = read_skeleton(path).recording
    assert source.labels == KINECT_V2
    assert source.rate == pytest.approx(30)
    x, y, z = np.moveaxis(values[..., :3], 2, 0)
    assert np.allclose(source.positions, np.stack([x, -z, y], axis=2), atol=1e-5)
    assert any("30 rows per second" in note for note in source.oddities)


def test_a_trc_file_of_markerless_software_is_a_skeleton(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(0, 0.3, (30, 3, 3))
    write_trc(tmp_path / "a.trc", ["RShoulder", "RElbow", "RWrist"], points, 60.0)
    found = read_skeleton(tmp_path / "a.trc")
    assert found.recording.labels == ("RShoulder", "RElbow", "RWrist")
    assert not found.inferred.any()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n1,2\n", "JOINT_x"),
        ("1 2 3\n4 5 6\n", "25 joints"),
        ("time_s,A_x,A_y,A_z\n" + "0,1,2,3\n" * 30, "repeat the time"),
        ("time_s,A_x,A_y,A_z\n1,1,2,3\n0,1,2,3\n", "does not increase"),
    ],
)
def test_what_is_no_skeleton_is_refused_with_what_was_expected(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(RecordingError, match=says):
        read_skeleton(tmp_path / "a.csv")


@pytest.mark.parametrize(
    "names",
    [
        ("ShoulderRight", "ShoulderLeft", "ElbowRight", "WristRight"),  # Kinect v2
        ("SHOULDER_RIGHT", "SHOULDER_LEFT", "ELBOW_RIGHT", "WRIST_RIGHT"),  # Azure Kinect
        ("right_shoulder", "left_shoulder", "right_elbow", "right_wrist"),  # MediaPipe
        ("RShoulder", "LShoulder", "RElbow", "RWrist"),  # Pose2Sim
        ("r_shoulder_study", "L_shoulder_study", "r_elbow_study", "r_wrist_study"),
    ],
)
def test_joints_are_found_by_the_names_of_usual_programs(names: tuple[str, ...]) -> None:
    assert find_roles(names, "right") == {role: k for k, role in enumerate(ARM)}
    left = find_roles(names, "left")
    assert left["near_shoulder"] == 1
    assert "elbow" not in left


def test_middle_joints_and_hips_are_told_apart() -> None:
    roles = find_roles(["Hip", "RHip", "LHip", "Neck", "Head", "SpineShoulder", "SpineMid"], "left")
    assert roles == {"pelvis": 0, "far_hip": 1, "near_hip": 2, "neck": 3, "head": 4, "spine_top": 5, "spine": 6}


def kinect_rows(count: int = 30) -> list[str]:
    values = np.random.default_rng(0).uniform(0.1, 2.0, (count, 75))
    return [" ".join(f"{value:.4f}" for value in row) for row in values]


@pytest.mark.parametrize("blank", [[0], [10], [30], [0, 10, 10, 30, 31]])
def test_blank_lines_in_the_text_of_a_kinect_are_ignored(tmp_path: Path, blank: list[int]) -> None:
    path, lines = tmp_path / "k.txt", kinect_rows()
    path.write_text("\n".join(lines) + "\n")
    whole = read_skeleton(path).recording
    for at in blank:
        lines.insert(at, "")
    path.write_text("\n".join(lines) + "\n\n")
    np.testing.assert_array_equal(read_skeleton(path).recording.positions, whole.positions)


def test_text_of_a_kinect_that_ends_within_its_last_row_is_refused(tmp_path: Path) -> None:
    text = "\n".join(kinect_rows())
    (tmp_path / "k.txt").write_text(text)
    assert len(read_skeleton(tmp_path / "k.txt").recording.time) == 30
    for lost in (1, 4, 200):
        (tmp_path / "k.txt").write_text(text[:-lost])
        with pytest.raises(RecordingError, match="ends within its last line"):
            read_skeleton(tmp_path / "k.txt")


def test_a_joint_that_occurs_twice_is_refused(tmp_path: Path) -> None:
    row = ",1,2,3,4,5,6\n"
    path = tmp_path / "s.csv"
    path.write_text("time_s,A_x,A_y,A_z,a_X,A_y,A_z\n" + "".join(f"{k / 30:.4f}{row}" for k in range(30)))
    with pytest.raises(RecordingError, match="`a_X` occurs twice"):
        read_skeleton(path)
    write_trc(tmp_path / "s.trc", ("A", "B"), np.random.default_rng(0).uniform(0, 1, (30, 2, 3)), 30)
    (tmp_path / "s.trc").write_text((tmp_path / "s.trc").read_text().replace("\tB", "\tA"))
    with pytest.raises(RecordingError, match="`A` occurs twice"):
        read_skeleton(tmp_path / "s.trc")


JOINTS = ("SpineBase", "SpineMid", "Neck", "Head", "HipLeft", "HipRight", "ShoulderLeft", "ShoulderRight")
JOINTS += ("ElbowLeft", "ElbowRight", "WristLeft", "WristRight")


def person(seed: int = 0, size: float = 1.0, at: float = 0.0, count: int = 400) -> np.ndarray:
    """Return the joints (F, 12, 3) of a person who sways and moves the arms, m: x to the side, y up, z the distance."""
    rng, time = np.random.default_rng(seed), np.arange(count) / 30
    x = np.array([0, 0, 0, 0, -0.09, 0.09, -0.18, 0.18, -0.2, 0.2, -0.22, 0.22])
    y = np.array([0, 0.25, 0.5, 0.65, -0.02, -0.02, 0.45, 0.45, 0.18, 0.18, -0.05, -0.05])
    z = np.array([0, -0.02, 0, 0.02, 0, 0, 0.03, 0.03, 0, 0, -0.1, -0.1])
    joints = size * np.stack([x, y, z], axis=1) * np.ones((count, 1, 1))
    for elbow, wrist in ((8, 10), (9, 11)):
        joints[:, elbow, 2] -= 0.1 * (1 - np.cos(2 * time))
        joints[:, wrist, 2] -= 0.3 * (1 - np.cos(2 * time))
    sway = 0.02 * np.stack([np.sin(time), 0 * time, np.cos(0.7 * time)], axis=1)
    return joints + sway[:, None] + rng.normal(0, 0.006, joints.shape) + [at, 1.0, 2.5]


def write_person(path: Path, joints: np.ndarray, short: tuple[int, ...] = ()) -> Path:
    rows = np.column_stack([np.arange(len(joints)) / 30, joints.reshape(len(joints), -1)])
    cells = [[f"{value:.9f}" for value in row] for row in rows]
    for k in short:
        del cells[k][4:7]
    head = ["time_s", *(f"{name}_{axis}" for name in JOINTS for axis in "xyz")]
    path.write_text("\n".join(map(",".join, [head, *cells])) + "\n")
    return path


def test_a_good_skeleton_has_no_reasons(tmp_path: Path) -> None:
    found = read_skeleton(write_person(tmp_path / "a.csv", person()))
    assert not found.reasons
    assert np.isfinite(found.recording.positions).all()


@pytest.mark.parametrize("depth", ["zero", "constant", "each joint's own", "a thousandth"])
def test_a_skeleton_without_depth_is_refused(tmp_path: Path, depth: str) -> None:
    joints = person()
    values = {"zero": 0.0, "constant": 2.1, "each joint's own": joints[:1, :, 2], "a thousandth": joints[..., 2] / 1e3}
    joints[..., 2] = values[depth]
    with pytest.raises(RecordingError, match=r"the z of its joints does not change.*no depth"):
        read_skeleton(write_person(tmp_path / "a.csv", joints))


def test_joints_without_depth_for_some_time_are_missing(tmp_path: Path) -> None:
    joints = person()
    joints[100:150, 3:, 2] = 0.0
    found = read_skeleton(write_person(tmp_path / "a.csv", joints)).recording
    assert np.isnan(found.positions[100:150, 3:]).all()
    assert np.isfinite(found.positions[:100]).all()
    assert any("450 positions of joints have no depth" in note for note in found.oddities)


def test_exchanged_sides_are_exchanged_back(tmp_path: Path) -> None:
    good = person()
    order = [JOINTS.index(name.replace("Left", "@").replace("Right", "Left").replace("@", "Right")) for name in JOINTS]
    bad = good.copy()
    for stretch in (slice(60, 150), slice(300, 315)):
        bad[stretch] = good[stretch][:, order]
    expected = read_skeleton(write_person(tmp_path / "a.csv", good)).recording.positions
    found = read_skeleton(write_person(tmp_path / "b.csv", bad))
    assert np.array_equal(found.recording.positions, expected)
    (reason,) = found.reasons
    assert reason.code == "skeleton-exchanged"
    assert "from 2.00 to 4.97 s, 10.00 to 10.47 s" in reason.message


@pytest.mark.parametrize(
    ("size", "at", "first", "stop"),
    [
        *((size, at, 100, 190) for size, at in ((0.9, 0.25), (0.85, 0.0), (1.12, 0.0), (1.0, 0.4))),
        *((size, at, 240, 400) for size, at in ((0.9, 0.25), (0.85, 0.0), (1.12, 0.0))),
    ],
)
def test_another_person_is_left_out(tmp_path: Path, size: float, at: float, first: int, stop: int) -> None:
    joints = person()
    joints[first:stop] = person(1, size, at)[first:stop]
    found = read_skeleton(write_person(tmp_path / "a.csv", joints))
    missing = np.isnan(found.recording.positions).all(axis=(1, 2))
    assert np.flatnonzero(missing).tolist() == list(range(first, stop))
    assert [reason.code for reason in found.reasons] == ["skeleton-other-person"]


def test_rows_with_fewer_cells_are_left_out_and_never_shifted(tmp_path: Path) -> None:
    short = tuple(range(3, 400, 7))
    found = read_skeleton(write_person(tmp_path / "a.csv", person(), short))
    missing = np.isnan(found.recording.positions).any(axis=(1, 2))
    assert np.flatnonzero(missing).tolist() == list(short)
    assert [(reason.code, reason.level) for reason in found.reasons] == [("skeleton-short-rows", "caution")]
    with pytest.raises(RecordingError, match="expected a cell for every column"):
        read_skeleton(write_person(tmp_path / "b.csv", person(), tuple(range(250))))


def test_short_rows_in_the_text_of_a_kinect_are_left_out(tmp_path: Path) -> None:
    path, lines = tmp_path / "k.txt", kinect_rows(60)
    lines[20] = " ".join(lines[20].split()[3:])
    path.write_text("\n".join(lines) + "\n")
    found = read_skeleton(path)
    assert np.flatnonzero(np.isnan(found.recording.positions).any(axis=(1, 2))).tolist() == [20]
    assert "1 of 60 rows have fewer cells" in found.reasons[0].message
