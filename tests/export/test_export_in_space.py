"""Exports of a trial in space: coordinates that give the poses again, a model that OpenSim accepts, and tables."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from mocap_id.geometry import so3
from mocap_id.recording import read_table
from mocap_id.store import Tree
from mocap_id.store.artefacts import MeasuredPoses, SpatialSkeleton
from mocap_id.store.provenance import DYNAMICS_TREE
from mocap_id.workflows.export import FORMATS, IN_SPACE
from mocap_id.workflows.export.opensim_model import ModelJoint, convert_spatial_inertia, model_joints
from mocap_id.workflows.export.opensim_tables import convert_spatial_wrench
from mocap_id.workflows.export.tables import ExportFiles
from mocap_id.workflows.run_folder import RunFolder
from spatial_trial import ANGLES_OF_ARM, SpatialTrial

X, Y, Z = np.eye(3)


def exported(trial: SpatialTrial, folder: Path, **changed: Any) -> ExportFiles:
    run = RunFolder(folder, folder / "s07", trial.artefacts(plates=True) | changed, {})
    made = ExportFiles()
    for exporters in IN_SPACE.values():
        for add_files in exporters:
            add_files(run, made)
    return made


def joints_of(trial: SpatialTrial) -> list[ModelJoint]:
    return model_joints(SpatialSkeleton(trial.tree()), MeasuredPoses(trial.poses()))


def turned(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return so3.exp(angle[:, None] * axis)


def moved(joint: ModelJoint) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the child in the parent by the definition of OpenSim's joints: origin (T, 3), rotation (T, 3, 3)."""
    q = joint.values.T
    count = len(joint.values)
    rotation, shift = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    if joint.element in ("FreeJoint", "BallJoint"):
        rotation = turned(X, q[0]) @ turned(Y, q[1]) @ turned(Z, q[2])
        shift = q[3:6].T if len(q) == 6 else shift
    elif joint.element == "PinJoint":
        rotation = turned(Z, q[0])
    elif joint.slides:
        shift = q[0][:, None] * joint.axes[0]
    else:
        for axis, angle in zip(joint.axes, q, strict=True):
            rotation = rotation @ turned(axis, angle)
    return joint.at + shift @ joint.parent_rotation.T, joint.parent_rotation @ rotation @ joint.child_rotation.T


@pytest.mark.parametrize("arm", [True, False])
def test_the_coordinates_give_the_poses_again(arm: bool) -> None:
    trial = SpatialTrial(frames=200, arm=arm)
    placed = {"/ground": (np.zeros((200, 3)), np.tile(np.eye(3), (200, 1, 1)))}
    for joint in joints_of(trial):
        (origin, rotation), (step, turn) = placed[joint.parent], moved(joint)
        placed[joint.child] = origin + np.einsum("tij,tj->ti", rotation, step), rotation @ turn
    for k, name in enumerate(trial.segments):
        np.testing.assert_allclose(placed[name][0], trial.origin[:, k], atol=1e-9)
        np.testing.assert_allclose(placed[name][1], trial.rotation[:, k], atol=1e-9)


def test_the_kinds_of_joints_are_those_of_opensim() -> None:
    found = [(joint.name, joint.element) for joint in joints_of(SpatialTrial(frames=50))]
    elements = ["FreeJoint", "CustomJoint", "BallJoint", "CustomJoint", "CustomJoint"]
    assert found == list(zip(["base", "shoulder_glide", "shoulder", "elbow", "wrist"], elements, strict=True))
    assert [joint.element for joint in joints_of(SpatialTrial(50, arm=False))] == ["FreeJoint", "BallJoint", "PinJoint"]


def test_every_format_has_its_files(tmp_path: Path) -> None:
    assert set(IN_SPACE) == set(FORMATS)
    trial = SpatialTrial(frames=120)
    made = exported(trial, tmp_path)
    endings = {".trc", "_model.trc", "_angles.mot", "_joint_angles.mot", "_grf.mot", "_external_loads.xml", ".osim"}
    endings |= {f"_{name}.csv" for name in ("markers", "angles", "poses", "skeleton", "landmarks", "wrench")}
    assert {f"s07{ending}" for ending in endings} <= set(made.files)
    model = ElementTree.fromstring(made.files["s07.osim"])
    marker = next(one for one in model.iter("Marker") if one.get("name") == trial.labels[4])
    assert marker.findtext("socket_parent_frame") == "/bodyset/shoulder_girdle"
    assert any("placeholders" in note for note in made.notes)


