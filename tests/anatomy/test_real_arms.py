"""Angles of recorded arms against other programs, and of simulated arms against the truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mocap_id.anatomy.angles import WRIST, JointAngles, RelativeMotion, elbow_angles, shoulder_angles
from mocap_id.anatomy.frames import (
    DEFINITIONS,
    FOREARM,
    HAND,
    THORAX,
    UPPER_ARM,
    FrameDefinition,
    build_frame,
    mirror_points,
)
from mocap_id.anatomy.landmarks import (
    SEGMENTS,
    calibrate_pointer,
    find_landmarks,
    find_pointer_markers,
    find_still_pose,
    locate_landmarks,
    locate_pointed_landmark,
)
from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.recording import read
from mocap_id.recording.model import Recording

pytestmark = pytest.mark.recordings

TO_TRIAL = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
X, Y, Z = np.eye(3)

CLUSTERS = {
    "upper_arm": ("LUA1", "LUA2", "LUA3", "LUA4"),
    "forearm": ("LLA1", "LLA2", "LLA3", "LLA4"),
    "hand": ("LH1", "LH2", "LH3"),
    "girdle": ("LACR1", "LACR2", "LACR3"),
    "thorax": ("ST1", "ST2", "ST3"),
}
POINTED = {
    **dict.fromkeys(("EL", "EM"), "upper_arm"),
    **dict.fromkeys(("RS", "US"), "forearm"),
    **dict.fromkeys(("MC3", "MCP2", "MCP5"), "hand"),
    **dict.fromkeys(("AC", "AA", "AI", "TS", "PC"), "girdle"),
    **dict.fromkeys(("IJ", "PX", "C7", "T8"), "thorax"),
}
ROD = np.array([0.4575, 0.369, 0.266, 0.1475]), 0.0
"""Distances that the laboratory gives for its pointer, m."""


@pytest.fixture(scope="module")
def ulema(recordings: Path) -> Path:
    folder = recordings / "upper-limb" / "ulema"
    if not folder.is_dir():
        pytest.skip(f"no recordings of arms at {folder}")
    return folder


def still_motion(rotation: FloatArray) -> RelativeMotion:
    zero = np.zeros((len(rotation), 3))
    return RelativeMotion(rotation, zero, zero, np.zeros((len(rotation), 9, 9)))


def relative(parent: FloatArray, child: FloatArray) -> RelativeMotion:
    return still_motion(np.swapaxes(parent, -1, -2) @ child)


def named(recording: Recording) -> dict[str, FloatArray]:
    """Return the landmarks of a left arm, mirrored, in the trial's frame."""
    found = find_landmarks(recording.labels)
    assert found.side == "left"
    return {name: mirror_points(recording.positions[:, i] @ TO_TRIAL.T) for name, i in found.markers.items()}


