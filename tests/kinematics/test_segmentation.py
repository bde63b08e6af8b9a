"""Number, order and markers of segments from the motion alone."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_id.errors import Refused
from mocap_id.kinematics.clusters import Constraints, find_base
from mocap_id.kinematics.joint import measure_asymmetry
from mocap_id.kinematics.link_fit import SegmentationRules
from mocap_id.kinematics.segmentation import segment_markers


@pytest.mark.parametrize("joints", [1, 2, 3, 4])
@pytest.mark.parametrize("seed", range(5))
def test_clean_chains_are_found_completely(chain, joints: int, seed: int) -> None:
    truth = chain(100 * joints + seed, joints=joints)
    found = segment_markers(truth.points, truth.lateral, SegmentationRules())
    assert found.count == joints + 1
    assert (found.segment == truth.segment).all()


def test_noise_and_gaps_change_nothing(chain) -> None:
    right = 0
    for seed in range(20):
        truth = chain(seed, noise=1e-3, missing=0.05)
        found = segment_markers(truth.points, truth.lateral, SegmentationRules())
        right += bool(found.count == 4 and (found.segment == truth.segment).all())
    assert right == 20


def test_the_noise_floor_is_that_of_the_base(chain) -> None:
    truth = chain(7, noise=8e-4)
    found = segment_markers(truth.points, truth.lateral, SegmentationRules())
    assert found.base.noise == pytest.approx(8e-4, rel=0.1)


def test_a_pair_of_limbs_is_left_out(chain) -> None:
    truth = chain(11)
    angle = np.cumsum(truth.relative, axis=1)
    shoulder = truth.points[:, truth.segment == 3].mean(axis=1)
    t = np.linspace(0, 2 * np.pi, len(shoulder))
    limbs, lateral = [], []
    for side, rhythm in ((0.25, 5.1), (-0.25, 6.7)):
        turn = np.exp(1j * (angle[:, 2] + 0.8 * np.sin(rhythm * t)))
        limbs += [shoulder + turn * place for place in (0.1j, 0.2j + 0.05, 0.3j)]
        lateral += [side] * 3
    points = np.concatenate([truth.points, np.stack(limbs, axis=1)], axis=1)
    found = segment_markers(points, np.concatenate([truth.lateral, lateral]), SegmentationRules())
    assert found.count == 4
    assert (found.segment[: len(truth.segment)] == truth.segment).all()
    assert (found.segment[len(truth.segment) :] == -1).all()


def test_a_malleolus_on_the_axis_joins_the_shank(chain) -> None:
    truth = chain(13, noise=3e-4)
    angle = np.cumsum(truth.relative, axis=1)
    malleolus = truth.centres[0] + np.exp(1j * angle[:, 0]) * (0.001 + 0.001j)
    rng = np.random.default_rng(0)
    malleolus = malleolus + 3e-4 * (rng.standard_normal(len(malleolus)) + 1j * rng.standard_normal(len(malleolus)))
    points = np.concatenate([truth.points, malleolus[:, None]], axis=1)
    found = segment_markers(points, np.append(truth.lateral, 0.0), SegmentationRules())
    assert points.shape[1] - 1 in find_base(points, 0.015, Constraints.of(points.shape[1])).markers
    assert found.segment[-1] == 1


def test_the_count_can_be_given(chain) -> None:
    truth = chain(17)
    found = segment_markers(truth.points, truth.lateral, SegmentationRules(count=3))
    assert found.count == 3


@pytest.mark.parametrize(
    ("points", "code"),
    [
        (np.zeros((100, 6)) + 1e-4 * np.random.default_rng(0).standard_normal((100, 6)) + 0j, "no-motion"),
        (np.linspace(0, 3, 100)[:, None] + np.arange(6) * 0.1j, "no-fixed-base"),
        (np.full((100, 6), np.nan) + 0j, "no-fixed-base"),
        (np.zeros((100, 1)) + 0j, "no-fixed-base"),
    ],
    ids=["standing", "walking", "unseen", "one marker"],
)
def test_a_recording_without_a_chain_on_a_base_is_refused(points: np.ndarray, code: str) -> None:
    with pytest.raises(Refused) as refused:
        segment_markers(points, np.zeros(points.shape[1]), SegmentationRules())
    assert refused.value.code == code


def test_a_body_that_flies_past_still_markers_is_refused() -> None:
    t = np.linspace(0, 1, 200)
    turn = np.exp(0.7j * np.sin(5 * t))
    body = (3 * t + 0.4j)[:, None] + turn[:, None] * np.array([0, 0.2, 0.1j, 0.2j])
    points = np.concatenate([np.zeros((200, 4)) + np.arange(4), body], axis=1)
    with pytest.raises(Refused) as refused:
        segment_markers(points, np.zeros(8), SegmentationRules())
    assert refused.value.code == "no-chain"


def test_asymmetric_sides_are_detected(chain) -> None:
    truth = chain(19)
    points, segment = truth.points.copy(), truth.segment
    lateral = np.where(np.arange(len(segment)) % 2 == 0, 0.15, -0.15)
    assert np.nanmax(measure_asymmetry(points, lateral, segment)) < 1e-6
    hip = truth.centres[0]
    turn = np.exp(1j * np.radians(8) * np.sin(np.linspace(0, 9, len(points))))
    left = np.flatnonzero((segment == 1) & (lateral > 0))
    points[:, left] = hip + turn[:, None] * (points[:, left] - hip)
    apart = np.degrees(measure_asymmetry(points, lateral, segment))
    assert apart[0] == pytest.approx(8 / np.sqrt(2), rel=0.1)
    assert apart[1:] == pytest.approx(0, abs=1e-4)


def test_a_joint_that_explains_little_has_low_confidence(chain) -> None:
    truth = chain(23, joints=1, noise=1e-4)
    sure = segment_markers(truth.points, truth.lateral, SegmentationRules())
    assert sure.confidence.value > 0.95
    rng = np.random.default_rng(0)
    wander = np.cumsum(rng.standard_normal((2, len(truth.points))), axis=1) * 2e-3
    points = truth.points.copy()
    points[:, truth.segment == 1] += (wander[0] + 1j * wander[1])[:, None]
    loose = segment_markers(points, truth.lateral, SegmentationRules())
    assert loose.confidence.value < sure.confidence.value - 0.1
    assert loose.confidence.joints[0] < sure.confidence.joints[0]


def about_the_ankle(truth, *follows: float, radius: float = 4e-3) -> np.ndarray:
    """Return markers (F, k) near the first axis that follow a share of the shank's rotation; 0.1 mm of noise."""
    rng = np.random.default_rng(0)
    angle = truth.relative[:, :1]
    marks = truth.centres[0] + radius * np.exp(1j * (0.3 + angle * np.array(follows)))
    return marks + 1e-4 * (rng.standard_normal(marks.shape) + 1j * rng.standard_normal(marks.shape))


