"""From measured poses to motion: derivatives, what the low-pass leaves, pins, gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dynamics_cases import CENTRES
from pose_cases import CENTROID, HIP, INFORMATION, OF_SEGMENT, moving, poses_of
from scipy.optimize import minimize

from mocap_id.arrays import find_complete_rows
from mocap_id.dynamics.measured_motion import (
    BodyPoses,
    JointGap,
    PoseFilter,
    close_gaps,
    fill_gaps,
    filter_motion,
    measure_gaps,
    measure_stretch,
)
from mocap_id.geometry import planar

RATE = 100.0
TIME = np.arange(1200) / RATE
INNER = slice(150, -150)
WIDE = (20.0, 20.0, 20.0)
EVERYTHING = np.ones(len(TIME), dtype=bool)


def single(x: np.ndarray, y: np.ndarray, angle: np.ndarray, centroid: np.ndarray | None = None) -> BodyPoses:
    """One body that moves so, no joint."""
    middle = np.zeros((1, 2)) if centroid is None else centroid[None]
    place = np.stack([x, y], axis=-1)[:, None]
    return BodyPoses(TIME, place, angle[:, None], middle, np.ones((1, 2)), np.zeros(1, dtype=int), np.zeros((0, 2)))


def passed(frequency: float, cutoff: float) -> float:
    """Gain of a second-order Butterworth forwards and backwards."""
    return 1 / (1 + (np.tan(np.pi * frequency / RATE) / np.tan(np.pi * cutoff / RATE)) ** 4)


def stencils(frequency: float) -> tuple[float, float]:
    """What central differences of fourth order make of a sine's first and second derivative, of their true size."""
    h = 2 * np.pi * frequency / RATE
    return (8 * np.sin(h) - np.sin(2 * h)) / (6 * h), (30 - 32 * np.cos(h) + 2 * np.cos(2 * h)) / (12 * h**2)


def test_polynomials_have_their_own_derivatives() -> None:
    """The low-pass is flat to the third order, the differences to the fourth."""
    t = TIME - 6.0
    motion = filter_motion(single(0.3 * t**2, 0.05 * t**3 - t, 0.02 * t**3 + 0.1 * t**2, np.zeros(2)), WIDE)
    np.testing.assert_allclose(motion.acceleration[INNER, 0, 0], 0.6, atol=1e-6)
    np.testing.assert_allclose(motion.acceleration[INNER, 0, 1], 0.3 * t[INNER], atol=1e-6)
    np.testing.assert_allclose(motion.omega[INNER, 0], 0.06 * t[INNER] ** 2 + 0.2 * t[INNER], atol=1e-6)
    np.testing.assert_allclose(motion.alpha[INNER, 0], 0.12 * t[INNER] + 0.2, atol=1e-6)
    np.testing.assert_allclose(motion.origin[INNER, 0, 0], 0.3 * t[INNER] ** 2, atol=1e-9)


def test_nothing_is_said_at_the_ends_of_a_stretch() -> None:
    poses = single(np.sin(TIME), np.cos(TIME), 0.3 * np.sin(TIME))
    poses.position[600:602] = np.nan
    motion = filter_motion(poses, WIDE)
    there = find_complete_rows(motion.acceleration) & find_complete_rows(motion.alpha)
    expected = np.ones(len(TIME), dtype=bool)
    expected[[0, 1, -2, -1]] = False
    expected[598:604] = False
    np.testing.assert_array_equal(find_complete_rows(motion.acceleration), expected)
    np.testing.assert_array_equal(there, expected)


