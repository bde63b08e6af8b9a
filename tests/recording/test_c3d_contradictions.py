"""Contradictory C3D files are refused, or read correctly with a note."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from recording_cases import body, build_c3d, save

from mocap_id import recording
from mocap_id.errors import ConfigError, RecordingError

POINTS = body() * 1e3


def read(folder: Path, data: bytes, **options: str) -> recording.Recording:
    return recording.read(save(folder, data), **options)


def test_a_consistent_file_is_read_as_written(tmp_path: Path) -> None:
    found = read(tmp_path, build_c3d(POINTS, first=91))
    np.testing.assert_allclose(found.positions, POINTS / 1e3, atol=1e-6)
    assert found.frames[0] == 91
    assert found.time[0] == pytest.approx(0.9)
    assert found.rate == 100
    assert found.analog_rate is None


def test_frames_from_zero_start_the_clock_at_zero(tmp_path: Path) -> None:
    assert read(tmp_path, build_c3d(POINTS, first=0)).time[0] == 0


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_truncated_files_are_refused(tmp_path: Path, share: float) -> None:
    data = build_c3d(np.tile(POINTS, (5, 1, 1)))
    with pytest.raises(RecordingError, match=r"truncated|corrupt"):
        read(tmp_path, data[: int(share * len(data))])


def test_a_file_that_lacks_only_its_padding_is_read(tmp_path: Path) -> None:
    data = build_c3d(POINTS)
    stored = POINTS.shape[0] * POINTS.shape[1] * 16
    start = len(data) - -(-stored // 512) * 512
    assert len(read(tmp_path, data[: start + stored]).frames) == len(POINTS)


def test_wrong_number_of_points_is_resolved_by_the_size(tmp_path: Path) -> None:
    found = read(tmp_path, build_c3d(POINTS, parameters={"POINT:USED": POINTS.shape[1] + 1}))
    np.testing.assert_allclose(found.positions, POINTS / 1e3, atol=1e-6)
    assert any("fits its size" in oddity for oddity in found.oddities)


def test_wrong_number_of_frames_is_resolved_by_the_size(tmp_path: Path) -> None:
    points = np.tile(POINTS, (2, 1, 1))
    found = read(tmp_path, build_c3d(points, parameters={"POINT:FRAMES": 5}))
    assert len(found.frames) == len(points)
    assert any("5 frames" in oddity for oddity in found.oddities)


def test_no_combination_fits(tmp_path: Path) -> None:
    wrong = {"points": 2, "last": 30}
    with pytest.raises(RecordingError, match="contradicts itself"):
        read(tmp_path, build_c3d(np.tile(POINTS, (4, 1, 1)), header=wrong, parameters={"POINT:FRAMES": 40}))


@pytest.mark.parametrize("fields", [True, False])
def test_more_than_65535_frames(tmp_path: Path, fields: bool) -> None:
    """With the number in TRIAL:ACTUAL_END_FIELD, and only with counters that end at 65,535."""
    frames = 70_001
    points = np.random.default_rng(0).uniform(100, 1500, size=(frames, 2, 3))
    trial = {
        "TRIAL:ACTUAL_START_FIELD": np.array([1, 0]),
        "TRIAL:ACTUAL_END_FIELD": np.array([frames - 65536, 1]),
    }
    found = read(tmp_path, build_c3d(points, parameters=trial if fields else {}))
    assert len(found.frames) == frames
    assert found.frames[-1] == frames
    np.testing.assert_allclose(found.positions[-1], points[-1] / 1e3, atol=1e-6)


def test_first_frame_beyond_65535(tmp_path: Path) -> None:
    first = 3 * 65536 + 7
    last = first + len(POINTS) - 1
    trial = {
        "TRIAL:ACTUAL_START_FIELD": np.array([7, 3]),
        "TRIAL:ACTUAL_END_FIELD": np.array([last - 3 * 65536, 3]),
    }
    data = build_c3d(POINTS, parameters=trial, header={"first": 65535, "last": 65535})
    assert read(tmp_path, data).frames[0] == first


def test_integer_files_and_residuals(tmp_path: Path) -> None:
    residuals = np.zeros(POINTS.shape[:2])
    residuals[10:20, 2] = -1
    points = POINTS.copy()
    points[10:20, 2] = 0
    found = read(tmp_path, build_c3d(points, residuals=residuals, scale=0.05))
    assert np.isnan(found.positions[10:20, 2]).all()
    assert found.missing_fraction == pytest.approx(10 / POINTS[..., 0].size)
    seen = found.visible
    np.testing.assert_allclose(found.positions[seen], points[seen] / 1e3, atol=0.026e-3)


def test_zeros_and_nan_count_as_missing_and_are_reported(tmp_path: Path) -> None:
    points = POINTS.copy()
    points[:5, 0] = 0
    points[5:9, 1] = np.nan
    points[9:12, 2, 1] = np.inf
    points[12:14, 3] = 1e12
    found = read(tmp_path, build_c3d(points))
    assert (~found.visible).sum() == 5 + 4 + 3 + 2
    assert any("exactly 0, 0, 0" in oddity for oddity in found.oddities)
    assert any("farther than" in oddity for oddity in found.oddities)


def test_long_label_lists_are_continued_in_labels2(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(100, 1500, size=(4, 300, 3))
    names = [f"P{i}" for i in range(300)]
    parameters = {"POINT:LABELS": names[:255], "POINT:LABELS2": names[255:]}
    assert read(tmp_path, build_c3d(points, parameters=parameters)).labels == tuple(names)


def test_damaged_parameters(tmp_path: Path) -> None:
    data = bytearray(build_c3d(POINTS))
    data[512 + 3] = 7
    with pytest.raises(RecordingError, match="processor type 7"):
        read(tmp_path, bytes(data))


@pytest.mark.parametrize(
    ("declared", "metres"), [("mm", 1e-3), ("MM", 1e-3), ("cm", 1e-2), ("m", 1.0), ("mete", 1.0), ("millimet", 1e-3)]
)
def test_declared_units(tmp_path: Path, declared: str, metres: float) -> None:
    found = read(tmp_path, build_c3d(body() / metres, parameters={"POINT:UNITS": declared}))
    np.testing.assert_allclose(found.positions, body(), atol=1e-6)


@pytest.mark.parametrize("declared", ["", "me", "furlong"])
def test_unknown_units_are_refused_and_the_key_is_named(tmp_path: Path, declared: str) -> None:
    data = build_c3d(POINTS, parameters={"POINT:UNITS": declared or " "})
    with pytest.raises(RecordingError, match=r"`planarise: \{units: mm\}`"):
        read(tmp_path, data)
    np.testing.assert_allclose(read(tmp_path, data, units="mm").positions, POINTS / 1e3, atol=1e-6)


def test_missing_units_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no length unit"):
        read(tmp_path, build_c3d(POINTS, drop=["POINT:UNITS"]))


@pytest.mark.parametrize("declared", ["m", "mm"])
def test_wrong_units_are_recognised_by_the_size_of_the_trial(tmp_path: Path, declared: str) -> None:
    points = body() * (1e3 if declared == "m" else 1.0)
    with pytest.raises(RecordingError, match=r"spread over .* unit is wrong"):
        read(tmp_path, build_c3d(points, parameters={"POINT:UNITS": declared}))


def test_an_override_of_a_declared_unit_is_reported(tmp_path: Path) -> None:
    found = read(tmp_path, build_c3d(body() * 1e2), units="cm")
    np.testing.assert_allclose(found.positions, body(), atol=1e-6)
    assert any("configuration cm: cm was used" in oddity for oddity in found.oddities)


def test_the_vertical_axis(tmp_path: Path) -> None:
    y_up = POINTS[..., [0, 2, 1]] * [1, 1, -1]
    data = build_c3d(y_up, parameters={"POINT:Y_SCREEN": "+Y"})
    found = read(tmp_path, data)
    assert found.vertical == "Y"
    np.testing.assert_allclose(found.positions, POINTS / 1e3, atol=1e-6)
    undeclared = read(tmp_path, build_c3d(y_up))
    assert undeclared.vertical == "Z"
    assert any("Z was assumed" in oddity for oddity in undeclared.oddities)
    np.testing.assert_allclose(read(tmp_path, build_c3d(y_up), vertical="+y").positions, POINTS / 1e3, atol=1e-6)
    with pytest.raises(ConfigError, match="is not an axis"):
        read(tmp_path, data, vertical="up")


@pytest.mark.parametrize("axis", ["X", "Y", "Z", "-X", "-Y", "-Z"])
def test_the_upward_axis_is_rotated_to_z(axis: str) -> None:
    from mocap_id.recording.model import axis_vector, nearest_axis, to_z_up

    turn = to_z_up(axis)
    np.testing.assert_allclose(turn @ axis_vector(axis), [0, 0, 1])
    np.testing.assert_allclose(turn @ turn.T, np.eye(3))
    assert np.linalg.det(turn) == pytest.approx(1)
    assert nearest_axis(axis_vector(axis) + 0.1) == axis


def test_files_that_are_not_recordings(tmp_path: Path) -> None:
    cases = {
        "nothing.c3d": (b"", "not a C3D file"),
        "text.c3d": (b"once upon a time " * 100, "not a C3D file"),
        "text.trc": (b"once upon a time " * 100, "not a TRC file"),
        "nothing.trc": (b"", "empty"),
    }
    for name, (data, reason) in cases.items():
        with pytest.raises(RecordingError, match=reason):
            recording.read(save(tmp_path, data, name))
    with pytest.raises(RecordingError, match="no such file"):
        recording.read(tmp_path / "gone.c3d")
    with pytest.raises(RecordingError, match="folder"):
        recording.read(tmp_path)
    with pytest.raises(ConfigError, match="only for markers in a text file"):
        recording.read(save(tmp_path, build_c3d(POINTS)), tmp_path / "forces.mot")


def test_an_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save(tmp_path, build_c3d(POINTS))

    def denied(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("os.open", denied)
    with pytest.raises(RecordingError, match="permission to read it is denied"):
        recording.read(path)


def test_mutated_headers_never_crash_and_never_change_the_count_without_a_note(tmp_path: Path) -> None:
    points = body(40, 6) * 1e3
    analog = np.random.default_rng(0).normal(size=(160, 6))
    data = build_c3d(points, analog=analog, first=3)
    rng = np.random.default_rng(5)
    read_again = 0
    for _ in range(400):
        mutated = bytearray(data)
        for _ in range(rng.integers(1, 4)):
            mutated[rng.integers(0, 24) if rng.random() < 0.5 else rng.integers(24, 1024)] = rng.integers(0, 256)
        try:
            found = read(tmp_path, bytes(mutated))
        except RecordingError:
            continue
        read_again += 1
        assert len(found.frames) == 40 or found.oddities
    assert read_again > 100


def test_the_builder_agrees_with_another_reader(tmp_path: Path) -> None:
    import ezc3d

    path = save(tmp_path, build_c3d(POINTS, first=5))
    content = ezc3d.c3d(str(path))
    np.testing.assert_allclose(content["data"]["points"][:3].transpose(2, 1, 0), POINTS, rtol=1e-5)
    assert content["header"]["points"]["first_frame"] == 4


def test_an_empty_parameter_section(tmp_path: Path) -> None:
    data = bytearray(build_c3d(POINTS))
    data[516:518] = struct.pack("bb", 0, 0)
    with pytest.raises(RecordingError, match="no parameters"):
        read(tmp_path, bytes(data))
