"""Recordings in and out: arrays of other programs, data frames, xarray and Kinetics Toolkit."""

from __future__ import annotations

import json
import shutil
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocap_id
from mocap_id.recording import to_z_up, write_recording, write_recording_as_text
from mocap_id.workflows.recording_trial import make_trial

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "sample_trials" / "robot-joint"
CORNERS = np.array([[0.3, 0.2, 0], [-0.3, 0.2, 0], [-0.3, -0.2, 0], [0.3, -0.2, 0]])


def invented(start: float = 0.0, *, corners: bool = True) -> mocap_id.Recording:
    """Return two markers with a gap, and a plate with an invalid sample."""
    rng = np.random.default_rng(5)
    positions = rng.normal(size=(100, 2, 3))
    positions[5, 1] = np.nan
    force = np.array([5.0, -3.0, 600.0]) + rng.normal(size=(400, 3))
    force[17] = np.nan
    moment = np.cross([0.1, -0.1, 0.0], force) + rng.normal(size=(400, 3))
    plate = mocap_id.Plate.from_arrays(force, 400, moment=moment, corners=CORNERS if corners else None, start=start)
    return mocap_id.Recording.from_arrays(["A", "B"], positions, 100, [plate], start=start)


def assert_same(found: mocap_id.Recording, expected: mocap_id.Recording, tolerance: float = 0.0) -> None:
    near = {"rtol": 0, "atol": tolerance}
    assert found.labels == expected.labels
    assert found.rate == pytest.approx(expected.rate, rel=1e-9)
    np.testing.assert_allclose(found.time, expected.time, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.frames, expected.frames)
    np.testing.assert_allclose(found.positions, expected.positions, **near)
    assert len(found.plates) == len(expected.plates)
    for ours, theirs in zip(found.plates, expected.plates, strict=True):
        assert ours.ok.tolist() == theirs.ok.tolist()
        assert (ours.rate, ours.start) == pytest.approx((theirs.rate, theirs.start))
        np.testing.assert_allclose(ours.force[ours.ok], theirs.force[ours.ok], **near)
        np.testing.assert_allclose(ours.moment[ours.ok], theirs.moment[ours.ok], **near)
        assert (ours.corners is None) == (theirs.corners is None)
        if ours.corners is not None and theirs.corners is not None:
            np.testing.assert_allclose(ours.corners, theirs.corners, **near)


@pytest.mark.parametrize("vertical", ["X", "-X", "Y", "-Y", "Z", "-Z"])
def test_units_and_axes_of_another_program(vertical: str) -> None:
    lab = invented()
    turn = to_z_up(vertical)  # from the other program's axes to the lab's
    plate = lab.plates[0]
    assert plate.corners is not None
    given = {"moment": 1e3 * plate.moment @ turn, "corners": 1e3 * plate.corners @ turn, "units": "mm"}
    own = mocap_id.Plate.from_arrays(plate.force @ turn, plate.rate, **given)
    there = 1e3 * lab.positions @ turn
    found = mocap_id.Recording.from_arrays(lab.labels, there, lab.rate, [own], units="mm", vertical=vertical)
    assert_same(found, lab, 1e-9)


def test_force_and_centre_of_pressure_are_the_wrench() -> None:
    """The moment about any point of the line of action, and about the lab's origin, are the same wrench."""
    rng = np.random.default_rng(2)
    force, free = rng.normal(size=(50, 3)) + np.array([0, 0, 400]), np.zeros((50, 3))
    free[:, 2] = rng.normal(size=50)
    cop = np.column_stack([rng.normal(size=(50, 2)), np.zeros(50)])
    force[3], cop[3] = 0.0, np.nan  # nobody on the plate
    cop[4] = np.nan
    plate = mocap_id.Plate.from_arrays(force, 100, cop=1e2 * cop, free_moment=1e2 * free, units="cm")
    for k in (0, 10, 49):
        about_cop = plate.moment[k] + np.cross(plate.force[k], cop[k])  # M_P = M_O - OP × F
        np.testing.assert_allclose(about_cop, free[k], atol=1e-9)
    assert np.flatnonzero(~plate.ok).tolist() == [4]
    np.testing.assert_array_equal(plate.moment[3], free[3])


