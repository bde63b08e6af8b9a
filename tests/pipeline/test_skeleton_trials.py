"""Whole trials of skeletons: simulated depth cameras against their truth, recorded ones against optical systems."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from mocap_id.config import load
from mocap_id.errors import ConfigError
from mocap_id.recording.skeleton_log import read_skeleton
from mocap_id.runner import run
from mocap_id_simulation import ArmOptions, generate_arm, write_arm
from mocap_id_simulation.arm_files import film_skeleton

ANGLES = ("shoulder_plane", "shoulder_elevation", "shoulder_axial", "elbow_flexion")
PRMD = (
    *("SpineBase", "SpineMid", "SpineShoulder", "Neck", "Head", "HeadTop", "CollarLeft", "ShoulderLeft", "ElbowLeft"),
    *("WristLeft", "CollarRight", "ShoulderRight", "ElbowRight", "WristRight", "HipLeft", "KneeLeft", "AnkleLeft"),
    *("FootLeft", "HipRight", "KneeRight", "AnkleRight", "FootRight"),
)
PRMD_PARENTS = (-1, 0, 1, 2, 3, 4, 3, 6, 7, 8, 3, 10, 11, 12, 0, 14, 15, 16, 0, 18, 19, 20)


def run_skeleton(
    folder: Path, file: Path | str, side: str, name: str = "skeleton"
) -> tuple[dict[str, np.ndarray], Any]:
    """Run a skeleton; return its angles by column, and the summary."""
    configuration = folder / f"{name}.yaml"
    configuration.write_text(f"trial: {name}\nspace: 3d\nside: {side}\nrecording: {{skeleton: {file}}}\n")
    found = run(load(configuration)).folder
    table = pq.read_table(found / "angles.parquet")
    columns = {column: table[column].to_numpy() for column in table.column_names}
    return columns, json.loads((found / "summary.json").read_text("utf-8"))


def simulated(folder: Path, **more: Any) -> tuple[dict[str, np.ndarray], Any, dict[str, Any]]:
    """Run the skeleton of a simulated reach; return also the true angles at its times, and the true ranges."""
    options = ArmOptions(cycles=1, severity=0.2, **more)
    trial = generate_arm(options)
    seen, truth = film_skeleton(trial, options)
    (folder / "kinect.csv").write_bytes(seen)
    columns, summary = run_skeleton(folder, "kinect.csv", options.side)
    at = columns["time"] + truth["offset_s"]
    true = {name: np.interp(at, trial.time, trial.angles[name]) for name in ANGLES}
    elevation = float(np.degrees(np.ptp(trial.angles["shoulder_elevation"])))
    return columns, summary, {"angles": true, "elevation": elevation, "upper_arm": trial.document["body"].upper_arm}


def errors_of(columns: dict[str, np.ndarray], true: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the errors of the angles, rad, and the standard deviations, where the truth has a meaning."""
    steep = np.sin(true["shoulder_elevation"]) > np.sin(np.radians(15))
    found = {}
    for name in ANGLES:
        keep = np.isfinite(columns[name]) & (steep if name.startswith("shoulder") else True)
        off = (columns[name] - true[name] + np.pi) % (2 * np.pi) - np.pi
        sd = np.hypot(columns[f"sd_{name}"], columns[f"constant_sd_{name}"])
        found[name] = np.stack([off, sd])[:, keep]
    return found


@pytest.fixture(scope="session")
def camera(once: Callable[[str, Callable[[Path], Any]], Any]) -> Any:
    """Angles, summary, truth and log of a simulated right arm that a depth camera saw."""

    def make(folder: Path) -> Any:
        return *simulated(folder, seed=401), (folder / "kinect.csv").read_text()

    return once("arm-by-depth-camera", make)


def test_angles_of_a_depth_camera_are_right_within_the_errors_that_are_stated(camera: Any) -> None:
    columns, summary, truth, _ = camera
    limits = dict(zip(ANGLES, (13, 6, 22, 10), strict=True))
    for name, (off, sd) in errors_of(columns, truth["angles"]).items():
        assert np.degrees(np.sqrt(np.mean(off**2))) < limits[name], name
        assert np.mean(np.abs(off) < 1.96 * sd) > 0.85, name
    assert "skeleton-biases" in [reason["code"] for reason in summary["verdict"]["reasons"]]
    spread = np.ptp(np.percentile(columns["shoulder_elevation"], [0.5, 99.5]))
    assert np.degrees(spread) == pytest.approx(truth["elevation"], abs=8)
    found = summary["lengths_m"]["upper_arm"]
    assert abs(found["value"] - truth["upper_arm"]) < 3 * found["sd"]
    assert np.allclose(np.degrees(columns["elbow_carrying"]), -10)
    assert "elbow_pronation" not in columns


