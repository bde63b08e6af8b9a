"""Chains with single-marker segments, as conventional marker sets have them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mocap_id.kinematics.bundle import chain_angles, fit_chain, frames_along_motion
from mocap_id.kinematics.chain_fit import ChainState
from mocap_id.kinematics.link_fit import SegmentationRules, group_points
from mocap_id.kinematics.segmentation import Segmentation, segment_markers
from mocap_id_simulation import Options, generate

RULES = SegmentationRules(longest=5)
SHORT = Options(repetitions=2, analog_rate=100)


def conventional(options: Options) -> SimpleNamespace:
    """Return the frames of a simulated trial in its true plane, and its true lengths."""
    trial = generate("sit-to-stand", options)
    points = trial.scene.plane.to_plane(trial.points)
    points = points[frames_along_motion(points[..., 0] + 1j * points[..., 1], 400)]
    return SimpleNamespace(
        plane=points[..., 0] + 1j * points[..., 1],
        lateral=np.nanmean(points[..., 2], axis=0),
        labels=trial.labels,
        link=trial.scene.markers.link,
        lengths=np.array([trial.scene.body.links[k].length for k in (1, 2)]),
    )


def found_in(trial: SimpleNamespace) -> Segmentation:
    return segment_markers(trial.plane, trial.lateral, RULES)


def wrong_markers(trial: SimpleNamespace, found: Segmentation) -> list[str]:
    """Return the markers on a wrong segment; ankle and knee markers may be on either side of their joint."""
    at_joint = {"ANK": (0, 1), "KNE": (1, 2)}
    return [
        label
        for label, segment, link in zip(trial.labels, found.segment, trial.link, strict=True)
        if segment not in at_joint.get(label[1:], (link,))
    ]


@pytest.mark.parametrize("seed", [41, 42, 43])
@pytest.mark.parametrize(
    "options",
    [
        replace(SHORT, marker_set="plug-in-gait"),
        replace(SHORT, marker_set="plug-in-gait-without-wands"),
        replace(SHORT, marker_set="plug-in-gait", without="R*"),
        replace(SHORT, marker_set="plug-in-gait-without-wands", knee_on_shank=True),
        replace(SHORT, marker_set="joints"),
    ],
    ids=["wands", "no wands", "left side", "knee on the shank", "joints"],
)
def test_conventional_sets_give_the_chain(options: Options, seed: int) -> None:
    trial = conventional(replace(options, seed=seed))
    found = found_in(trial)
    assert found.count == 4
    assert wrong_markers(trial, found) == []
    if found.links is not None:
        np.testing.assert_allclose(np.abs(found.links.state.centres[1:]), trial.lengths, rtol=0.05)


def test_without_a_knee_marker_the_chain_is_doubted() -> None:
    for seed in (51, 52, 53):
        assert (
            found_in(conventional(replace(SHORT, seed=seed, marker_set="plug-in-gait", without="KNE"))).confidence.value
            < 0.5
        )


def test_markers_at_the_joints_are_recognised() -> None:
    trial = conventional(replace(SHORT, seed=61, marker_set="joints"))
    links = found_in(trial).links
    assert links is not None
    named = {joint: {trial.labels[marker] for marker in unit} for joint, unit in links.pins.items()}
    assert named == {0: {"LANK", "RANK"}, 1: {"LKNE", "RKNE"}}
    assert links.loose == ()


def test_a_still_heel_is_no_ankle() -> None:
    trial = conventional(replace(SHORT, seed=62, marker_set="plug-in-gait", without="ANK"))
    links = found_in(trial).links
    assert links is None or 0 not in links.pins


def test_left_and_right_markers_at_one_place_are_one_point() -> None:
    place = np.exp(1j * np.linspace(0, 1, 50))
    points = np.stack([place, place + 0.01, place + 0.2, place + 0.005], axis=1)
    lateral = np.array([0.1, -0.1, 0.1, 0.12])  # the last one is on the same side as the first
    units = [unit.tolist() for unit in group_points(points, lateral, np.arange(4))]
    assert units == [[0, 1], [2], [3]]


def test_angles_of_a_known_chain_follow_from_joint_markers(chain) -> None:
    truth = chain(5)
    angle = np.cumsum(truth.relative, axis=1)
    turn = np.exp(1j * angle)
    second = truth.centres[0] + turn[:, 0] * truth.centres[1]
    local = np.zeros(len(truth.segment), dtype=np.complex128)
    tip = truth.segment == 3
    third = second + turn[:, 1] * truth.centres[2]
    local[tip] = (np.conj(turn[:, 2:]) * (truth.points[:, tip] - third[:, None])).mean(axis=0)
    kept = np.flatnonzero((truth.segment == 0) | tip)
    angles = chain_angles(truth.points[:, kept], truth.segment[kept], truth.centres, local[kept], {2: second})
    np.testing.assert_allclose(np.exp(1j * angles), turn, atol=1e-9)


def test_a_displaced_joint_marker_moves_the_joints_as_its_covariance_says() -> None:
    trial = conventional(replace(SHORT, seed=71, marker_set="joints"))
    found = found_in(trial)
    assert found.links is not None
    assigned = np.flatnonzero(found.segment >= 0)
    points, segment = trial.plane[:, assigned], found.segment[assigned]
    pins = {joint + 1: trial.plane[:, unit].mean(axis=1) for joint, unit in found.links.pins.items()}
    state = found.links.state
    start = ChainState(
        state.centres,
        state.local[assigned],
        chain_angles(points, segment, state.centres, state.local[assigned], pins),
    )
    rest = fit_chain(points, segment, pins, 0.01, start)
    shift = np.zeros(2)
    for offset in (0.01, 0.01j):
        moved = fit_chain(
            points, segment, {joint: track + offset * (joint == 1) for joint, track in pins.items()}, 0.01, start
        )
        off = moved.centres[0] - rest.centres[0]
        shift += [off.real**2, off.imag**2]
    stated = np.diag(rest.covariance[0])
    assert (stated > 0.5 * shift).all()
    assert (stated < 4 * shift + 1e-4).all()
