"""Angles, rates and accelerations: laws, uncertainty, continuity."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from mocap_id.anatomy.angles import (
    ELBOW,
    SHOULDER,
    WRIST,
    JointAngles,
    RelativeMotion,
    elbow_angles,
    joint_coordinates,
    shoulder_angles,
)
from mocap_id.arrays import FloatArray
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialJoint

X, Y, Z = np.eye(3)
TIME = np.linspace(0, 4, 401)
STEP = 1e-4


def unit(*v: float) -> FloatArray:
    return np.array(v) / np.linalg.norm(v)


TWO_AXES = SpatialJoint(
    "two-axis", 0, np.zeros(3), first_axis=unit(0.1, 0.2, 1), second_axis=unit(0.2, 1, 0.1), offset=so3.exp(0.3 * X)
)
HINGE = SpatialJoint("hinge", 0, np.zeros(3), first_axis=unit(0.1, -0.2, 1), offset=so3.exp(np.array([0.3, 0.8, 0.1])))
BALL = SpatialJoint("ball", 0, np.zeros(3))


def coordinates(t: FloatArray) -> FloatArray:
    """Smooth angles (K, 3); the second stays between 0.4 and 1.2."""
    return np.stack([2.4 * np.sin(0.9 * t), 0.8 + 0.4 * np.sin(1.7 * t), 1.1 * np.cos(1.3 * t) - 1.5 * t], axis=1)


def turned(axes: list[FloatArray], q: FloatArray) -> FloatArray:
    result = np.broadcast_to(np.eye(3), (len(q), 3, 3))
    for i, axis in enumerate(axes):
        result = result @ so3.exp(q[:, i : i + 1] * axis)
    return result


CASES: dict[str, tuple[Callable[[FloatArray], FloatArray], Callable[[RelativeMotion], JointAngles], int]] = {
    "shoulder": (lambda q: turned([Y, -X, Y], q), shoulder_angles, 3),
    "elbow": (lambda q: turned([Z, X, Y], q * [1, 0.3, 1]), elbow_angles, 3),
    "wrist": (lambda q: turned([Z, X], q), partial(elbow_angles, names=WRIST), 2),
    "two-axis": (lambda q: TWO_AXES.rotation(q[:, :2]), lambda m: joint_coordinates(m, TWO_AXES, ("a", "b")), 2),
    "hinge": (lambda q: HINGE.rotation(q[:, :1]), lambda m: joint_coordinates(m, HINGE, ("a",)), 1),
    "ball": (lambda q: BALL.rotation(q * 0.8), lambda m: joint_coordinates(m, BALL, ("a", "b", "c")), 3),
}
FREE: dict[str, Callable[[FloatArray], FloatArray]] = {
    "hinge": lambda q: (HINGE.offset.T @ HINGE.first_axis)[:, None],
    "two-axis": lambda q: np.stack(
        [(TWO_AXES.offset @ so3.exp(q[1] * TWO_AXES.second_axis)).T @ TWO_AXES.first_axis, TWO_AXES.second_axis], axis=1
    ),
}
"""Directions in which a joint of fewer than three coordinates can err, in the child's axes."""
SCALE = {"elbow": np.array([1, 0.3, 1]), "ball": np.full(3, 0.8)}


def motion_of(rotation: Callable[[FloatArray], FloatArray], t: FloatArray, sd: float = 0.01) -> RelativeMotion:
    """Return the relative motion by central differences of the rotation."""

    def velocity(at: FloatArray) -> FloatArray:
        step = np.swapaxes(rotation(coordinates(at - STEP)), 1, 2) @ rotation(coordinates(at + STEP))
        middle = so3.exp(-so3.log(step) / 2)
        return np.einsum("fij,fj->fi", middle, so3.log(step)) / (2 * STEP)

    speed = velocity(t)
    change = (velocity(t + STEP) - velocity(t - STEP)) / (2 * STEP)
    return RelativeMotion(rotation(coordinates(t)), speed, change, np.broadcast_to(sd**2 * np.eye(9), (len(t), 9, 9)))


