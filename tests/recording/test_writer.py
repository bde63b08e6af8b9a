"""Written files are read back by mocap-id and by another library."""

from __future__ import annotations

import hashlib
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from recording_cases import body, moved_corners, signals, standing_wrench

from mocap_id import recording
from mocap_id.recording.c3d_package import compare_with_package

FRAMES, RATE, PER_FRAME = 50, 100.0, 5


def trial(markers: int = 6) -> tuple[list[str], np.ndarray]:
    positions = body(FRAMES, markers)
    positions[10:20, 3] = np.nan
    return [f"M{i}" for i in range(markers)], positions


def plates() -> tuple[list[np.ndarray], list[recording.PlateSignals], list[tuple[np.ndarray, np.ndarray]]]:
    corners = [moved_corners(), moved_corners(0.1, (1.2, 0.3, 0.0))]
    wrenches = [standing_wrench(FRAMES * PER_FRAME, c, seed) for seed, c in enumerate(corners)]
    made = [signals(force, moment, c, RATE * PER_FRAME) for (force, moment), c in zip(wrenches, corners, strict=True)]
    return corners, made, wrenches


@pytest.mark.parametrize("markers", [6, 300])
def test_c3d_round_trip(tmp_path: Path, markers: int) -> None:
    labels, positions = trial(markers)
    corners, made, wrenches = plates()
    path = tmp_path / "trial.c3d"
    recording.write_c3d(path, labels, positions, RATE, first_frame=91, plates=made)
    found = recording.read(path)
    assert found.oddities == () and compare_with_package(path) == []
    assert found.labels == tuple(labels)
    assert found.vertical == "Z"
    assert (found.frames[0], found.time[0]) == (91, pytest.approx(0.9))
    np.testing.assert_allclose(found.positions, positions, atol=1e-6)
    for plate, c, (force, moment) in zip(found.plates, corners, wrenches, strict=True):
        np.testing.assert_allclose(plate.force, force, atol=2e-4)
        np.testing.assert_allclose(plate.moment, moment, atol=2e-4)
        np.testing.assert_allclose(plate.corners, c, atol=1e-6)
        assert plate.start == pytest.approx(0.9)
    assert list(tmp_path.iterdir()) == [path]


def test_another_library_reads_the_same(tmp_path: Path) -> None:
    labels, positions = trial()
    corners, made, wrenches = plates()
    path = tmp_path / "trial.c3d"
    recording.write_c3d(path, labels, positions, RATE, plates=made)
    content = ezc3d.c3d(str(path), extract_forceplat_data=True)
    np.testing.assert_allclose(content["data"]["points"][:3].transpose(2, 1, 0) * 1e-3, positions, atol=1e-6)
    assert tuple(content["parameters"]["POINT"]["LABELS"]["value"]) == tuple(labels)
    for platform, c, (force, moment) in zip(content["data"]["platform"], corners, wrenches, strict=True):
        np.testing.assert_allclose(platform["force"].T, force, atol=2e-4)
        about_lab = platform["moment"].T * 1e-3 + np.cross(c.mean(axis=0), force)
        np.testing.assert_allclose(about_lab, moment, atol=2e-4)


def test_missing_markers_are_written_as_residual_minus_one(tmp_path: Path) -> None:
    from mocap_id.recording.c3d_file import C3DFile

    labels, positions = trial()
    path = tmp_path / "trial.c3d"
    recording.write_c3d(path, labels, positions, RATE)
    with path.open("rb") as stream:
        file = C3DFile(path, stream)
        ((stored,), _) = file.read_frames(slice(15, 16))
    np.testing.assert_array_equal(stored[3], [0, 0, 0, -1])
    assert (np.delete(stored, 3, axis=0)[:, 3] == 0).all()


def test_long_trials(tmp_path: Path) -> None:
    positions = np.random.default_rng(0).uniform(0.1, 1.5, size=(66_000, 1, 3))
    path = tmp_path / "long.c3d"
    recording.write_c3d(path, ["A"], positions, RATE)
    found = recording.read(path)
    assert found.frames[-1] == 66_000
    assert found.oddities == ()


def test_the_same_trial_gives_the_same_bytes(tmp_path: Path) -> None:
    labels, positions = trial()
    digests = set()
    for name in ("a.c3d", "b.c3d"):
        recording.write_c3d(tmp_path / name, labels, positions, RATE, plates=plates()[1])
        digests.add(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert len(digests) == 1


def test_trc_round_trip(tmp_path: Path) -> None:
    labels, positions = trial()
    path = tmp_path / "trial.trc"
    recording.write_trc(path, labels, positions, RATE, first_frame=91)
    found = recording.read(path)
    assert found.labels == tuple(labels)
    assert found.frames[0] == 91
    assert found.time[0] == pytest.approx(0.9)
    np.testing.assert_allclose(found.positions, positions, atol=1e-7)
    assert list(tmp_path.iterdir()) == [path]


def test_inconsistent_arguments_are_refused(tmp_path: Path) -> None:
    labels, positions = trial()
    path = tmp_path / "trial.c3d"
    with pytest.raises(ValueError, match="do not fit"):
        recording.write_c3d(path, labels[:-1], positions, RATE)
    with pytest.raises(ValueError, match="do not fit"):
        recording.write_trc(tmp_path / "trial.trc", labels[:-1], positions, RATE)
    with pytest.raises(ValueError, match="integer multiple"):
        recording.write_c3d(path, labels, positions, 99.0, plates=plates()[1])
    with pytest.raises(ValueError, match="cover every frame"):
        recording.write_c3d(path, labels, positions[:-1], RATE, plates=plates()[1])
    assert list(tmp_path.iterdir()) == []