def axis_assignment(
    truth, marks: np.ndarray, sides: list[float], constraints: Constraints | None = None
) -> tuple[list[int], float]:
    """Return the segments of the markers near the axis, and the reduction of the confidence by their decision."""
    points = np.concatenate([truth.points, marks], axis=1)
    found = segment_markers(points, np.append(truth.lateral, sides), SegmentationRules(), constraints)
    count = len(truth.segment)
    assert (found.segment[:count] == truth.segment).all()
    return found.segment[count:].tolist(), found.confidence.against["axis"]


def test_left_and_right_malleolus_are_judged_together(chain) -> None:
    """A malleolus with lagging skin follows its counterpart."""
    truth = chain(13, noise=1e-4)
    marks = about_the_ankle(truth, 0.35, 0.9)
    assert axis_assignment(truth, marks, [-0.15, 0.15])[0] == [1, 1]
    assert axis_assignment(truth, marks, [0.15, 0.15])[0] == [0, 1]  # both on the same side: no pair
    away = marks + np.array([0.05, 0.0])
    assert axis_assignment(truth, away, [-0.15, 0.15])[0] == [0, 1]  # 5 cm apart: no pair


def test_a_close_decision_about_the_axis_reduces_the_confidence(chain) -> None:
    truth = chain(13, noise=1e-4)
    doubts = {}
    for follows in (0.0, 0.2, 0.45, 0.8, 1.0):
        (segment,), doubts[follows] = axis_assignment(truth, about_the_ankle(truth, follows), [0.0])
        assert segment == (follows > 0.4)
    assert doubts[0.45] > max(doubts[0.2], doubts[0.8])
    assert doubts[0.0] == doubts[1.0] == 0


def test_two_markers_stay_with_the_base(chain) -> None:
    truth = chain(13, noise=1e-4)
    marks = about_the_ankle(truth, 1.0, 1.0, 1.0)
    left = 5  # two base markers and three near the axis
    points, lateral = np.concatenate([truth.points, marks], axis=1)[:, 2:], np.append(truth.lateral, [0.0] * 3)[2:]
    for kept in (left, left - 1, left - 2):
        found = segment_markers(points, lateral, SegmentationRules())
        assert len(found.segment) == kept + 15
        assert (found.segment == 0).sum() == 2
        points, lateral = points[:, 1:], lateral[1:]


def test_a_marker_kept_apart_from_the_shank_stays_on_the_base(chain) -> None:
    truth = chain(13, noise=1e-4)
    marks, last = about_the_ankle(truth, 1.0, 1.0), len(truth.segment)
    assert axis_assignment(truth, marks, [0.1, 0.1])[0] == [1, 1]
    one = Constraints.of(last + 2, (), [[last, 5]])
    assert axis_assignment(truth, marks, [0.1, 0.1], one)[0] == [0, 1]
    other = Constraints.of(last + 2, (), [[last, last + 1]])
    assert sorted(axis_assignment(truth, marks, [0.1, 0.1], other)[0]) == [0, 1]
    still = Constraints.of(last + 2, [[last, 0]])
    assert axis_assignment(truth, marks, [0.1, 0.1], still)[0] == [0, 1]