@pytest.mark.parametrize("name", CASES)
def test_angles_and_their_derivatives_are_recovered(name: str) -> None:
    rotation, decompose, count = CASES[name]
    result = decompose(motion_of(rotation, TIME))
    scale = SCALE.get(name, np.ones(3))[:count]
    angle = coordinates(TIME)[:, :count] * scale
    rate = (coordinates(TIME + STEP) - coordinates(TIME - STEP))[:, :count] * scale / (2 * STEP)
    acceleration = (coordinates(TIME + 0.01) - 2 * coordinates(TIME) + coordinates(TIME - 0.01))[:, :count] * scale
    offset = 2 * np.pi * np.round((angle[0] - result.angle[0]) / (2 * np.pi))
    assert np.allclose(result.angle + offset, angle, atol=1e-9)
    assert np.allclose(result.rate, rate, atol=1e-5)
    assert np.allclose(result.acceleration, acceleration / 1e-4, atol=2e-3)
    assert len(result.names) == count


@pytest.mark.parametrize("name", CASES)
def test_standard_deviations_agree_with_monte_carlo(name: str) -> None:
    rotation, decompose, _ = CASES[name]
    rng, draws = np.random.default_rng(5), 8000
    one = motion_of(rotation, np.array([0.7]))
    root = np.tril(rng.normal(size=(9, 9))) * 0.003
    if name in FREE:
        basis = FREE[name](coordinates(np.array([0.7]))[0])
        root = np.kron(np.eye(3), basis @ np.linalg.pinv(basis)) @ root
    covariance = root @ root.T
    noise = rng.normal(size=(draws, 9)) @ root.T
    many = RelativeMotion(
        one.rotation @ so3.exp(noise[:, :3]),
        one.velocity + noise[:, 3:6],
        one.acceleration + noise[:, 6:],
        np.broadcast_to(covariance, (draws, 9, 9)),
    )
    predicted = decompose(RelativeMotion(one.rotation, one.velocity, one.acceleration, covariance[None]))
    measured = decompose(many)
    assert np.allclose(np.std(measured.angle, axis=0), predicted.sd[0], rtol=0.05)
    assert np.allclose(np.std(measured.rate, axis=0), predicted.sd_rate[0], rtol=0.05)
    assert np.allclose(np.std(measured.acceleration, axis=0), predicted.sd_acceleration[0], rtol=0.05)


@pytest.mark.slow
def test_errors_of_frames_agree_with_monte_carlo_as_a_mean_and_changes() -> None:
    rng, draws = np.random.default_rng(6), 4000
    root = np.tril(rng.normal(size=(6, 6))) * 0.01
    one = motion_of(CASES["shoulder"][0], np.array([0.3, 0.7, 1.1]), sd=0.0)
    predicted = shoulder_angles(one, root @ root.T)
    angles, rates, accelerations = [], [], []
    for parent, child in (np.split(error, 2) for error in rng.normal(size=(draws, 6)) @ root.T):
        turn = so3.exp(child)
        moved = shoulder_angles(
            RelativeMotion(
                so3.exp(-parent) @ one.rotation @ turn,
                one.velocity @ turn,
                one.acceleration @ turn,
                np.zeros((3, 9, 9)),
            )
        )
        angles.append(moved.angle)
        rates.append(moved.rate)
        accelerations.append(moved.acceleration)
    means = np.mean(angles, axis=1)
    assert np.allclose(np.std(means, axis=0), predicted.constant_sd, rtol=0.06)
    assert np.allclose(np.std(angles - means[:, None], axis=0), predicted.sd, rtol=0.06)
    assert np.allclose(np.std(rates, axis=0), predicted.sd_rate, rtol=0.06)
    assert np.allclose(np.std(accelerations, axis=0), predicted.sd_acceleration, rtol=0.06)


