"""From bodies to the chain: exact where the bodies are the chain's, the sum kept where a body is two segments."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, random_chain
from pose_cases import BODIES, CENTROID, INFORMATION, SHOULDER, moving, poses_of, slow

from mocap_id.dynamics.measured_motion import (
    BodyPoses,
    map_to_chain,
    measure_relative_pose,
    merge_segments,
    propagate_centres,
    propagate_to_base,
)
from mocap_id.dynamics.priors import average_transform, compute_reference_sd
from mocap_id.dynamics.regressor import move_chain, structural_base
from mocap_id.geometry import planar

TIME = np.arange(600) / 100
EVERYTHING = np.ones(len(TIME), dtype=bool)
NOTHING = np.full(16, np.nan)
BASE = structural_base(CENTRES)
FIVE = np.vstack([CENTRES, [0.01, 0.15]])
"""Ankle, knee, hip and a joint between pelvis and trunk."""
PEOPLE = np.vstack([BODY[:3], [11.0, -0.1, 0.9, 0.2], [44.0, -0.5, 9.0, 3.9]])


def test_an_arm_that_does_not_move_is_a_part_of_the_torso() -> None:
    """The chain's base parameters then are those of the very bodies, to rounding."""
    motion = moving(TIME, size=0.0, swing=0.0)
    q = slow(TIME)[0][:, :3]
    found = map_to_chain(poses_of(TIME, motion), q, EVERYTHING, NOTHING, NOTHING)
    base = BASE.regrouping @ found.apply(BODIES.ravel())
    torso = BODIES[3] + average_transform(np.zeros(1), SHOULDER[None]) @ BODIES[4]
    truth = BASE.regrouping @ np.concatenate([BODIES[:3].ravel(), torso])
    np.testing.assert_allclose(base, truth, rtol=0, atol=1e-10)
    assert (found.open == 0.0).all()
    assert (found.constant == 0.0).all()


def test_a_chain_of_its_own_bodies_is_itself() -> None:
    motion = move_chain(CENTRES, *(values[:, :3] for values in slow(TIME)))
    poses = BodyPoses(
        TIME,
        motion.origin + planar.rotate(motion.angle, CENTROID[:4]),
        motion.angle,
        CENTROID[:4],
        INFORMATION[:4],
        np.arange(4),
        CENTRES,
    )
    found = map_to_chain(poses, slow(TIME)[0][:, :3], EVERYTHING, NOTHING, NOTHING)
    np.testing.assert_array_equal(found.matrix, np.eye(16))


def test_an_arm_that_swings_counts_where_it_is_on_average_over_these_samples() -> None:
    motion, some = moving(TIME), TIME > 2.5
    poses = poses_of(TIME, motion)
    poses.angle[400:420, 4] = np.nan  # unknown there
    found = map_to_chain(poses, slow(TIME)[0][:, :3], some, NOTHING, NOTHING)
    moments = []
    mass, mx, my, inertia = BODIES[4]
    for k in np.flatnonzero(some & np.isfinite(poses.angle[:, 4])):
        turn = motion.angle[k, 4] - motion.angle[k, 3]
        shift = planar.rotate(-motion.angle[k, 3], motion.origin[k, 4] - motion.origin[k, 3])
        first = planar.rotate(turn, np.array([mx, my]))
        moments.append([mass, *(mass * shift + first), inertia + 2 * shift @ first + mass * shift @ shift])
    expected = np.concatenate([BODIES[:3].ravel(), BODIES[3] + np.mean(moments, axis=0)])
    np.testing.assert_allclose(found.matrix @ BODIES.ravel() + found.constant, expected, atol=1e-10)


def torso_as_one() -> tuple[BodyPoses, np.ndarray, np.ndarray]:
    """Poses of foot, shank, thigh, torso (pelvis and trunk together), the angles, and the true four bodies."""
    states = slow(TIME)
    motion = move_chain(FIVE, *states)
    kept = [0, 1, 2, 3]
    poses = BodyPoses(
        TIME,
        (motion.origin + planar.rotate(motion.angle, CENTROID))[:, kept],
        motion.angle[:, kept],
        CENTROID[:4],
        INFORMATION[:4],
        np.array([0, 1, 2, 3, 3]),
        FIVE,
    )
    both = merge_segments(FIVE, states[0], EVERYTHING, np.array([3, 4])) @ PEOPLE[3:].ravel()
    return poses, states[0], np.concatenate([PEOPLE[:3].ravel(), both])


