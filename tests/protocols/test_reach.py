"""Ranges, geometry and reaches of an arm from its angles and poses, and what the artefact says of them."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from mocap_id.protocols.reach import (
    ANGLES,
    ReachArm,
    RecordedArm,
    UnknownReach,
    compute_workspace,
    find_reaches,
    locate_body_targets,
    measure_arm,
    measure_ranges,
)
from mocap_id.store import Table, Tree
from mocap_id.store.artefacts import MeasuredPoses, SpatialAngles, SpatialSkeleton
from spatial_trial import SpatialTrial


def views(trial: SpatialTrial) -> tuple[SpatialAngles, MeasuredPoses, SpatialSkeleton]:
    artefacts = trial.artefacts()
    angles, poses, chain = (artefacts[name] for name in ("angles.parquet", "poses.parquet", "chain.h5"))
    assert isinstance(angles, Table) and isinstance(poses, Table) and isinstance(chain, Tree)
    return SpatialAngles(angles), MeasuredPoses(poses), SpatialSkeleton(chain)


def altered(view: Any, **fields: Any) -> Any:
    """Return a copy of a view with other values of these fields."""
    other = copy(view)
    vars(other).update(fields)
    return other


def test_noise_of_a_skeleton_does_not_make_a_range_larger() -> None:
    angles, poses, _ = views(SpatialTrial())
    flexion, rng, noise = angles.names.index("elbow_flexion"), np.random.default_rng(0), np.radians(5.0)
    true = measure_ranges(angles, poses)["elbow_flexion"]
    sd = angles.sd.copy()
    sd[:, flexion, 0] = noise
    plain, corrected = [], []
    for _ in range(20):  # noise that lasts as long as a held posture
        held = np.repeat(rng.normal(0, noise, len(angles.time) // 30 + 1), 30)[: len(angles.time)]
        mean = angles.mean.copy()
        mean[:, flexion, 0] += held
        noisy = altered(angles, mean=mean, sd=sd)
        for widths, skeleton in ((plain, False), (corrected, True)):
            found = measure_ranges(noisy, poses, skeleton=skeleton)["elbow_flexion"]
            widths.append(found.high - found.low - (true.high - true.low))
    assert np.mean(plain) > 0.5 * noise
    assert abs(np.mean(corrected)) < 0.5 * np.mean(plain)
    elevation = measure_ranges(angles, poses, skeleton=True)["shoulder_elevation"]
    assert elevation.low_sd > np.radians(7), "recorded cameras show raised arms up to 20° too high"


def test_a_range_smaller_than_the_noise_is_empty() -> None:
    angles, poses, _ = views(SpatialTrial())
    sd = np.full_like(angles.sd, 3.0)
    found = measure_ranges(altered(angles, sd=sd), poses, skeleton=True)["elbow_flexion"]
    assert found.low == found.high


def test_single_samples_and_the_gimbal_move_no_end() -> None:
    angles, poses, _ = views(SpatialTrial())
    before = measure_ranges(angles, poses)
    wrong = angles.mean.copy()
    flexion, plane = angles.names.index("elbow_flexion"), angles.names.index("shoulder_plane")
    wrong[200:203, flexion, 0] += 2.0
    wrong[angles.near_gimbal, plane, 0] += 1.0
    after = measure_ranges(altered(angles, mean=wrong), poses)
    assert after["elbow_flexion"].high == pytest.approx(before["elbow_flexion"].high, abs=0.01)
    assert after["shoulder_plane"] == before["shoulder_plane"]
    assert 0 < before["shoulder_plane"].used_share < before["elbow_flexion"].used_share <= 1
    exact = np.ptp(angles.mean[:, flexion, 0])
    assert before["elbow_flexion"].high - before["elbow_flexion"].low == pytest.approx(exact, abs=0.02)


def test_the_geometry_is_that_of_the_chain() -> None:
    angles, poses, skeleton = views(SpatialTrial())
    found = measure_arm(angles, poses, skeleton)
    glide = skeleton.chain.joints[0].glide
    assert np.allclose(found.arm.elbow, skeleton.chain.joints[1].centre, atol=1e-6)
    assert np.allclose(found.glide, glide, atol=1e-6)
    assert found.arm.rise == pytest.approx(float(glide[1]), abs=1e-6)
    reach = np.linalg.norm(found.wrists, axis=1)
    assert np.nanmax(reach) <= found.arm.length + 1e-9
    flexion = angles.mean[:, angles.names.index("elbow_flexion"), 0]
    assert np.allclose(np.linalg.norm(found.arm.wrist(flexion), axis=1), reach, atol=1e-6)


def test_the_interval_grows_with_the_errors() -> None:
    angles, poses, skeleton = views(SpatialTrial(frames=2500))
    arm, ranges = measure_arm(angles, poses, skeleton), measure_ranges(angles, poses)
    box, visited, sd, sources = compute_workspace(arm, ranges, None)
    assert visited is None
    low, high = box["interval_m3"]
    assert low < box["volume_m3"] < high
    assert sum(sources.values()) == pytest.approx(1)
    worse = {name: replace(one, low_sd=2 * one.low_sd, high_sd=2 * one.high_sd) for name, one in ranges.items()}
    assert compute_workspace(arm, worse, None)[2] > 1.1 * sd
    longer = compute_workspace(replace(arm, forearm_sd=0.02), ranges, None)
    assert longer[3]["forearm"] > sources["forearm"]


def test_ranges_without_a_volume_are_refused() -> None:
    angles, poses, skeleton = views(SpatialTrial())
    arm, ranges = measure_arm(angles, poses, skeleton), measure_ranges(angles, poses)
    point = {name: replace(one, high=one.low) for name, one in ranges.items()}
    with pytest.raises(UnknownReach, match="too small for a volume"):
        compute_workspace(arm, point, None)


@pytest.mark.parametrize("lost", [*ANGLES, "forearm", "centre"])
def test_a_trial_without_what_is_needed_says_what_is_missing(lost: str) -> None:
    angles, poses, skeleton = views(SpatialTrial(known=lost != "centre"))
    if lost in angles.names:
        kept = [k for k, name in enumerate(angles.names) if name != lost]
        names = tuple(angles.names[k] for k in kept)
        angles = altered(angles, names=names, mean=angles.mean[:, kept])
    if lost == "forearm":
        poses = altered(poses, segments=("thorax", "upper_arm", "lower", "hand"))
    with pytest.raises(UnknownReach, match=lost.replace("_", " ")):
        measure_arm(angles, poses, skeleton)


def moving_hand(places: list[np.ndarray], rate: float = 100.0) -> tuple[np.ndarray, RecordedArm]:
    """Return an arm whose palm visits places for half a second each, with a second between them."""
    step = np.linspace(0, 1, int(rate))
    smooth = (step**3 * (10 - 15 * step + 6 * step**2))[:, None]
    pause = np.ones((int(rate / 2), 1))
    path = [places[0] * np.ones((50, 1))]
    for a, b in pairwise(places):
        path += [a + smooth * (b - a), pause * b]
    palms = np.concatenate(path)
    arm = ReachArm(np.array([0.0, -0.3, 0.0]), 0.25, np.zeros(3), 0.0)
    shoulder = np.array([-0.03, -0.02, 0.16])
    everywhere = np.ones(len(palms), dtype=bool)
    whole = RecordedArm(
        arm, 0.002, 0.002, 0.005, shoulder, np.zeros(3), palms, palms, palms, measured=everywhere, stature=1.66
    )
    return np.arange(len(palms)) / rate, whole


def test_reaches_are_found_with_their_targets_and_misses() -> None:
    home = np.array([0.25, -0.45, 0.05])
    _, arm = moving_hand([home, home + 0.1])
    targets = locate_body_targets(arm)
    short = targets["mouth"] + np.array([0.2, 0.0, 0.0])
    time, arm = moving_hand([home, targets["opposite_shoulder"], home, targets["head"], short, home])
    found = find_reaches(time, arm)
    assert [one.target for one in found] == ["opposite_shoulder", "head", "mouth"]
    assert [one.complete for one in found] == [True, True, True]
    assert found[0].miss == found[1].miss == 0
    assert found[2].miss == pytest.approx(0.2 - 0.05 * arm.stature, abs=1e-3)
    assert found[0].start == pytest.approx(0.6, abs=0.25)
    assert found[0].top == pytest.approx(1.75, abs=0.2)
    assert found[0].end == pytest.approx(3.0, abs=0.35)
    away = np.array([0.5, -0.1, 0.1])
    time, arm = moving_hand([home, away])
    (last,) = find_reaches(time, arm)
    assert last.target == "none" and np.isnan(last.miss) and not last.complete
    assert find_reaches(time, replace(arm, palms=np.full_like(arm.palms, np.nan))) == ()


def test_events_of_a_reach_where_the_arm_is_not_measured_are_unknown() -> None:
    home = np.array([0.25, -0.45, 0.05])
    _, arm = moving_hand([home, home + 0.1])
    targets = locate_body_targets(arm)
    time, arm = moving_hand([home, targets["opposite_shoulder"], home, targets["head"], home])
    wrong = (time > 1.4) & (time < 2.1)
    bridged = np.where(wrong[:, None], arm.palms + np.array([0.0, 0.15, 0.0]), arm.palms)
    first, second = find_reaches(time, replace(arm, palms=bridged, wrists=bridged, measured=~wrong))
    assert np.isnan(first.top)
    assert "not measured at its top" in first.why
    assert (first.target, first.miss) == ("none", pytest.approx(np.nan, nan_ok=True)) or first.miss == 0
    assert np.isfinite([second.start, second.top, second.end, second.miss]).all()
    assert not second.why


def test_a_chain_that_is_no_arm_has_no_reach() -> None:
    angles, poses, skeleton = views(SpatialTrial())
    upper, lower = poses.segments.index("upper_arm"), poses.segments.index("forearm")
    loose = poses.origin.copy()
    loose[:, upper, 1] += 0.2 * np.sin(poses.time)
    with pytest.raises(UnknownReach, match="moves by"):
        measure_arm(angles, altered(poses, origin=loose), skeleton)
    short = poses.origin.copy()
    short[:, lower] = 0.6 * short[:, upper] + 0.4 * short[:, lower]
    with pytest.raises(UnknownReach, match="expected a ratio"):
        measure_arm(angles, altered(poses, origin=short), skeleton)


def test_segments_that_are_never_seen_together_are_named() -> None:
    angles, poses, skeleton = views(SpatialTrial())
    for name, pair in (("upper_arm", "thorax and upper arm"), ("forearm", "upper arm and forearm")):
        lost = poses.origin.copy()
        lost[:, poses.segments.index(name)] = np.nan
        with pytest.raises(UnknownReach, match=pair):
            measure_arm(angles, altered(poses, origin=lost), skeleton)
    plain = views(SpatialTrial(arm=False))
    with pytest.raises(UnknownReach, match="no thorax"):
        measure_arm(*plain)
    assert set(measure_ranges(*plain[:2])) == set(plain[0].names)
