"""Parameters carried between trials: nothing changes where only the frames differ, little where the joints do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, waves

from mocap_id.dynamics.consistency import PointGrid
from mocap_id.dynamics.prediction import BodyFrames, Registration, register_bodies, transfer_parameters
from mocap_id.dynamics.regressor import planar_regressor, structural_base
from mocap_id.geometry import planar

NAMES = ("foot", "shank", "thigh", "torso")
RNG = np.random.default_rng(4)
SEGMENT = np.repeat([0, 1, 2, 3], 5)
LOCAL = RNG.uniform((-0.1, 0.02), (0.1, 0.4), (20, 2))
LABELS = tuple(f"M{i}" for i in range(20))
BETWEEN = np.array([[0, 1], [1, 2], [2, 3]])
HERE = BodyFrames(NAMES, CENTRES, BETWEEN, LABELS, SEGMENT, LOCAL)
TURNED = np.array([0.0, 0.03, -0.05, 0.3])
FEET = np.array([0.07, 0.002])


def rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def elsewhere(angle: np.ndarray = TURNED, feet: np.ndarray = FEET) -> BodyFrames:
    """The same skeleton with every segment's frame turned about its joint, and the feet on another place."""
    local = np.stack([rotation(-angle[k]) @ point for k, point in zip(SEGMENT, LOCAL, strict=True)])
    centres = np.stack([rotation(-angle[k]) @ centre for k, centre in enumerate(CENTRES)])
    local[SEGMENT == 0] += feet
    centres[0] += feet
    return BodyFrames(NAMES, centres, BETWEEN, LABELS, SEGMENT, local)