def test_tables_have_units_and_the_numbers_of_the_run(tmp_path: Path) -> None:
    trial = SpatialTrial(frames=120)
    files = exported(trial, tmp_path).files
    angles, poses, joints = (
        pd.read_csv(io.BytesIO(files[f"s07_{name}.csv"])) for name in ("angles", "poses", "skeleton")
    )
    np.testing.assert_allclose(angles["shoulder_plane (rad)"], trial.angles[:, 0])
    assert {"dshoulder_plane (rad/s)", "sd_ddelbow_flexion (rad/s^2)", "isb_condition"} <= set(angles)
    np.testing.assert_allclose(poses[[f"forearm_{axis} (m)" for axis in "xyz"]], trial.origin[:, 2])
    assert joints["kind"].tolist() == ["ball", "two-axis", "two-axis"] and joints["axis 1 x"].isna().tolist()[0]
    (tmp_path / "angles.mot").write_bytes(files["s07_joint_angles.mot"])
    table = read_table(tmp_path / "angles.mot")
    assert tuple(table.columns)[-len(ANGLES_OF_ARM) :] == ANGLES_OF_ARM


def test_a_chain_with_an_unknown_centre_has_no_model(tmp_path: Path) -> None:
    made = exported(SpatialTrial(frames=60, known=False), tmp_path)
    assert "s07.osim" not in made.files and "s07_angles.csv" in made.files
    assert "osim: no model: the motion does not determine the centre of: shoulder" in made.notes
    joints = pd.read_csv(io.BytesIO(made.files["s07_skeleton.csv"]))
    assert joints["x (m)"].isna().tolist() == [True, False, False]


def test_forces_are_equivalent_to_the_wrench() -> None:
    wrench = np.random.default_rng(1).normal(size=(50, 6)) * 50 + [0, 500, 0, 0, 0, 0]
    wrench[7] = [1.0, 0.5, 0.0, 3.0, 2.0, 1.0]
    force, point, free = np.split(convert_spatial_wrench(wrench, 20.0), 3, axis=1)
    np.testing.assert_allclose(np.cross(point, force) + free, wrench[:, 3:], atol=1e-9)
    assert np.abs(free[wrench[:, 1] > 20][:, [0, 2]]).max() < 1e-9


def test_identified_bodies_keep_their_inertia(tmp_path: Path) -> None:
    def block(mass: float, centre: np.ndarray, own: np.ndarray) -> np.ndarray:
        about = own - mass * so3.hat(centre) @ so3.hat(centre)
        return np.array([mass, *(mass * centre), *about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])

    own = np.array([[0.02, 0.001, -0.002], [0.001, 0.015, 0.0005], [-0.002, 0.0005, 0.012]])
    centres = (np.array([0.01, -0.12, 0.02]), np.array([0.0, -0.1, 0.03]))
    blocks = np.concatenate([block(2.0 + k, centre, own) for k, centre in enumerate(centres)])
    _, centre, inertia = convert_spatial_inertia(blocks[:10])
    np.testing.assert_allclose(centre, centres[0])
    np.testing.assert_allclose(inertia, own[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], atol=1e-15)
    tree = Tree(DYNAMICS_TREE, {"full": {"value": blocks}})
    made = exported(SpatialTrial(frames=60, arm=False), tmp_path, **{"dynamics.h5": tree})
    masses = [float(one.findtext("mass") or 0) for one in ElementTree.fromstring(made.files["s07.osim"]).iter("Body")]
    assert masses == [1.0, 2.0, 3.0]
    assert any("the base has a placeholder" in note for note in made.notes)


@pytest.mark.external
@pytest.mark.parametrize("arm", [True, False])
def test_opensim_finds_our_coordinates(arm: bool, tmp_path: Path, opensim: Callable[..., dict[str, Any]]) -> None:
    trial = SpatialTrial(frames=120, arm=arm)
    for name, content in exported(trial, tmp_path).files.items():
        (tmp_path / name).write_bytes(content)
    exact = opensim(tmp_path, "s07", "s07_model.trc")
    noisy = opensim(tmp_path, "s07")
    assert exact["bodies"] == len(trial.segments) + arm and exact["markers"] == len(trial.labels)
    for joint in joints_of(trial):
        for k, name in enumerate(joint.coordinates):
            is_length = joint.slides or k >= 3
            ours = joint.values[:, k] if is_length else np.degrees(joint.values[:, k])
            assert np.abs(np.array(exact["kinematics"][name]) - ours).max() < (1e-5 if is_length else 1e-3), name
            rms = float(np.sqrt(np.mean((np.array(noisy["kinematics"][name]) - ours) ** 2)))
            assert rms < (2e-3 if is_length else 1.5), name