@pytest.mark.parametrize(("frequency", "cutoff"), [(0.5, 3.0), (1.0, 3.0), (1.5, 2.5)])
@pytest.mark.parametrize("axis", range(3))
def test_a_sine_keeps_what_the_low_pass_of_its_coordinate_passes(frequency: float, cutoff: float, axis: int) -> None:
    omega = 2 * np.pi * frequency
    wave, still = np.sin(omega * TIME), np.zeros(len(TIME))
    poses = single(*(wave if k == axis else still for k in range(3)))
    motion = filter_motion(poses, tuple(cutoff if k == axis else 12.0 for k in range(3)))  # type: ignore[arg-type]
    gain, (first, second) = passed(frequency, cutoff), stencils(frequency)
    found = motion.alpha[:, 0] if axis == 2 else motion.acceleration[:, 0, axis]
    np.testing.assert_allclose(found[INNER], -gain * second * omega**2 * wave[INNER], atol=2e-3 * omega**2)
    if axis == 2:
        np.testing.assert_allclose(motion.angle[INNER, 0], gain * wave[INNER], atol=2e-3)
        expected = gain * first * omega * np.cos(omega * TIME[INNER])
        np.testing.assert_allclose(motion.omega[INNER, 0], expected, atol=2e-3 * omega)


def test_slow_poses_give_the_exact_motion_of_every_body() -> None:
    """Frames' origins and their accelerations too, though it is the centroids that are measured."""
    exact = moving(TIME)
    motion = filter_motion(poses_of(TIME, exact), WIDE)
    for name in ("angle", "omega", "alpha", "origin", "acceleration", "joint"):
        np.testing.assert_allclose(getattr(motion, name)[INNER], getattr(exact, name)[INNER], atol=2e-3, err_msg=name)
    np.testing.assert_array_equal(motion.beyond, exact.beyond)


def test_other_cut_offs_before_leave_no_trace() -> None:
    poses = poses_of(TIME, moving(TIME), noise=1.0)
    filtered = PoseFilter(poses)
    filtered.motion((3.0, 5.0, 4.0))
    for bands in ((3.0, 2.5, 6.0), (3.0, 5.0, 4.0)):
        once, alone = filtered.motion(bands), filter_motion(poses, bands)
        for name in ("angle", "omega", "alpha", "origin", "acceleration", "joint", "beyond"):
            np.testing.assert_array_equal(getattr(once, name), getattr(alone, name), err_msg=name)


def test_gap_and_origin_are_those_of_the_motion() -> None:
    exact = moving(TIME)
    poses = poses_of(TIME, exact)
    np.testing.assert_allclose(poses.origin, exact.origin, atol=1e-12)
    assert poses.joints == [0, 1, 2]
    for joint in (0, 1):
        np.testing.assert_allclose(poses.measure_gap(joint), 0.0, atol=1e-12)
    middle = exact.joint[:, HIP] - (poses.measure_gap(HIP) / 2)
    foot = exact.origin[:, HIP] + planar.rotate(exact.angle[:, HIP], CENTRES[HIP])
    np.testing.assert_allclose(middle, foot, atol=1e-12)


def test_a_joint_between_segments_of_one_body_has_no_centre() -> None:
    """Shank and thigh as one body: its place is that of its first segment, and the arm is beyond everything."""
    exact = moving(TIME)
    kept = [0, 1, 3, 4]
    poses = replace(
        poses_of(TIME, exact),
        position=poses_of(TIME, exact).position[:, kept],
        angle=exact.angle[:, kept],
        centroid=CENTROID[kept],
        information=INFORMATION[kept],
        body=np.array([0, 1, 1, 2]),
    )
    assert poses.joints == [0, 2]
    motion = filter_motion(poses, WIDE)
    assert np.isnan(motion.joint[:, 1]).all()
    assert np.isfinite(motion.joint[INNER][:, [0, 2]]).all()
    np.testing.assert_array_equal(motion.beyond[0], [False, True, True, True])
    np.testing.assert_array_equal(motion.beyond[2], [False, False, True, True])


def test_gaps_of_joints_that_hold_are_nothing() -> None:
    found = measure_gaps(poses_of(TIME, moving(TIME, size=0.0)), EVERYTHING)
    assert sorted(found) == [0, 1, 2]
    for gap in found.values():
        assert gap.pinned
        assert gap.size < 1e-9
        assert gap.acceleration < 1e-6


