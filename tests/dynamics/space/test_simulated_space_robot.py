"""The simulated robot in space: its files, its truth, and the plate's wrench read from them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from space_cases import robot

from mocap_id import recording
from mocap_id.errors import ConfigError, StoreError
from mocap_id.geometry import PlaneFrame
from mocap_id.plates.choice import choose_plates
from mocap_id.recording import ThinnedFrames
from mocap_id.stages.planarise.wrenches import compute_ground_wrench_in_space, find_plates_centre
from mocap_id_simulation import SpaceRobotOptions, generate_space_robot, simulate_space_robot
from mocap_id_simulation.space_robot import FRAME

SMALL = SpaceRobotOptions(seed=7, preset="clean", duration=6, rate=60, analog_rate=600)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("robots") / "robot"
    assert simulate_space_robot(place, SMALL) == place / "trial.yaml"
    return place


def test_the_wrench_in_the_file_is_the_true_one(folder: Path) -> None:
    source, truth = recording.read(folder / "trial.c3d"), np.load(folder / "truth.npz")
    thinned = ThinnedFrames.of(source.positions, source.time, source.rate, source.plates)
    choice = choose_plates(source.plates, thinned.samples, thinned.positions, feet=(), seat=())
    samples = [recording.decimate(plate, source.time, source.rate) for plate in source.plates]
    columns = compute_ground_wrench_in_space(source.time, samples, choice, PlaneFrame(0.0), 20.0)
    true = np.hstack([truth["wrench"][:, :3] @ FRAME.axes.T, truth["wrench"][:, 3:] @ FRAME.axes.T])
    for k, name in enumerate(("Fx", "Fy", "Fz", "taux", "tauy", "tauz")):
        np.testing.assert_allclose(columns[name][5:-5], true[5:-5, k], atol=0.05)
    assert columns["plate_ok"].all()
    placed = generate_space_robot(SMALL).signals.corners.mean(axis=0)
    np.testing.assert_allclose(
        find_plates_centre(source.plates, choice, PlaneFrame(0.0), mirrored=False), FRAME.to_plane(placed), atol=1e-5
    )
    assert find_plates_centre(source.plates, choice, PlaneFrame(0.0), mirrored=True)[2] == pytest.approx(
        placed[1], abs=1e-5
    )
    mirrored = compute_ground_wrench_in_space(source.time, samples, choice, PlaneFrame(0.0), 20.0, mirrored=True)
    arm, force = np.array([0.3, 0.2, -0.4]), np.array([columns[name][9] for name in ("Fx", "Fy", "Fz")])
    moment = np.array([mirrored[name][9] - columns[name][9] for name in ("tauz",)])
    assert moment == pytest.approx(0.0)
    assert mirrored["taux"][9] == -columns["taux"][9]
    flipped = np.cross(arm * [1, 1, -1], force * [1, 1, -1])
    np.testing.assert_allclose(flipped, np.cross(arm, force) * [-1, -1, 1])


def test_the_truth_places_the_markers(folder: Path) -> None:
    source, truth = recording.read(folder / "trial.c3d"), np.load(folder / "truth.npz")
    document = json.loads((folder / "truth.json").read_text("utf-8"))
    for label, segment in document["assignment"].items():
        local = np.array(document["local_xyz_m"][label])
        placed = truth["seg_origin"][:, segment] + truth["seg_R"][:, segment] @ local
        np.testing.assert_allclose(source.positions[:, source.labels.index(label)], placed, atol=1e-5)
    for k, (axis, in_child) in enumerate(document["joint_axes"]):
        np.testing.assert_allclose(truth["seg_R"][:, k] @ axis, truth["seg_R"][:, k + 1] @ in_child, atol=1e-12)
    assert len(document["base_parameters"]["names"]) == len(document["base_parameters"]["values"]) == 15


def test_a_payload_changes_only_the_last_segment() -> None:
    empty, loaded = robot(4), robot(4, payload=2.0)
    change = loaded.robot.parameters - empty.robot.parameters
    np.testing.assert_allclose(change[-1], loaded.robot.payload)
    assert change[-1, 0] == pytest.approx(2.0)
    assert not change[:-1].any()
    np.testing.assert_array_equal(loaded.q, empty.q)
    assert (loaded.errors.position == empty.errors.position).all()
    assert loaded.clock_offset != empty.clock_offset


def test_a_used_folder_and_impossible_options_are_refused(folder: Path) -> None:
    with pytest.raises(StoreError, match="already contains a trial"):
        simulate_space_robot(folder, SMALL)
    with pytest.raises(ConfigError, match="`joints` is 0"):
        SpaceRobotOptions(joints=0)
    with pytest.raises(ConfigError, match="multiple of `rate`"):
        SpaceRobotOptions(rate=100, analog_rate=1250)
