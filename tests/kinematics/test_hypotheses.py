"""Every number of segments that was weighed up is kept, with the reason why it lost."""

from __future__ import annotations

import re

import pytest

from mocap_id.kinematics import SegmentationRules, segment_markers


@pytest.mark.parametrize("seed", range(4))
def test_the_best_of_each_number_is_what_asking_for_that_number_finds(chain, seed: int) -> None:
    truth = chain(seed, noise=1e-3)
    free = segment_markers(truth.points, truth.lateral, SegmentationRules(longest=9)).hypotheses
    for count in {len(hypothesis.chain) + 1 for hypothesis in free}:
        asked = segment_markers(truth.points, truth.lateral, SegmentationRules(count=count, longest=9))
        cheapest = min(hypothesis.cost for hypothesis in free if len(hypothesis.chain) + 1 == count)
        assert asked.hypotheses[0].cost == cheapest
    assert {2, 3, 4} <= {len(hypothesis.chain) + 1 for hypothesis in free}


@pytest.mark.parametrize("longest", [2, 3, 6])
@pytest.mark.parametrize("seed", range(4))
def test_the_reasons_add_up_to_the_difference_in_cost(chain, seed: int, longest: int) -> None:
    truth = chain(seed, noise=2e-3)
    found = segment_markers(truth.points, truth.lateral, SegmentationRules(longest=longest)).hypotheses
    assert found[0].best_of_level and found[0].lost_to(found[0]) == "chosen"
    assert [h.cost for h in found] == sorted(h.cost for h in found)
    assert all(len(h.chain) < longest for h in found)
    chains = [tuple(tuple(body.markers) for body in h.chain) for h in found]
    assert len(set(chains)) == len(chains)
    for other in found[1:]:
        why = other.lost_to(found[0])
        stated = float(re.match(r"costs ([\d.]+) more", why)[1])
        terms = [
            float(number.replace("\N{MINUS SIGN}", "-")) for number in re.findall(r"\(([+\N{MINUS SIGN}][\d.]+)\)", why)
        ]
        assert stated == pytest.approx(other.cost - found[0].cost, abs=0.05)
        assert sum(terms) == pytest.approx(stated, abs=0.35)  # each of the terms is rounded
