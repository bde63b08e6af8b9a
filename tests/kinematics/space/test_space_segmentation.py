"""Segments of a chain in space, without names or templates."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import Refused
from mocap_id.geometry import so3
from mocap_id.kinematics.clusters import Constraints
from mocap_id.kinematics.link_fit import SegmentationRules
from mocap_id.kinematics.space.segmentation import SpatialSegmentation, segment_in_space
from mocap_id_simulation import SimulatedSpaceTrial, simulate_arm, simulate_chain

UNSURE = 0.5


@cache
def reach(seed: int = 3, side: str = "right") -> SimulatedSpaceTrial:
    return simulate_arm(seed, side=side)


@cache
def found_reach() -> SpatialSegmentation:
    return segment_in_space(reach().positions)


def counted(trial: SimulatedSpaceTrial) -> BoolArray:
    """Return the markers with a true segment: the one on the shoulder girdle has none."""
    return np.array([name != "AC" for name in trial.names])


def assert_right(found: SpatialSegmentation, trial: SimulatedSpaceTrial, count: int) -> None:
    here = counted(trial)
    assert found.count == count
    np.testing.assert_array_equal(found.segment[here], trial.assignment[here])


@pytest.mark.parametrize("side", ["right", "left"])
def test_an_arm_on_a_swaying_thorax_has_four_segments(side: str) -> None:
    trial = reach(3, side)
    found = segment_in_space(trial.positions)
    assert_right(found, trial, 4)
    assert found.segment[list(trial.names).index("AC")] == 0
    assert found.confidence.value > 0.8
    assert np.isfinite(found.residual).all()
    assert found.residual.max() < 0.015


def test_the_order_of_the_markers_and_the_axes_of_the_lab_do_not_matter() -> None:
    trial = reach()
    order = np.random.default_rng(0).permutation(len(trial.names))
    turn = so3.exp(np.array([0.3, 1.2, -0.7]))
    found = segment_in_space(trial.positions[:, order] @ turn.T + np.array([1.0, 2.0, -3.0]))
    np.testing.assert_array_equal(found.segment, found_reach().segment[order])
    np.testing.assert_allclose(found.residual, found_reach().residual[order], atol=2e-4)
    assert found.planarity == pytest.approx(found_reach().planarity, abs=0.02)


def test_three_markers_a_segment_are_enough() -> None:
    trial = reach()
    names = ["IJ", "C7", "T8", "UPA2", "EL", "EM", "FOR2", "US", "RS", "HND1", "HND2", "HND3"]
    few = [trial.names.index(name) for name in names]
    found = segment_in_space(trial.positions[:, few])
    assert found.count == 4
    np.testing.assert_array_equal(found.segment, trial.assignment[few])


@pytest.mark.parametrize(("kinds", "arc", "sway"), [("SS", 40, 0), ("SH", 15, 0), ("STH", 40, 20)])
def test_chains_of_balls_hinges_and_two_axis_joints(kinds: str, arc: float, sway: float) -> None:
    trial = simulate_chain(5, kinds=kinds, arc_deg=arc, sway_mm=sway)
    found = segment_in_space(trial.positions)
    assert_right(found, trial, len(kinds) + 1)
    assert found.moving_base == (sway > 15)
    assert min(joint.arc for joint in found.joints) > np.radians(arc) / 2
    assert max(joint.residual for joint in found.joints) < 0.006


@pytest.mark.parametrize("seed", [709, 260022])
def test_skin_that_slides_is_not_divided_in_place_of_the_hand(seed: int) -> None:
    trial = simulate_arm(seed, "hard", cycles=1, severity=0.5, anonymous=True)
    assert_right(segment_in_space(trial.positions), trial, 4)


def test_the_other_arm_and_the_head_are_branches() -> None:
    trial, other = reach(), reach(4)
    beside = other.assignment > 0
    relative = (
        np.swapaxes(other.rotations[:, 0], 1, 2)[:, None]
        @ (other.positions[:, beside] - other.origins[:, None, 0])[..., None]
    )
    frames = min(len(trial.time), len(other.time))
    mirrored = 0.6 * np.eye(3)  # the other arm is smaller
    mirrored[2, 2] *= -1
    thorax, place = trial.rotations[:frames, 0], trial.origins[:frames, 0]
    left = place[:, None] + (thorax[:, None] @ (mirrored @ relative[:frames]))[..., 0]
    nod = so3.exp(np.radians(15) * np.sin(np.linspace(0, 20, frames))[:, None] * np.array([[0.0, 0, 1]]))
    skull = np.array([[0.1, 0.2, 0], [-0.1, 0.2, 0.05], [0, 0.25, -0.08], [0.05, 0.12, 0.08]])
    head = place[:, None] + np.einsum("fij,kj->fki", thorax @ nod, skull)
    points = np.concatenate([trial.positions[:frames], left, head], axis=1)
    found = segment_in_space(points)
    kept, here = len(trial.names), counted(trial)
    np.testing.assert_array_equal(found.segment[:kept][here], trial.assignment[here])
    assert (found.segment[kept:] == -1).all()
    assert found.count == 4
    assert all("branch" in reason for reason in found.reasons[kept:])


def test_curls_that_do_not_show_all_joints_say_so() -> None:
    trial = simulate_arm(7, movement="curl")
    found = segment_in_space(trial.positions)
    here = counted(trial)
    right = found.count == 4 and bool((found.segment[here] == trial.assignment[here]).all())
    assert right or found.confidence.value < UNSURE
    assert found.planarity < 0.1 < found_reach().planarity


def test_an_object_that_moves_alone_is_on_no_segment() -> None:
    trial = reach()
    t = trial.time[:, None]
    ball = np.concatenate([0.4 * np.sin(t), 1 + 0.3 * np.cos(1.7 * t), 1 + 0.2 * np.sin(2.3 * t)], axis=1)
    found = segment_in_space(np.concatenate([trial.positions, ball[:, None]], axis=1))
    np.testing.assert_array_equal(found.segment[:-1], found_reach().segment)
    assert found.segment[-1] == -1
    assert "fewer than three markers" in found.reasons[-1]


def test_long_gaps_a_straight_cluster_and_a_marker_that_is_never_seen_do_no_harm() -> None:
    trial = simulate_chain(5, kinds="SS")
    points = trial.positions.copy()
    middle = points[:, [4, 5]].mean(axis=1)  # with both, three markers on a line
    points = np.concatenate([points, middle[:, None], np.full_like(middle, np.nan)[:, None]], axis=1)
    points[:900, 2] = np.nan
    points[1100:, 9] = np.nan
    found = segment_in_space(points)
    np.testing.assert_array_equal(found.segment, [*trial.assignment, 1, -1])


def test_hints_are_honoured() -> None:
    trial = reach()
    names = list(trial.names)
    constraints = Constraints.of(len(names), together=[[names.index("US"), names.index("RS"), names.index("HND1")]])
    found = segment_in_space(trial.positions, constraints=constraints)
    assert len({int(found.segment[names.index(name)]) for name in ("US", "RS", "HND1")}) == 1
    fewer = segment_in_space(trial.positions, SegmentationRules(count=3))
    assert fewer.count == 3
    ignored = trial.positions.copy()
    ignored[:, names.index("UPA1")] = np.nan
    without = segment_in_space(ignored)
    assert without.segment[names.index("UPA1")] == -1
    assert without.reasons[names.index("UPA1")] == "visible in too few frames"


@pytest.mark.parametrize(
    ("points", "code"),
    [
        (np.tile(np.random.default_rng(0).uniform(0, 1, (1, 8, 3)), (50, 1, 1)), "no-motion"),
        (np.random.default_rng(0).uniform(0, 1, (50, 5, 3)), "no-chain"),
        (np.random.default_rng(0).uniform(0, 1, (50, 8, 3)), "no-chain"),
    ],
)
def test_no_motion_or_no_chain_is_refused_with_what_to_do(points: FloatArray, code: str) -> None:
    with pytest.raises(Refused) as refusal:
        segment_in_space(points)
    assert refusal.value.code == code
    assert "Record" in refusal.value.message or "Add markers" in refusal.value.message


def test_an_impossible_count_is_refused() -> None:
    with pytest.raises(Refused, match="count: 9"):
        segment_in_space(simulate_chain(5, kinds="SS").positions, SegmentationRules(count=9, longest=9))
