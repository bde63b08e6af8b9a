"""Rigid bodies and the joint between two of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_id.kinematics.joint import fit_joint
from mocap_id.kinematics.rigid import fit_body, marker_residuals, still_body

SEEDS = st.integers(0, 1000)


@given(SEEDS)
def test_a_rigid_body_is_recovered_exactly_with_gaps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    place = rng.standard_normal(5) + 1j * rng.standard_normal(5)
    turn = np.exp(1j * np.cumsum(rng.normal(0, 0.1, 80)))
    path = np.cumsum(rng.normal(0, 0.02, 80) + 1j * rng.normal(0, 0.02, 80))
    points = path[:, None] + turn[:, None] * place
    points[rng.uniform(size=points.shape) < 0.2] = np.nan
    body = fit_body(points, np.arange(5))
    known = np.isfinite(body.rotation)
    assert body.residual < 1e-7
    rebuilt = body.position[known, None] + body.rotation[known, None] * body.template
    assert np.nanmax(np.abs(rebuilt - points[known])) < 1e-6
    assert (known == (np.isfinite(points).sum(axis=1) >= 2)).all()


def test_the_residual_is_the_noise_less_the_poses_it_took() -> None:
    rng = np.random.default_rng(3)
    place = rng.standard_normal(10) + 1j * rng.standard_normal(10)
    noise = 1e-3 * (rng.standard_normal((3000, 10)) + 1j * rng.standard_normal((3000, 10)))
    body = fit_body(place + noise, np.arange(10))
    freedom = (2 * 10 - 3) / (2 * 10)  # a pose takes three of the twenty coordinates of a frame
    assert body.residual == pytest.approx(1e-3 * np.sqrt(2 * freedom), rel=0.01)


def test_an_intruder_shows_in_its_residual(chain) -> None:
    truth = chain(5, noise=1e-4)
    body = fit_body(truth.points, np.flatnonzero(truth.segment == 2))
    residuals = marker_residuals(body, truth.points)
    own = truth.segment == 2
    assert residuals[own].max() < 5e-4
    assert residuals[~own].min() > 10 * residuals[own].max()


@given(seed=SEEDS)
def test_a_joint_between_two_bodies_is_exact(chain, seed: int) -> None:
    truth = chain(seed, joints=2)
    parent = fit_body(truth.points, np.flatnonzero(truth.segment == 1))
    child = fit_body(truth.points, np.flatnonzero(truth.segment == 2))
    joint = fit_joint(parent, child)
    met = parent.position + parent.rotation * joint.in_parent
    angle = np.cumsum(truth.relative, axis=1)
    knee = truth.centres[0] + np.exp(1j * angle[:, 0]) * truth.centres[1]
    assert joint.residual < 1e-6
    assert np.abs(met - knee).max() < 1e-5
    spread = np.quantile(truth.relative[:, 1], [0.025, 0.975])
    assert joint.arc == pytest.approx(spread[1] - spread[0], abs=1e-6)


def test_bodies_that_are_never_seen_together_have_no_joint(chain) -> None:
    points = chain(1, joints=2).points.copy()
    points[:200, 4:9] = np.nan
    points[200:, 9:] = np.nan
    joint = fit_joint(fit_body(points, np.arange(4, 9)), fit_body(points, np.arange(9, 14)))
    assert joint.residual == np.inf
    assert joint.arc == 0


def test_the_base_is_the_plane_frame(chain) -> None:
    points = chain(2).points
    base = still_body(points, np.arange(4))
    assert base.residual < 1e-12
    assert np.allclose(base.local(points), points)