def angles(q: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """The same posture's joint angles in frames that are turned."""
    return q + np.diff(turned)


def wrench(skeleton: BodyFrames, full: np.ndarray, turned: np.ndarray, feet: np.ndarray) -> np.ndarray:
    """Of one and the same movement, about the place of the feet."""
    q, dq, ddq = waves(np.arange(0, 6, 0.02), 3, seed=3)
    values = planar_regressor(skeleton.centres, angles(q, turned), dq, ddq) @ full
    moment = values[:, 2] - feet[0] * values[:, 1] + feet[1] * values[:, 0]
    return np.column_stack([values[:, :2], moment])


NOWHERE = np.zeros(2)
UNTURNED = np.zeros(4)


def test_other_frames_and_another_place_change_nothing() -> None:
    there = elsewhere()
    registration = register_bodies(there, HERE)
    np.testing.assert_allclose(registration.angle, [0.0, *TURNED[1:]], atol=1e-12)
    np.testing.assert_allclose(registration.shift, [-FEET, *np.zeros((3, 2))], atol=1e-12)
    np.testing.assert_allclose(registration.residual, 0.0, atol=1e-12)
    np.testing.assert_allclose(registration.joint, 0.0, atol=1e-12)
    away = transfer_parameters(BODY.ravel(), register_bodies(HERE, there))
    np.testing.assert_allclose(transfer_parameters(away, registration), BODY.ravel(), atol=1e-12)
    np.testing.assert_allclose(
        wrench(there, away, TURNED, FEET), wrench(HERE, BODY.ravel(), UNTURNED, NOWHERE), atol=1e-9
    )


def test_it_is_what_happens_to_point_masses() -> None:
    """Masses at points, each moved by hand."""
    there = elsewhere()
    position = RNG.uniform((-0.1, 0.0), (0.1, 0.4), (12, 2))
    segment = np.repeat(np.arange(4), 3)
    masses = RNG.uniform(1, 5, 12)
    full = PointGrid(segment, position, 4).moments() @ masses
    moved = np.stack([rotation(TURNED[k]) @ point for k, point in zip(segment, position, strict=True)])
    moved[segment == 0] = position[segment == 0] - FEET
    expected = PointGrid(segment, moved, 4).moments() @ masses
    np.testing.assert_allclose(transfer_parameters(full, register_bodies(there, HERE)), expected, atol=1e-12)


def test_where_the_joints_agree_any_body_with_the_same_base_parameters_will_do() -> None:
    there = elsewhere()
    base = structural_base(there.centres).regrouping
    _, size, basis = np.linalg.svd(base)
    hidden = basis[len(size) :]  # what the wrench does not tell
    registration, own = register_bodies(there, HERE), transfer_parameters(BODY.ravel(), register_bodies(HERE, there))
    one = wrench(HERE, transfer_parameters(own, registration), UNTURNED, NOWHERE)
    for direction in hidden:
        other = wrench(HERE, transfer_parameters(own + 3.0 * direction, registration), UNTURNED, NOWHERE)
        np.testing.assert_allclose(other, one, atol=1e-8)


def test_a_joint_that_is_placed_otherwise_takes_no_mass_with_it() -> None:
    """A trial that finds the knee 1 cm too low has a longer thigh and a shorter shank; the body is the same.

    Every segment's mass stays where it was. The base parameters are others all the same: those of one trial are not
    those of the other.
    """
    error = np.array([0.0, -0.01])
    local = LOCAL.copy()
    local[SEGMENT == 2] -= error  # thigh coordinates from the new knee, in the mean posture
    centres = CENTRES.copy()
    centres[1] += error
    centres[2] -= error
    there = BodyFrames(NAMES, centres, BETWEEN, LABELS, SEGMENT, local)
    registration = register_bodies(HERE, there)
    np.testing.assert_allclose(registration.shift[2], -error, atol=1e-12)
    np.testing.assert_allclose(registration.joint, [0.0, 0.01, 0.0], atol=1e-12)
    carried = transfer_parameters(BODY.ravel(), registration)
    np.testing.assert_allclose(carried[8:12], [14.2, 0.1, 3.4 + 0.142, 1.1 + 2 * 0.01 * 3.4 + 14.2e-4], atol=1e-12)
    q = np.zeros((1, 3))  # upright: every segment where it is
    height = [
        planar.marker_positions(q, c, np.arange(4), (f.reshape(-1, 4)[:, 1:3] / f.reshape(-1, 4)[:, :1]))[0, :, 1]
        for c, f in ((CENTRES, BODY.ravel()), (centres, carried))
    ]
    np.testing.assert_allclose(height[1], height[0], atol=1e-12)
    plain = structural_base(centres).regrouping @ BODY.ravel() - structural_base(CENTRES).regrouping @ BODY.ravel()
    assert np.abs(plain).max() > 0.5  # kg m: what the joint's place alone changes in the base parameters


def test_markers_that_dropped_out_or_changed_their_segment_do_not_count() -> None:
    there = elsewhere()
    owner = np.where(np.arange(18) == 6, 2, SEGMENT[:-2])
    fewer = BodyFrames(NAMES, there.centres, BETWEEN, LABELS[:-2], owner, there.local[:-2])
    registration = register_bodies(fewer, HERE)
    np.testing.assert_array_equal(registration.markers, [5, 4, 5, 3])
    np.testing.assert_allclose(registration.angle, [0.0, *TURNED[1:]], atol=1e-12)


def test_the_order_of_the_markers_does_not_matter() -> None:
    order = RNG.permutation(20)
    mixed = BodyFrames(NAMES, CENTRES, BETWEEN, tuple(LABELS[i] for i in order), SEGMENT[order], LOCAL[order])
    one, other = register_bodies(elsewhere(), HERE), register_bodies(elsewhere(), mixed)
    np.testing.assert_allclose(one.angle, other.angle, atol=1e-12)
    np.testing.assert_allclose(one.shift, other.shift, atol=1e-12)


def test_markers_on_the_plate_stay_where_the_feet_do_not() -> None:
    there = elsewhere()
    on_plate = np.array([[0.3, 0.0], [-0.3, 0.0], [0.3, 0.01], [-0.3, 0.02], [0.2, 0.0], [-0.2, 0.0], [0.1, 0.0]])
    names = tuple(f"P{i}" for i in range(7))

    def beside(skeleton: BodyFrames) -> BodyFrames:
        return BodyFrames(
            NAMES,
            skeleton.centres,
            BETWEEN,
            (*skeleton.markers, *names),
            np.append(skeleton.segment, np.zeros(7, dtype=np.int64)),
            np.concatenate([skeleton.local, on_plate + RNG.normal(size=(7, 2)) * 3e-4]),
        )

    moved = beside(there)
    np.testing.assert_allclose(register_bodies(moved, beside(HERE)).shift[0], -FEET, atol=1e-9)
    unsure = replace(moved, centres=moved.centres + np.array([[0.02, -0.01], [0.0, 0.0], [0.0, 0.0]]))
    np.testing.assert_allclose(register_bodies(unsure, beside(HERE)).shift[0], -FEET, atol=1e-9)
    still = register_bodies(beside(elsewhere(feet=NOWHERE)), beside(HERE)).shift[0]
    np.testing.assert_allclose(still, 0.0, atol=1e-3)


def test_without_base_markers_the_ankle_tells_where_the_feet_are() -> None:
    bare = [
        BodyFrames(NAMES, s.centres, BETWEEN, s.markers[5:], s.segment[5:], s.local[5:]) for s in (elsewhere(), HERE)
    ]
    registration = register_bodies(*bare)
    np.testing.assert_allclose(registration.shift[0], -FEET, atol=1e-12)
    assert registration.markers[0] == 0


def test_too_few_common_markers_are_seen() -> None:
    lonely = replace(HERE, markers=tuple(f"X{i}" if SEGMENT[i] == 2 and i > 10 else LABELS[i] for i in range(20)))
    registration = register_bodies(elsewhere(), lonely)
    assert registration.markers[2] == 1
    assert np.isnan(registration.angle[2])
    assert np.isnan(transfer_parameters(BODY.ravel(), registration)[9:12]).all()
    assert np.isfinite(transfer_parameters(BODY.ravel(), registration)[[0, 4, 12]]).all()


@pytest.mark.parametrize("noise", [0.001, 0.005])
def test_a_person_who_faces_the_other_way_fits_when_turned_over(noise: float) -> None:
    flipped = replace(HERE, local=LOCAL * [-1, 1] + RNG.normal(size=(20, 2)) * noise, centres=CENTRES * [-1, 1])
    over: Registration = register_bodies(flipped, HERE)
    assert (over.mirrored[1:] < 3 * noise).all()
    assert (over.residual[1:] > 5 * over.mirrored[1:]).all()
    same = register_bodies(elsewhere(), HERE)
    assert (same.mirrored[1:] > 0.01).all()


def test_a_body_without_a_joint_is_carried_and_not_judged() -> None:
    """Arms and head: their markers tell where they are, and no joint does."""
    rng = np.random.default_rng(8)
    arms = rng.uniform(-0.3, 0.3, (6, 2))
    labels = tuple(f"A{i}" for i in range(6))

    def with_arms(skeleton: BodyFrames, places: np.ndarray) -> BodyFrames:
        return replace(
            skeleton,
            segments=(*NAMES, "others"),
            markers=(*skeleton.markers, *labels),
            segment=np.append(skeleton.segment, np.full(6, 4)),
            local=np.concatenate([skeleton.local, places]),
        )

    there, here = with_arms(elsewhere(), arms), with_arms(HERE, arms @ rotation(0.4).T + [0.1, -0.2])
    np.testing.assert_array_equal(there.jointed, [1, 2, 3])
    forth, back = register_bodies(there, here), register_bodies(here, there)
    assert forth.angle[4] == pytest.approx(0.4)
    assert len(forth.joint) == 3
    full = np.append(BODY.ravel(), [6.0, 0.3, -0.2, 0.4])
    np.testing.assert_allclose(transfer_parameters(transfer_parameters(full, forth), back), full, atol=1e-12)


def test_a_joint_that_the_other_trial_does_not_have_is_not_compared() -> None:
    centres = np.where(np.arange(3)[:, None] == 1, np.nan, CENTRES)
    registration = register_bodies(elsewhere(), replace(HERE, centres=centres))
    np.testing.assert_array_equal(np.isnan(registration.joint), [False, True, False])
    np.testing.assert_allclose(
        transfer_parameters(BODY.ravel(), registration),
        transfer_parameters(BODY.ravel(), register_bodies(elsewhere(), HERE)),
    )
