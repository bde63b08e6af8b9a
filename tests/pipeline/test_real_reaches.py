"""Reaches of a recorded left arm against the ranges of another program (ULEMA), and fast bones against their pins."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from mocap_id.config import load
from mocap_id.recording import read
from mocap_id.runner import run, run_to
from mocap_id.store import Folder

pytestmark = pytest.mark.recordings

POINTERS = {"IJ": "IJ", "PX": "PX", "C7": "C7", "T8": "T8", "EL": "LEL", "EM": "LEM", "RS": "LRS", "US": "LUS"}
TRIAL = """\
trial: {name}
space: 3d
protocol: reach
side: left
recording: {folder}/{name}.c3d
planarise: {{ignore: ['CH*', LEL, LEM, LRS, LUS, 'LMC*', LGH, 'LA?', LTS, LPC, C7, T8, IJ, PX]}}
segment: {{names: [thorax, girdle, upper_arm, forearm, hand]}}
pointer: {{P1: 0.4575, P2: 0.369, P3: 0.266, P4: 0.1475}}
pointers: {{{pointers}}}
"""
LEFT_FOREARM = ("LLA1", "LLA2", "LLA3")
THEIRS = {
    "shoulder_plane": "LElevationplaneH1",
    "shoulder_elevation": "LShoulderElevationH1",
    "shoulder_axial": "LShoulderRotationH1",
}


def write_trial(recordings: Path, place: Path, name: str) -> Path:
    """Write the configuration of a reach with pointed landmarks; skip the test without the recordings."""
    folder = recordings / "upper-limb" / "ulema"
    if not folder.is_dir():
        pytest.skip(f"no recordings of arms at {folder}")
    pointers = ", ".join(f"{landmark}: {folder}/cal{file}.c3d" for landmark, file in POINTERS.items())
    configuration = place / f"{name}.yaml"
    configuration.write_text(TRIAL.format(name=name, folder=folder, pointers=pointers))
    return configuration


@pytest.mark.parametrize(("name", "volume"), [("RF1", (0.001, 0.01)), ("HTH1", (0.005, 0.05))])
def test_ranges_are_those_of_the_other_program(
    recordings: Path, tmp_path: Path, name: str, volume: tuple[float, float]
) -> None:
    outcome = run(load(write_trial(recordings, tmp_path, name)))
    folder = recordings / "upper-limb" / "ulema"
    found = json.loads((outcome.folder / "summary.json").read_text())["workspace"]
    rows = (line.rstrip("\t").split("\t") for line in _lines(folder / f"{name}_angles.csv"))
    printed = {row[0]: np.sort(np.array(row[1:], dtype=float)) for row in rows}
    for ours, theirs in THEIRS.items():
        values = printed[theirs]
        assert found["ranges"][ours]["range_deg"] == pytest.approx(values[-5] - values[4], abs=5), ours
    flexion = found["ranges"]["elbow_flexion"]["range_deg"]
    printed_range, rigid_range = flexion_ranges(folder / f"{name}.c3d")
    theirs = printed["LElbowFlExt"]
    assert theirs[-5] - theirs[4] == pytest.approx(printed_range, abs=0.5)
    assert flexion == pytest.approx(rigid_range, abs=5)
    assert flexion - printed_range > 4  # their forearm's axis follows the skin of both segments
    assert volume[0] < found["volume_m3"] < volume[1]  # one movement only, repeated
    assert found["interval_m3"][0] <= found["volume_m3"] <= found["interval_m3"][1]


def flexion_ranges(file: Path) -> tuple[float, float]:
    """Return the range of flexion, °, from the other program's landmarks, and with a forearm that is rigid.

    The other program places both epicondyles by the upper arm's cluster, so that the elbow moves in the forearm. The
    rigid forearm has the elbow at its mean place between the forearm's markers.
    """
    recording = read(file)
    label = {name: recording.positions[:, recording.labels.index(name)] for name in recording.labels}
    axes = [label[name] for name in LEFT_FOREARM]
    elbow, wrist = (label["LEL"] + label["LEM"]) / 2, label["LUS"]
    found = []
    for place in (elbow, rigid_place(axes, elbow)):
        upper, lower = elbow - label["LGH"], wrist - place
        across = label["LEM"] - label["LEL"]
        across = across - (across * upper).sum(axis=1, keepdims=True) / (upper**2).sum(axis=1, keepdims=True) * upper
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        angle = np.arctan2((np.cross(upper, lower) * across).sum(axis=1), (upper * lower).sum(axis=1))
        values = np.sort(np.abs(np.degrees(angle[np.isfinite(angle)])))
        found.append(float(values[-5] - values[4]))
    return found[0], found[1]


def test_pointers_without_named_segments_are_reported(recordings: Path, tmp_path: Path) -> None:
    folder = recordings / "upper-limb" / "ulema"
    if not folder.is_dir():
        pytest.skip(f"no recordings of arms at {folder}")
    pointers = ", ".join(f"{landmark}: {folder}/cal{file}.c3d" for landmark, file in POINTERS.items())
    text = TRIAL.format(name="RF1", folder=folder, pointers=pointers)
    file = tmp_path / "RF1.yaml"
    file.write_text("".join(line for line in text.splitlines(keepends=True) if not line.startswith("segment:")))
    chain = Folder(run_to(load(file), "fit-joints").folder).tree("chain.h5")
    told = {reason.code: reason for reason in chain.reasons}
    assert told["pointers-unused"].value == len(POINTERS)
    assert "EL, EM" in told["pointers-unused"].message
    assert "segment: {names: [thorax, upper_arm, forearm, hand]}" in told["pointers-unused"].message


def test_exchanged_labels_in_a_recording_of_the_pointer_are_reported(recordings: Path, tmp_path: Path) -> None:
    file = write_trial(recordings, tmp_path, "RF1")
    original = recordings / "upper-limb" / "ulema" / "calLEL.c3d"
    exchanged = tmp_path / original.name
    parts = original.read_bytes().split(b"LUA1")
    exchanged.write_bytes(b"LUA3".join(part.replace(b"LUA3", b"LUA1") for part in parts))
    good = Folder(run_to(load(file), "fit-joints").folder).tree("chain.h5")
    file.write_text(file.read_text().replace(str(original), str(exchanged)))
    wrong = Folder(run_to(load(file), "fit-joints").folder).tree("chain.h5")
    assert "pointer-cluster" not in [reason.code for reason in good.reasons]
    told = [reason for reason in wrong.reasons if reason.code == "pointer-cluster"]
    assert len(told) == 1 and told[0].value > 0.004
    assert told[0].message.startswith("EL: in calLEL.c3d")


def rigid_place(axes: list[np.ndarray], point: np.ndarray) -> np.ndarray:
    """Return a point (F, 3) at its mean place in the frame of three markers (F, 3)."""
    x = axes[1] - axes[0]
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    z = np.cross(x, axes[2] - axes[0])
    z = z / np.linalg.norm(z, axis=1, keepdims=True)
    frame = np.stack([x, np.cross(z, x), z], axis=2)
    middle = np.mean(axes, axis=0)
    local = np.einsum("fji,fj->fi", frame, point - middle)
    return np.asarray(middle + np.einsum("fij,j->fi", frame, np.nanmean(local, axis=0)))


def _lines(file: Path) -> list[str]:
    """Return the lines of the angles in every frame; those after them are resampled."""
    return file.read_text(encoding="latin-1").splitlines()[1:29]


def test_no_angle_jumps_where_the_movement_outruns_a_filtered_export(recordings: Path, tmp_path: Path) -> None:
    """The export has a noise of 0.05 mm, and the gate around the prediction lost all markers of the hand."""
    outcome = run(load(write_trial(recordings, tmp_path, "RF1")))
    angles = pd.read_parquet(outcome.folder / "angles.parquet")
    names = [name for name in angles if name.startswith(("shoulder_", "elbow_", "wrist_"))]
    assert len(names) == 8
    for name in names:
        step = np.degrees(np.abs(np.diff(angles[name].to_numpy())))
        beside = np.maximum(step[:-2], step[2:])
        assert np.all(step[1:-1] < np.maximum(3 * beside, 0.2)), name
    markers = pd.read_parquet(outcome.folder / "markers.parquet")
    assert markers["used"][np.isfinite(markers["residual"])].mean() > 0.99


def test_markers_of_a_thorax_that_fail_together_are_reported(recordings: Path, tmp_path: Path) -> None:
    """From 4.64 s on, a marker of the thorax jumps by 3 mm, and the landmarks computed from it too."""
    folder = recordings / "upper-limb" / "ulema"
    if not folder.is_dir():
        pytest.skip(f"no recordings of arms at {folder}")
    configuration = tmp_path / "HTH1.yaml"
    configuration.write_text(f"trial: HTH1\nspace: 3d\nprotocol: reach\nside: left\nrecording: {folder}/HTH1.c3d\n")
    outcome = run(load(configuration))
    summary = json.loads((outcome.folder / "summary.json").read_text())
    (reason,) = (each for each in summary["verdict"]["reasons"] if each["code"] == "markers-rejected")
    assert "(thorax at 4.64–4.69 s)" in reason["message"]
    poses = pd.read_parquet(outcome.folder / "poses.parquet")
    there = poses["time"].between(4.635, 4.665)
    assert not poses["thorax_observed"][there].any()
    assert poses["thorax_observed"][~poses["time"].between(4.6, 4.72)].all()
    observed = [poses[name].mean() for name in poses if name.endswith("_observed")]
    facts = Folder(outcome.folder).table("states.parquet").facts
    assert facts["bridged_fraction"] == pytest.approx([1 - share for share in observed[1:]])


@pytest.mark.parametrize(("name", "limits"), [("S2M_punching", (4.2, 3.2)), ("OTTAWA_hopping", (3.4, 1.4))])
def test_fast_bones_are_followed(recordings: Path, tmp_path: Path, name: str, limits: tuple[float, float]) -> None:
    """The rotations of skin markers are compared with those of pins in the bones, relative to their mean difference."""
    folder = recordings / "bones" / name
    if not folder.is_dir():
        pytest.skip(f"no recordings of bones at {folder}")
    with np.load(folder / "truth.npz") as truth:
        owner, labels = truth["owner"].tolist(), truth["labels"].tolist()
        bones = list(dict.fromkeys(owner))
        true = {bone: truth[f"R_{bone}"] for bone in bones}
    together = [[label for label, own in zip(labels, owner, strict=True) if own == bone] for bone in bones]
    configuration = tmp_path / "trial.yaml"
    configuration.write_text(
        f"trial: {name}\nspace: 3d\nprotocol: free\nrecording: {folder}/trial.c3d\n"
        f"segment: {{count: 2, together: {together}}}\n"
    )
    outcome = run(load(configuration))
    poses, segments = (pd.read_parquet(outcome.folder / f"{table}.parquet") for table in ("poses", "segments"))
    names = [column.removesuffix("_qw") for column in poses if column.endswith("_qw")]
    up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    for bone, own, limit in zip(bones, together, limits, strict=True):
        segment = names[int(segments["segment"][segments["marker"] == own[0]].iloc[0])]
        found = Rotation.from_quat(poses[[f"{segment}_q{axis}" for axis in "xyzw"]].to_numpy())
        between = Rotation.from_matrix(up @ true[bone]).inv() * found
        off = np.degrees((between.mean().inv() * between).magnitude())
        assert np.sqrt(np.mean(off**2)) < limit, bone
        assert off.max() < 12, bone