def test_a_data_frame_and_back() -> None:
    made = replace(invented(start=2.5), plates=())
    assert_same(mocap_id.Recording.from_frame(made.to_frame()), made)
    shuffled = made.to_frame()[[("B", "z"), ("A", "y"), ("B", "x"), ("A", "x"), ("B", "y"), ("A", "z")]]
    found = mocap_id.Recording.from_frame(shuffled)
    np.testing.assert_array_equal(found.positions, made.positions[:, ::-1])
    with pytest.raises(mocap_id.RecordingError, match="expected x, y and z of each marker"):
        mocap_id.Recording.from_frame(made.to_frame().iloc[:, :5])
    with pytest.raises(mocap_id.RecordingError, match="not evenly spaced"):
        mocap_id.Recording.from_frame(made.to_frame().drop(made.time[7]))


@pytest.mark.external
def test_a_dataset_of_xarray_and_back() -> None:
    pytest.importorskip("xarray", reason="needs `pip install mocap-id[xarray]`")
    for corners in (True, False):
        made = invented(start=1.25, corners=corners)
        dataset = made.to_xarray()
        assert dataset["force_1"].attrs["units"] == "N"
        assert float(dataset["position"].sel(marker="A", axis="y")[3]) == made.positions[3, 0, 1]
        assert_same(mocap_id.Recording.from_xarray(dataset), made)
        assert_same(mocap_id.Recording.from_xarray(dataset.transpose("axis", "marker", ...)), made)
    with pytest.raises(mocap_id.RecordingError, match="expected `position`"):
        mocap_id.Recording.from_xarray(dataset.drop_vars("position"))
    with pytest.raises(mocap_id.RecordingError, match="plate 1 has no `moment_1`"):
        mocap_id.Recording.from_xarray(dataset.drop_vars("moment_1"))
    with pytest.raises(mocap_id.RecordingError, match="`axis` is X, Y, Z; expected x, y, z"):
        mocap_id.Recording.from_xarray(dataset.assign_coords(axis=list("XYZ")))


def test_xarray_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(mocap_id.ConfigError, match="xarray is not installed"):
        invented().to_xarray()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "expected either `moment` or `cop`"),
        ({"moment": np.zeros((4, 3)), "cop": np.zeros((4, 3))}, "expected either `moment` or `cop`"),
        ({"moment": np.zeros((4, 3)), "free_moment": np.zeros((4, 3))}, "`free_moment` belongs to `cop`"),
        ({"moment": np.zeros((3, 3))}, r"`moment` has the shape \(3, 3\); expected \(4, 3\)"),
        ({"moment": np.zeros((4, 3)), "corners": np.zeros((3, 3))}, r"`corners` has the shape \(3, 3\)"),
    ],
)
def test_plates_that_do_not_fit(given: dict[str, Any], message: str) -> None:
    with pytest.raises(mocap_id.RecordingError, match=message):
        mocap_id.Plate.from_arrays(np.zeros((4, 3)), 100, **given)


def test_unknown_units_and_axes() -> None:
    with pytest.raises(mocap_id.ConfigError, match="'furlong' is not a unit of length"):
        mocap_id.Recording.from_arrays(["A"], np.zeros((2, 1, 3)), 100, units="furlong")
    with pytest.raises(mocap_id.ConfigError, match="'up' is not an axis"):
        mocap_id.Recording.from_arrays(["A"], np.zeros((2, 1, 3)), 100, vertical="up")


def test_a_plate_without_corners_is_kept_as_text(tmp_path: Path) -> None:
    made = invented(corners=False)
    write_recording_as_text(tmp_path / "own.trc", made)
    found = mocap_id.read(tmp_path / "own.trc", tmp_path / "own.mot")
    assert_same(found, made, 1e-6)
    trial = make_trial(made, {"trial": "own", "protocol": "free", "space": "plane", "out": tmp_path / "run"})
    assert trial.keys.recording is not None
    assert trial.keys.recording.forces == tmp_path / "run" / "recording.mot"
    other = replace(made.plates[0], rate=200.0)
    with pytest.raises(mocap_id.RecordingError, match="different rates"):
        write_recording_as_text(tmp_path / "two.trc", replace(made, plates=(made.plates[0], other)))


@pytest.mark.parametrize("start", [0.004, -1.0, 2.0])
def test_markers_and_forces_keep_one_clock(start: float, tmp_path: Path) -> None:
    write_recording_as_text(tmp_path / "own.trc", invented(start, corners=False))
    found = mocap_id.read(tmp_path / "own.trc", tmp_path / "own.mot")
    assert found.plates[0].start == pytest.approx(start, abs=1e-6)
    assert found.time[[0, -1]] == pytest.approx([start, start + 0.99], abs=1e-6)