@pytest.mark.parametrize(("size", "holds"), [(0.02, False), (0.003, True)])
def test_a_gap_has_the_size_and_acceleration_of_its_sine(size: float, holds: bool) -> None:
    frequency, direction = 0.5, np.array([0.6, 0.8])
    poses = replace(poses_of(TIME, moving(TIME, size=0.0)), camera=0.6**2 / INFORMATION)
    poses.position[:, HIP + 1 :] += (size * np.sin(2 * np.pi * frequency * TIME))[:, None, None] * direction
    gap = measure_gaps(poses, np.abs(TIME - 6.0) <= 4.0)[HIP]
    assert gap.size == pytest.approx(size / np.sqrt(2), rel=5e-3)
    expected = size * (2 * np.pi * frequency) ** 2 / np.sqrt(2) * passed(frequency, 3.0)
    assert gap.acceleration == pytest.approx(expected, rel=5e-3)
    assert gap.pinned == holds
    assert gap.above_noise == pytest.approx(np.sqrt(max(gap.acceleration**2 - gap.noise**2, 0.0)))
    assert replace(gap, holds=True).pinned


@pytest.mark.parametrize("rate", [50.0, 100.0, 480.0])
@pytest.mark.parametrize("noise", [0.2, 1.0, 4.0])  # some 0.1 to 2 mm
def test_noise_of_the_cameras_alone_opens_no_joint(rate: float, noise: float) -> None:
    """Whatever its size and the rate; the largest acceleration that noise may give is less than a third above."""
    time = np.arange(round(20 * rate)) / rate
    motion, everything = moving(time, size=0.0), np.ones(len(time), dtype=bool)
    found = [measure_gaps(poses_of(time, motion, noise=noise, seed=seed), everything) for seed in range(10)]
    for joint in range(3):
        assert all(gap[joint].pinned for gap in found)
        usual = np.sqrt(np.mean([gap[joint].acceleration ** 2 for gap in found]))
        assert 0.75 < usual / found[0][joint].noise < 1.0


def test_fast_noise_is_no_gap_and_what_is_never_known_is_pinned() -> None:
    poses = poses_of(TIME, moving(TIME, size=0.0), noise=0.4)  # some 0.2 mm and 0.5 mrad
    assert all(gap.pinned for gap in measure_gaps(poses, EVERYTHING).values())
    assert np.isnan(measure_gaps(poses, ~EVERYTHING)[HIP].acceleration)
    assert JointGap(np.nan, np.nan).pinned


@pytest.mark.parametrize("joints", [[0], [HIP], [0, 1, HIP]])
def test_pins_close_the_gaps(joints: list[int]) -> None:
    poses = poses_of(TIME, moving(TIME, size=0.002), noise=0.5)
    closed = close_gaps(poses, joints)
    for joint in joints:
        assert np.abs(closed.measure_gap(joint)).max() < 1e-9
    for joint in set(range(3)) - set(joints):
        assert np.abs(closed.measure_gap(joint)).max() > 1e-4
    np.testing.assert_array_equal(closed.position[:, 4], poses.position[:, 4])
    assert close_gaps(poses, []) is poses


def test_pins_move_the_poses_as_little_as_they_can() -> None:
    """Against a general minimiser with the gaps as constraints."""
    poses, k = poses_of(TIME, moving(TIME, size=0.004), noise=1.0), 371
    one = replace(poses, time=TIME[:1], position=poses.position[k : k + 1], angle=poses.angle[k : k + 1])
    weight = np.concatenate([np.repeat(INFORMATION[:, :1], 2, axis=1), INFORMATION[:, 1:]], axis=1).ravel()

    def at(change: np.ndarray) -> BodyPoses:
        step = (change / np.sqrt(weight)).reshape(1, 5, 3)
        return replace(one, position=one.position + step[..., :2], angle=one.angle + step[..., 2])

    best = minimize(
        lambda change: change @ change,
        np.zeros(15),
        jac=lambda change: 2 * change,
        constraints={
            "type": "eq",
            "fun": lambda change: 1e3 * np.concatenate([at(change).measure_gap(j)[0] for j in range(3)]),
        },
        options={"ftol": 1e-9},
    )
    assert best.success
    closed = close_gaps(one, [0, 1, 2])
    found = np.concatenate([closed.position - one.position, (closed.angle - one.angle)[..., None]], axis=-1)
    cost = float(weight @ found.ravel() ** 2)
    assert cost > 1.0
    assert cost == pytest.approx(best.fun, rel=1e-3)
    np.testing.assert_allclose(found.ravel() * np.sqrt(weight), best.x, atol=0.02 * np.sqrt(best.fun))


