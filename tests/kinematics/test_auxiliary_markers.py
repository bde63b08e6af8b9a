"""Markers around a joint that pull its centre (p_A of 3.15, lambda_A of 3.16)."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.kinematics.bundle import fit_chain, rigid_body_links

ANKLE = 0.05 + 0.1j
SEGMENT = np.array([0] * 3 + [1] * 6)
PULL = 0.01


def ankle(seed: int, slip: complex = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return a shank with an arc of 13 degrees, skin slide ``slip`` (m), and a marker on the joint; noise 0.5 mm."""
    rng = np.random.default_rng(seed)
    angle = np.radians(6.5) * np.sin(np.linspace(0, 6 * np.pi, 300))
    local = rng.uniform(-0.06, 0.06, 6) + 1j * rng.uniform(0.05, 0.4, 6)
    skin = slip * angle[:, None] / np.radians(13)
    shank = ANKLE + np.exp(1j * angle)[:, None] * (local + skin)
    still = np.tile([-0.1, 0.0, 0.15, ANKLE], (300, 1))
    points = np.concatenate([still[:, :3], shank, still[:, 3:]], axis=1)
    points = points + 5e-4 * (rng.standard_normal(points.shape) + 1j * rng.standard_normal(points.shape))
    return points[:, :-1], points[:, -1]


def off(slip: complex = 0.0, error: complex = 0.0, pull: float = PULL) -> tuple[float, float]:
    """Return the rms error of the centre, mm, without and with a joint marker misplaced by ``error``."""
    centres = []
    for seed in range(5):
        points, marker = ankle(seed, slip)
        plain, pulled = fit_chain(points, SEGMENT), fit_chain(points, SEGMENT, {1: marker + error}, pull)
        centres.append([plain.centres[0], pulled.centres[0]])
    without, with_marker = 1e3 * np.sqrt(np.mean(np.abs(np.array(centres) - ANKLE) ** 2, axis=0))
    return float(without), float(with_marker)


@pytest.mark.parametrize("slip", [2e-3, 2e-3j, 3.4e-3, 3.4e-3j])
def test_a_marker_on_the_joint_helps_where_skin_slips(slip: complex) -> None:
    """Measured: 15.0 mm falls to 5.1 or, with skin that slides along the shank, to 11.9."""
    without, pulled = off(slip)
    assert without == pytest.approx(1e3 * abs(slip) / np.radians(13), rel=0.03)  # the slide is invisible otherwise
    assert pulled < 0.85 * without


@pytest.mark.parametrize(("error", "spoilt"), [(5e-3, 0.9), (5e-3j, 2.5), (0.01j, 5.0)])
def test_a_marker_beside_the_joint_harms_a_clean_fit(error: complex, spoilt: float) -> None:
    """Measured: 0.5 mm grows to 1.1, 3.2 and 6.3."""
    without, pulled = off(0.0, error)
    assert without < 0.8
    assert pulled > spoilt


@pytest.mark.parametrize("slip", [0.0, 3.4e-3])
def test_the_centre_moves_to_the_marker_as_the_pull_grows(slip: float) -> None:
    points, marker = ankle(1, slip)
    there = marker.mean() + 0.006 - 0.003j
    track = marker + 0.006 - 0.003j
    distance = [
        abs(fit_chain(points, SEGMENT, {1: track}, pull).centres[0] - there) for pull in 10.0 ** np.arange(-6, 7)
    ]
    plain = abs(fit_chain(points, SEGMENT).centres[0] - there)
    assert distance[0] == pytest.approx(plain, rel=1e-2)
    assert (np.diff(distance) < 0).all()
    assert distance[-1] < 1e-6


def test_without_joint_markers_the_pull_has_no_effect(chain) -> None:
    truth = chain(21, noise=1e-3, missing=0.05)
    plain = fit_chain(truth.points, truth.segment)
    for same in (fit_chain(truth.points, truth.segment, {}, 7.0), fit_chain(truth.points, truth.segment, None, 1e6)):
        for name in ("centres", "local", "angles", "covariance", "residual"):
            np.testing.assert_array_equal(getattr(same, name), getattr(plain, name))


