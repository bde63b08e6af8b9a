"""The chain fitted link by link: by pairs of rigid bodies, and by the circles of the thesis."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from scipy import optimize

from mocap_id.errors import NumericalError, Refused
from mocap_id.kinematics.bundle import LinkMethod, circle_links, fit_chain, fit_links, rigid_body_links
from mocap_id.kinematics.chain_fit import joint_angles, orient_frames
from mocap_id.kinematics.joint import fit_common_centre
from mocap_id.stages.base import Context
from mocap_id.stages.fit_joints import STAGE
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.store import LongTable, Table, Tree
from mocap_id.store.provenance import PLANAR, SEGMENTS

METHODS = get_args(LinkMethod)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("joints", [1, 2, 3, 4])
def test_a_clean_chain_is_recovered_exactly_with_gaps(chain, joints: int, method: LinkMethod) -> None:
    truth = chain(joints, joints=joints, missing=0.1)
    fit = orient_frames(fit_links(truth.points, truth.segment, method))
    assert np.abs(fit.centres - truth.centres).max() < 1e-6
    assert fit.residual.max() < 1e-6
    angles = joint_angles(fit.angles)
    known = np.isfinite(angles).all(axis=1)
    off = angles[known] - truth.relative[known]  # the last segment's angle is known up to a constant
    assert np.abs(off - off.mean(axis=0)).max() < 1e-5
    assert np.abs(off[:, :-1]).max(initial=0) < 1e-5
    spread = np.quantile(truth.relative[known], [0.025, 0.975], axis=0)
    assert fit.arcs == pytest.approx(spread[1] - spread[0], abs=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_the_result_is_a_chain_fit_as_from_the_bundle(chain, method: LinkMethod) -> None:
    truth = chain(3, noise=5e-4, missing=0.05)
    fit, whole = (orient_frames(each) for each in (fit_links(truth.points, truth.segment, method), chain_of(truth)))
    assert fit.lengths == pytest.approx(whole.lengths, abs=3e-3)
    assert (np.isfinite(fit.angles) == np.isfinite(whole.angles)).all()
    assert np.nanmax(np.abs(joint_angles(fit.angles) - joint_angles(whole.angles))) < np.radians(2)
    assert fit.residual == pytest.approx(reprojected(truth.points, fit), rel=1e-9)
    assert np.sum(fit.residual**2) > np.sum(whole.residual**2)  # the bundle minimises this
    assert fit.arcs == pytest.approx(whole.arcs, abs=np.radians(1))


def chain_of(truth):
    return fit_chain(truth.points, truth.segment)


def reprojected(points, fit):
    """Return the rms distance of every marker from its place on the chain, marker by marker."""
    found = []
    for marker, link in enumerate(fit.segment):
        place, turn = np.zeros(len(points), dtype=complex), np.ones(len(points), dtype=complex)
        for k in range(link):
            place, turn = place + turn * fit.centres[k], np.exp(1j * fit.angles[:, k])
        distance = np.abs(points[:, marker] - place - turn * fit.local[marker])
        found.append(np.sqrt(np.nanmean(distance**2)))
    return np.array(found)


def test_circles_are_the_recursion_of_the_thesis(chain) -> None:
    """Each link follows 3.8 (centre), 3.16 (angles) and 3.9 (mapping of the rest)."""
    truth = chain(4, joints=2, noise=1e-3, frames=60)
    state = circle_links(truth.points, truth.segment)
    first, second = truth.points[:, truth.segment == 1], truth.points[:, truth.segment == 2]
    assert state.centres[0] == fit_common_centre(first)
    own = np.flatnonzero(truth.segment == 1)

    def off(unknown):
        local, angle = unknown[:10:2] + 1j * unknown[1:10:2], unknown[10:]
        z = state.centres[0] + np.exp(1j * angle)[:, None] * local - first
        return np.concatenate([z.real.ravel(), z.imag.ravel()])

    found = np.concatenate(
        [np.stack([state.local[own].real, state.local[own].imag], axis=1).ravel(), state.angles[:, 0]]
    )
    best = optimize.least_squares(off, found, xtol=1e-15, ftol=1e-15)
    assert np.sum(off(found) ** 2) == pytest.approx(2 * best.cost, rel=1e-7)
    seen_from = np.exp(-1j * state.angles[:, :1]) * (second - state.centres[0])
    assert state.centres[1] == pytest.approx(fit_common_centre(seen_from), abs=1e-12)


def test_an_error_propagates_through_circles_but_not_through_bodies(chain) -> None:
    """The circles of the first link are distorted; joint 3 relative to the exact segment 2 shows the effect."""
    truth = chain(6, joints=3)
    bent = truth.points.copy()
    slow = 0.01 * np.sin(np.linspace(0, 9, len(bent)))[:, None]
    bent[:, truth.segment == 1] += slow * np.array([1, -1, 1j, -1j, 0.5])
    moved = {}
    for method, estimate in (("circle", circle_links), ("rigid-body", rigid_body_links)):
        before, after = (estimate(points, truth.segment) for points in (truth.points, bent))
        own = truth.segment == 2
        distance = [np.abs(state.centres[2] - state.local[own]) for state in (before, after)]
        moved[method] = np.abs(distance[1] - distance[0]).max()
    assert moved["circle"] > 1e-3
    assert moved["rigid-body"] < 1e-12


def test_standard_deviations_match_repetition(chain) -> None:
    fits = []
    for seed in range(40):
        truth = chain(9, frames=300)
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal(truth.points.shape) + 1j * rng.standard_normal(truth.points.shape)
        fits.append(fit_links(truth.points + 1e-3 * noise, truth.segment, "rigid-body"))
    spread = np.std([fit.lengths for fit in fits], axis=0)
    stated = np.mean([fit.length_sd for fit in fits], axis=0)
    assert stated == pytest.approx(spread, rel=0.35)  # sampling error: 11 % of the spread of 40, 16 % of the stated
    centre = np.array([fit.centres[0] for fit in fits])
    first = np.mean([np.diag(fit.covariance[0]) for fit in fits], axis=0)
    assert np.sqrt(first) == pytest.approx([centre.real.std(), centre.imag.std()], rel=0.35)


def test_circles_have_no_standard_deviation(chain) -> None:
    truth = chain(9, noise=1e-3)
    fit = orient_frames(fit_links(truth.points, truth.segment, "circle"))
    assert np.isnan(fit.covariance).all()
    assert np.isnan(fit.length_sd).all()
    assert np.isfinite(fit.centres).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_segment_that_is_hardly_seen_is_refused(chain, method: LinkMethod) -> None:
    truth = chain(14)
    points = truth.points.copy()
    points[20:, truth.segment == 2] = np.nan
    with pytest.raises(Refused, match="20 of 400 frames contain at least two markers") as refused:
        fit_links(points, truth.segment, method)
    assert refused.value.code == "too-few-frames"


@pytest.mark.parametrize("estimator", ["bundle", *METHODS])
def test_the_stage_says_which_estimator_it_used(chain, estimator: str) -> None:
    chained = staged(chain(15, joints=2, noise=3e-4), estimator=estimator)
    assert chained.facts["estimator"] == estimator
    assert [reason.code for reason in chained.reasons] == ([] if estimator == "bundle" else ["estimator"])
    known = np.isfinite(chained.data["joints"]["covariance"]).all()
    assert known == (estimator != "circle")


def staged(truth, **settings) -> Tree:
    """Run fit-joints on a chain of two joints."""
    frames, count = truth.points.shape
    names = [f"M{i:02}" for i in range(count)]
    values = {"x": truth.points.real, "y": truth.points.imag, "z": np.zeros((frames, count))}
    seen = {"visible": np.isfinite(truth.points)}
    facts = {"rate_hz": 100.0, "bursts": {}}
    planar = LongTable(PLANAR, np.arange(frames), np.arange(frames) / 100, names, values | seen, facts)
    segments = {"marker": np.array(names, dtype=object), "segment": truth.segment}
    named = {"names": ["foot", "shank", "thigh"], "joint_names": ["ankle", "knee"], "joint_markers": {}}
    inputs = {"planar.parquet": planar, "segments.parquet": Table(SEGMENTS, segments, named)}
    trial = TrialKeys(trial="swing", recording=Files(markers=Path("swing.c3d")))
    (tree,) = STAGE.function(Context(trial, STAGE.settings(**settings), inputs))
    assert isinstance(tree, Tree)
    return tree


def test_straight_lines_have_no_circle() -> None:
    base = np.tile([0j, 1 + 0j], (100, 1))
    sliding = np.linspace(0, 1, 100)[:, None] + np.array([0.2j, 0.4j, 0.5 + 0.3j])
    with pytest.raises(NumericalError, match="segment 1 move on straight lines relative to segment 0"):
        fit_links(np.concatenate([base, sliding], axis=1), np.array([0, 0, 1, 1, 1]), "circle")