def test_a_left_arm_has_the_angles_of_the_right_one(tmp_path: Path) -> None:
    columns, summary, truth = simulated(tmp_path, seed=402, side="left")
    assert summary["mirrored"]
    errors = errors_of(columns, truth["angles"])
    assert np.degrees(np.sqrt(np.mean(errors["shoulder_elevation"][0] ** 2))) < 6
    assert np.degrees(np.sqrt(np.mean(errors["shoulder_plane"][0] ** 2))) < 14


def test_a_file_whose_coordinates_are_mirrored_is_mirrored_back_with_a_caution(camera: Any, tmp_path: Path) -> None:
    columns, lines = camera[0], camera[3].splitlines()
    head = lines[0].split(",")
    depth = [k for k, name in enumerate(head) if name.endswith("_z")]
    rows = [line.split(",") for line in lines[1:]]
    for row in rows:
        for k in depth:
            row[k] = f"{5 - float(row[k]):.5f}" if row[k] else ""
    (tmp_path / "kinect.csv").write_text("\n".join([lines[0], *(",".join(row) for row in rows)]) + "\n")
    found, summary = run_skeleton(tmp_path, "kinect.csv", "right")
    assert "skeleton-mirrored" in [reason["code"] for reason in summary["verdict"]["reasons"]]
    off = found["shoulder_elevation"] - columns["shoulder_elevation"]
    assert np.degrees(np.sqrt(np.nanmean(off**2))) < 1


def test_a_skeleton_without_an_arm_is_refused_and_one_in_the_plane_is_a_mistake(camera: Any, tmp_path: Path) -> None:
    text = camera[3].replace("ElbowRight", "Thing")
    (tmp_path / "kinect.csv").write_text(text)
    configuration = tmp_path / "trial.yaml"
    configuration.write_text("trial: a\nspace: 3d\nside: right\nrecording: {skeleton: kinect.csv}\n")
    refused = run(load(configuration)).refused
    assert refused is not None
    assert refused.code == "skeleton-incomplete"
    configuration.write_text("trial: a\nrecording: {skeleton: kinect.csv}\n")
    with pytest.raises(ConfigError, match="space: 3d"):
        load(configuration)
    configuration.write_text("trial: a\nspace: 3d\nrecording: {forces: kinect.csv}\n")
    with pytest.raises(ConfigError, match="skeleton"):
        load(configuration)


def test_a_simulated_trial_has_the_skeleton_beside_the_markers(tmp_path: Path) -> None:
    options = ArmOptions(seed=5, movement="curl", repetitions=1, preset="clean", skeleton=True)
    folder = write_arm(tmp_path / "arm", options).parent
    truth = json.loads((folder / "truth.json").read_text())["kinect"]
    seen = read_skeleton(folder / "kinect.csv").recording
    arrays = np.load(folder / "truth.npz")
    x, y, z = np.moveaxis(seen.positions[:, seen.labels.index("ElbowRight")], 1, 0)
    lab = np.stack([x, z, -y], axis=1) @ np.array(truth["camera_R_to_lab"]).T + truth["camera_p_lab_m"]
    at = seen.time + truth["offset_s"]
    true = np.column_stack([np.interp(at, arrays["t"], each) for each in arrays["seg_origin"][:, 2].T])
    known = np.isfinite(lab[:, 0])
    assert np.abs(lab - true)[known].max() < 2e-3


def best_match(time: np.ndarray, curve: np.ndarray, other: np.ndarray, rate: float) -> tuple[float, np.ndarray]:
    """Return the best correlation with another curve, whose clock and rate are unknown, and the differences."""
    best, off = -1.0, np.zeros(0)
    for stretch in np.linspace(0.9, 1.6, 36):
        for shift in np.linspace(-1.0, 1.0, 81):
            there = np.interp(stretch * time + shift, np.arange(len(other)) / rate, other, left=np.nan, right=np.nan)
            both = np.isfinite(there) & np.isfinite(curve)
            if both.mean() > 0.75 and (r := float(np.corrcoef(there[both], curve[both])[0, 1])) > best:
                best, off = r, (curve - there)[both]
    return best, off


def assert_within_the_stated_error(columns: dict[str, np.ndarray], off: np.ndarray) -> None:
    """Check that the stated interval of the elevation holds the mean difference, and most of the differences."""
    half = 1.96 * np.degrees(np.hypot(columns["sd_shoulder_elevation"], columns["constant_sd_shoulder_elevation"]))
    assert abs(off.mean()) < np.nanmedian(half)
    assert np.mean(np.abs(off) < np.nanmedian(half)) > 0.85