def test_pins_leave_what_is_unknown_alone() -> None:
    poses = poses_of(TIME, moving(TIME, size=0.002))
    poses.angle[300:310, 1] = np.nan
    closed = close_gaps(poses, [1, HIP])
    assert np.abs(closed.measure_gap(HIP)[:300]).max() < 1e-9
    assert np.isnan(closed.angle[300:310, 1]).all()
    np.testing.assert_array_equal(closed.angle[300:310, 3], poses.angle[300:310, 3])


def test_short_inner_gaps_are_bridged_and_no_others() -> None:
    time = TIME
    straight = single(0.3 * time, 1 - 0.2 * time, 0.5 * time)
    whole = replace(straight, position=straight.position.copy(), angle=straight.angle.copy())
    holes = {"start": slice(0, 10), "short": slice(200, 225), "long": slice(400, 426), "end": slice(1190, 1200)}
    for hole in holes.values():
        straight.position[hole] = np.nan
    straight.angle[700, 0] = np.nan
    filled, observed = fill_gaps(straight)
    for name, hole in holes.items():
        assert not observed[hole].any()
        assert np.isnan(filled.position[hole]).all() == (name != "short")
    np.testing.assert_allclose(filled.position[holes["short"]], whole.position[holes["short"]], atol=1e-12)
    np.testing.assert_allclose(filled.angle[700], whole.angle[700], atol=1e-12)
    assert not observed[700]
    assert observed.sum() == len(time) - 72
    assert np.isnan(straight.position[210]).all()  # the poses that were given are as they were


def test_each_body_is_bridged_by_itself() -> None:
    exact = moving(TIME)
    poses = poses_of(TIME, exact)
    for body in range(5):
        poses.position[100 * body + 100 : 100 * body + 105, body] = np.nan
    filled, observed = fill_gaps(poses)
    assert (~observed).sum() == 25
    assert np.isfinite(filled.position).all()
    assert np.abs(filled.position - poses_of(TIME, exact).position).max() < 2e-3
    np.testing.assert_array_equal(filled.body, OF_SEGMENT)


def test_the_stretch_is_the_change_of_the_distance_between_both_joints() -> None:
    """The poses of the two neighbours give it; the pose of the segment itself does not matter."""
    motion = moving(TIME)
    found = measure_stretch(poses_of(TIME, motion), HIP)
    gap = motion.origin[:, HIP + 1] - motion.joint[:, HIP - 1]
    exact = np.gradient(np.gradient(np.linalg.norm(gap, axis=1), TIME), TIME)
    known = np.isfinite(found.acceleration)
    assert known[INNER].all()
    np.testing.assert_allclose(found.acceleration[INNER], exact[INNER], atol=0.01)
    turned = poses_of(TIME, motion)
    turned.angle[:, HIP] += 0.2 * np.sin(TIME)
    np.testing.assert_array_equal(measure_stretch(turned, HIP).acceleration[INNER], found.acceleration[INNER])
    assert found.above_noise == pytest.approx(np.sqrt(np.mean(exact[known] ** 2)), rel=0.1)


@pytest.mark.parametrize("noise", [0.5, 2.0])
def test_the_noise_of_the_cameras_alone_stretches_nothing(noise: float) -> None:
    still = moving(TIME, size=0.0)
    found = [measure_stretch(poses_of(TIME, still, noise, seed), HIP) for seed in range(20)]
    assert sum(each.above_noise > 0 for each in found) <= 1
    own = [np.sqrt(np.nanmean(each.acceleration**2)) / each.noise for each in found]
    assert 0.65 < np.mean(own) < 1.0