def test_gathering_is_moving_each_segment_into_the_first_one_s_frame() -> None:
    q = slow(TIME)[0]
    some = np.arange(len(TIME)) == 123
    three = merge_segments(FIVE, q, some, np.array([2, 3, 4]))
    angle, origin = planar.segment_poses(q[123], FIVE)
    expected = sum(
        average_transform(
            np.array([angle[k] - angle[2]]), planar.rotate(np.array(-angle[2]), origin[k] - origin[2])[None]
        )
        @ PEOPLE[k]
        for k in (2, 3, 4)
    )
    np.testing.assert_allclose(three @ PEOPLE[2:].ravel(), expected, atol=1e-12)


@pytest.mark.parametrize("scale", [1.0, 1.3])
def test_a_body_of_two_segments_is_shared_and_its_sum_kept(scale: float) -> None:
    """As the table would; where the body is the table's, it is the table's."""
    poses, q, bodies = torso_as_one()
    table = (PEOPLE * [[1.0], [1.0], [1.0], [scale], [1 / scale]]).ravel()
    found = map_to_chain(poses, q, EVERYTHING, table, compute_reference_sd(table, 0.15))
    chain = found.matrix @ bodies + found.constant
    np.testing.assert_allclose(chain[:12], bodies[:12], atol=1e-12)
    total = merge_segments(FIVE, q, EVERYTHING, np.array([3, 4]))
    np.testing.assert_allclose(total @ chain[12:], bodies[12:], atol=1e-9)
    if scale == 1.0:
        np.testing.assert_allclose(chain, PEOPLE.ravel(), atol=1e-9)


def test_how_a_body_is_shared_stays_as_uncertain_as_the_table() -> None:
    """Open is what the table's spread leaves where the sum is given: nothing along the sum, the rest as conditioned."""
    poses, q, _ = torso_as_one()
    sd = compute_reference_sd(PEOPLE.ravel(), 0.15)
    found = map_to_chain(poses, q, EVERYTHING, PEOPLE.ravel(), sd)
    total, left = merge_segments(FIVE, q, EVERYTHING, np.array([3, 4])), found.open[12:, 12:]
    np.testing.assert_allclose(total @ left @ total.T, 0.0, atol=1e-9)
    tight = np.vstack([np.diag(1 / sd[12:]), 1e5 * total])  # the sum known well, the rest by the table
    np.testing.assert_allclose(left, np.linalg.inv(tight.T @ tight), atol=1e-3 * np.abs(left).max())
    assert (found.open[:12] == 0.0).all()


def test_without_a_table_the_first_segment_has_it_all() -> None:
    poses, q, bodies = torso_as_one()
    found = map_to_chain(poses, q, EVERYTHING, np.full(20, np.nan), np.full(20, np.nan))
    chain = found.matrix @ bodies + found.constant
    np.testing.assert_allclose(chain, np.append(bodies, np.zeros(4)), atol=1e-12)


def exists(chain: np.ndarray) -> bool:
    m, mx, my, inertia = chain.reshape(-1, 4).T
    return bool((m >= 0).all() and (m * inertia >= (mx**2 + my**2) * (1 - 1e-8)).all())


def test_a_share_that_cannot_exist_moves_towards_an_even_one_and_the_sum_stays() -> None:
    """The table's pelvis is heavier than the whole torso that was found."""
    poses, q, bodies = torso_as_one()
    total = merge_segments(FIVE, q, EVERYTHING, np.array([3, 4]))
    found = map_to_chain(poses, q, EVERYTHING, PEOPLE.ravel(), compute_reference_sd(PEOPLE.ravel(), 0.15))
    np.testing.assert_allclose(found.apply(bodies), PEOPLE.ravel(), atol=1e-9)
    light = bodies.copy()
    light[12:] *= [0.2, 0.35, 0.2, 0.2]
    likely = found.matrix @ light + found.constant
    assert exists(light)
    assert not exists(likely)
    for full in (found.apply(light), found.halves @ light):
        assert exists(full)
        np.testing.assert_allclose(total @ full[12:], light[12:], atol=1e-9)
        np.testing.assert_allclose(full[:12], light[:12], atol=1e-12)
    moved, whole = found.apply(light) - likely, found.halves @ light - likely
    share = moved @ whole / (whole @ whole)
    np.testing.assert_allclose(moved, share * whole, atol=1e-9)
    assert 0 < share < 1


