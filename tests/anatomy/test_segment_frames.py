"""From landmarks on clusters to ISB frames and a chain expressed in them."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.anatomy.frames import (
    FOREARM,
    PALPATION,
    THORAX,
    UPPER_ARM,
    ClusterPoses,
    build_frame,
    fit_segment_frames,
    frame_covariance,
    rotate_to_midline,
    set_middle_covariance,
)
from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint, change_frames

SEGMENT = {
    **dict.fromkeys(("thorax", "IJ", "PX", "C7", "T8"), 0),
    **dict.fromkeys(("upper_arm", "GH", "EL", "EM"), 1),
    **dict.fromkeys(("forearm", "RS", "US"), 2),
    "hand": 3,
}
STANDING = {
    "IJ": (0.0, 0.0, 0.0),
    "PX": (0.04, -0.17, 0.003),
    "C7": (-0.1, 0.05, 0.0),
    "T8": (-0.14, -0.17, -0.002),
    "GH": (-0.03, -0.02, 0.16),
    "EL": (0.0, -0.3, 0.22),
    "EM": (-0.01, -0.31, 0.15),
    "RS": (0.24, -0.28, 0.22),
    "US": (0.24, -0.33, 0.18),
}


@pytest.fixture
def still() -> ClusterPoses:
    rng = np.random.default_rng(4)
    return ClusterPoses(so3.exp(rng.normal(size=(4, 3))), rng.normal(size=(4, 3)))


@pytest.fixture
def places(still: ClusterPoses) -> dict[str, FloatArray]:
    return {
        name: still.rotations[SEGMENT[name]].T @ (np.array(at) - still.origins[SEGMENT[name]])
        for name, at in STANDING.items()
    }


def test_frames_and_their_covariance_are_those_of_the_still_pose(
    still: ClusterPoses, places: dict[str, FloatArray]
) -> None:
    found = fit_segment_frames(places, SEGMENT, still)
    standing = {name: np.array(at) for name, at in STANDING.items()}
    direct = {"upper_arm": UPPER_ARM, "forearm": FOREARM, "hand": FOREARM}
    for name, definition in direct.items():
        k, expected = SEGMENT[name], build_frame(definition, standing)
        assert np.allclose(still.rotations[k] @ found.frames[name].rotation, expected.rotation)
    pair = frame_covariance((build_frame(UPPER_ARM, standing), build_frame(FOREARM, standing)))
    assert np.allclose(found.covariance("upper_arm", "forearm"), pair)
    assert [reason.code for reason in found.reasons] == ["wrist-at-rest"]


MIDLINE = {name: np.array(STANDING[name]) * (1, 1, 0) for name in THORAX.up}


def test_the_thorax_of_landmarks_in_one_plane_is_that_of_the_isb() -> None:
    turn = so3.exp(np.array([0.3, -0.5, 0.2]))
    places = {name: turn @ at for name, at in MIDLINE.items()}
    expected = build_frame(THORAX, places)
    assert np.allclose(rotate_to_midline(expected, places).rotation, expected.rotation)


def test_four_landmarks_halve_the_error_of_the_thorax_about_its_long_axis() -> None:
    exact = build_frame(THORAX, MIDLINE)
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(1000):
        palpated = {name: at + rng.normal(0, 6e-3, 3) for name, at in MIDLINE.items()}
        isb = build_frame(THORAX, palpated)
        errors.append([so3.log(exact.rotation.T @ each.rotation) for each in (isb, rotate_to_midline(isb, palpated))])
    of_isb, of_four = np.sqrt(np.mean(np.square(errors), axis=0))
    assert of_four[1] < 0.6 * of_isb[1]
    assert of_four[0] < of_isb[0]
    assert of_four[2] == pytest.approx(of_isb[2], rel=0.02)
    stated = frame_covariance((rotate_to_midline(exact, MIDLINE),), dict.fromkeys(MIDLINE, 6e-3))
    assert np.sqrt(np.diag(stated)) == pytest.approx(of_four, rel=0.07)


def test_the_thorax_turns_with_its_landmarks_as_its_sensitivity_says() -> None:
    frame = rotate_to_midline(build_frame(THORAX, MIDLINE), MIDLINE)
    for name, part in frame.sensitivity.items():
        for axis in np.eye(3):
            moved = MIDLINE | {name: MIDLINE[name] + 1e-6 * axis}
            other = rotate_to_midline(build_frame(THORAX, moved), moved)
            assert np.allclose(so3.log(frame.rotation.T @ other.rotation) / 1e-6, part @ axis, atol=1e-4)


def test_option_two_takes_the_bent_pose_and_falls_back_with_a_word(
    still: ClusterPoses, places: dict[str, FloatArray]
) -> None:
    first = fit_segment_frames(places, SEGMENT, still).frames["upper_arm"].rotation
    second = fit_segment_frames(places, SEGMENT, still, bent=still)
    angle = np.linalg.norm(so3.log(first.T @ second.frames["upper_arm"].rotation))
    assert 0 < np.degrees(angle) < 40
    turned = still.rotations.copy()
    elbow = (np.array(STANDING["EL"]) + STANDING["EM"]) / 2
    turn = so3.exp(np.array([0.0, 0.0, -1.3]))
    turned[2] = turn @ still.rotations[2]
    origins = still.origins.copy()
    origins[2] = elbow + turn @ (still.origins[2] - elbow)
    stretched = fit_segment_frames(places, SEGMENT, still, bent=ClusterPoses(turned, origins))
    assert "elbow-not-bent" in [reason.code for reason in stretched.reasons]
    assert np.allclose(stretched.frames["upper_arm"].rotation, first)


def test_a_missing_landmark_leaves_its_frame_out_with_a_word(
    still: ClusterPoses, places: dict[str, FloatArray]
) -> None:
    found = fit_segment_frames({k: v for k, v in places.items() if k != "T8"}, SEGMENT, still)
    assert set(found.frames) == {"upper_arm", "forearm", "hand"}
    assert any(r.code == "no-isb-frame" and "thorax" in r.message and "T8" in r.message for r in found.reasons)


def test_an_expressed_chain_places_every_marker_where_it_was() -> None:
    rng = np.random.default_rng(8)
    joints = tuple(
        SpatialJoint(
            kind, k, rng.normal(size=3), np.diag(rng.uniform(1, 2, 3)),
            first_axis=so3.exp(rng.normal(size=3))[0], second_axis=so3.exp(rng.normal(size=3))[1],
            axes_covariance=np.stack([np.diag(rng.uniform(1, 2, 3))] * 2), offset=so3.exp(rng.normal(size=3)),
            glide=rng.normal(size=3) if k == 0 else np.zeros(3),
        )
        for k, kind in enumerate(("ball", "two-axis", "hinge"))
    )  # fmt: skip
    segment = np.array([0, 0, 1, 2, 3])
    chain = SpatialChain(joints, segment, rng.normal(size=(5, 3)), np.zeros(5, dtype=bool))
    frames, base = so3.exp(rng.normal(size=(4, 3))), rng.normal(size=3)
    new = change_frames(chain, frames, base)
    q = [rng.normal(size=(6, joint.dimension)) for joint in joints]
    origin, rotation = rng.normal(size=(6, 3)), so3.exp(rng.normal(size=(6, 3)))

    def markers(each: SpatialChain, at: FloatArray, turn: FloatArray, moved: FloatArray) -> FloatArray:
        origins, rotations = each.place(at, turn, moved)
        return origins[:, segment] + np.einsum("fmij,mj->fmi", rotations[:, segment], each.local)

    old_turns = np.stack([joint.rotation(each) for joint, each in zip(joints, q, strict=True)], axis=1)
    new_turns = old_turns.copy()
    for k in range(3):
        new_turns[:, k] = frames[k].T @ old_turns[:, k] @ frames[k + 1]
        if joints[k].kind != "ball":
            assert np.allclose(new.joints[k].rotation(q[k]), new_turns[:, k])
    before = markers(chain, origin, rotation, old_turns)
    after = markers(new, origin + np.einsum("fij,j->fi", rotation, base), rotation @ frames[0], new_turns)
    assert np.allclose(before, after)


def test_a_known_middle_counts_by_its_own_covariance(still: ClusterPoses, places: dict[str, FloatArray]) -> None:
    found = fit_segment_frames(places, SEGMENT, still)
    same = set_middle_covariance(found, ("EL", "EM"), PALPATION**2 / 2 * np.eye(3))
    assert np.allclose(same.covariance("upper_arm", "forearm"), found.covariance("upper_arm", "forearm"))
    sure = set_middle_covariance(found, ("EL", "EM"), np.zeros((3, 3)))
    before, after = (np.diag(each.covariance("upper_arm", "forearm")) for each in (found, sure))
    assert after[2] < 0.7 * before[2]  # the long axis of the upper arm
    assert after[1] > 0.9 * before[1]  # the line of the epicondyles is as unsure as before