def test_a_recording_that_counts_frames_from_zero_keeps_its_times(tmp_path: Path) -> None:
    made = invented(start=0.05)
    write_recording(tmp_path / "own.c3d", replace(made, frames=made.frames - 1))
    np.testing.assert_allclose(mocap_id.read(tmp_path / "own.c3d").time, made.time, rtol=0, atol=1e-9)


@pytest.mark.parametrize("start", [-1.0, -0.01, 0.004])
def test_a_start_that_a_c3d_file_cannot_hold_is_refused(start: float, tmp_path: Path) -> None:
    with pytest.raises(mocap_id.RecordingError, match=f"first frame is at {start:g} s; a C3D file stores times from 0"):
        make_trial(invented(start), {"trial": "own", "out": tmp_path / "run"})
    assert not list(tmp_path.rglob("recording*"))


def test_times_too_late_for_nine_digits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(mocap_id.RecordingError, match="expected times below 100000 s"):
        write_recording_as_text(tmp_path / "own.trc", invented(1.7e9, corners=False))


def test_corners_of_some_plates_only_are_refused(tmp_path: Path) -> None:
    made = invented()
    bare = replace(made.plates[0], index=2, corners=None)
    with pytest.raises(mocap_id.RecordingError, match="plates with corners: 1; plates without corners: 2"):
        make_trial(replace(made, plates=(made.plates[0], bare)), {"trial": "own", "out": tmp_path / "run"})
    unusable = replace(bare, problem="its type is unknown")
    keys = {"trial": "own", "protocol": "free", "space": "plane", "out": tmp_path / "run"}
    trial = make_trial(replace(made, plates=(made.plates[0], unusable)), keys)
    assert trial.keys.recording is not None
    assert trial.keys.recording.motion.name == "recording.c3d"


def test_a_plate_that_starts_between_two_frames_is_not_moved(tmp_path: Path) -> None:
    made = invented()
    late = replace(made, plates=(replace(made.plates[0], start=0.004),))
    with pytest.raises(mocap_id.RecordingError, match=r"starts at 0\.004 s; expected 0\.0 s"):
        write_recording(tmp_path / "own.c3d", late)


def as_series(values: dict[str, Any], time: Any, units: dict[str, str]) -> dict[str, Any]:
    """Return a TimeSeries as Kinetics Toolkit writes it."""
    info = {name: {"Unit": unit} for name, unit in units.items()} | {"Time": {"Unit": "s"}}
    data = {name: np.asarray(one).tolist() for name, one in values.items()}
    return {"class__": "ktk.TimeSeries", "time": list(time), "info": info, "data": data, "events": []}


def ktk_file(path: Path, content: Any) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("metadata.json", "{}")
        archive.writestr("data.json", content if isinstance(content, str) else json.dumps(content))
    return path