def shoulder(plane: FloatArray, elevation: FloatArray, axial: FloatArray) -> JointAngles:
    rotation = turned([Y, -X, Y], np.stack([plane, elevation, axial], axis=1))
    still = np.zeros((len(plane), 3))
    return shoulder_angles(RelativeMotion(rotation, still, still, np.zeros((len(plane), 9, 9))))


def test_angles_are_continuous_past_the_half_turn_and_past_gaps() -> None:
    plane = np.linspace(2.5, 4.5, 200)
    result = shoulder(plane, np.full(200, 1.0), -2 * plane)
    assert np.allclose(np.diff(result.angle[:, 0]), np.diff(plane))
    assert np.allclose(np.diff(result.angle[:, 2]), -2 * np.diff(plane))
    assert -np.pi < result.angle[0, 0] <= np.pi and -np.pi < result.angle[0, 2] <= np.pi
    rotation = turned([Y, -X, Y], np.stack([plane, np.full(200, 1.0), -2 * plane], axis=1))
    rotation[50:60] = np.nan
    gappy = shoulder_angles(RelativeMotion(rotation, np.zeros((200, 3)), np.zeros((200, 3)), np.zeros((200, 9, 9))))
    assert np.isnan(gappy.angle[50:60]).all()
    assert np.allclose(gappy.angle[60:], result.angle[60:])


@pytest.mark.parametrize(("pole", "sign"), [(0.0, 1), (np.pi, -1)])
def test_the_sum_or_difference_is_continuous_through_a_pole(pole: float, sign: int) -> None:
    signed = np.linspace(-0.6, 0.6, 120)
    rotation = turned([Y, -X, Y], np.stack([np.full(120, 0.4), pole + signed, np.full(120, 1.3)], axis=1))
    still = np.zeros((120, 3))
    result = shoulder_angles(RelativeMotion(rotation, still, still, np.zeros((120, 9, 9))))
    assert np.all(result.angle[:, 1] >= 0)
    assert np.allclose(np.abs(result.angle[:, 1] - pole), np.abs(signed))
    kept = result.angle[:, 2] + sign * result.angle[:, 0]
    assert np.allclose(kept, kept[0])
    assert np.array_equal(result.near_gimbal, np.abs(signed) < np.radians(15))
    assert np.allclose(result.condition, 1 / np.abs(np.sin(signed)))


def test_noise_at_a_hanging_arm_does_not_count_turns() -> None:
    rng = np.random.default_rng(2)
    elevation = np.concatenate([np.full(300, 0.9), np.full(600, 0.001), np.full(300, 0.9)])
    rotation = turned([Y, -X, Y], np.stack([np.full(1200, 0.5), elevation, np.full(1200, -0.3)], axis=1))
    rotation = rotation @ so3.exp(0.002 * rng.normal(size=(1200, 3)))
    still = np.zeros((1200, 3))
    result = shoulder_angles(RelativeMotion(rotation, still, still, np.zeros((1200, 9, 9))))
    assert np.allclose(result.angle[~result.near_gimbal][:, 0], 0.5, atol=0.02)
    total = result.angle[:, 0] + result.angle[:, 2]
    assert np.allclose(total, 0.2, atol=0.03)


def test_the_exact_pole_has_an_elevation_and_no_rates() -> None:
    result = shoulder(np.zeros(3), np.array([0.5, 0.0, 0.5]), np.zeros(3))
    assert np.isclose(result.angle[1, 1], 0)
    assert np.isnan(result.rate[1]).all()
    assert np.isfinite(result.rate[[0, 2]]).all()


def test_names_are_those_of_the_artefact() -> None:
    assert [*SHOULDER, *ELBOW, *WRIST] == [
        "shoulder_plane", "shoulder_elevation", "shoulder_axial", "elbow_flexion", "elbow_carrying", "elbow_pronation",
        "wrist_flexion", "wrist_deviation",
    ]  # fmt: skip