def test_the_covariance_is_carried_along() -> None:
    poses, q, bodies = torso_as_one()
    rng = np.random.default_rng(3)
    root, base = 0.1 * rng.normal(size=(16, 16)), structural_base(FIVE)
    sd = compute_reference_sd(PEOPLE.ravel(), 0.15)
    found = map_to_chain(poses, q, EVERYTHING, PEOPLE.ravel(), sd)
    covariance = propagate_to_base(found, base, root @ root.T)
    value = found.matrix @ bodies
    plus = [base.regrouping @ (found.matrix @ (bodies + column) - value) for column in root.T]
    of_bodies = np.stack(plus, axis=1) @ np.stack(plus)
    expected = of_bodies + base.regrouping @ found.open @ base.regrouping.T
    np.testing.assert_allclose(covariance, expected, atol=1e-9 * np.abs(expected).max())


def test_relative_poses_are_those_of_samples_where_both_are_known() -> None:
    motion = moving(TIME)
    poses = poses_of(TIME, motion)
    poses.angle[10:20, 4], poses.position[30:40, 2] = np.nan, np.nan
    angle, shift = measure_relative_pose(poses, 4, 3, EVERYTHING)
    assert len(angle) == len(shift) == len(TIME) - 10
    back = planar.rotate(motion.angle[0, 3], shift[0]) + motion.origin[0, 3]
    np.testing.assert_allclose(back, motion.origin[0, 4], atol=1e-12)
    assert angle[0] == pytest.approx(motion.angle[0, 4] - motion.angle[0, 3])


def in_other_frames(centres: np.ndarray, q: np.ndarray, joint: int, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The chain with one joint elsewhere (``shift`` in the segment before), and the very same masses counted on it."""
    moved, own = centres.copy(), planar.rotate(np.array(-q[joint]), shift)
    moved[joint] += shift
    if joint + 1 < len(centres):
        moved[joint + 1] -= own  # the next joint stays where it is on its segment
    return moved, own


@pytest.mark.parametrize("seed", range(3))
def test_the_response_to_a_joint_s_place_is_that_of_the_same_masses_counted_from_there(seed: int) -> None:
    """Every mass stays on its segment and every other joint where it is."""
    rng = np.random.default_rng(seed)
    centres, q = random_chain(rng, 3), rng.uniform(-1.5, 1.5, size=3)
    base = structural_base(centres)
    found, step = propagate_centres(base, centres, q, BODY.ravel()), 1e-6
    for joint in range(3):
        for axis in range(2):
            ends = []
            for sign in (1, -1):
                moved, own = in_other_frames(centres, q, joint, sign * step * np.eye(2)[axis])
                body = BODY.copy()
                body[joint + 1] = average_transform(np.zeros(1), -own[None]) @ BODY[joint + 1]
                ends.append(structural_base(moved).regrouping @ body.ravel())
            expected = (ends[0] - ends[1]) / (2 * step)
            np.testing.assert_allclose(
                found[:, joint, axis], expected, atol=1e-3 * np.abs(expected).max(), err_msg=f"{joint} {axis}"
            )


def test_what_is_beyond_a_joint_weighs_on_its_place() -> None:
    """The first moment of the torso's segment about the hip falls by its mass for every metre that the hip moves."""
    upright = np.zeros(3)
    found = propagate_centres(BASE, CENTRES, upright, BODY.ravel())
    assert list(BASE.kept[-3:]) == [13, 14, 15]
    np.testing.assert_allclose(found[-3, 2], [-BODY[3, 0], 0.0], atol=1e-3)
    np.testing.assert_allclose(found[-2, 2], [0.0, -BODY[3, 0]], atol=1e-3)


def test_a_base_of_other_columns_is_only_moved() -> None:
    """Where a rest leaves fewer base parameters than the chain could have, the masses regroup as they did."""
    q, base = np.array([0.2, -0.5, 0.4]), structural_base(CENTRES, components=(0, 1))
    found = propagate_centres(base, CENTRES, q, BODY.ravel())
    assert found.shape == (len(base.kept), 3, 2)
    torso = planar.rotate(-q[2], -BODY[3, 0] * np.eye(2)).T  # of its first moments, per metre of the hip
    np.testing.assert_allclose(found[-2:, 2], torso, atol=1e-3)
