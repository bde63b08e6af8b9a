"""Areas and volumes against closed forms, limits against order statistics, overlays against geometry."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from mocap_id.arrays import sobol
from mocap_id.config import load
from mocap_id.errors import StoreError
from mocap_id.geometry import Chain, Revolute, se3
from mocap_id.store import Folder, Tree
from mocap_id.store.hdf5 import encode_tree
from mocap_id_assist.workspace import (
    JointLimits,
    PlanarArm,
    SpatialArm,
    compute_alpha_shape,
    compute_measure,
    compute_reachable_workspace,
    find_limits,
    overlay_workspaces,
    sample_box,
)
from mocap_id_assist.workspaces import measure_workspace, read_arm

UPPER, FORE = 0.31, 0.28
LOWER_LIMITS, UPPER_LIMITS = np.array([0.98, -2.0]), np.array([3.05, -0.1])


def arm() -> PlanarArm:
    return PlanarArm.exact(np.array([[0.1, 1.4], [0.0, UPPER]]), np.array([0.0, FORE]))


def exact_area(lower: np.ndarray, upper: np.ndarray) -> float:
    """∫∫ l₁ l₂ |sin θ₂|: an elbow of one sign reaches every point in one posture."""
    return float(UPPER * FORE * (upper[0] - lower[0]) * abs(np.cos(upper[1]) - np.cos(lower[1])))


@pytest.mark.parametrize("seed", range(3))
def test_the_area_of_a_two_link_arm_is_the_exact_one(seed: int) -> None:
    found = compute_reachable_workspace(arm(), JointLimits.given(LOWER_LIMITS, UPPER_LIMITS), seed=seed)
    exact = exact_area(LOWER_LIMITS, UPPER_LIMITS)
    assert found.measure == pytest.approx(exact, rel=5e-4)
    errors = [abs(value - exact) for _, _, value in found.convergence]
    assert errors[-1] < 0.3 * errors[0]


def test_the_interval_is_that_of_drawn_limits_and_dimensions() -> None:
    sd = np.array([0.004, 0.006])
    limits = JointLimits(LOWER_LIMITS, UPPER_LIMITS, sd, sd)
    uncertain = PlanarArm(arm().centres, arm().tip, np.stack([np.eye(2)] * 2) * 0.002**2, np.eye(2) * 0.001**2)
    found = compute_reachable_workspace(uncertain, limits, samples=4000)
    random = np.random.default_rng(4)
    drawn = []
    for _ in range(20_000):
        low, high = LOWER_LIMITS + sd * random.standard_normal(2), UPPER_LIMITS + sd * random.standard_normal(2)
        elbow = uncertain.centres[1] + 0.002 * random.standard_normal(2)
        tip = uncertain.tip + 0.001 * random.standard_normal(2)
        turn = np.arctan2(elbow[0], elbow[1]) - np.arctan2(tip[0], tip[1])  # links that are bent in their frames
        ends = np.cos(low[1] + turn) - np.cos(high[1] + turn)
        drawn.append(np.hypot(*elbow) * np.hypot(*tip) * (high[0] - low[0]) * abs(ends))
    assert found.sd == pytest.approx(np.std(drawn), rel=0.05)
    assert found.interval[0] < exact_area(LOWER_LIMITS, UPPER_LIMITS) < found.interval[1]


@pytest.mark.parametrize(
    ("upper", "fore", "bend"),
    [
        (UPPER, FORE, 120.0),
        (0.30, 0.26, 140.0),  # around a small cavity the volumes with fewer samples are right by chance
        pytest.param(0.30, 0.25, 110.0, marks=pytest.mark.slow),
        pytest.param(0.28, 0.24, 150.0, marks=pytest.mark.slow),
    ],
)
def test_the_volume_of_a_shoulder_that_turns_every_way_is_a_shell(upper: float, fore: float, bend: float) -> None:
    still = np.eye(4)
    elbow = still.copy()
    elbow[1, 3] = -upper
    chain = Chain((Revolute((0, 1, 0)), Revolute((1, 0, 0)), Revolute((1, 0, 0))), np.stack([still, still, elbow]))
    bent = np.radians(bend)
    limits = JointLimits.given(np.array([-np.pi, -np.pi, 0.0]), np.array([np.pi, np.pi, bent]))
    found = compute_reachable_workspace(SpatialArm(chain, np.array([0.0, -fore, 0.0])), limits)
    inner = np.sqrt(upper**2 + fore**2 + 2 * upper * fore * np.cos(bent))
    exact = 4 / 3 * np.pi * ((upper + fore) ** 3 - inner**3)
    assert found.measure == pytest.approx(exact, rel=0.03)
    assert found.interval[0] < exact < found.interval[1]
    assert found.discretisation < 0.06 * exact


def test_an_alpha_shape_keeps_a_hole_and_its_edge_encloses_it() -> None:
    angle, share = 2 * np.pi * sobol(6000, 2, 3)[:, 0], sobol(6000, 2, 4)[:, 1]
    radius = np.sqrt(0.3**2 + share * (1 - 0.3**2))
    ring = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    shape = compute_alpha_shape(ring, 0.12)
    assert shape.measure == pytest.approx(np.pi * (1 - 0.3**2), rel=0.02)
    assert compute_measure(ring[shape.boundary()]) == pytest.approx(shape.measure, rel=1e-12)
    assert shape.contains(np.array([[0.0, 0.0], [0.6, 0.0], [2.0, 0.0]])).tolist() == [False, True, False]


def test_the_surface_of_a_ball_encloses_it() -> None:
    points = 2 * sobol(4000, 3, 0) - 1
    ball = points[np.linalg.norm(points, axis=1) < 1]
    shape = compute_alpha_shape(ball, 0.4)
    assert compute_measure(ball[shape.boundary()]) == pytest.approx(shape.measure, rel=1e-12)
    assert compute_alpha_shape(ball, np.inf).measure == pytest.approx(ConvexHull(ball).volume, rel=1e-12)


def test_points_on_a_line_have_no_area() -> None:
    with pytest.raises(ValueError, match="no area"):
        compute_alpha_shape(np.outer(np.linspace(0, 1, 50), [1.0, 2.0]), 1.0)


def test_samples_fill_the_box_and_each_of_its_faces() -> None:
    q = sample_box(LOWER_LIMITS, UPPER_LIMITS, 2000, 0, 2)
    assert ((q >= LOWER_LIMITS) & (q <= UPPER_LIMITS)).all()
    assert len(np.unique(q, axis=0)) > 1990
    for joint in range(2):
        for end in (LOWER_LIMITS, UPPER_LIMITS):
            on = q[q[:, joint] == end[joint], 1 - joint]
            assert len(on) >= 95
            spread = np.sort(on)[[0, -1]]
            assert np.ptp(spread) > 0.95 * (UPPER_LIMITS - LOWER_LIMITS)[1 - joint]
    share = (q - LOWER_LIMITS) / (UPPER_LIMITS - LOWER_LIMITS)
    counts = np.histogram2d(*share.T, bins=4)[0]
    assert counts.min() > 70


def test_samples_of_one_joint_repeat_and_are_within_its_limits() -> None:
    """A joint alone has no face that is a part of an edge in the plane."""
    one, other = (sample_box(np.array([-0.5]), np.array([1.5]), 500, 3, 2) for _ in range(2))
    np.testing.assert_array_equal(one, other)
    assert one.min() >= -0.5 and one.max() <= 1.5
    assert len(np.unique(one)) > 400


def test_limits_are_the_extremes_of_what_was_seen() -> None:
    q = np.linspace(-1, 2, 301)[:, None]
    sd = np.full_like(q, 0.01)
    sd[-2] = 0.03
    seen = np.ones_like(q, dtype=bool)
    seen[-1] = False
    found = find_limits(q, sd, seen)
    assert (found.lower[0], found.upper[0]) == (-1.0, q[-2, 0])
    assert (found.lower_sd[0], found.upper_sd[0]) == (0.01, 0.03)


def test_a_quantile_is_not_moved_by_a_few_wild_samples() -> None:
    random = np.random.default_rng(0)
    q = np.sin(np.linspace(0, 60, 5000))[:, None]
    wild = q.copy()
    wild[random.choice(5000, 20, replace=False)] += 1.5
    sd, seen = np.full_like(q, 0.01), np.ones_like(q, dtype=bool)
    assert find_limits(wild, sd, seen).upper[0] > 2.0
    clean, robust = find_limits(q, sd, seen, 0.01), find_limits(wild, sd, seen, 0.01)
    assert robust.upper[0] == pytest.approx(clean.upper[0], abs=0.01)
    assert clean.lower[0] == pytest.approx(np.quantile(q, 0.01), abs=1e-12)


@pytest.mark.parametrize(("lower", "upper"), [(1.0, 1.0), (2.0, 1.0), (np.nan, 1.0)])
def test_limits_that_are_crossed_or_unknown_are_refused(lower: float, upper: float) -> None:
    with pytest.raises(ValueError, match="joint 1"):
        JointLimits.given(np.array([lower]), np.array([upper]))


def test_gained_and_lost_areas_of_two_squares() -> None:
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41)), axis=-1).reshape(-1, 2)
    square = compute_alpha_shape(grid + 1e-6 * sobol(len(grid), 2, 0), 0.05)
    found = overlay_workspaces(square, square, np.array([0.25, 0.0]))
    assert [found.gained, found.lost, found.kept] == pytest.approx([0.25, 0.25, 0.75], abs=4 * found.sd)


def test_the_planar_arm_is_the_spatial_one_in_its_plane() -> None:
    chain = Chain(
        (Revolute((0, 0, 1)), Revolute((0, 0, 1))), se3.pose(np.eye(3), np.array([[0.1, 1.4, 0.0], [0.0, UPPER, 0.0]]))
    )
    q = np.random.default_rng(1).uniform(-3, 3, (50, 2))
    tips = SpatialArm(chain, np.array([0.0, FORE, 0.0])).tips(q)
    np.testing.assert_allclose(tips[:, :2], arm().tips(q), atol=1e-14)


@pytest.mark.recordings
def test_the_area_of_arm_reach_from_its_recording(reaching_arm: Path, recordings: Path) -> None:
    truth = json.loads((recordings / "simulated" / "arm-reach" / "truth.json").read_text())["reach"]["area_m2"]
    for chosen in ("WRST", None):
        subject = read_arm(reaching_arm, chosen)
        reach = measure_workspace(subject)
        assert subject.tip == "WRST"
        assert reach.measure == pytest.approx(truth, rel=0.01)
        low, high = reach.interval
        assert low < truth < high
        assert high - low < 0.05 * truth


@pytest.mark.recordings
def test_artefacts_of_two_runs_in_one_folder_are_refused(reaching_arm: Path, tmp_path: Path) -> None:
    mixed = tmp_path / "mixed"
    shutil.copytree(load(reaching_arm).out, mixed)
    folder = Folder(mixed)
    chain = folder.read("chain.h5")
    assert isinstance(chain, Tree)
    joints = dict(chain.data["joints"])
    other = replace(chain, data={**chain.data, "joints": joints | {"centre": 1.1 * np.asarray(joints["centre"])}})
    origin = replace(folder.provenance("chain.h5").origin, key="of another run")
    (mixed / "chain.h5").write_bytes(encode_tree(other, origin))
    with pytest.raises(StoreError, match=r"chain.h5 is damaged or was edited"):
        read_arm(mixed)
    shutil.rmtree(mixed / ".mocap-id")  # the files alone still tell what they were made from
    with pytest.raises(StoreError, match=r"states.parquet was not made from the chain.h5 in"):
        read_arm(mixed)