def test_a_file_of_kinetics_toolkit_as_documented(tmp_path: Path) -> None:
    """Its format: a zipped `data.json` with points (T, 4), and a force, moment and corners of each platform."""
    lab = invented()
    plate = lab.plates[0]
    padded = np.concatenate([lab.positions, np.ones((100, 2, 1))], axis=2)
    points = as_series({"A": 1e3 * padded[:, 0] * [1, 1, 1, 1e-3], "B": 1e3 * padded[:, 1] * [1, 1, 1, 1e-3]}, lab.time, {"A": "mm", "B": "mm"})  # fmt: skip  # noqa: E501
    vectors = {
        "FP0_Force": plate.force,
        "FP0_MomentAtCenter": 1e3 * (plate.moment - np.cross(CORNERS.mean(0), plate.force)),
    }
    vectors |= {f"FP0_Corner{k + 1}": np.tile(CORNERS[k], (400, 1)) for k in range(4)}
    units = {"FP0_Force": "N", "FP0_MomentAtCenter": "Nmm"} | {f"FP0_Corner{k}": "m" for k in (1, 2, 3, 4)}
    plates = as_series(vectors, np.arange(400) / 400, units)
    found = mocap_id.read(ktk_file(tmp_path / "own.ktk.zip", {"Points": points, "ForcePlatforms": plates}))
    assert found.oddities == ()
    assert_same(found, lab, 1e-9)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not a valid file"),
        ("[" * 100_000, "not a valid file"),
        ([1, 2], "not a valid file"),
        ({}, "contains no TimeSeries"),
        ({"Points": {"class__": "ktk.TimeSeries", "time": [0, 1]}}, "damaged file"),
        (as_series({"A": [[1, 2, 3, 1]]}, [0, 1], {}), "A has 1 samples for 2 times"),
        (as_series({"A": [1, 2]}, [0, 1], {}), "no TimeSeries contains points"),
        (as_series({"A": [[1, 2, 3, 1]] * 2}, [0, 0], {"A": "m"}), "time of Points does not increase"),
        (as_series({"A": [[1, 2, 3, 1]] * 2}, [0, 0.01], {}), "no length unit"),
    ],
)
def test_files_of_kinetics_toolkit_that_are_wrong(content: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(mocap_id.RecordingError, match=message):
        mocap_id.read(ktk_file(tmp_path / "own.ktk.zip", content))


def test_a_damaged_or_swollen_file_of_kinetics_toolkit(tmp_path: Path) -> None:
    file = ktk_file(tmp_path / "own.ktk.zip", "0" * (45 << 20))
    with pytest.raises(mocap_id.RecordingError, match="unpacks to 47 MB of text"):
        mocap_id.read(file)
    file = ktk_file(tmp_path / "own.ktk.zip", as_series({"A": [[1, 2, 3, 1]] * 200}, range(200), {"A": "m"}))
    whole, rng = file.read_bytes(), np.random.default_rng(1)
    for _ in range(200):
        broken = bytearray(whole)
        broken[rng.integers(4, len(whole))] ^= 1 << rng.integers(8)
        file.write_bytes(bytes(broken[: rng.integers(5, len(whole) + 1)] if rng.random() < 0.3 else broken))
        try:
            mocap_id.read(file)
        except mocap_id.RecordingError as error:
            assert str(error).startswith(str(file))
    with pytest.raises(mocap_id.ConfigError, match="with its own force plates"):
        mocap_id.read(file, tmp_path / "forces.mot")


@pytest.fixture
def robot(once: Callable[[str, Callable[[Path], Any]], Any]) -> mocap_id.Run:
    """A finished run of the sample `robot-joint`, made by test_runs_from_python too."""

    def make(folder: Path) -> Path:
        for name in ("trial.c3d", "encoder.csv"):
            shutil.copy(SAMPLE / name, folder)
        options = {"protocol": "robot-joint", "encoder": folder / "encoder.csv", "out": folder / "runs" / "trial"}
        mocap_id.run(folder / "trial.c3d", **options)
        return folder

    return mocap_id.open(once("interface-run", make) / "runs" / "trial")


def test_a_run_as_a_file_of_kinetics_toolkit(robot: mocap_id.Run, tmp_path: Path) -> None:
    (file,) = robot.export("ktk", out=tmp_path)
    content = json.loads(zipfile.ZipFile(file).read("data.json"))
    np.testing.assert_array_equal(content["States"]["data"]["theta_1"], robot.states["theta_1"])
    assert content["States"]["info"]["theta_1"] == {"Unit": "rad"}
    again = mocap_id.read(file, vertical="Y")
    x, y = (robot.planar.pivot(index="time", columns="marker", values=axis)[list(again.labels)] for axis in "xy")
    np.testing.assert_allclose(again.positions[..., 0], x, atol=1e-12)
    np.testing.assert_allclose(again.positions[..., 2], y, atol=1e-12)
    assert robot.export("ktk", out=tmp_path, force=True)[0].read_bytes() == file.read_bytes()


@pytest.mark.external
@pytest.mark.filterwarnings("ignore")
def test_kinetics_toolkit_reads_and_writes_the_same(robot: mocap_id.Run, tmp_path: Path) -> None:
    ktk = pytest.importorskip("kineticstoolkit", reason="needs `pip install kineticstoolkit`")
    theirs = ktk.load(str(robot.export("ktk", out=tmp_path)[0]))
    states = theirs["States"]
    np.testing.assert_array_equal(states.data["dtheta_1"], robot.states["dtheta_1"])
    assert states.get_sample_rate() == pytest.approx(100)
    assert states.info["dtheta_1"]["Unit"] == "rad/s"
    assert theirs["Points"].data["PLT1"].shape == (len(states.time), 4)
    read = ktk.read_c3d(str(SAMPLE / "trial.c3d"), convert_point_unit=True)
    ktk.save(str(tmp_path / "theirs.ktk.zip"), {name: read[name] for name in ("Points", "ForcePlatforms")})
    assert_same(mocap_id.read(tmp_path / "theirs.ktk.zip"), mocap_id.read(SAMPLE / "trial.c3d"), 1e-5)
