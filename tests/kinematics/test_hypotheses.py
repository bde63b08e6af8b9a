"""Hypotheses for every number of segments, with the reasons why they lost."""

from __future__ import annotations

import re

import numpy as np
import pytest

from mocap_id.kinematics.clusters import Constraints
from mocap_id.kinematics.link_fit import SegmentationRules
from mocap_id.kinematics.segmentation import segment_markers


@pytest.mark.parametrize("seed", range(4))
def test_the_best_of_each_number_equals_the_result_for_this_count(chain, seed: int) -> None:
    truth = chain(seed, noise=1e-3)
    free = segment_markers(truth.points, truth.lateral, SegmentationRules(longest=9)).hypotheses
    for count in {len(hypothesis.chain) + 1 for hypothesis in free}:
        asked = segment_markers(truth.points, truth.lateral, SegmentationRules(count=count, longest=9)).hypotheses
        cheapest = min(hypothesis.cost for hypothesis in free if len(hypothesis.chain) + 1 == count)
        bodies = {tuple(body.markers) for hypothesis in free for body in (*hypothesis.chain, *hypothesis.left_out)}
        of_bodies = [h.cost for h in asked if {tuple(body.markers) for body in h.chain} <= bodies]
        assert min(of_bodies, default=asked[0].cost) >= cheapest >= asked[0].cost
    assert {2, 3, 4} <= {len(hypothesis.chain) + 1 for hypothesis in free}


@pytest.mark.parametrize("longest", [2, 3, 6])
@pytest.mark.parametrize("seed", range(4))
def test_the_reasons_add_up_to_the_difference_in_cost(chain, seed: int, longest: int) -> None:
    truth = chain(seed, noise=2e-3)
    found = segment_markers(truth.points, truth.lateral, SegmentationRules(longest=longest)).hypotheses
    assert found[0].best_of_level and found[0].explain_cost(found[0]) == "chosen"
    assert [h.cost for h in found] == sorted(h.cost for h in found)
    assert all(len(h.chain) < longest for h in found)
    chains = [tuple(tuple(body.markers) for body in h.chain) for h in found]
    assert len(set(chains)) == len(chains)
    for other in found[1:]:
        why = other.explain_cost(found[0])
        stated = float(re.match(r"costs ([\d.]+) more", why)[1])
        terms = [
            float(number.replace("\N{MINUS SIGN}", "-")) for number in re.findall(r"\(([+\N{MINUS SIGN}][\d.]+)\)", why)
        ]
        assert stated == pytest.approx(other.cost - found[0].cost, abs=0.05)
        assert sum(terms) == pytest.approx(stated, abs=0.35)  # each of the terms is rounded


def with_stiff_tip(truth, share: float, noise: float) -> np.ndarray:
    """Return a chain's trajectories with the arc of its last joint reduced to a share."""
    angle = np.cumsum(truth.relative, axis=1)
    arms = np.exp(1j * np.pad(angle[:, :-1], ((0, 0), (1, 0)))) * truth.centres
    last = truth.relative[:, -1]
    back = np.exp(1j * (share - 1) * (last - last.mean()))[:, None]
    points, tip, joint = truth.points.copy(), truth.segment == truth.segment.max(), arms.sum(axis=1)[:, None]
    points[:, tip] = joint + back * (points[:, tip] - joint)
    rng = np.random.default_rng(1)
    return points + noise * (rng.standard_normal(points.shape) + 1j * rng.standard_normal(points.shape))


@pytest.mark.parametrize(("seed", "share"), [(0, 0.3), (1, 0.5), (1, 0.7), (2, 0.5)])
def test_a_shorter_count_merges_the_bending_tip_into_the_last_segment(chain, seed: int, share: float) -> None:
    """A trunk that bends on its pelvis belongs to the torso; cut at the pelvis (seed 1), the chain has no trunk."""
    truth = chain(seed, joints=4)
    points = with_stiff_tip(truth, share, noise=1e-3)
    assert (segment_markers(points, truth.lateral, SegmentationRules()).segment == truth.segment).all()
    asked = segment_markers(points, truth.lateral, SegmentationRules(count=4))
    assert (asked.segment == np.minimum(truth.segment, 3)).all()
    assert not any(np.isin(body.markers, asked.hypotheses[0].markers).any() for body in asked.hypotheses[0].left_out)


def test_bodies_kept_apart_are_not_merged_into_a_last_segment(chain) -> None:
    truth = chain(0, joints=4)
    points = with_stiff_tip(truth, 0.3, noise=1e-3)
    of = [np.flatnonzero(truth.segment == k) for k in (3, 4)]
    constraints = Constraints.of(points.shape[1], apart=[[int(of[0][0]), int(of[1][0])]])
    asked = segment_markers(points, truth.lateral, SegmentationRules(count=4), constraints)
    assert asked.segment[of[0][0]] != asked.segment[of[1][0]]
