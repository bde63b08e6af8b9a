"""poses.parquet of the stage: the pose of every body in its segment's frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated_chains import Moving, planar_table, swinging

from mocap_id.arrays import FloatArray
from mocap_id.geometry import planar
from mocap_id.stages.base import Context
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.stages.ukf_smooth import STAGE
from mocap_id.store import Table, Tree, provenance
from mocap_id.store.parquet import conform_table
from mocap_id.store.provenance import CHAIN

SEGMENTS = ["foot", "shank", "thigh", "pelvis", "trunk"]
RATE, NOISE = 100.0, 3e-4
FOOT = np.array([[-0.2, 0.02], [0.05, 0.06], [-0.05, 0.1]])
ARM = np.array([[0.0, 0.1], [0.02, -0.15], [-0.03, 0.0]])
FRAMES = np.arange(400)


@pytest.fixture(scope="module")
def moving() -> Moving:
    return swinging(joints=4, seconds=len(FRAMES) / RATE, rate=RATE, noise=NOISE, seed=2)


def arm_pose() -> tuple[FloatArray, FloatArray]:
    """Return place (F, 2) and angle (F,) of the body with the markers of no segment."""
    time = FRAMES / RATE
    return np.column_stack([0.3 * np.sin(time), 1.2 + 0.1 * np.cos(2 * time)]), 0.8 * np.sin(3 * time)


def names(moving: Moving, loose: int) -> list[str]:
    of_chain = [f"M{i}" for i in range(len(moving.segment))]
    return of_chain + [f"FOOT{i}" for i in range(len(FOOT))] + [f"ARM{i}" for i in range(loose)]


def run(
    moving: Moving, markers: FloatArray | None = None, *, loose: int = 3, segments: list[str] = SEGMENTS
) -> tuple[Table, Table]:
    """Return states and poses of the stage; chain and table have different marker orders."""
    markers = moving.markers if markers is None else markers
    place, angle = arm_pose()
    noise = NOISE * np.random.default_rng(8).normal(size=(len(FRAMES), 6, 2))
    foot = np.broadcast_to(FOOT, (len(FRAMES), 3, 2)) + noise[:, :3]
    arm = place[:, None] + planar.rotate(angle[:, None], ARM) + noise[:, 3:]
    points, labels = np.concatenate([markers, foot, arm[:, :loose]], axis=1), names(moving, loose)
    segment, local = np.concatenate([moving.segment, [0, 0, 0]]), np.concatenate([moving.local, FOOT])
    order = np.random.default_rng(0).permutation(len(segment))
    chain = {
        "joints": {
            "name": np.array(["ankle", "knee", "hip", "waist"], dtype=object),
            "centre": moving.centres,
            "covariance": np.tile(1e-6 * np.eye(2), (4, 1, 1)),
        },
        "segments": {"name": np.array(segments, dtype=object)},
        "markers": {
            "name": np.array(labels[: len(segment)], dtype=object)[order],
            "segment": segment[order],
            "local": local[order],
            "residual": np.full(len(segment), 1e-3),
        },
    }
    table = planar_table(FRAMES, FRAMES / RATE, labels, points, RATE)
    inputs = {
        "planar.parquet": table,
        "chain.h5": Tree(CHAIN, chain),
        "segments.parquet": Table(provenance.SEGMENTS, {}, {}),
    }
    trial = TrialKeys(trial="swing", recording=Files(markers=Path("swing.c3d")))
    outputs = STAGE.function(Context(trial, STAGE.settings(), inputs))
    states, poses = outputs[0], outputs[4]
    assert isinstance(states, Table) and isinstance(poses, Table)
    conform_table(poses)
    return states, poses


def pose(poses: Table, body: int) -> tuple[FloatArray, FloatArray]:
    """Return the place of the centroid (F, 2) and the angle (F,) of a body, from 0."""
    frame = poses.frame
    return frame[[f"x_{body + 1}", f"y_{body + 1}"]].to_numpy(), frame[f"angle_{body + 1}"].to_numpy()


def middle(body: dict[str, Any]) -> FloatArray:
    return np.mean(list(body["markers"].values()), axis=0)


def test_every_segment_the_torso_and_the_others_have_their_own_pose(moving: Moving) -> None:
    states, poses = run(moving)
    bodies = poses.facts["bodies"]
    assert [body["name"] for body in bodies] == [*SEGMENTS, "torso", "others"]
    assert [body["segments"] for body in bodies] == [[0], [1], [2], [3], [4], [3, 4], []]
    angle, origin = planar.segment_poses(moving.truth[..., 0], moving.centres)
    np.testing.assert_array_equal(poses.frame["time"], states.frame["time"])
    for k in range(5):
        place, turned = pose(poses, k)
        labels = {label for label, own in zip(names(moving, 0), [*moving.segment, 0, 0, 0], strict=True) if own == k}
        assert set(bodies[k]["markers"]) == labels
        expected = origin[:, k] + planar.rotate(angle[:, k], middle(bodies[k]))
        # four markers, and the frame itself is as good as the mean over all frames
        assert np.sqrt(np.mean((place - expected) ** 2)) == pytest.approx(NOISE / np.sqrt(len(labels)), rel=0.15)
        whole = np.round(np.mean(turned - angle[:, k]) / (2 * np.pi))
        assert np.abs(turned - 2 * np.pi * whole - angle[:, k]).max() < 0.02
        assert (poses.frame[f"markers_{k + 1}"] == len(labels)).all()
        assert 0.5 * NOISE < bodies[k]["residual_m"] < 1.5 * NOISE


def test_coordinates_on_a_body_are_those_on_its_segment(moving: Moving) -> None:
    bodies = run(moving)[1].facts["bodies"]
    local = dict(zip(names(moving, 0), np.concatenate([moving.local, FOOT]), strict=True))
    for body in bodies[:5]:
        for label, place in body["markers"].items():
            np.testing.assert_allclose(place, local[label], atol=3 * NOISE)


def test_the_torso_is_pelvis_and_trunk_in_the_pelvis_s_frame(moving: Moving) -> None:
    """With a stiff waist the two are one body."""
    angles = moving.truth[..., 0].copy()
    angles[:, 3] = 0.3
    exact = planar.marker_positions(angles, moving.centres, moving.segment, moving.local)
    poses = run(moving, exact + NOISE * np.random.default_rng(4).normal(size=exact.shape))[1]
    torso, (place, turned) = poses.facts["bodies"][5], pose(poses, 5)
    angle, origin = planar.segment_poses(angles, moving.centres)
    local = dict(zip(names(moving, 0), moving.local, strict=False))
    assert len(torso["markers"]) == 8
    for label, found in torso["markers"].items():
        on_trunk = moving.segment[int(label[1:])] == 4
        at = moving.centres[3] + planar.rotate(np.array(0.3), local[label]) if on_trunk else local[label]
        np.testing.assert_allclose(found, at, atol=2e-3)
    back = place - planar.rotate(turned, middle(torso))
    assert np.sqrt(np.mean((back - origin[:, 3]) ** 2)) < 1.5e-3
    whole = np.round(np.mean(turned - angle[:, 3]) / (2 * np.pi))
    np.testing.assert_allclose(turned - 2 * np.pi * whole, angle[:, 3], atol=0.01)
    assert torso["residual_m"] == pytest.approx(NOISE * np.sqrt(2), rel=0.2)


def test_other_markers_have_their_own_frame(moving: Moving) -> None:
    """Its origin is their centroid, and it is parallel to the plane on average."""
    poses = run(moving)[1]
    place, turned = pose(poses, 6)
    truth, angle = arm_pose()
    np.testing.assert_allclose(place, truth + planar.rotate(angle, ARM.mean(axis=0)), atol=5 * NOISE)
    np.testing.assert_allclose(turned - turned.mean(), angle - angle.mean(), atol=0.02)
    assert np.angle(np.mean(np.exp(1j * turned))) == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(middle(poses.facts["bodies"][6]), 0.0, atol=1e-9)


def test_a_joint_that_gives_way_shows_between_the_poses(moving: Moving) -> None:
    """Thigh and everything beyond move off the knee by a known function: only the poses show it."""
    gap = 0.01 * np.sin(2 * np.pi * 0.7 * FRAMES / RATE)
    markers = moving.markers.copy()
    markers[:, moving.segment >= 2, 0] += gap[:, None]
    poses = run(moving, markers)[1]
    bodies = poses.facts["bodies"]
    (shank, tilt), (thigh, turned) = pose(poses, 1), pose(poses, 2)
    knee = shank + planar.rotate(tilt, moving.centres[1] - middle(bodies[1]))
    origin = thigh - planar.rotate(turned, middle(bodies[2]))
    found = origin - knee
    assert np.sqrt(np.mean((found - [1, 0] * gap[:, None]) ** 2)) < 2e-3
    assert np.corrcoef(found[:, 0], gap)[0, 1] > 0.98


def test_a_body_without_enough_markers_has_no_columns(moving: Moving) -> None:
    few = moving.markers.copy()
    few[:, np.flatnonzero(moving.segment == 1)[1:]] = np.nan
    poses = run(moving, few, loose=1)[1]
    bodies = poses.facts["bodies"]
    assert [body["name"] for body in bodies] == ["foot", "thigh", "pelvis", "trunk", "torso"]
    assert [name for name in poses.frame if name.startswith("angle")] == [f"angle_{k}" for k in range(1, 6)]


def test_without_pelvis_and_trunk_there_is_no_torso(moving: Moving) -> None:
    other = ["base", "link 1", "link 2", "link 3", "link 4"]
    assert [body["name"] for body in run(moving, loose=0, segments=other)[1].facts["bodies"]] == other


def test_frames_with_one_marker_have_no_pose(moving: Moving) -> None:
    gone, own = moving.markers.copy(), np.flatnonzero(moving.segment == 2)
    gone[100:120, own[1:]] = np.nan
    gone[200:220, own[2:]] = np.nan
    frame = run(moving, gone)[1].frame
    assert frame.loc[100:119, ["x_3", "y_3", "angle_3"]].isna().all().all()
    np.testing.assert_array_equal(frame.loc[100:119, "markers_3"], 1)
    assert frame.loc[200:219, "angle_3"].notna().all()
    np.testing.assert_array_equal(frame.loc[200:219, "markers_3"], 2)
    assert frame["angle_2"].notna().all()