def angle_from_down(arm: np.ndarray, up: np.ndarray) -> np.ndarray:
    cosine = -np.sum(arm * up, axis=-1) / np.linalg.norm(arm, axis=-1) / np.linalg.norm(up, axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def rotations(quaternion: np.ndarray) -> np.ndarray:
    """Return rotations (..., 3, 3) of quaternions x y z w (..., 4)."""
    x, y, z, w = np.moveaxis(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


@pytest.mark.recordings
@pytest.mark.parametrize(("side", "arm", "forearm"), [("right", 2, 0), ("left", 3, 1)])
def test_a_recorded_depth_camera_follows_optical_bodies(
    recordings: Path, tmp_path: Path, side: str, arm: int, forearm: int
) -> None:
    folder = recordings / "upper-limb" / "keraal"
    if not folder.is_dir():
        pytest.skip(f"no recordings of arms at {folder}")
    bodies = np.loadtxt(folder / "G3-Vicon-CTK.txt").reshape(-1, 17, 7)
    place, turn = bodies[..., :3] / 1e3, rotations(bodies[..., 3:])
    chest = 4

    def common_point(a: int, b: int) -> np.ndarray:
        """Return the point of body a, in its axes, that moves least in body b."""
        system = np.concatenate([turn[:, a], -turn[:, b]], axis=2).reshape(-1, 6)
        return np.asarray(np.linalg.lstsq(system, (place[:, b] - place[:, a]).ravel(), rcond=None)[0][:3])

    bone = turn[:, arm] @ (common_point(arm, forearm) - common_point(arm, chest))
    optical = angle_from_down(bone, turn[:, chest] @ turn[0, chest].T @ np.array([0.0, 0.0, 1.0]))
    columns, _ = run_skeleton(tmp_path, folder / "G3-Kinect-CTK.txt", side)
    r, off = best_match(columns["time"], np.degrees(columns["shoulder_elevation"]), optical, 60.0)
    assert r >= 0.95
    assert abs(off.mean()) < 15
    assert_within_the_stated_error(columns, off)


@pytest.mark.recordings
@pytest.mark.parametrize("episode", ["e01", "e02", "e03"])
def test_a_recorded_abduction_follows_the_optical_system(recordings: Path, tmp_path: Path, episode: str) -> None:
    folder = recordings / "upper-limb" / "ui-prmd"
    if not folder.is_dir():
        pytest.skip(f"no recordings of arms at {folder}")

    def table(system: str, what: str) -> np.ndarray:
        with gzip.open(folder / f"{system}_m07_s01_{episode}_{what}.txt.gz") as file:
            return np.loadtxt(file, delimiter=",").reshape(-1, 22 if system == "Kinect" else 39, 3)

    steps, angles = table("Kinect", "positions") / 100, np.radians(table("Kinect", "angles"))
    turns, joints = [], []
    for k, parent in enumerate(PRMD_PARENTS):  # positions and turns are relative to the parent's
        half = angles[:, k] / 2
        own = np.broadcast_to(np.eye(3), (len(half), 3, 3))
        for axis in (2, 1, 0):
            quaternion = np.zeros((len(half), 4))
            quaternion[:, axis], quaternion[:, 3] = np.sin(half[:, axis]), np.cos(half[:, axis])
            own = own @ rotations(quaternion)
        up = turns[parent] if parent >= 0 else np.eye(3)
        joints.append((joints[parent] if parent >= 0 else 0) + (up @ steps[:, k, :, None])[..., 0])
        turns.append(up @ own)
    head = ["time_s", *(f"{name}_{axis}" for name in PRMD for axis in "xyz")]
    rows = np.column_stack([np.arange(len(steps)) / 30, np.stack(joints, axis=1).reshape(len(steps), -1)])
    np.savetxt(tmp_path / "kinect.csv", rows, delimiter=",", header=",".join(head), comments="", fmt="%.5f")
    columns, _ = run_skeleton(tmp_path, "kinect.csv", "right")
    optical = table("Vicon", "positions")
    trunk = (optical[:, 4] + optical[:, 6]) / 2 - optical[:, 23:27].mean(axis=1)
    true = angle_from_down(optical[:, 18] - optical[:, 16], trunk)
    r, off = best_match(columns["time"], np.degrees(columns["shoulder_elevation"]), true, 100.0)
    assert r >= 0.95
    assert abs(off.mean()) < 25
    assert_within_the_stated_error(columns, off)
    assert np.ptp(np.degrees(columns["shoulder_elevation"])) == pytest.approx(np.ptp(true), abs=30)
