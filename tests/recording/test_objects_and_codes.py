"""Trajectories that are not markers of the person, and numbers that mark missing samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_cases import build_c3d

from mocap_id import recording
from mocap_id.errors import RecordingError
from mocap_id.recording import Recording
from mocap_id.stages.planarise.plane import select_part

FRAMES = 300
TIME = np.arange(FRAMES) / 100
NAMES = [f"M{k}" for k in range(12)]


def person() -> np.ndarray:
    """Twelve markers (F, 12, 3), mm, of which the upper half swings about the others."""
    local = np.random.default_rng(1).uniform(-200, 200, size=(12, 3)) + np.array([0, 0, 900])
    swing = 200 * np.sin(2 * np.pi * 0.5 * TIME)
    points = np.tile(local, (FRAMES, 1, 1))
    points[:, 6:, 0] += swing[:, None]
    return points + np.random.default_rng(2).normal(scale=0.3, size=points.shape)


def box(at: float = 0.0) -> np.ndarray:
    """Four rigid markers (F, 4, 3), mm, that are lifted."""
    corners = np.array([[0, 0, 0], [300, 0, 0], [300, 200, 0], [0, 200, 0]], dtype=float) + np.array([500 + at, 0, 300])
    points = np.tile(corners, (FRAMES, 1, 1))
    points[..., 2] += 300 * np.sin(np.pi * TIME / 3)[:, None]
    return points + np.random.default_rng(3).normal(scale=0.3, size=points.shape)


def read(folder: Path, points: np.ndarray, labels: list[str], **parameters: object) -> Recording:
    path = folder / "trial.c3d"
    path.write_bytes(build_c3d(points, parameters={"POINT:LABELS": labels, **parameters}))
    return recording.read(path)


def test_objects_with_a_prefix_are_left_out_and_the_person_keeps_bare_names(tmp_path: Path) -> None:
    labels = [f"BODY:{n}" for n in NAMES] + [f"BOX:{k}" for k in range(4)] + [f"TABLE:{k}" for k in range(4)]
    still = np.tile(box()[:1], (FRAMES, 1, 1)) + np.array([0, 900, 0])
    found = read(tmp_path, np.concatenate([person(), box(), still], axis=1), labels)
    assert found.labels == tuple(NAMES)
    assert len(found.left_out) == 8
    notes = " ".join(found.oddities)
    assert "object 1" in notes and "object 2" in notes and "subjects share" not in notes
    assert not any(word in notes for word in ("BODY", "BOX", "TABLE"))  # a prefix may be the name of a person


@pytest.mark.parametrize("other", ["B:M", "B:N", "M", "B_M", "my.B_M"])
def test_a_trial_has_one_person(tmp_path: Path, other: str) -> None:
    """Two people are refused, with the same marker set or another, or with the same labels, until one is chosen."""
    own = {"M": "", "B_M": "A_", "my.B_M": "my.A_"}.get(other, "A:")
    labels = [f"{own}{n}" for n in NAMES] + [f"{other}{k}" for k in range(12)]
    found = read(tmp_path, np.concatenate([person(), person() + np.array([0, 1500, 0])], axis=1), labels)
    assert len(found.labels) == 24
    assert found.people == ("subject-1:", "subject-2:")
    with pytest.raises(RecordingError, match=r"2 people,.*ignore: \['subject-2:\*'\]"):
        select_part(found, None, ())
    assert len(select_part(found, None, ["subject-2:*"]).labels) == 12


def test_rigid_bodies_alone_are_segments_not_objects(tmp_path: Path) -> None:
    """Motive gives every rigid body a prefix; if none of them is a person, all may belong to one."""
    labels = [f"{name}:{k}" for name in ("thorax", "arm") for k in range(4)]
    found = read(tmp_path, np.concatenate([box(), np.tile(box(900.0)[:1], (FRAMES, 1, 1))], axis=1), labels)
    assert len(found.labels) == 8


def test_a_marker_with_a_prefix_of_its_own_is_no_object(tmp_path: Path) -> None:
    labels = [f"S:{n}" for n in NAMES] + ["X"]
    found = read(tmp_path, np.concatenate([person(), box()[:, :1]], axis=1), labels)
    assert len(found.labels) == 13


def test_unlabelled_pieces_are_left_out_but_not_where_nothing_has_a_label(tmp_path: Path) -> None:
    points = person()
    pieces = np.full((FRAMES, 30, 3), np.nan)
    for k in range(30):
        pieces[7 * k : 7 * k + 20, k] = points[7 * k : 7 * k + 20, k % 12]
    whole = points[:, :2] + 50.0
    labels = [*NAMES, *(f"*{k}" for k in range(30)), "*99", "Unlabeled 12"]
    found = read(tmp_path, np.concatenate([points, pieces, whole], axis=1), labels)
    assert found.labels == (*NAMES, "*99")
    assert "31 trajectories without a label" in " ".join(found.oddities)
    assert len(read(tmp_path, pieces, [f"*{k}" for k in range(30)]).labels) == 30


@pytest.mark.parametrize("code", [9999.0, -9999.0, -16512.0, 999999.0])
def test_a_number_that_marks_missing_samples(tmp_path: Path, code: float) -> None:
    points = person()
    hidden = np.random.default_rng(4).random(points.shape[:2]) < 0.02
    points[hidden] = code
    found = read(tmp_path, points, NAMES)
    np.testing.assert_array_equal(found.visible, ~hidden)
    assert "marks missing samples" in " ".join(found.oddities)


def test_a_code_near_real_samples(tmp_path: Path) -> None:
    points = person()
    for marker in (0, 5, 9):
        points[20 * marker : 20 * marker + 15, marker] = 999.9
    found = read(tmp_path, points, NAMES)
    assert np.isnan(found.positions).all(axis=2).sum() == 45
    assert any("this number marks missing samples" in text for text in found.oddities)


def test_a_marker_that_rests_far_away_is_no_code(tmp_path: Path) -> None:
    points = np.concatenate([person(), np.full((FRAMES, 1, 3), (4000.0, 0.0, 500.0))], axis=1)
    found = read(tmp_path, points, [*NAMES, "WALL"])
    assert found.missing_fraction == 0


def test_plate_on_channels_above_255(tmp_path: Path) -> None:
    channels, per = 300, 2
    analog = np.zeros((FRAMES * per, channels))
    analog[:, -6:] = np.array([0.0, 0.0, -700.0, 0.0, 0.0, 0.0]) / np.array([0.01, 0.01, 0.01, 1, 1, 1])
    scale, units = np.ones(channels), ["V"] * 294 + ["N"] * 3 + ["Nmm"] * 3
    scale[-6:-3] = 0.01
    offset = np.zeros(channels, dtype=np.int16)
    offset[-4] = 1000  # 10 N of the vertical force
    corners = np.array([[300, -200, 0], [-300, -200, 0], [-300, 200, 0], [300, 200, 0]], dtype=float)
    path = tmp_path / "trial.c3d"
    path.write_bytes(
        build_c3d(
            person(),
            analog=analog,
            parameters={
                "POINT:LABELS": NAMES,
                "ANALOG:SCALE": scale[:255], "ANALOG:SCALE2": scale[255:],
                "ANALOG:OFFSET": offset[:255], "ANALOG:OFFSET2": offset[255:],
                "ANALOG:UNITS": units[:255], "ANALOG:UNITS2": units[255:],
                "FORCE_PLATFORM:USED": np.array([1], np.int16), "FORCE_PLATFORM:TYPE": np.array([2], np.int16),
                "FORCE_PLATFORM:CHANNEL": np.arange(295, 301, dtype=np.int16).reshape(6, 1),
                "FORCE_PLATFORM:CORNERS": corners.T.reshape(3, 4, 1),
                "FORCE_PLATFORM:ORIGIN": np.array([[0.0], [0.0], [-40.0]]),
            },
        )
    )  # fmt: skip
    (plate,) = recording.read(path).plates
    assert plate.usable, plate.problem
    assert abs(plate.mean_vertical()) == pytest.approx(710.0)


def test_a_trajectory_that_occurs_twice_is_one_measurement(tmp_path: Path) -> None:
    """Copies have the same errors: counted as measurements, they make the stated noise and intervals too small."""
    points = np.concatenate([person(), person()[:, [2, 7]]], axis=1)
    found = read(tmp_path, points, [*NAMES, NAMES[2], "other"])
    assert found.labels == (*NAMES, "other"), "another label may be that of a landmark"
    notes = [note for note in found.oddities if "exactly equal" in note]
    assert [note.split(" are ")[0] for note in notes] == ["the trajectories M2, M2#2", "the trajectories M7, other"]


def test_an_unlabelled_marker_far_from_the_person_is_left_out(tmp_path: Path) -> None:
    """It is seen all the time; that of the person, between the labelled ones, is kept."""
    points = np.concatenate([person(), person()[:, :3] + np.array([1500, 0, 0]), person()[:, 6:7] + 40], axis=1)
    found = read(tmp_path, points, [*NAMES, "*12", "*13", "*14", "*15"])
    assert found.labels == (*NAMES, "*15")
    assert found.left_out == ("*12", "*13", "*14")