def joints_of(truth) -> np.ndarray:
    """Return the joint positions (F, n)."""
    turn = np.exp(1j * np.cumsum(truth.relative, axis=1))
    return np.cumsum(
        np.concatenate([truth.centres[:1] + 0 * turn[:, :1], turn[:, :-1] * truth.centres[1:]], axis=1), axis=1
    )


@pytest.mark.parametrize("joint", [1, 2, 3])
@pytest.mark.parametrize("pull", [PULL, 1e3])
def test_an_exact_joint_marker_changes_nothing(chain, joint: int, pull: float) -> None:
    """The chain is exact too, with one coordinate per marker."""
    truth = chain(22)
    fit = fit_chain(truth.points, truth.segment, {joint: joints_of(truth)[:, joint - 1]}, pull)
    assert np.abs(np.abs(fit.centres) - np.abs(truth.centres)).max() < 1e-8
    assert fit.local.shape == fit.residual.shape == truth.segment.shape
    assert fit.residual.max() < 1e-8


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_only_the_named_joint_moves_to_the_marker(chain, joint: int) -> None:
    """In their own segments, the other joints hardly move; the marker is 5 mm from its joint, fixed to the parent."""
    truth = chain(23, noise=3e-4)
    carried = np.exp(1j * np.concatenate([[0 * truth.relative[:, 0]], np.cumsum(truth.relative, axis=1).T])[joint - 1])
    track = joints_of(truth)[:, joint - 1] + 5e-3j * carried
    plain = positions(fit_chain(truth.points, truth.segment))
    pulled = positions(fit_chain(truth.points, truth.segment, {joint: track}, 1e4))
    moved = np.sqrt(np.mean(np.abs(pulled - plain) ** 2, axis=0))
    named = np.arange(3) == joint - 1
    assert moved[named] == pytest.approx(5e-3, rel=0.1)
    assert np.sqrt(np.mean(np.abs(pulled[:, joint - 1] - track) ** 2)) < 1e-4
    assert moved[~named].max() < 2e-3


def positions(fit) -> np.ndarray:
    """Return the joint positions (F, n) of a fitted chain."""
    turn = np.exp(1j * fit.angles)
    arms = np.concatenate([np.full((len(turn), 1), fit.centres[0]), turn[:, :-1] * fit.centres[1:]], axis=1)
    return np.cumsum(arms, axis=1)


def test_two_joints_may_be_named_in_any_order(chain) -> None:
    truth = chain(24, noise=5e-4)
    marks = joints_of(truth) + 3e-3
    one = fit_chain(truth.points, truth.segment, {1: marks[:, 0], 3: marks[:, 2]}, 0.1)
    other = fit_chain(truth.points, truth.segment, {3: marks[:, 2], 1: marks[:, 0]}, 0.1)
    assert other.centres == pytest.approx(one.centres, abs=1e-9)
    assert one.centres[0] != pytest.approx(fit_chain(truth.points, truth.segment).centres[0], abs=1e-5)


def test_missing_samples_do_no_harm() -> None:
    points, marker = ankle(2, 3.4e-3)
    plain = fit_chain(points, SEGMENT).centres[0]
    never = fit_chain(points, SEGMENT, {1: np.full(len(marker), np.nan + 0j)}, PULL)
    assert never.centres[0] == pytest.approx(plain, abs=1e-9)
    assert np.isfinite(never.covariance).all()
    holed = marker.copy()
    holed[np.random.default_rng(0).uniform(size=len(marker)) < 0.5] = np.nan
    half = fit_chain(points, SEGMENT, {1: holed}, 2 * PULL).centres[0]
    whole = fit_chain(points, SEGMENT, {1: marker}, PULL).centres[0]
    assert abs(half - whole) < 0.05 * abs(whole - plain)  # half the samples at twice the weight


def test_a_joint_marker_seen_only_without_its_segment_is_not_used(chain) -> None:
    truth = chain(25, noise=5e-4)
    points = truth.points.copy()
    points[:100, truth.segment == 2] = np.nan
    track = np.where(np.arange(len(points)) < 100, 9.0 + 0j, np.nan)
    plain = fit_chain(points, truth.segment)
    assert fit_chain(points, truth.segment, {2: track}, 1e3).centres == pytest.approx(plain.centres, abs=1e-9)
    assert np.isnan(rigid_body_links(points, truth.segment).angles[:100, 1]).all()
