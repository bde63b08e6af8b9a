"""Confidence in the segments, and the effect of each piece of evidence."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocap_id.kinematics.joint import PairJoint
from mocap_id.kinematics.segmentation import Confidence, assess_confidence, explained_share


def reading(segments: int, cost: float, wander: float = 2e-3) -> Any:
    """Return a hypothesis with this number of moving segments, joint residual (m) and cost."""
    joint = PairJoint(0j, 0j, wander, 1.0)
    return SimpleNamespace(chain=(None,) * segments, joints=(joint,) * segments, cost=cost, best_of_level=True)


def judged(
    *,
    ratios: tuple[float, ...] = (6.0, 6.0, 3.0),
    explained: float = 1.0,
    margin: float = 4.0,
    gap: float = 9.0,
    wander: float = 2e-3,
    behind: float = 40.0,
) -> Confidence:
    """Return the confidence of a clear case, except for the given arguments."""
    best, other = reading(len(ratios), 10.0, wander), reading(len(ratios) + 1, 10.0 + behind)
    return assess_confidence((best, other), ratios, explained, margin, gap)


WORSE = {
    "skipped": ("ratios", [(r, 6.0, 3.0) for r in (3.5, 3.0, 2.0, 1.2)]),
    "left-out": ("explained", [1.0, 0.9, 0.6, 0.3]),
    "axis": ("margin", [2.0, 1.6, 1.2, 1.0]),
    "first-joint": ("wander", [8e-3, 1e-2, 2e-2, 5e-2]),
    "base": ("gap", [2.0, 1.8, 1.4, 1.0]),
    "runner-up": ("behind", [20.0, 10.0, 3.0, 0.0]),
}


def test_without_evidence_against_it_confidence_is_high_but_not_one() -> None:
    sure = judged()
    assert set(sure.against) == set(WORSE)
    assert list(sure.against.values()) == [0.0] * 6
    assert 0.95 < sure.value < 1


@pytest.mark.parametrize("evidence", WORSE)
def test_worse_evidence_reduces_the_confidence_more(evidence: str) -> None:
    argument, values = WORSE[evidence]
    found = [judged(**{argument: value}) for value in values]
    assert found[0].value == judged().value  # no reduction at the limit
    assert (np.diff([each.value for each in found]) < 0).all()
    assert (np.diff([each.against[evidence] for each in found]) > 0).all()
    for each in found:
        assert min(each.against.values()) >= 0
        assert [name for name, off in each.against.items() if off > 0] in ([], [evidence])
        odds = np.log(each.value / (1 - each.value))
        sure = judged().value
        assert odds == pytest.approx(np.log(sure / (1 - sure)) - sum(each.against.values()))


@pytest.mark.parametrize("seed", range(20))
def test_better_evidence_never_reduces_the_confidence(seed: int) -> None:
    rng = np.random.default_rng(seed)
    case = {
        "ratios": tuple(rng.uniform(1, 6, 3)),
        "explained": rng.uniform(0.2, 1),
        "margin": rng.uniform(1, 3),
        "gap": rng.uniform(1, 3),
        "wander": rng.uniform(1e-3, 3e-2),
        "behind": rng.uniform(0, 30),
    }
    before = judged(**case)
    assert 0 < before.value < 1
    assert min(before.against.values()) >= 0
    for name, value in case.items():
        factor = 0.7 if name == "wander" else 1.3
        better = tuple(factor * r for r in value) if name == "ratios" else factor * value
        assert judged(**{**case, name: better}).value >= before.value


def test_the_limits() -> None:
    """Without alternatives nothing is subtracted; with all evidence against it almost nothing is left."""
    alone = assess_confidence((reading(1, 3.0),), (np.inf,), 1.0, np.inf, np.inf)
    assert list(alone.against.values()) == [0.0] * 6
    assert alone.value == judged().value
    exact = assess_confidence((reading(1, 3.0, wander=0.0),), (5.0,), 1.0, np.inf, np.inf)
    assert exact.value == alone.value
    worst = judged(ratios=(0.0, 0.0, 0.0), explained=0.0, margin=1.0, gap=1.0, wander=1.0, behind=0.0)
    assert 0 <= worst.value < 1e-6
    assert np.isfinite(list(worst.against.values())).all()


def test_the_weakest_joint_relative_to_its_limit_counts() -> None:
    assert judged(ratios=(9.0, 9.0, 1.5)).against["skipped"] == 0
    assert judged(ratios=(9.0, 1.5, 9.0)).against["skipped"] > 0
    assert judged(ratios=(2.0, 1.75, 0.75)).against == judged(ratios=(1.75, 9.0, 9.0)).against
    assert judged(ratios=(3.5, 3.5, 1.5)).joints == pytest.approx((0.5, 0.5, 0.5))
    assert judged(ratios=(7.0, 3.5, 3.0)).joints == pytest.approx((2 / 3, 0.5, 2 / 3))


def test_only_hypotheses_with_another_number_of_segments_count_as_runner_up() -> None:
    best, twin, rival = reading(3, 10.0), reading(3, 10.1), reading(2, 16.0)
    args = ((6.0, 6.0, 3.0), 1.0, 4.0, 9.0)
    assert assess_confidence((best, twin), *args).against["runner-up"] == 0
    assert assess_confidence((best, twin, rival), *args).against == assess_confidence((best, rival), *args).against
    assert assess_confidence((best, rival), *args).against["runner-up"] == pytest.approx(0.4 * np.log(21 / 7))


def test_limbs_at_the_side_do_not_reduce_the_confidence() -> None:
    segment = np.array([0, 0, 1, 1, 2, 2, -1, -1])
    moving = np.arange(2, 8)
    lateral = np.array([0.3, -0.3, 0.1, -0.1, 0.15, -0.15, 0.4, -0.4])
    assert explained_share(segment, lateral, moving) == 1.0
    inside = lateral.copy()
    inside[6] = 0.12
    assert explained_share(segment, inside, moving) == pytest.approx(4 / 5)
    inside[7] = -0.15
    assert explained_share(segment, inside, moving) == pytest.approx(4 / 6)


def test_the_share_does_not_depend_on_position_and_direction_of_the_plane() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        segment = np.concatenate([[0, 0, 1, 1, 2, 2], rng.integers(-1, 3, 10)])
        lateral = rng.normal(scale=0.2, size=16)
        moving = np.flatnonzero(segment != 0)
        share = explained_share(segment, lateral, moving)
        assert 0 < share <= 1
        assert explained_share(segment, -lateral, moving) == share
        assert explained_share(segment, lateral + 3.0, moving) == pytest.approx(share)
        assert explained_share(np.maximum(segment, 1), lateral, moving) == 1.0


def test_a_leftover_still_marker_is_not_a_moving_one() -> None:
    segment = np.array([0, -1, 1, 1])
    assert explained_share(segment, np.zeros(4), np.array([2, 3])) == 1.0