def angles_of(points: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the angles (F,) of shoulder, elbow and wrist by name, degrees."""
    frames = {
        name: build_frame(definition, points).rotation
        for name, definition in DEFINITIONS.items()
        if set(definition.landmarks) <= set(points)
    }
    parts: list[JointAngles] = [
        shoulder_angles(relative(frames["thorax"], frames["upper_arm"])),
        elbow_angles(relative(frames["upper_arm"], frames["forearm"])),
    ]
    if "hand" in frames:
        parts.append(elbow_angles(relative(frames["forearm"], frames["hand"]), names=WRIST))
    return {name: np.degrees(part.angle[:, i]) for part in parts for i, name in enumerate(part.names)}


def printed(folder: Path, trial: str) -> dict[str, FloatArray]:
    """Return the other program's angles (F,) under our names, degrees; it prints the elevation negative."""
    rows = {}
    for line in (folder / f"{trial}_angles.csv").read_text(encoding="latin-1").splitlines()[1:29]:
        name, *values = line.rstrip("\t").split("\t")
        rows[name] = np.array(values, dtype=float)
    return {
        "shoulder_plane": rows["LElevationplaneH1"],
        "shoulder_elevation": -rows["LShoulderElevationH1"],
        "shoulder_axial": rows["LShoulderRotationH1"],
        "axial by option 2": rows["LShoulderRotationH2"],
        "elbow_flexion": rows["LElbowFlExt"],
        "elbow_pronation": rows["LElbowProSupination"],
        "wrist_flexion": rows["LWristFlExt"],
        "wrist_deviation": rows["LWristDeviation"],
    }


def differences(ours: FloatArray, theirs: FloatArray) -> FloatArray:
    return np.degrees(np.angle(np.exp(1j * np.radians(ours - theirs))))


@pytest.mark.parametrize("trial", ["RF1", "HTH1"])
def test_a_left_arm_agrees_with_the_other_program_from_the_same_landmarks(ulema: Path, trial: str) -> None:
    points = named(read(ulema / f"{trial}.c3d"))
    ours, theirs = angles_of(points), printed(ulema, trial)
    for name in ("shoulder_plane", "shoulder_elevation", "shoulder_axial", "elbow_flexion", "elbow_pronation"):
        assert np.max(np.abs(differences(ours[name], theirs[name]))) < 0.001, name
    assert np.std(differences(ours["wrist_flexion"], theirs["wrist_flexion"])) < 4  # other landmarks of the hand


@pytest.mark.parametrize("trial", ["RF1", "HTH1"])
def test_its_second_option_uses_the_middle_of_the_wrist_in_every_frame(ulema: Path, trial: str) -> None:
    points = named(read(ulema / f"{trial}.c3d"))
    wrist = FrameDefinition({"GH": 1.0}, UPPER_ARM.up, {"RS": 0.5, "US": 0.5, "EL": -0.5, "EM": -0.5}, "x")
    thorax, arm = build_frame(THORAX, points), build_frame(wrist, points)
    ours = np.degrees(shoulder_angles(relative(thorax.rotation, arm.rotation)).angle[:, 2])
    assert np.max(np.abs(differences(ours, printed(ulema, trial)["axial by option 2"]))) < 0.001


def cluster_poses(recording: Recording, template: FloatArray, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    points = recording.positions[:, [recording.labels.index(name) for name in names]]
    middle, centre = points.mean(axis=1), template.mean(axis=0)
    left, _, right = np.linalg.svd(np.einsum("fpi,pj->fij", points - middle[:, None], template - centre))
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    rotation = left @ right
    return rotation, middle - np.einsum("fij,j->fi", rotation, centre)


@pytest.fixture(scope="module")
def templates(ulema: Path) -> dict[str, FloatArray]:
    first = read(ulema / "RF1.c3d")
    return {
        name: first.positions[0, [first.labels.index(each) for each in markers]] for name, markers in CLUSTERS.items()
    }


@pytest.fixture(scope="module")
def touches(ulema: Path, templates: dict[str, FloatArray]) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    """Pointer markers, and the pose of the cluster, of every pointer trial."""
    files = {name: read(ulema / f"cal{'' if seg == 'thorax' else 'L'}{name}.c3d") for name, seg in POINTED.items()}
    trial = read(ulema / "RF1.c3d")
    rod = find_pointer_markers(trial.labels, [each.labels for each in files.values()])
    assert rod == ("P1", "P2", "P3", "P4")
    result = {}
    for name, each in files.items():
        markers = each.positions[:, [each.labels.index(label) for label in rod]]
        result[name] = (markers, *cluster_poses(each, templates[POINTED[name]], CLUSTERS[POINTED[name]]))
    return result


@pytest.mark.parametrize("trial", ["RF1", "HTH1"])
def test_pointer_trials_give_the_other_programs_angles_after_one_constant(
    ulema: Path,
    templates: dict[str, FloatArray],
    touches: dict[str, tuple[FloatArray, FloatArray, FloatArray]],
    trial: str,
) -> None:
    recording = read(ulema / f"{trial}.c3d")
    poses = {name: cluster_poses(recording, templates[name], CLUSTERS[name]) for name in CLUSTERS}
    recorded = named(recording)
    points = {"GH": shoulder_centre(ulema, templates, poses["girdle"])}
    for name, touch in touches.items():
        position, reasons = locate_pointed_landmark(*touch, ROD)
        assert not reasons
        rotation, origin = poses[POINTED[name]]
        track = np.einsum("fij,j->fi", rotation, position.local) + origin
        points[name] = mirror_points(track @ TO_TRIAL.T)
        off = np.linalg.norm(points[name] - recorded[name], axis=1)
        assert np.max(off) < (0.006 if name == "C7" else 0.002), name
    ours, theirs = angles_of(points), printed(ulema, trial)
    for name in ("shoulder_plane", "shoulder_elevation", "elbow_flexion"):
        difference = differences(ours[name], theirs[name])
        assert np.std(difference) < 2.5, name
        assert abs(np.mean(difference)) < 5, name


def shoulder_centre(
    folder: Path, templates: dict[str, FloatArray], girdle: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return GH (F, 3) of a left arm: the point that rests in the arm's and in the acromion's cluster (SCoRE)."""
    calibration = read(folder / "GHr.c3d")
    arm, base = (cluster_poses(calibration, templates[name], CLUSTERS[name]) for name in ("upper_arm", "girdle"))
    seen = np.isfinite(arm[0]).all(axis=(1, 2)) & np.isfinite(base[0]).all(axis=(1, 2))
    system = np.concatenate([arm[0][seen], -base[0][seen]], axis=2).reshape(-1, 6)
    centre = np.linalg.lstsq(system, (base[1] - arm[1])[seen].reshape(-1), rcond=None)[0][3:]
    return mirror_points((np.einsum("fij,j->fi", girdle[0], centre) + girdle[1]) @ TO_TRIAL.T)


def test_the_pointer_shows_its_own_tip(touches: dict[str, tuple[FloatArray, FloatArray, FloatArray]]) -> None:
    found, sd = calibrate_pointer(list(touches.values()))
    assert abs(np.mean(found - ROD[0])) < 3 * sd


def test_an_abduction_agrees_with_opensim(recordings: Path) -> None:
    """OpenSim's elevation of the humerus in the thorax, from its coordinates and the angles of its model's joints.

    Its ``shoulder_elv`` is the elevation in the scapula. The constants are those of the subject's model (published with
    the recording): the orientations of the scapula's joint, the axis of ``axial_rot``, and the directions of the
    landmarks centpxt8 → centijc7 in the thorax and centelbow → gu in the humerus.
    """
    folder = recordings / "upper-limb" / "abduction"
    if not folder.is_dir():
        pytest.skip(f"no recordings of arms at {folder}")
    header, *rows = (folder / "ABD01_ik.mot").read_text().split("endheader\n")[1].splitlines()
    table = np.radians(np.array([row.split() for row in rows], dtype=float))
    q = {name: table[:, i : i + 1] for i, name in enumerate(header.split())}
    seat = so3.exp(-0.5181 * X) @ so3.exp(-1.1416 * Y) @ so3.exp(-0.2854 * Z)
    scapula = so3.exp(-1.07 * Y) @ so3.exp(q["scapula_abduction"] * Y) @ so3.exp(-q["scapula_elevation"] * X)
    scapula = scapula @ so3.exp(q["scapula_upward_rot"] * Z) @ so3.exp(q["scapula_winging"] * Y) @ seat.T
    twist = np.array([-0.0846, 0.9947, -0.0584])
    humerus = scapula @ so3.exp(q["plane_elv"] * Y) @ so3.exp(-q["shoulder_elv"] * X)
    humerus = humerus @ so3.exp(q["axial_rot"] * twist / np.linalg.norm(twist))
    landmarks = humerus @ np.array([0.0418, 0.9956, 0.0841]) @ np.array([-0.1365, 0.9906, -0.0056])
    theirs, bodies = np.degrees(np.arccos(landmarks)), np.degrees(np.arccos(humerus[:, 1, 1]))

    recording = read(folder / "ABD01.trc")
    place = {name: recording.positions[:, i] for i, name in enumerate(recording.labels)}
    found = find_landmarks(recording.labels)
    assert recording.labels[found.markers["EL"]] == "EpL" and recording.labels[found.markers["GH"]] == "gu"
    up, arm = place["centijc7"] - place["centpxt8"], place["gu"] - place["centelbow"]
    cosine = np.sum(up * arm, axis=1) / np.linalg.norm(up, axis=1) / np.linalg.norm(arm, axis=1)
    ours = np.degrees(np.arccos(cosine))
    assert np.ptp(ours) > 140
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 3
    assert np.std(ours - bodies) < 2.5


@pytest.mark.parametrize("trial", ["reach-default", "reach-hard", "curl-C"])
def test_frames_from_true_landmarks_are_the_truth(recordings: Path, trial: str) -> None:
    folder = recordings / "simulated-arm" / trial
    if not folder.is_dir():
        pytest.skip(f"no simulated arms at {folder}")
    truth, data = json.loads((folder / "truth.json").read_text()), np.load(folder / "truth.npz")
    turns, origins = data["seg_R"][::7], data["seg_origin"][::7]
    points = {"GH": origins[:, 1]}
    for marker in truth["markers"]:
        if marker["name"] in SEGMENTS:
            k = marker["segment"]
            points[marker["name"]] = np.einsum("fij,j->fi", turns[:, k], marker["bone_xyz_m"]) + origins[:, k]
    for k, definition in enumerate((THORAX, UPPER_ARM, FOREARM)):
        frame = build_frame(definition, points)
        assert np.allclose(frame.rotation, turns[:, k], atol=1e-9)
        assert np.allclose(frame.origin, origins[:, k], atol=1e-9)
    assert HAND.landmarks[0] in points
    angle = shoulder_angles(relative(build_frame(THORAX, points).rotation, build_frame(UPPER_ARM, points).rotation))
    gated = ~angle.near_gimbal
    assert np.allclose(angle.angle[:, 1], -data["isb_shoulder"][::7, 1], atol=1e-9)
    for i in (0, 2):
        wrapped = np.angle(np.exp(1j * (angle.angle[:, i] - data["isb_shoulder"][::7, i])))
        assert np.allclose(wrapped[gated], 0, atol=1e-9)
    assert np.allclose(angle.condition[gated], data["isb_condition"][::7][gated])
    elbow = elbow_angles(relative(build_frame(UPPER_ARM, points).rotation, build_frame(FOREARM, points).rotation))
    assert np.allclose(np.angle(np.exp(1j * (elbow.angle - data["isb_elbow"][::7]))), 0, atol=1e-9)


def test_rates_are_those_of_the_truth(recordings: Path) -> None:
    folder = recordings / "simulated-arm" / "reach-default"
    if not folder.is_dir():
        pytest.skip(f"no simulated arms at {folder}")
    data = np.load(folder / "truth.npz")
    turn, omega, alpha = (data[name][::5] for name in ("seg_R", "omega", "alpha"))

    def motion(parent: int, child: int) -> RelativeMotion:
        back = np.swapaxes(turn[:, child], 1, 2)
        velocity = omega[:, child] - omega[:, parent]
        change = alpha[:, child] - alpha[:, parent] - np.cross(omega[:, child], velocity)
        return RelativeMotion(
            np.swapaxes(turn[:, parent], 1, 2) @ turn[:, child],
            np.einsum("fij,fj->fi", back, velocity),
            np.einsum("fij,fj->fi", back, change),
            np.zeros((len(turn), 9, 9)),
        )

    for result, name, sign in (
        (shoulder_angles(motion(0, 1)), "isb_shoulder", np.array([1, -1, 1])),
        (elbow_angles(motion(1, 2)), "isb_elbow", np.ones(3)),
    ):
        assert np.allclose(result.rate, sign * data[f"{name}_rate"][::5], atol=1e-9)
        assert np.allclose(result.acceleration, sign * data[f"{name}_acc"][::5], atol=1e-8)


def test_landmarks_of_a_simulated_trial_are_tied_by_its_still_start(recordings: Path) -> None:
    folder = recordings / "simulated-arm" / "reach-default"
    if not folder.is_dir():
        pytest.skip(f"no simulated arms at {folder}")
    truth, data = json.loads((folder / "truth.json").read_text()), np.load(folder / "truth.npz")
    recording = read(folder / "trial.c3d")
    pose = find_still_pose(recording.positions, recording.rate)
    assert not pose.reasons
    assert pose.frames.start / recording.rate < 0.1
    assert abs(pose.frames.stop / recording.rate - truth["static_s"]) < 0.5
    found = find_landmarks(recording.labels)
    marked = {m["label"]: m for m in truth["markers"]}
    segment = {name: marked[recording.labels[i]]["segment"] for name, i in found.markers.items()}
    tracks = {name: recording.positions[:, i] for name, i in found.markers.items()}
    places, reasons = locate_landmarks(tracks, segment, data["seg_R"], data["seg_origin"], frames=pose.frames)
    assert not reasons
    assert set(places) >= {"IJ", "PX", "C7", "T8", "AC", "EL", "EM", "RS", "US"}
    for name, place in places.items():
        marker = marked[recording.labels[found.markers[name]]]
        assert np.allclose(place.local, marker["local_xyz_m"], atol=0.002 if name == "AC" else 0.001), name
        assert np.linalg.norm(place.local - marker["bone_xyz_m"]) < 3.5 * np.sqrt(3) * place.sd
